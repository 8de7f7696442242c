"""The control loop on a simulated arm: how often does an exported policy insert?

Hypothesis: `control_loop.py`, which shares no code with the training environment, inserts as often
as `python -m crsfd_jax.evaluate` says.

Commands:
    python -m crsfd_jax.export RUN --format npz --check
    python experiments/real_arm/simulated_arm.py RUN/export/npz 500
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import control_loop
import jax
import jax.numpy as jnp
import numpy as np
import tyro

from crsfd_jax import cli, config, task
from crsfd_jax.env import inserted
from crsfd_jax.errors import UserError
from crsfd_jax.intervals import wilson_interval
from crsfd_jax.options.limits import Interval
from crsfd_jax.scene import kinematics


class SimulatedArm:
    """A robot for the control loop: one arm of the native engine, started anew by `restart`."""

    def __init__(self, contract: dict):
        does = contract["task"]
        parts = config.Scene(**{k: does[k] for k in ("clearance", "footprint", "friction")})
        options = config.Config(
            shape=does["shape"], shift=does["shift"], scene=parts, engine="native"
        )
        known = task.shapes_known(options)
        engine, self.scene = task.engine("native", parts, known)
        self._reset = jax.jit(task.make_env(options).reset, static_argnums=1)
        self._step = jax.jit(engine.step)
        self._links = kinematics.chain(self.scene)
        self._pose = jax.jit(lambda qpos: kinematics.tip_pose(self._links, qpos))

    def restart(self, seed: int) -> None:
        """Draws the start of an episode and the place of the socket."""
        self.state = self._reset(jax.random.key(seed), 1)

    def read(self):
        """What the arm measures."""
        physics = self.state.physics
        q, dq = np.asarray(physics.qpos[0]), np.asarray(physics.qvel[0])
        position, rotation, jacobian = (np.asarray(x) for x in self._pose(q))
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, position + self.scene.nominal
        return q, dq, pose, jacobian @ dq

    def hold(self, pose: np.ndarray) -> None:
        """Simulates one control period with this setpoint."""
        position = pose[:3, 3] - self.scene.nominal
        vector = kinematics.rotation_vector(jnp.asarray(pose[:3, :3]))
        setpoint = np.concatenate([position, vector])[None].astype(np.float32)
        physics = self._step(self.state.physics, self.state.around, setpoint)
        self.state = self.state.replace(physics=physics)

    def is_inserted(self) -> bool:
        """The truth, which a real arm does not know: at the bottom of its own socket."""
        position = self._pose(self.state.physics.qpos[0])[0]
        return bool(inserted(position[None], self.state.around)[0])


@dataclass(frozen=True)
class Trials:
    """Plays an exported policy on a simulated arm."""

    folder: tyro.conf.Positional[Path]
    """Where `crsfd_jax.export` wrote policy.json."""
    episodes: tyro.conf.Positional[Annotated[int, Interval(1, 1_000_000)]]


def main(argv: list[str]) -> None:
    """Plays episodes and prints the success rate.

    Raises:
      UserError: the folder holds no exported policy.
    """
    options = cli.parse(Trials, argv)
    folder, episodes = options.folder, options.episodes
    try:
        contract, layers = control_loop.load(folder)
    except (OSError, ValueError, KeyError) as error:
        raise UserError(
            f"{folder}: holds no policy that can be read ({error}); write it with "
            "crsfd_jax.export --format npz"
        ) from None
    arm = SimulatedArm(contract)
    successes, wrong = 0, 0
    for seed in range(episodes):
        arm.restart(seed)
        said = control_loop.insert(arm, contract, layers)
        successes += arm.is_inserted()
        wrong += said != arm.is_inserted()
    low, high = wilson_interval(successes, episodes)
    print(
        f"success {successes / episodes:.3f}, 95 % interval {low:.3f} to {high:.3f} "
        f"({successes} of {episodes}); the loop was wrong about {wrong}"
    )


if __name__ == "__main__":
    cli.main(main)
