"""Every option of a run and its default, as frozen dataclasses. SI units inside.

This is the only place that knows a default. It imports neither jax nor mujoco, so that a
bad command line is answered at once.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Annotated, Literal

import tyro

from crsfd_jax.units import format_length, parse_length

SHAPES = ("0", "1", "2", "3", "4")

_LENGTH_SPEC = tyro.constructors.PrimitiveConstructorSpec(
    nargs=1,
    metavar="LENGTH",
    instance_from_str=lambda args: parse_length(args[0]),
    is_instance=lambda value: isinstance(value, float),
    str_from_instance=lambda value: [format_length(value)],
)
Length = Annotated[float, _LENGTH_SPEC]
"""A float in metres that the command line reads with its unit, such as 8mm."""


@dataclass(frozen=True)
class Scene:
    """The parts and the arm's surroundings."""

    clearance: Length = 1e-3
    """Width of the hole minus width of the peg (both sides together)."""
    footprint: Length = 0.04
    """Side of the square that the digit fills."""
    friction: float = 1.0
    """Sliding friction coefficient between peg and socket."""


@dataclass(frozen=True)
class Mdp:
    """The insertion task as a Markov decision process."""

    horizon: int = 50
    """Control steps (0.1 s each) after which an episode is truncated."""
    translation_scale: Length = 0.01
    """Setpoint displacement for an action of 1 along a translation axis."""
    rotation_scale: float = 0.05
    """Setpoint rotation for an action of 1 about a rotation axis, rad."""


@dataclass(frozen=True)
class Sac:
    """Soft actor-critic."""

    hidden: tuple[int, ...] = (128, 128)
    """Widths of the hidden layers of actor and critics."""
    learning_rate: float = 5e-4
    """Adam step size of actor, critics and temperature."""
    gamma: float = 0.98
    """Discount of the new task, gamma_k in the paper; the same for every method."""
    tau: float = 0.005
    """Polyak rate of the target critics."""
    batch_size: int = 128
    """Transitions in a gradient update."""
    updates_per_step: int = 16
    """Gradient updates after each vector step of all environments."""
    initial_alpha: float = 0.02
    """Entropy temperature at the start; it is tuned automatically from there."""
    target_entropy: float = -3.0
    """Entropy that the temperature is tuned towards, nats."""
    warmup_steps: int = 2000
    """Environment steps with uniform random actions before the first update."""


@dataclass(frozen=True)
class Replay:
    """The prioritised buffer that keeps demonstrations and experience."""

    capacity: int = 300_000
    """Transitions kept besides the demonstrations, which are never overwritten."""
    priority_exponent: float = 0.6
    """Exponent a of the drawing probability p^a / sum p^a."""
    importance_exponent: float = 0.4
    """Exponent b of the importance weight (N P)^-b; at 1 prioritising cancels out."""
    priority_floor: float = 1e-3
    """Added to every priority."""
    demo_bonus: float = 0.1
    """Added to the priority of a demonstration."""
    n_step: int = 3
    """Length of the n-step return used beside the 1-step return."""
    n_step_weight: float = 1.0
    """Weight of the n-step critic loss, lambda_1 of DDPGfD; 0 switches it off."""


@dataclass(frozen=True)
class Potential:
    """The conservative value function of Algorithm 1."""

    gamma: float = 0.95
    """Discount of the demonstrated task, gamma_0 in the paper; below --sac.gamma."""
    free_space_weight: float = 0.1
    """Weight lambda of the regression of free-space states to zero."""
    free_space_extent: float = 3.0
    """Half width of the sampled free space, in workspaces."""
    steps: int = 4000
    """Regression steps n_r."""
    batch_size: int = 256
    """Demonstration states, and as many free-space states, in a regression step."""
    learning_rate: float = 1e-3
    """Adam step size."""
    hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers."""
    terminal: Literal["zero", "keep"] = "zero"
    """Potential of the success state: zero (Ng et al. 1999) or kept as fitted."""


@dataclass(frozen=True)
class Evaluation:
    """Evaluation with the deterministic policy on fresh episodes."""

    every: int = 10_000
    """Environment steps of each seed between two evaluations."""
    episodes: int = 50
    """Episodes of each seed in an evaluation."""


@dataclass(frozen=True)
class Config:
    """Learns to insert a peg from demonstrations of another insertion task."""

    shape: str = "2"
    """Digit of the peg and its socket: 0, 1, 2, 3 or 4."""
    shift: Length = 0.0
    """Side of the square in which the socket's unknown offset is drawn, such as 8mm."""
    algorithm: str = "crsfd"
    """Learning method."""
    seeds: int = 5
    """Number of seeds, trained side by side in one compiled program."""
    seed: int = 0
    """First seed; the others follow it."""
    steps: int = 60_000
    """Environment steps of each seed."""
    engine: Literal["auto", "native", "mjx", "warp"] = "auto"
    """Physics engine; auto is mjx on an accelerator and native on a CPU."""
    envs: int = 64
    """Environments of each seed."""
    demos: str = "builtin"
    """Demonstration file, or builtin for the 40 shipped episodes of shape 0."""
    out: str = ""
    """Run folder; empty for a name made of the options, under runs/."""
    smoke: bool = False
    """Shrink everything to a quick check that the whole path works."""
    scene: Scene = field(default_factory=Scene)
    mdp: Mdp = field(default_factory=Mdp)
    sac: Sac = field(default_factory=Sac)
    replay: Replay = field(default_factory=Replay)
    potential: Potential = field(default_factory=Potential)
    evaluation: Evaluation = field(default_factory=Evaluation)


def to_dict(config: Config) -> dict:
    """Plain nested dict of every value, as written to config.json."""
    return dataclasses.asdict(config)
