"""The learning methods: a file each, found by its name."""

import importlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from crsfd_jax.algorithms.method import Method
from crsfd_jax.config import Config, to_dict
from crsfd_jax.errors import UserError
from crsfd_jax.learn import replay
from crsfd_jax.options.names import by_full_name
from crsfd_jax.options.smoke import smoke_sized

_PRIORITIES = ("priority_exponent", "importance_exponent", "priority_floor", "demo_bonus")
_OF_METHODS = "potential."
"""Group of options that the common learner has no use for."""


def load(name: str) -> Method:
    """The method of crsfd_jax/algorithms/NAME.py.

    Raises:
      UserError: the file cannot be executed, or defines no method.
    """
    path = Path(__file__).with_name(f"{name}.py")
    try:
        found = importlib.import_module(f"{__name__}.{name}")
    except Exception as error:
        # The file may be the user's: anything may be wrong in it.
        raise UserError(f"{path}: {type(error).__name__}: {error}; correct the file") from error
    method = getattr(found, "METHOD", None)
    if not isinstance(method, Method):
        raise UserError(f"{path}: METHOD: got {method!r}, expected a Method; define it")
    return method


def refuse_unused(config: Config) -> None:
    """Refuses a value that was asked for and that the method would not use.

    Raises:
      UserError: there is one.
    """
    for name, value, instead in _replaced(load(config.algorithm), config):
        raise UserError(
            f"--{name.replace('_', '-')}: got {value}, but {config.algorithm} {instead}; leave it "
            "out or choose another --algorithm"
        )


def _replaced(method: Method, config: Config) -> Iterator[tuple[str, Any, str]]:
    """Options whose value is not used, the value, and what is so instead."""
    if config.sac.warmup != "auto" and not method.interacts:
        yield "sac.warmup", config.sac.warmup, "does not act before it is evaluated"
    elif config.sac.warmup == "demos" and not method.uses_demos:
        yield "sac.warmup", "demos", "has none to imitate"
    by_priority = method.uses_demos and method.draw is replay.draw
    if config.replay.draw_demos != "auto" and not by_priority:
        yield "replay.draw_demos", config.replay.draw_demos, "does not draw by priority"
    default = smoke_sized(Config()) if config.smoke else Config()
    usual, given, used = (
        by_full_name(to_dict(each)) for each in (default, config, method.configure(config))
    )
    unused = {*_unused(method, usual)}
    for name, value in given.items():
        if value not in (usual[name], used[name]):
            yield name, value, f"always has {used[name]}"
        elif value != usual[name] and name in unused:
            yield name, value, "has no use for it"


def _unused(method: Method, names: Iterable[str]) -> Iterator[str]:
    """Options that mean something to other methods only."""
    yield from method.idle
    weighs = method.configure(Config()).replay.priority_exponent > 0
    if method.draw is not replay.draw or not weighs:
        yield from (f"replay.{name}" for name in _PRIORITIES)
    for name in names:
        own = any(f"{name}.".startswith(f"{each}.") for each in method.options)
        if name.startswith(_OF_METHODS) and not own:
            yield name
