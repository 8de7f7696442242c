"""Lengths with units on the command line: "8mm" in, metres out."""

import math
import re

_METRES_PER = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
_LENGTH = re.compile(r"^\s*([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*(mm|cm|m)\s*$")


def parse_length(text: str) -> float:
    """Converts a non-negative length with a unit, such as "8mm", to metres.

    Raises:
      ValueError: the text has no unit, an unknown unit, a sign, or is not finite.
    """
    match = _LENGTH.match(text)
    if match is None or not math.isfinite(float(match[1])):
        raise ValueError(
            f'got {text!r}, allowed: a non-negative number with the unit mm, cm or m, such as "8mm"'
        )
    return float(match[1]) * _METRES_PER[match[2]]


def format_length(metres: float) -> str:
    """Writes a length in millimetres, the inverse of `parse_length`."""
    return f"{metres * 1e3:g}mm"
