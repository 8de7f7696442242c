"""The parts of the page that tell of trials."""

from collections.abc import Sequence
from pathlib import Path

from crsfd_jax.report import claims, html, tables, trials
from crsfd_jax.report.own_trials import Trials
from crsfd_jax.report.transfer import Transfer


def held_out(found: Sequence[Transfer], folder: Path) -> str:
    """Trials under conditions that training never saw, drawn and as a table."""
    if not found:
        return ""
    path = folder / "transfer.png"
    trials.draw(found, claims.ROBOT, path)
    text = "Success rate under a randomisation that training never saw, 95 % interval."
    rates: dict[str, list[float]] = {}
    for each in found:
        rates.setdefault(each.label, []).append(each.successes / each.trials)
    means = [f"{label}: {sum(r) / len(r):.3f} over {len(r)} shapes" for label, r in rates.items()]
    shown = html.table(*tables.transfers(found, claims.ROBOT))
    said = html.paragraph("; ".join(means) + ".")
    return html.section("Held-out randomisation", said, html.media(path, text), shown)


def own(found: Sequence[Trials]) -> str:
    """Trials on the task of training."""
    if not found:
        return ""
    said = "Fresh episodes of the task of training, deterministic policies; all seeds together."
    shown = html.table(*tables.own_trials(found))
    return html.section("Trials on the task of training", html.paragraph(said), shown)
