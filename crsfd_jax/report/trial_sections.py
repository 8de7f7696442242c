"""The parts of the page that tell of trials."""

from collections.abc import Sequence
from pathlib import Path

from crsfd_jax.report import html, tables, transfer
from crsfd_jax.report.trials import Trials


def held_out(found: Sequence[Trials], folder: Path) -> str:
    """Trials under conditions that training never saw, drawn and as a table."""
    if not found:
        return ""
    path = folder / "transfer.png"
    transfer.draw(found, path)
    text = "Success rate under a randomisation that training never saw, 95 % interval."
    shown = html.table(*tables.transfers(found))
    return html.section("Held-out randomisation", html.media(path, text), shown)


def own(found: Sequence[Trials]) -> str:
    """Trials on the task of training."""
    if not found:
        return ""
    said = "Fresh episodes of the task of training, deterministic policies; all seeds together."
    shown = html.table(*tables.own_trials(found))
    return html.section("Trials on the task of training", html.paragraph(said), shown)
