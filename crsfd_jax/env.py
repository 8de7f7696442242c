"""The insertion task as a Markov decision process over batches of environments.

Observation and action follow Guo et al. 2022, section 5.1: proprioception relative to the nominal
socket, blind to its offset, and a 6-D displacement of the end effector at 10 Hz. Reward 1 when the
peg is fully inserted, which terminates; the time limit truncates.
"""

from collections.abc import Callable
from typing import NamedTuple

import flax.struct
import jax
import jax.numpy as jnp
import numpy as np

from crsfd_jax import config, sensing
from crsfd_jax.observation import ACTION_SIZE, CLIP, SCALE
from crsfd_jax.physics.interface import Engine, Limits, PhysicsState, Surroundings
from crsfd_jax.scene import randomize
from crsfd_jax.scene.build import Scene
from crsfd_jax.scene.digits import HOLE_DEPTH
from crsfd_jax.scene.kinematics import (
    Chain,
    chain,
    inverse_kinematics,
    pose,
    rotation_vector,
    tip_pose,
)

SUCCESS_DEPTH = HOLE_DEPTH - 0.0015
"""m below the mouth at which the peg counts as fully inserted."""
SUCCESS_OFFSET = 0.003
"""m, largest distance of tip and socket axis along x or y at success."""
SETPOINT_LOW = (-0.04, -0.04, -HOLE_DEPTH - 0.01, -0.15, -0.15, -0.15)
SETPOINT_HIGH = (0.04, 0.04, 0.08, 0.15, 0.15, 0.15)
"""m and rad, the box that setpoints are clipped to."""


@flax.struct.dataclass(kw_only=True)
class EnvState:
    """N environments between two control steps."""

    physics: PhysicsState
    around: Surroundings
    tip: jax.Array
    """[N, 6] measured position (m) and rotation vector (rad) of the tip, nominal socket frame."""
    obs: jax.Array
    """[N, O]."""
    age: jax.Array
    """[N] int32 control steps since the episode began."""
    commanded: jax.Array | None = None
    """[N, 6] m and rad, the newest setpoint, held next where commands are delayed; None where none
    is."""


@flax.struct.dataclass(kw_only=True)
class Outcome:
    """What a step gave, before any reset; [N] each, next_obs [N, O]."""

    next_obs: jax.Array
    reward: jax.Array
    terminated: jax.Array
    truncated: jax.Array
    finite: jax.Array
    """False where the simulation broke down: the episode ends and must not be stored."""
    tip: jax.Array
    """[N, 6] where the step left the tip, whatever the arm measures."""
    limits: Limits = Limits()
    """What the engine met."""

    @property
    def failed(self) -> jax.Array:
        """[N] The episode ended without success: out of time, or broken down."""
        return self.truncated | ~self.finite

    @property
    def over(self) -> jax.Array:
        """[N] The episode ended."""
        return self.terminated | self.failed


Reward = Callable[[jax.Array, Surroundings, jax.Array], jax.Array]
"""(tip [N, 6], surroundings, terminated [N]) -> reward [N]."""


def sparse_reward(tip: jax.Array, around: Surroundings, terminated: jax.Array) -> jax.Array:
    """1 at full insertion, else 0."""
    return terminated.astype(jnp.float32)


class Env(NamedTuple):
    """Pure functions of a task; `key` draws the episodes that start."""

    reset: Callable[[jax.Array, int], EnvState]
    """(key, N) -> N fresh episodes."""
    step: Callable[[EnvState, jax.Array, jax.Array], tuple[EnvState, Outcome]]
    """(state, action [N, A], key) -> state with ended episodes replaced, outcome of the step."""
    advance: Callable[[EnvState, jax.Array], tuple[EnvState, Outcome]]
    """(state, action [N, A]) -> state with ended episodes left as they ended, outcome."""
    horizon: int


def make(
    engine: Engine,
    scene: Scene,
    mdp: config.Mdp,
    distribution: randomize.Distribution,
    reward: Reward = sparse_reward,
) -> Env:
    """The task on an engine, with the episodes of a distribution."""
    links = chain(scene)
    with jax.ensure_compile_time_eval():
        rest = np.asarray(rest_posture(links))
    arm = distribution.randomisation
    deviation = (arm.position_noise, arm.rotation_noise)

    def reset(key: jax.Array, count: int) -> EnvState:
        physics, around = randomize.draw(distribution, key, count)
        age = jnp.zeros(count, jnp.int32)
        read, noise = sensing.believed(physics, around), sensing.noise(around, age, deviation)
        tip, obs = observe(links, rest, read, jnp.zeros((count, 3)), noise)
        still = None if around.is_delayed is None else setpoint(mdp, tip, jnp.zeros(ACTION_SIZE))
        return EnvState(physics=physics, around=around, tip=tip, obs=obs, age=age, commanded=still)

    def advance(state: EnvState, action: jax.Array) -> tuple[EnvState, Outcome]:
        around, age = state.around, state.age + 1
        target = setpoint(mdp, state.tip, action)
        physics, limits = engine.advance(state.physics, around, command(links, state, target))
        read, noise = sensing.believed(physics, around), sensing.noise(around, age, deviation)
        error = target[..., :3] - tip_pose(links, read.qpos)[0]
        measured, next_obs = observe(links, rest, read, error, noise)
        tip = pose(links, physics.qpos)
        finite = jnp.isfinite(next_obs).all(axis=-1) & jnp.isfinite(physics.warmstart).all(axis=-1)
        terminated = finite & inserted(tip, around)
        truncated = finite & ~terminated & (age >= mdp.horizon)
        outcome = Outcome(
            next_obs=next_obs,
            reward=reward(tip, around, terminated),
            terminated=terminated,
            truncated=truncated,
            finite=finite,
            tip=tip,
            limits=limits,
        )
        newest = None if state.commanded is None else target
        after = EnvState(
            physics=physics, around=around, tip=measured, obs=next_obs, age=age, commanded=newest
        )
        return after, outcome

    def step(state: EnvState, action: jax.Array, key: jax.Array) -> tuple[EnvState, Outcome]:
        going, outcome = advance(state, action)
        return _where(outcome.over, reset(key, len(outcome.over)), going), outcome

    return Env(reset=reset, step=step, advance=advance, horizon=mdp.horizon)


def rest_posture(links: Chain) -> jax.Array:
    """[7] rad, joint angles with the tip in the middle of the start cube."""
    middle = jnp.array([[0.0, 0.0, randomize.START_HEIGHT + randomize.START_HALF_WIDTH]])
    return jax.jit(inverse_kinematics)(links, middle, jnp.zeros((1, 3)))[0][0]


def setpoint(mdp: config.Mdp, tip: jax.Array, action: jax.Array) -> jax.Array:
    """Target of the impedance control: the measured pose displaced by the action, clipped.

    Args:
      tip: [N, 6] m and rad.
      action: [N, 6] in [-1, 1].
    """
    moved = tip + jnp.clip(action, -1.0, 1.0) * jnp.array(mdp.action_scale)
    return jnp.clip(moved, jnp.array(SETPOINT_LOW), jnp.array(SETPOINT_HIGH))


def command(links: Chain, state: EnvState, target: jax.Array) -> jax.Array:
    """[N, 6] what the impedance control pulls the true tip towards during a control step.

    Args:
      target: [N, 6] the setpoint that is asked for; where commands are delayed, the one before is
        in effect.
    """
    return sensing.commanded(links, state.physics, state.around, _held(state, target))


def inserted(tip: jax.Array, around: Surroundings) -> jax.Array:
    """[N] bool: the tip is at the bottom of its socket, and not beside the block."""
    aligned = (jnp.abs(tip[..., :2] - around.socket_offset) < SUCCESS_OFFSET).all(axis=-1)
    return aligned & (tip[..., 2] < -SUCCESS_DEPTH)


def observe(
    links: Chain,
    rest: np.ndarray,
    physics: PhysicsState,
    error: jax.Array,
    noise: jax.Array | None = None,
) -> tuple[jax.Array, jax.Array]:
    """Measured tip pose [N, 6] and observation [N, O].

    Args:
      rest: [7] rad, the joint angles that are observed as zero.
      error: [N, 3] m, setpoint minus tip position.
      noise: [N, 6] m and rad, what the tip's pose is measured too large.
    """
    position, rotation, jacobian = tip_pose(links, physics.qpos)
    tip = jnp.concatenate([position, rotation_vector(rotation)], axis=-1)
    if noise is not None:
        tip, error = tip + noise, error - noise[..., :3]
    twist = jnp.einsum("...ij,...j->...i", jacobian, physics.qvel)
    raw = jnp.concatenate([physics.qpos - rest, physics.qvel, tip, twist, error], axis=-1)
    return tip, jnp.clip(raw / SCALE, -CLIP, CLIP)


def _held(state: EnvState, target: jax.Array) -> jax.Array:
    """[N, 6] the setpoint in effect: the newest, or the one before where commands are delayed."""
    if state.around.is_delayed is None or state.commanded is None:
        return target
    return jnp.where(state.around.is_delayed[:, None], state.commanded, target)


def _where(mask, yes, no):
    def pick(a, b):
        return jnp.where(mask.reshape(mask.shape + (1,) * (a.ndim - mask.ndim)), a, b)

    return jax.tree.map(pick, yes, no)
