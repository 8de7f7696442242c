"""Words for writing experiments down: arguments of `python -m crsfd_jax.train`, combined."""

import itertools
from collections.abc import Sequence

Arguments = tuple[str, ...]

METHODS = ("crsfd", "sacfd", "sac", "bc", "rlpd", "rsgm", "pofd", "sqil", "gail", "gaifo")
"""What the paper compares and RLPD, the most telling first."""
_STEPS = "300000"
_STEPS_OF = {"bc": "40000"}
"""BC never meets its environment: steps only count its updates, and 9,728 of them are plenty."""


def methods(*names: str, every: str = "10240") -> tuple[Arguments, ...]:
    """An axis of methods, each with its budget of environment steps, evaluated every so many."""
    return tuple(
        ("--algorithm", name, "--steps", _STEPS_OF.get(name, _STEPS), "--evaluation.every", every)
        for name in names
    )


def axis(option: str, *values: str) -> tuple[Arguments, ...]:
    """An axis of the values of one option."""
    return tuple((option, value) for value in values)


def grid(*axes: Sequence[Arguments]) -> tuple[Arguments, ...]:
    """Every combination of one entry of each axis; the first axis varies slowest."""
    return tuple(tuple(itertools.chain(*entries)) for entries in itertools.product(*axes))
