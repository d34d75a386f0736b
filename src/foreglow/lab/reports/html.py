"""What all HTML reports share: their look, and tables."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterator

from foreglow.lab.studies.detector.tables import Table

STYLE = """
:root { color-scheme: light dark; --ink: #222; --ground: #fff; --line: #ccc; --pale: #f3f4f7; --accent: #b3651a }
@media (prefers-color-scheme: dark) {
  :root { --ink: #ddd; --ground: #17181b; --line: #3a3c42; --pale: #222428; --accent: #e6a15c } }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--ground);
  margin: 2rem auto; max-width: 1280px; padding: 0 1rem }
h1, h2, h3 { line-height: 1.2 } h2 { margin-top: 2.5rem }
.wide { overflow-x: auto } table { border-collapse: collapse; font-size: 13px; font-variant-numeric: tabular-nums }
th, td { padding: .3rem .6rem; border-bottom: 1px solid var(--line); text-align: right; white-space: nowrap }
th:first-child, td:first-child, td.why { text-align: left } td.why { color: var(--accent); white-space: normal }
tbody tr:nth-child(even) { background: var(--pale) }
.pictures { display: grid; grid-template-columns: repeat(auto-fill, minmax(400px, 1fr)); gap: 1rem }
figure { margin: 0 } figure img { width: 100%; border-radius: 4px } figcaption { font-size: 13px }
.good { color: #2c9c4b } .bad { color: #d3453a }
"""


def html_table(table: Table) -> Iterator[str]:
    """The lines of `table`; it scrolls sideways where it is too wide."""
    yield '<div class="wide"><table><thead><tr>'
    yield "".join(f"<th>{html.escape(cell)}</th>" for cell in table.head)
    yield "</tr></thead><tbody>"
    for row, reason in zip(table.rows, table.missing, strict=True):
        cells = [f"<td>{html.escape(cell)}</td>" for cell in (row[:1] if reason else row)]
        if reason:
            cells.append(f'<td class="why" colspan="{len(row) - 1}">{html.escape(reason)}</td>')
        yield f"<tr>{''.join(cells)}</tr>"
    yield "</tbody></table></div>"


def html_figure(picture: bytes, words: str, kind: str = "png") -> str:
    """A plot or a picture of a `kind`, png or jpeg, within the page, on white, with `words` beneath."""
    source, caption = base64.b64encode(picture).decode(), html.escape(words)
    return (
        f'<figure style="margin: 1.5rem 0"><img style="max-width: 100%; width: auto; background: #fff" '
        f'alt="{caption}" src="data:image/{kind};base64,{source}"><figcaption>{caption}</figcaption></figure>'
    )
