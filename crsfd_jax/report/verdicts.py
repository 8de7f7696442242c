"""How the paper's claims are listed: on the page, and as a table of Markdown to read beside it."""

from collections import Counter
from collections.abc import Sequence

from crsfd_jax.report import html, markdown
from crsfd_jax.report.evidence import FAILS, HOLDS, OPEN, RULES, Claim

FILE = "claims.md"
_SHOWN = 4
"""Comparisons of a claim that are not folded away."""
_KINDS = {FAILS: "fails", OPEN: "open", HOLDS: "holds"}
"""Style of each verdict, those that decide a claim first."""
_SEVERAL = {FAILS: "do not hold", OPEN: "undecided", HOLDS: "hold"}


def section(claims: Sequence[Claim]) -> str:
    """A part of the page: verdict, claim and the numbers that decide."""
    rows = []
    for claim in claims:
        mark = f'<td class="verdict {_KINDS[claim.verdict]}">{claim.verdict}</td>'
        rows.append(f"<tr>{mark}<td>{html.escape(claim.statement)}{_folded(claim)}</td></tr>")
    body = "\n".join(rows)
    return html.section(
        "Claims of the paper",
        html.folded("how the verdicts are made", html.bullets(RULES)),
        f"<table><thead><tr><th>verdict</th><th>claim and the numbers that decide</th></tr></thead>"
        f"<tbody>{body}</tbody></table>",
    )


def document(claims: Sequence[Claim], made_of: Sequence[str]) -> str:
    """A document with a row for each claim, how verdicts are made, and every comparison.

    Args:
      made_of: lines that say what runs are behind it.
    """
    rows = [(claim.verdict, claim.statement, _counted(claim)) for claim in claims]
    parts = [("How the verdicts are made", "", RULES)]
    parts += [(c.statement, f"**{c.verdict}**", _lines(c)) for c in claims]
    below = ((f"## {title}", said, markdown.bullets(lines)) for title, said, lines in parts)
    return markdown.document(
        "Claims of the paper",
        markdown.bullets(made_of),
        markdown.table(("verdict", "claim", "comparisons"), rows),
        *(text for texts in below for text in texts if text),
    )


def _folded(claim: Claim) -> str:
    """The numbers; of many, a few that decide and the whole list folded away."""
    lines = _lines(claim)
    if len(lines) <= _SHOWN:
        return html.bullets(lines)
    deciding = [line for line in lines if line.startswith(claim.verdict)]
    shown = html.bullets(deciding[:_SHOWN]) if claim.verdict != HOLDS else ""
    title = f"all {len(lines)} comparisons: {_counted(claim)}"
    return shown + html.folded(title, html.bullets(lines))


def _lines(claim: Claim) -> list[str]:
    """A line for each comparison, those that decide first."""
    parts = sorted(claim.parts, key=lambda part: [*_KINDS].index(part.verdict))
    return [f"{part.verdict}: {part.numbers}" for part in parts]


def _counted(claim: Claim) -> str:
    """Such as 20 do not hold, 8 undecided, 1 holds."""
    counts = Counter(part.verdict for part in claim.parts)
    said = {v: v if counts[v] == 1 else words for v, words in _SEVERAL.items()}
    return ", ".join(f"{counts[v]} {words}" for v, words in said.items() if counts[v])
