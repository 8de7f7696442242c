"""Every option of a run and its default, as frozen dataclasses. SI units inside.

Those of `randomisation` are in options/randomisation.py. Neither imports jax or mujoco, so that a
bad command line is answered at once.
"""

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from crsfd_jax.options import shapes
from crsfd_jax.options.field_types import (
    AUTO,
    Count,
    Discount,
    Engine,
    Envs,
    Fraction,
    Length,
    PositiveRate,
    Seed,
    Shape,
    Shift,
    Steps,
    Weight,
    Widths,
)
from crsfd_jax.options.limits import Interval, OneOf
from crsfd_jax.options.randomisation import Randomisation

SHAPES = tuple(shapes.GRIDS)
STEPS, SEARCHING_STEPS = 40_000, 300_000
"""Environment steps to learn a shape whose hole is in place, and one that must be searched for."""
_METHOD_FILES = (Path(__file__).parent / "algorithms").glob("*.py")
ALGORITHMS = tuple(sorted({path.stem for path in _METHOD_FILES} - {"__init__", "method"}))
"""A method is a file of its own name."""


@dataclass(frozen=True)
class Scene:
    """The parts and the arm's surroundings."""

    clearance: Annotated[Length, Interval(0, 0.005, open="low")] = 1e-3
    """Width of the hole minus width of the peg (both sides together)."""
    footprint: Annotated[Length, Interval(0.01, 0.08)] = 0.04
    """Side of the square that the digit fills."""
    friction: Annotated[float, Interval(0, 10, open="low")] = 1.0
    """Sliding friction coefficient between peg and socket."""


@dataclass(frozen=True)
class Mdp:
    """The insertion task as a Markov decision process."""

    horizon: Annotated[int, Interval(1, 100_000)] = 50
    """Control steps (0.1 s each) after which an episode is truncated."""
    translation_scale: Annotated[Length, Interval(0, 0.1, open="low")] = 0.01
    """Setpoint displacement for an action of 1 along a translation axis."""
    rotation_scale: PositiveRate = 0.05
    """Setpoint rotation for an action of 1 about a rotation axis, rad."""

    @property
    def action_scale(self) -> list[float]:
        """[6] m and rad, setpoint displacement for an action of 1."""
        return [self.translation_scale] * 3 + [self.rotation_scale] * 3


@dataclass(frozen=True)
class Sac:
    """Soft actor-critic."""

    hidden: Widths = (128, 128)
    """Widths of the hidden layers of actor and critics."""
    critics: Annotated[int, Interval(1, 100)] = 2
    """Critics in the ensemble; targets and actor take the smallest of their values."""
    learning_rate: PositiveRate = 5e-4
    """Adam step size of actor, critics and temperature."""
    gamma: Discount = 0.98
    """Discount of the new task, gamma_k in the paper; the same for every method."""
    reward_scale: Annotated[float, Interval(0, 1000, open="low")] = 16.0
    """Factor on all rewards that are learned from, potentials included; priorities are without."""
    tau: PositiveRate = 0.005
    """Polyak rate of the target critics."""
    actor_tau: Annotated[float, Interval(0, 1, open="low")] = 0.005
    """Polyak rate of the averaged actor, which is evaluated and kept; 1 for the actor that learns,
    as it is."""
    batch_size: Annotated[int, Interval(1, 65_536)] = 128
    """Transitions in a gradient update."""
    updates_per_step: Annotated[int, Interval(1, 10_000)] = 16
    """Gradient updates after each vector step of all environments."""
    initial_alpha: Annotated[float, Interval(0, 100, open="low")] = 0.02
    """Entropy temperature at the start; it is tuned automatically from there."""
    target_entropy: Annotated[float, Interval(-1000, 1000)] = -3.0
    """Entropy that the temperature is tuned towards, nats."""
    warmup_steps: Annotated[int, Interval(0, 1_000_000_000)] = 2000
    """Environment steps before the first update."""
    warmup: Literal["auto", "random", "demos"] = "auto"
    """Actions until then. random: uniform; demos: what was demonstrated at the nearest tip pose,
    with noise; auto: demos where they are in no batch (--replay.draw-demos), else random."""


@dataclass(frozen=True)
class Replay:
    """The prioritised buffer that keeps demonstrations and experience."""

    capacity: Count = 307_200
    """Most transitions kept besides the demonstrations, a multiple of --envs."""
    priority_exponent: Fraction = 0.6
    """Exponent a of the drawing probability p^a / sum p^a."""
    importance_exponent: Fraction = 0.4
    """Exponent b of the importance weight (N P)^-b; at 1 prioritising cancels out."""
    priority_floor: Annotated[float, Interval(0, 1000, open="low")] = 1e-3
    """Added to every priority."""
    demo_bonus: Weight = 0.1
    """Added to the priority of a demonstration."""
    draw_demos: Literal["auto", "yes", "no"] = "auto"
    """Whether demonstrations are drawn into batches; auto: for CRSfD and RS-GM unless the socket
    may stand in a wider square than theirs, for GAIL, GAIfO and POfD never, for others always."""
    n_step: Annotated[int, Interval(1, 1000)] = 3
    """Length of the n-step return used beside the 1-step return."""
    n_step_weight: Weight = 1.0
    """Weight of the n-step critic loss, lambda_1 of DDPGfD; 0 switches it off."""


@dataclass(frozen=True)
class Potential:
    """The conservative value function of Algorithm 1."""

    gamma: Discount = 0.95
    """Discount of the demonstrated task, gamma_0 in the paper; at most --sac.gamma."""
    free_space_weight: Weight = 0.1
    """Weight lambda of the regression of free-space states to zero."""
    free_space_extent: Annotated[float, Interval(0, 1000, open="low")] = 3.0
    """Half width of the sampled free space, in workspaces."""
    steps: Annotated[int, Interval(0, 10_000_000)] = 4000
    """Regression steps n_r."""
    batch_size: Annotated[int, Interval(1, 65_536)] = 256
    """Demonstration states, and as many free-space states, in a regression step."""
    learning_rate: PositiveRate = 1e-3
    """Adam step size."""
    hidden: Widths = (64, 64)
    """Widths of the hidden layers."""
    spread: Shift | None = None
    """Side of the square in which demonstrated positions are moved about in the regression, since
    the socket may stand anywhere in it; --shift less that of the demonstrations if not given, 0mm
    for the paper's potential."""
    terminal: Literal["zero", "keep"] = "keep"
    """Potential of the success state: kept as fitted, or zero (Ng et al. 1999)."""


@dataclass(frozen=True)
class Evaluation:
    """Evaluation with the deterministic policy on fresh episodes."""

    every: Count = 2_048
    """Environment steps of each seed between two evaluations."""
    episodes: Annotated[int, Interval(1, 1_000_000)] = 50
    """Episodes of each seed in an evaluation."""


@dataclass(frozen=True)
class Config:
    """Learns to insert a peg from demonstrations of another insertion task.

    `--and` between two command lines trains both runs in one program; they may differ in shape,
    shift and seeds.
    """

    shape: Shape = "2"
    """Peg and socket: 0, 1, 2, 3, 4, a text file with a grid of # and ., all, or several such as
    0,2: each episode then draws its own."""
    shift: Shift = 0.0
    """Side of the square of the socket's unknown offsets: 8mm is up to 4 mm either way."""
    algorithm: Annotated[str, OneOf(ALGORITHMS)] = "crsfd"
    """Learning method: a file of crsfd_jax/algorithms (docs/method.md)."""
    seeds: Annotated[int, Interval(1, 10_000)] = 5
    """Number of seeds, trained side by side in one compiled program."""
    seed: Seed = 0
    """First seed; the others follow it."""
    steps: Steps = AUTO
    """Environment steps of each seed; auto: 40,000, or 300,000 where the hole may have moved."""
    target: Fraction = 0.0
    """Final success rate below which the run ends with exit code 1."""
    engine: Engine = "auto"
    """Physics engine; auto is mjx on an accelerator and native on a CPU."""
    envs: Envs = 64
    """Environments of each seed."""
    demos: str = "builtin"
    """Demonstration file, or builtin for the 40 shipped episodes of shape 0."""
    demo_episodes: Annotated[int, Interval(0, 10_000)] = 0
    """Episodes used, the first of the file; all if 0."""
    out: str = ""
    """Run folder; under runs/ if empty, named by method, task, seeds and what is not usual."""
    log: Literal["none", "tensorboard", "wandb"] = "none"
    """Also give metrics.csv to TensorBoard or Weights & Biases, inside the run folder."""
    clips: bool = False
    """Write a short film of the first seed's policy at each evaluation, clips/STEPS.gif; it needs
    OpenGL, takes some seconds each, and changes nothing that is learned."""
    smoke: bool = False
    """A quick check that the whole path works: at most 2 seeds, 4,096 steps and 16 environments,
    and little of all else, also where more is asked for."""
    scene: Scene = field(default_factory=Scene)
    randomisation: Randomisation = field(default_factory=Randomisation)
    mdp: Mdp = field(default_factory=Mdp)
    sac: Sac = field(default_factory=Sac)
    replay: Replay = field(default_factory=Replay)
    potential: Potential = field(default_factory=Potential)
    evaluation: Evaluation = field(default_factory=Evaluation)

    def __post_init__(self) -> None:
        if self.steps == AUTO:
            # From here on it is a number, as every other option is a value.
            object.__setattr__(self, "steps", SEARCHING_STEPS if self.shift else STEPS)


def to_dict(config: Config) -> dict:
    """Plain nested dict of every value, as written to config.json."""
    return dataclasses.asdict(config)
