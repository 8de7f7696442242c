"""What options are called in figures and tables, with their units."""

import re
from collections.abc import Callable, Mapping
from typing import Any

from crsfd_jax.options.names import show
from crsfd_jax.options.randomisation import TRAINING, Randomisation

_PREFIX = "randomisation."
DRAWN = {TRAINING: "randomised", Randomisation(): "no randomisation"}
"""What the usual ranges are called."""
_MOST = 3
"""Options that are named; dots stand for more."""


def in_words(changed: Mapping[str, Any], drawn: Randomisation) -> str:
    """Options and their values; one word stands for those that make a run small, or that draw.

    Args:
      drawn: all that the run draws.
    """
    if "smoke" in changed:
        return "smoke" if changed["smoke"] else "no smoke"
    rest = {name: value for name, value in changed.items() if not name.startswith(_PREFIX)}
    words = _drawn(drawn) if len(rest) < len(changed) else []
    words += [_in_words(name, value) for name, value in rest.items()]
    return ", ".join(words[:_MOST]) + ", ..." * (len(words) > _MOST)


def by_size(said: str) -> list[tuple[bool, float, str]]:
    """Sorts words by the size of the numbers in them, no words first: 5 before 10."""
    parts = filter(None, re.split(r"(\d+\.?\d*)", said))
    return [(False, float(p), "") if p[0].isdigit() else (True, 0.0, p) for p in parts]


def counted(number: int, noun: str) -> str:
    """Such as 1 seed, or 5 seeds."""
    return f"{number} {noun}{'s' * (number != 1)}"


def _drawn(drawn: Randomisation) -> list[str]:
    if drawn in DRAWN:
        return [DRAWN[drawn]]
    usual = vars(Randomisation())
    changed = (name for name, value in vars(drawn).items() if value != usual[name])
    return [_in_words(f"{_PREFIX}{name}", getattr(drawn, name)) for name in changed]


def _in_words(name: str, value: Any) -> str:
    return _WORDS[name](value) if name in _WORDS else f"{name.removeprefix(_PREFIX)} {show(value)}"


def _millimetres(metres: float) -> str:
    return f"{metres * 1e3:g} mm"


def _demonstrations(count: int) -> str:
    return f"{count or 'all'} demonstration{'s' * (count != 1)}"


def _turned(radians: tuple[float, ...]) -> str:
    return f"hole turned by {show(radians, ' to ')} rad"


_WORDS: dict[str, Callable[[Any], str]] = {
    "demo_episodes": _demonstrations,
    "demos": lambda file: f"demonstrations {file.removesuffix('.npz')}",
    "scene.clearance": lambda metres: f"clearance {_millimetres(metres)}",
    "randomisation.socket_yaw": _turned,
    "sac.gamma": lambda gamma: f"gamma_k {gamma:g}",
    "sac.actor_tau": lambda tau: (
        "newest actor" if tau == 1 else f"actor averaged with rate {tau:g}"
    ),
    "sac.warmup": lambda word: {
        "random": "warm-up at random",
        "demos": "warm-up by demonstrations",
        "auto": "usual warm-up",
    }[word],
    "sac.initial_alpha": lambda alpha: f"temperature {alpha:g} at the start",
    "sac.reward_scale": lambda scale: f"rewards times {scale:g}",
    "potential.gamma": lambda gamma: f"gamma_0 {gamma:g}",
    "potential.free_space_weight": lambda weight: f"lambda {weight:g}",
    "replay.draw_demos": lambda word: {
        "yes": "demonstrations in batches",
        "no": "no demonstrations in batches",
        "auto": "demonstrations in batches as usual",
    }[word],
    "potential.terminal": lambda word: f"potential at success {word.replace('keep', 'kept')}",
    "potential.spread": lambda metres: (
        "usual spread" if metres is None else f"demonstrations spread {_millimetres(metres)}"
    ),
}
