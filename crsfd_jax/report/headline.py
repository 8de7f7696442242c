"""The answer in a few sentences, before anything else."""

import itertools
from collections import Counter
from collections.abc import Sequence

import numpy as np

from crsfd_jax.report.cells import Cell
from crsfd_jax.report.evidence import FAILS, HOLDS, OPEN, Claim, show
from crsfd_jax.report.methods import WITHOUT_INTERACTION, style
from crsfd_jax.report.pairing import Rivals, longest, rivals
from crsfd_jax.report.statistics import Estimate, weighted_interval
from crsfd_jax.report.summary import LEVEL, Scores, difference, scores, summarise


def sentences(cells: Sequence[Cell], claims: Sequence[Claim]) -> list[str]:
    """How good the method is, how it compares with the best other one, which claims hold."""
    kept = longest(cells)
    usual = [cell for cell in kept if not cell.variant] or kept
    ours = subject(usual)
    said = [_level(usual, ours), *_contest(cells, ours)]
    counts = Counter(claim.verdict for claim in claims)
    said.append(
        f"Of the paper's {len(claims)} claims {counts[HOLDS]} held up, {counts[FAILS]} did not, "
        f"and {counts[OPEN]} stay undecided with these runs."
    )
    return said


def subject(cells: Sequence[Cell]) -> str:
    """The method that the others are compared with: CRSfD, else the one with the most tasks."""
    methods = Counter(cell.method for cell in cells)
    return "crsfd" if "crsfd" in methods else max(methods, key=lambda m: (methods[m], m))


def _level(cells: Sequence[Cell], ours: str) -> str:
    mine = [cell for cell in cells if cell.method == ours]
    ended = [cell for cell in mine if cell.finished]
    success = {cell.task: summarise(cell).mean for cell in ended or mine}
    label, rates = style(ours).label, np.array(list(success.values()))
    if not ended:
        return f"{label} stands at a mean success of {rates.mean():.3f}; no run of it is finished."
    if len(rates) == 1:
        return f"{label} ends at a success of {rates[0]:.3f} on {next(iter(success))}."
    worst = min(success, key=lambda task: success[task])
    learned = int((rates >= LEVEL).sum())
    return (
        f"{label} ends at a mean success of {rates.mean():.3f} over {len(rates)} tasks; "
        f"{learned} of them end at {LEVEL:g} or above, the worst is {worst} with "
        f"{success[worst]:.3f}."
    )


def _contest(cells: Sequence[Cell], ours: str) -> list[str]:
    """Against the interacting method that comes closest, all on the same tasks."""
    block = _largest_block(rivals(cells, ours))
    compared = {method: _compared(pairs) for method, pairs in block.items()}
    ahead = {method: _steps_ahead(each) for method, each in compared.items() if each}
    if not ahead:
        return []
    rival = min(ahead, key=lambda method: ahead[method].value)
    best, each = ahead[rival], compared[rival]
    where = f"{len(each)} tasks" if len(each) > 1 else f"{block[rival][0][0].task}"
    known = best.low > 0 or best.high < 0
    words = "faster than" if best.low > 0 else "slower than" if known else "as fast as"
    doubt = "" if known else ", as far as these seeds can tell"
    of = f"the closest of {len(block)} others" if len(block) > 1 else "the only other method"
    return [
        f"It learns {words} {style(rival).label}, {of} on {where}{doubt}: the area between the "
        f"curves is worth {show(best, '+,.0f')} environment steps, the final success differs by "
        f"{show(difference(each, 'final'), '+.3f')}."
    ]


def _largest_block(found: Rivals) -> Rivals:
    """Methods that interact, and tasks that all of them have: as many pairs as there can be.

    How far two methods are behind on different tasks says nothing about which is closer.
    """
    acting = {
        m: {ours.task: (ours, theirs) for ours, theirs in pairs}
        for m, pairs in found.items()
        if m not in WITHOUT_INTERACTION and not m.startswith("crsfd")
    }
    blocks = []
    for task in dict.fromkeys(task for pairs in acting.values() for task in pairs):
        methods = [m for m, pairs in acting.items() if task in pairs]
        shared = [t for t in acting[methods[0]] if all(t in acting[m] for m in methods)]
        blocks.append({m: [acting[m][t] for t in shared] for m in methods})
    return max(blocks, key=lambda block: (sum(map(len, block.values())), len(block)), default={})


def _compared(pairs: Sequence[tuple[Cell, Cell]]) -> list[Scores]:
    return [task for task in itertools.starmap(scores, pairs) if task]


def _steps_ahead(each: Sequence[Scores]) -> Estimate:
    """Environment steps by which the first is ahead, mean over tasks.

    Areas under curves of other lengths do not compare, the steps that they stand for do.
    """
    gaps, seeds = [task.gap("area") for task in each], [task.seeds for task in each]
    return weighted_interval(gaps, seeds, [task.steps / len(each) for task in each])
