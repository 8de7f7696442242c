"""Ranges and choices written beside a dataclass field, and the check of a whole config.

A field says `gamma: Annotated[float, Interval(0, 1, open="both")]`; `check_limits` refuses
the first value outside, naming the command-line option that sets it.
"""

import dataclasses
import difflib
import itertools
import math
import types
import typing
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

from crsfd_jax.errors import UserError
from crsfd_jax.options import names


@dataclass(frozen=True)
class Interval:
    """Numbers between two ends; `open` names the ends that are themselves excluded."""

    low: float
    high: float
    open: Literal["", "low", "high", "both"] = ""

    def contains(self, value: float) -> bool:
        above = value > self.low if self.open in ("low", "both") else value >= self.low
        below = value < self.high if self.open in ("high", "both") else value <= self.high
        return above and below

    def describe(self, show: Callable[[float], str]) -> str:
        above = "above" if self.open in ("low", "both") else "at least"
        below = "below" if self.open in ("high", "both") else "at most"
        return f"{above} {show(self.low)} and {below} {show(self.high)}"


@dataclass(frozen=True)
class OneOf:
    """A closed list of words."""

    choices: tuple[str, ...]


@dataclass(frozen=True)
class Ranges:
    """Ends of one or more ranges, in rising order."""


@dataclass(frozen=True)
class ReadBy:
    """Text that a function must be able to read; its ValueError says what is wrong."""

    read: Callable[[str], Any]


@dataclass(frozen=True)
class ShownAs:
    """How a message writes a value of the field, such as a length with its unit."""

    show: Callable[[Any], str]


def check_limits(config: Any, prefix: str = "--") -> None:
    """Checks every field of a dataclass, and of the dataclasses in it, against its limits.

    Raises:
      UserError: the first value that is outside, with the option that sets it.
    """
    hints = typing.get_type_hints(type(config), include_extras=True)
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        option = prefix + field.name.replace("_", "-")
        if dataclasses.is_dataclass(value):
            check_limits(value, option + ".")
        else:
            _check_value(option, value, tuple(_limits_of(hints[field.name])))


def differences(one: Any, other: Any, prefix: str = "") -> dict[str, tuple[str, str]]:
    """Both values of each option that differs, by its full name, as messages write them."""
    hints = typing.get_type_hints(type(one), include_extras=True)
    found = {}
    for field in dataclasses.fields(one):
        a, b, name = getattr(one, field.name), getattr(other, field.name), prefix + field.name
        if dataclasses.is_dataclass(a):
            found |= differences(a, b, f"{name}.")
        elif a != b:
            show = _shown_by(_limits_of(hints[field.name]))
            found[name] = tuple(str(value) if value is None else show(value) for value in (a, b))
    return found


def is_like(value: Any, usual: Any) -> bool:
    """Whether a value from JSON could stand in place of a field's default.

    Lists hold numbers, all of them finite, and a default of None stands for a number that may be
    left out.
    """
    if isinstance(usual, tuple):
        return isinstance(value, list | tuple) and all(is_like(part, 0.0) for part in value)
    if isinstance(usual, bool | str):
        return type(value) is type(usual)
    if usual is None and value is None:
        return True
    is_fraction = type(value) is float and math.isfinite(value) and type(usual) is not int
    return type(value) is int or is_fraction


def choice_message(option: str, value: str, choices: tuple[str, ...]) -> str:
    """The refusal of a word that is not in a closed list, with the nearest one that is."""
    near = difflib.get_close_matches(value, choices, n=1)
    advice = f"did you mean {near[0]}?" if near else "choose one of them"
    return f"{option}: got {value!r}, allowed: {', '.join(choices)}; {advice}"


def _limits_of(hint: Any) -> Iterator[Any]:
    if typing.get_origin(hint) is Literal:
        yield OneOf(typing.get_args(hint))
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        for part in typing.get_args(hint):
            yield from _limits_of(part)
    yield from getattr(hint, "__metadata__", ())


def _check_value(option: str, value: Any, limits: tuple[Any, ...]) -> None:
    if value is None:
        return
    show = _shown_by(limits)
    for limit in limits:
        if isinstance(limit, OneOf) and value not in limit.choices:
            raise UserError(choice_message(option, value, limit.choices))
        if isinstance(limit, Interval):
            _check_numbers(option, value, limit, show)
        if isinstance(limit, Ranges):
            _check_ranges(option, value)
        if isinstance(limit, ReadBy):
            _check_text(option, value, limit)


def _shown_by(limits: Iterable[Any]) -> Callable[[Any], str]:
    return next((limit.show for limit in limits if isinstance(limit, ShownAs)), names.show)


def _check_numbers(option: str, value: Any, limit: Interval, show: Callable[[float], str]) -> None:
    allowed = limit.describe(show)
    numbers = value if isinstance(value, tuple) else (value,)
    if not numbers:
        raise UserError(f"{option}: got no number, allowed: {allowed}; give at least one")
    for number in numbers:
        if not limit.contains(number):
            raise UserError(
                f"{option}: got {show(number)}, allowed: {allowed}; choose a value in that range"
            )


def _check_ranges(option: str, ends: tuple[float, ...]) -> None:
    rising = all(a < b for a, b in itertools.pairwise(ends)) or (
        len(ends) == 2 and len({*ends}) == 1
    )
    if len(ends) % 2 or not rising:
        got = names.show(tuple(ends))
        raise UserError(
            f"{option}: got {got}, allowed: low high, or low high low high with rising numbers; "
            "write both ends of every range"
        )


def _check_text(option: str, value: str, limit: ReadBy) -> None:
    try:
        limit.read(value)
    except ValueError as error:
        raise UserError(f"{option}: {error}") from None
