"""Kinds of option values: numbers with their ranges, lengths with units, shapes."""

from typing import Annotated, Literal

import tyro

from crsfd_jax.options import shapes
from crsfd_jax.options.limits import Interval, Ranges, ReadBy, ShownAs
from crsfd_jax.options.units import format_length, parse_length

_LENGTH_SPEC = tyro.constructors.PrimitiveConstructorSpec(
    nargs=1,
    metavar="LENGTH",
    instance_from_str=lambda args: parse_length(args[0]),
    is_instance=lambda value: isinstance(value, float),
    str_from_instance=lambda value: [format_length(value)],
)
Length = Annotated[float, _LENGTH_SPEC, ShownAs(format_length)]
"""A float in metres that the command line reads with its unit, such as 8mm."""
_SHAPE_SPEC = tyro.constructors.PrimitiveConstructorSpec(
    nargs=1,
    metavar="SHAPE",
    instance_from_str=lambda args: shapes.inlined(args[0]),
    is_instance=lambda value: isinstance(value, str),
    str_from_instance=lambda value: [value],
)
Shape = Annotated[str, _SHAPE_SPEC, ReadBy(shapes.read)]
"""What `shapes.read` takes; the command line replaces files by the grids in them."""
Count = Annotated[int, Interval(1, 1_000_000_000)]
AUTO = 0
"""A number of steps that is left to the task."""


def _read_steps(text: str) -> int:
    if text == "auto":
        return AUTO
    try:
        steps = int(text)
    except ValueError:
        raise ValueError(f"got {text!r}, allowed: a whole number, or auto") from None
    if steps < 1:
        raise ValueError(f"got {steps}, allowed: at least 1, or auto")
    return steps


_STEPS_SPEC = tyro.constructors.PrimitiveConstructorSpec(
    nargs=1,
    metavar="INT|auto",
    instance_from_str=lambda args: _read_steps(args[0]),
    is_instance=lambda value: isinstance(value, int),
    str_from_instance=lambda value: ["auto" if value == AUTO else str(value)],
)
Steps = Annotated[Count, _STEPS_SPEC]
"""A count, or auto on the command line."""
Weight = Annotated[float, Interval(0, 1000)]
PositiveRate = Annotated[float, Interval(0, 1, open="low")]
Fraction = Annotated[float, Interval(0, 1)]
Discount = Annotated[float, Interval(0, 1, open="both")]
Widths = Annotated[tuple[int, ...], Interval(1, 8192)]
Factors = Annotated[tuple[float, ...], Interval(0, 10, open="low"), Ranges()]
"""Ends of ranges in rising order: low high, or low high low high for two."""
Engine = Literal["auto", "native", "mjx", "warp"]
Seed = Annotated[int, Interval(0, 2_000_000_000)]
Envs = Annotated[int, Interval(1, 65_536)]
LARGEST_SHIFT = 0.02
"""m."""
Shift = Annotated[Length, Interval(0, LARGEST_SHIFT)]
"""Side of the square in which sockets are offset."""
