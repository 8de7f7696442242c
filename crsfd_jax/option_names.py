"""Options by the names that the command line gives them."""

from collections.abc import Mapping
from typing import Any


def by_full_name(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested options as one mapping, with names such as potential.gamma."""
    flat = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            flat |= by_full_name(value, f"{prefix}{name}.")
        else:
            flat[prefix + name] = value
    return flat
