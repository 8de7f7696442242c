"""Options of recording demonstrations and their defaults."""

from dataclasses import dataclass, field
from typing import Annotated

import tyro

from crsfd_jax.config import Mdp, Sac, Scene
from crsfd_jax.options.field_types import Count, Engine, Envs, Seed, Shape, Shift
from crsfd_jax.options.limits import Interval


@dataclass(frozen=True)
class Record:
    """Trains an expert with a dense reward and records demonstrations of it."""

    out: str = "demos.npz"
    """File to write; an existing one is not overwritten."""
    shape: Shape = "0"
    """Peg and socket of the demonstrated task: a digit, or a text file with a grid."""
    episodes: Annotated[int, Interval(1, 10_000)] = 40
    """Episodes to record; all are kept, whether they succeed or not."""
    noise: Annotated[float, Interval(0, 100)] = 1.5
    """Factor on the standard deviation of the expert's policy, which makes it sub-optimal."""
    seed: Seed = 0
    """Seed of the expert's training and of its noise."""
    steps: Count = 204_800
    """Environment steps after which training stops, successful or not."""
    enough: Annotated[float, Interval(0, 1)] = 1.0
    """Success rate of the deterministic policy at which training stops."""
    engine: Engine = "auto"
    """Physics engine; auto is mjx on an accelerator and native on a CPU."""
    envs: Envs = 64
    """Environments."""
    scene: Scene = field(default_factory=Scene)
    mdp: Mdp = field(default_factory=Mdp)
    sac: Sac = field(default_factory=lambda: Sac(reward_scale=1.0, actor_tau=1.0))
    """The dense reward has a size of its own, and training stops at the first good actor."""


@dataclass(frozen=True)
class FromRun:
    """Records demonstrations of a run's policy: a task that was learned teaches the next one."""

    run: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="RUN")]
    """Folder of the run."""
    out: str = "demos.npz"
    """File to write; an existing one is not overwritten."""
    seed: str = "best"
    """Seed whose policy is recorded: a number, or best for the one with the most success."""
    shape: Shape | None = None
    """Peg and socket, one shape; the run's own if not given."""
    shift: Shift | None = None
    """Side of the square of the socket's offset, such as 4mm; the run's own if not given."""
    episodes: Annotated[int, Interval(1, 10_000)] = 40
    """Episodes to record; all are kept, whether they succeed or not."""
    noise: Annotated[float, Interval(0, 100)] = 1.0
    """Factor on the standard deviation of the policy; 0 for its mean action."""
