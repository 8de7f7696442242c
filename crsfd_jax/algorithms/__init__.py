"""The learning methods: a file each, found by its name."""

import importlib

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
    method = load(config.algorithm)
    if config.sac.warmup == "demos" and not (method.uses_demos and method.interacts):
        raise UserError(
            f"--sac.warmup: got demos, but {config.algorithm} has none to imitate; leave it out or "
            "choose another --algorithm"
        )
    if config.replay.draw_demos != "auto" and not (
        method.uses_demos and method.draw is replay.draw
    ):
        raise UserError(
            f"--replay.draw-demos: got {config.replay.draw_demos}, but {config.algorithm} does not "
            "draw by priority; leave it out or choose another --algorithm"
        )
    usual, given, used = (
        by_full_name(to_dict(each)) for each in (Config(), config, method.configure(config))
    )
    for name, value in given.items():
        if value not in (usual[name], used[name]):
            option = f"--{name.replace('_', '-')}"
            raise UserError(
                f"{option}: got {value}, but {config.algorithm} always has {used[name]}; leave it "
                "out or choose another --algorithm"
            )
