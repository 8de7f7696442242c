"""The options of a run as config.json holds them, read back."""

import dataclasses
import typing
from collections.abc import Mapping
from typing import Any

from crsfd_jax.config import Config
from crsfd_jax.errors import UserError
from crsfd_jax.options.limits import is_like


def from_dict(values: Mapping[str, Any]) -> Config:
    """The inverse of `config.to_dict`; lists from JSON become tuples.

    An option that is missing, because it is younger than the file, has its default, or what it was
    before it could be chosen.

    Raises:
      UserError: an option is unknown, or its value is of another kind.
    """
    for part, before in _before(values.get("algorithm", Config.algorithm)).items():
        if isinstance(given := values.get(part), Mapping):
            values = {**values, part: {**before, **given}}
    return _rebuild(Config, values)


def _before(algorithm: Any) -> dict[str, dict[str, Any]]:
    """What was done before an option could be chosen, where its default is something else."""
    drew = {"draw_demos": "yes"} if str(algorithm).startswith(("crsfd", "rsgm")) else {}
    return {"sac": {"reward_scale": 1.0, "actor_tau": 1.0}, "replay": drew}


def _rebuild(kind: Any, values: Any) -> Any:
    hints = typing.get_type_hints(kind)
    if not isinstance(values, Mapping):
        raise UserError(f"got {values!r}, expected the options of {kind.__name__}")
    if odd := values.keys() - hints.keys():
        raise UserError(f"options {', '.join(sorted(odd))} are unknown to this version")
    usual, made = kind(), {}
    for name, value in values.items():
        if dataclasses.is_dataclass(hints[name]):
            value = _rebuild(hints[name], value)
        elif not is_like(value, getattr(usual, name)):
            raise UserError(f"{name} is {value!r}, not a value of that option")
        made[name] = tuple(value) if isinstance(value, list) else value
    return kind(**made)
