"""How each method looks and is called, the same in every figure and table."""

from typing import Any, NamedTuple

from crsfd_jax.config import Config

WITHOUT_FREE_SPACE = "crsfd_no_free_space"
WITHOUT_LARGER_GAMMA = "crsfd_same_gamma"
ARMS = (WITHOUT_FREE_SPACE, WITHOUT_LARGER_GAMMA)
"""The ablations of the paper."""
BASELINES = ("sacfd", "rsgm", "pofd", "sqil", "sac", "gaifo", "gail", "bc")
"""The methods that the paper compares with."""
WITHOUT_INTERACTION = ("bc",)
"""Methods that learn from demonstrations alone; environment steps mean nothing to them."""


class Style(NamedTuple):
    """Name and line of a method."""

    label: str
    colour: str
    dashes: Any = "-"
    """Line style, as matplotlib takes it."""
    width: float = 1.7
    """In points."""


# Colours of Okabe and Ito 2008 and of Paul Tol, told apart by colour-blind readers; dashes help.
_STYLES = {
    "crsfd": Style("CRSfD", "#D55E00", width=2.8),
    "sacfd": Style("SACfD", "#0072B2", width=2.1),
    "rlpd": Style("RLPD", "#009E73"),
    "rsgm": Style("RS-GM", "#CC79A7"),
    "pofd": Style("POfD", "#56B4E9", (0, (6, 2))),
    "sqil": Style("SQIL", "#785EF0", (0, (1.5, 1))),
    "sac": Style("SAC", "#4D4D4D"),
    "gaifo": Style("GAIfO", "#882255", (0, (3, 1.5))),
    "gail": Style("GAIL", "#999933", (0, (6, 1.5, 1.5, 1.5))),
    "bc": Style("BC", "#000000", (0, (4, 3)), 1.4),
    WITHOUT_FREE_SPACE: Style("CRSfD without free-space regression", "#117733", (0, (6, 2))),
    WITHOUT_LARGER_GAMMA: Style("CRSfD without larger discount", "#332288", (0, (2, 1.2))),
}
_OTHERS = ("#44AA99", "#A6761D", "#666666", "#88CCEE", "#DDCC77")
_VARIANT_DASHES = ((0, (5, 2)), (0, (2, 1.5)), (0, (7, 2, 1.5, 2)), (0, (1, 1)))


def method_of(config: Config) -> str:
    """The method of a run; CRSfD with a part switched off by its options is that ablation."""
    name = config.algorithm
    if name == "crsfd" and config.potential.free_space_weight == 0:
        return WITHOUT_FREE_SPACE
    if name == "crsfd" and config.potential.gamma == config.sac.gamma:
        return WITHOUT_LARGER_GAMMA
    return name


def style(method: str, variant: int = 0) -> Style:
    """Look of a method; other variants of it keep its colour and get dashes of their own."""
    known = _STYLES.get(method)
    if known is None:
        known = Style(method, _OTHERS[sum(method.encode()) % len(_OTHERS)])
    if variant:
        known = known._replace(
            dashes=_VARIANT_DASHES[(variant - 1) % len(_VARIANT_DASHES)], width=1.7
        )
    return known


def rank(method: str) -> tuple[int, str]:
    """Sorts our method first, then as in the list above, then by name."""
    names = list(_STYLES)
    return (names.index(method) if method in names else len(names), method)
