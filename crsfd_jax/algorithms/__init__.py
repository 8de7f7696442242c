"""The learning methods: a file each, found by its name."""

import importlib
from collections.abc import Iterator
from typing import Any

from crsfd_jax.algorithms.method import Method
from crsfd_jax.config import Config, to_dict
from crsfd_jax.errors import UserError
from crsfd_jax.learn import replay
from crsfd_jax.options.names import by_full_name


def load(name: str) -> Method:
    """The method of crsfd_jax/algorithms/NAME.py."""
    return importlib.import_module(f"crsfd_jax.algorithms.{name}").METHOD


def refuse_replaced(config: Config) -> None:
    """Refuses a value that was asked for and that the method would put another in the place of.

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
    if config.sac.warmup == "demos" and not (method.uses_demos and method.interacts):
        yield "sac.warmup", "demos", "has none to imitate"
    by_priority = method.uses_demos and method.draw is replay.draw
    if config.replay.draw_demos != "auto" and not by_priority:
        yield "replay.draw_demos", config.replay.draw_demos, "does not draw by priority"
    usual, given, used = (
        by_full_name(to_dict(each)) for each in (Config(), config, method.configure(config))
    )
    for name, value in given.items():
        if value not in (usual[name], used[name]):
            yield name, value, f"always has {used[name]}"
