"""The options of a task as Python keywords, read and checked as on the command line."""

from crsfd_jax import cli
from crsfd_jax.config import Config


def to_config(
    *,
    shape: str | int | None = None,
    shift: str | None = None,
    friction: float | None = None,
    clearance: str | None = None,
    horizon: int | None = None,
    engine: str | None = None,
) -> Config:
    """The configuration with these values and defaults for the others.

    Lengths carry their unit, such as "8mm".

    Raises:
      UserError: a value cannot be used; the same line as on the command line.
    """
    given = {
        "--shape": shape,
        "--shift": shift,
        "--scene.friction": friction,
        "--scene.clearance": clearance,
        "--mdp.horizon": horizon,
        "--engine": engine,
    }
    argv = [f"{option}={value}" for option, value in given.items() if value is not None]
    return cli.parse(Config, argv)
