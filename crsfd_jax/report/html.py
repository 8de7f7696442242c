"""Pieces of a web page that needs nothing but itself."""

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path

_KINDS = {
    ".png": "image/png",
    ".gif": "image/gif",
    ".mp4": "video/mp4",
}
_STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; color: #1c2127;
  background: #fff; max-width: 1360px; margin: 2rem auto; padding: 0 1.2rem; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: 0 0 .4rem; }
h2 { font-size: 1.2rem; margin: 2.2rem 0 .5rem; border-bottom: 1px solid #d8dde3; }
p, li { max-width: 62rem; }
.lead { font-size: 1.08rem; }
.quiet { color: #59636e; font-size: .9rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .85rem; margin: .5rem 0;
  font-variant-numeric: tabular-nums; }
td:first-child { white-space: nowrap; }
th, td { padding: .22rem .6rem; text-align: left; border-bottom: 1px solid #e5e9ed;
  vertical-align: top; }
th { border-bottom: 2px solid #aab3bd; vertical-align: bottom; }
.number { text-align: right; white-space: nowrap; }
figure { margin: .8rem 0 1.4rem; }
figure img, figure video { max-width: 100%; height: auto; }
td ul { margin: .1rem 0 .3rem; padding-left: 1.3rem; }
.clips { display: flex; flex-wrap: wrap; gap: 1rem; }
.clips figure { margin: 0; width: 320px; }
figcaption { color: #59636e; font-size: .9rem; }
summary { cursor: pointer; }
.verdict { white-space: nowrap; font-weight: 600; }
.holds { color: #00674b; } .fails { color: #a83c00; } .open { color: #59636e; }
"""


def page(title: str, body: Sequence[str]) -> str:
    """A whole document around pieces of HTML."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(body)
        + "\n</body>\n</html>\n"
    )


def section(title: str, *body: str) -> str:
    """A heading and what stands below it."""
    return "\n".join((f"<h2>{escape(title)}</h2>", *body))


def paragraph(text: str, kind: str = "") -> str:
    """Text of its own, with the style of that name."""
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def bullets(lines: Sequence[str]) -> str:
    """A list of lines."""
    return f"<ul>{''.join(f'<li>{escape(line)}</li>' for line in lines)}</ul>"


def table(head: Sequence[str], rows: Sequence[Sequence[str]], words: int) -> str:
    """A table whose first columns hold words and whose others hold numbers.

    Args:
      words: number of columns aligned to the left.
    """
    kinds = [""] * words + [' class="number"'] * (len(head) - words)
    top = "".join(f"<th{k}>{escape(cell)}</th>" for k, cell in zip(kinds, head, strict=True))
    lines = (
        "".join(f"<td{k}>{escape(cell)}</td>" for k, cell in zip(kinds, row, strict=True))
        for row in rows
    )
    body = "".join(f"<tr>{line}</tr>\n" for line in lines)
    return (
        f'<div class="wide"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'
    )


def folded(title: str, *body: str) -> str:
    """Pieces that a click unfolds."""
    return f"<details><summary>{escape(title)}</summary>{''.join(body)}</details>"


def media(path: Path, caption: str) -> str:
    """A picture or film with its bytes in the page."""
    kind, data = _KINDS[path.suffix], path.read_bytes()
    source = f"data:{kind};base64,{base64.b64encode(data).decode()}"
    # A PNG states its width in bytes 16 to 20; ours have two pixels for each of the page.
    width = f' width="{int.from_bytes(data[16:20]) // 2}"' if path.suffix == ".png" else ""
    inner = (
        f'<video controls loop muted src="{source}"></video>'
        if kind.startswith("video")
        else f'<img{width} alt="{escape(caption)}" src="{source}">'
    )
    return f"<figure>{inner}<figcaption>{escape(caption)}</figcaption></figure>"
