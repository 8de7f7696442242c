"""What the demonstration commands do."""

import datetime
import importlib.metadata
from pathlib import Path

import jax
import numpy as np

from crsfd_jax.demos import builtin, dataset, exchange, record, replay
from crsfd_jax.demos.options import Record
from crsfd_jax.demos.provenance import Provenance, obs_layout
from crsfd_jax.errors import UserError
from crsfd_jax.physics.interface import CONTROL_DT

_PACKAGES = ("crsfd-jax", "jax", "mujoco", "numpy")
_TRIALS = 200


def record_file(options: Record, command: str) -> int:
    """Trains the expert, records it and writes the file."""
    if Path(options.out).exists():
        raise UserError(
            f"--out: got {options.out!r}, which exists, allowed: a new file; choose another name"
        )

    def report(env_steps: int, success: float) -> None:
        print(f"expert: {env_steps:7d} steps, success {success:.2f}", flush=True)

    print(f"training the expert of shape {options.shape}", flush=True)
    expert = record.train_expert(options, report)
    trial_key, key = jax.random.split(jax.random.key(options.seed + 1))
    trials = record.flatten(record.play(options, expert, trial_key, _TRIALS))
    rate = float(trials.terminated.sum()) / _TRIALS
    episodes = record.play(options, expert, key, options.episodes)
    source = _provenance(options, expert, rate, command)
    steps = record.flatten(episodes)
    demos = dataset.Demonstrations(
        obs=np.asarray(steps.obs),
        action=np.asarray(steps.action),
        reward=np.asarray(steps.reward),
        next_obs=np.asarray(steps.next_obs),
        terminated=np.asarray(steps.terminated),
        truncated=np.asarray(steps.truncated),
        episode_length=episodes.length,
        start_qpos=episodes.start_qpos,
        socket_offset=episodes.socket_offset,
        provenance=source,
    )
    dataset.save(options.out, demos)
    print(dataset.describe(demos))
    print(f"written to {options.out}")
    return 0


def show(name: str) -> int:
    """Prints what a file holds."""
    print(dataset.describe(builtin.load(name)))
    return 0


def import_demos(source: str, out: str) -> int:
    """Writes a demonstration file from another format."""
    print(dataset.describe(exchange.import_file(source, out)))
    print(f"written to {out}; python -m crsfd_jax.demos check {out} replays it")
    return 0


def export_demos(name: str, form: str, out: str) -> int:
    """Writes another format from a demonstration file."""
    print(f"written to {exchange.export_file(name, form, out)}")
    return 0


def check(name: str) -> int:
    """Replays a file; 1 if an episode that the file calls successful does not insert."""
    played = replay.replay(builtin.load(name))
    total, lost = len(played.success), int((played.recorded_success & ~played.success).sum())
    print(f"recorded  {played.recorded_success.sum()} of {total} episodes successful")
    print(f"replayed  {played.success.sum()} of {total} episodes successful")
    print(f"largest distance of recorded and replayed tip {played.deviation.max() * 1e3:.3f} mm")
    if lost:
        print(f"{lost} episodes that the file calls successful do not insert here")
    return 1 if lost else 0


def _provenance(options: Record, expert: record.Expert, rate: float, command: str) -> Provenance:
    mdp = options.mdp
    return Provenance(
        shape=options.shape,
        clearance_m=options.scene.clearance,
        shift_m=0.0,
        control_dt_s=CONTROL_DT,
        obs_layout=obs_layout(),
        action_scale=mdp.action_scale,
        expert=f"SAC under a dense reward, {expert.env_steps} environment steps",
        expert_success_rate=rate,
        noise=options.noise,
        seed=options.seed,
        command=command,
        versions={name: importlib.metadata.version(name) for name in _PACKAGES},
        date=datetime.datetime.now(datetime.UTC).date().isoformat(),
    )
