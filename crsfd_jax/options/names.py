"""Options by the names that the command line gives them, and which of them may change."""

from collections.abc import Mapping
from typing import Any

MAY_CHANGE = ("out", "engine", "target", "log", "clips")
"""Options that a run which goes on may be given anew; --steps may grow."""


def show(value: Any, between: str = " ") -> str:
    """A value in SI units; several are joined by `between`."""
    if isinstance(value, tuple):
        return between.join(show(part) for part in value)
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def by_full_name(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested options as one mapping, with names such as potential.gamma."""
    flat = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            flat |= by_full_name(value, f"{prefix}{name}.")
        else:
            flat[prefix + name] = value
    return flat
