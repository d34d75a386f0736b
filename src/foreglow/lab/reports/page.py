"""A page of results: paragraphs, lists, tables and figures, composed once, written as Markdown or as one HTML file."""

from __future__ import annotations

import base64
import csv
import io
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote

from foreglow.files import in_unicode, to_json, write_json_results
from foreglow.outputs import running_command
from foreglow.own_folders import REPORT_SUFFIXES
from foreglow.provenance import provenance
from foreglow.whole_files import make_folder, remove_file, together, write_atomic

DASH = "–"

ROUNDING = 1e-6
"""Shares of sums of light that are no further from 0 or 1 are these."""


def number(value: float | None, digits: int = 2, missing: str = DASH) -> str:
    """`value` with `digits` decimals.

    >>> number(0.125, 2), number(None), number(math.nan, missing="")
    ('0.12', '–', '')
    """
    return missing if value is None or math.isnan(value) else f"{value:.{digits}f}"


def signed(value: float, digits: int = 2) -> str:
    """`value` with its sign and `digits` decimals.

    >>> signed(0.5)
    '+0.50'
    """
    return DASH if math.isnan(value) else f"{value:+.{digits}f}"


def percent(value: float) -> str:
    """A share as whole per cent; one that is nearly all or nearly none is told as neither.

    >>> percent(0.256), percent(0.998), percent(0.002), percent(1.0)
    ('26%', '>99%', '<1%', '100%')
    """
    if math.isnan(value):
        return DASH
    if 0.995 <= value < 1.0 - ROUNDING:
        return ">99%"
    return "<1%" if ROUNDING < value <= 0.005 else f"{value:.0%}"


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
.words th, .words td { text-align: left; white-space: normal; vertical-align: top }
.pictures { display: grid; grid-template-columns: repeat(auto-fill, minmax(400px, 1fr)); gap: 1rem }
figure { margin: 1.5rem 0 } .pictures figure { margin: 0 } figcaption { font-size: 13px }
figure img { max-width: 100%; background: #fff; border-radius: 4px }
"""

VIDEOS = (".mp4", ".webm")


@dataclass(frozen=True, slots=True)
class Missing:
    """Stands in for all cells of a row but the first: why there are none."""

    reason: str


@dataclass(frozen=True, slots=True)
class Table:
    """A table of text.

    Attributes:
        rows: As many cells in each as there are columns, or the first cell and a `Missing`.
        is_wordy: Whether its cells are words, which may take several lines.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[object]]
    is_wordy: bool = False

    @classmethod
    def of(
        cls, columns: Mapping[str, Callable[[Any], object]], items: Iterable[Any], *, is_wordy: bool = False
    ) -> Table:
        """A row for each item: `columns` says by head what the item's cell holds."""
        return cls(list(columns), [[cell(item) for cell in columns.values()] for item in items], is_wordy)

    def markdown(self) -> str:
        """The table as Markdown."""
        lines = [_markdown_row(self.head), "|---" * len(self.head) + "|"]
        for row in self.rows:
            if isinstance(row[-1], Missing):
                row = [row[0], f"*{row[-1].reason}*", *[DASH] * (len(self.head) - 2)]
            lines.append(_markdown_row(row))
        return "\n".join(lines)

    def html(self) -> str:
        """The table as HTML; it scrolls sideways where it is too wide."""
        head = "".join(f"<th>{escape(title)}</th>" for title in self.head)
        rows = "\n".join(f"<tr>{''.join(map(self._html_cell, row))}</tr>" for row in self.rows)
        kind = "wide words" if self.is_wordy else "wide"
        return f'<div class="{kind}"><table><thead><tr>{head}</tr></thead><tbody>\n{rows}\n</tbody></table></div>'

    def csv(self) -> str:
        """The table as CSV, for numbers without units and without dashes."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([self.head, *self.rows])
        return text.getvalue()

    def _html_cell(self, cell: object) -> str:
        if isinstance(cell, Missing):
            return f'<td class="why" colspan="{len(self.head) - 1}">{_html_words(cell.reason)}</td>'
        return f"<td>{_html_words(str(cell))}</td>"


@dataclass(frozen=True, slots=True, eq=False)
class Figure:
    """A plot or a picture.

    Attributes:
        data: A PNG or JPEG file.
        file: Name of its file beside the page, without which it can only be part of an HTML page.
    """

    data: bytes
    caption: str
    file: str = ""

    def markdown(self) -> str:
        """A reference to the file beside the page."""
        return f"![{Path(self.file).stem}]({self.file})"

    def html(self) -> str:
        """The figure within the page."""
        kind = "png" if self.data.startswith(b"\x89PNG") else "jpeg"
        source, caption = base64.b64encode(self.data).decode(), escape(self.caption)
        return (
            f'<figure><img alt="{caption}" src="data:image/{kind};base64,{source}">'
            f"<figcaption>{caption}</figcaption></figure>"
        )


class Page:
    """A page that grows from top to bottom.

    Texts are plain; in a page that is only ever written as Markdown they may use its emphasis.
    """

    def __init__(self, title: str) -> None:
        """Begins with the title."""
        self.title = title
        self._figures: list[Figure] = []
        self._markdown: list[str] = []
        self._html: list[str] = []
        self._add(f"# {title}", f"<h1>{escape(title)}</h1>")

    def section(self, heading: str, *lines: str) -> None:
        """Begins a section, with the paragraph `lines` if there are any."""
        self._add(f"## {heading}", f"<h2>{escape(heading)}</h2>")
        if any(lines):
            self.text(*lines)

    def text(self, *lines: str) -> None:
        """Adds a paragraph."""
        self._add("\n".join(lines), f"<p>{_html_words(' '.join(lines))}</p>")

    def items(self, lines: Iterable[str]) -> None:
        """Adds a list; nothing without lines."""
        lines = list(lines)
        if lines:
            shown = "\n".join(f"<li>{_html_words(line)}</li>" for line in lines)
            self._add("\n".join(f"- {line}" for line in lines), f"<ul>\n{shown}\n</ul>")

    def table(self, table: Table) -> None:
        """Adds a table."""
        self._add(table.markdown(), table.html())

    def figure(self, figure: Figure) -> None:
        """Adds a figure."""
        self._figures.append(figure)
        self._add(figure.markdown(), figure.html())

    def pictures(self, figures: Iterable[Figure], heading: str = "") -> None:
        """Adds small figures side by side, under a heading of their own if there is one; nothing without figures."""
        figures = list(figures)
        if figures:
            self._figures += figures
            over = f"<h3>{escape(heading)}</h3>" if heading else ""
            markdown, shown = zip(*((figure.markdown(), figure.html()) for figure in figures), strict=True)
            named = [f"### {heading}\n"] if heading else []
            self._add("\n".join([*named, *markdown]), "\n".join([f'{over}<div class="pictures">', *shown, "</div>"]))

    def media(self, file: str, caption: str) -> None:
        """Adds a picture or a video that lies beside the page already."""
        source, words = quote(file), escape(caption)
        shown = f'<img alt="{words}" src="{source}">'
        if file.endswith(VIDEOS):
            shown = f'<video controls style="max-width: 100%" src="{source}"></video>'
        self._add(f"![{caption}]({source})", f"<figure>{shown}<figcaption>{words}</figcaption></figure>")

    def listing(self, text: str, summary: str) -> None:
        """Adds a long text as it is, such as a file; in HTML it is folded up under `summary`."""
        folded = f"<details><summary>{escape(summary)}</summary><pre>{escape(text)}</pre></details>"
        self._add(f"```\n{text}```", folded)

    def markdown(self) -> str:
        """The whole page as Markdown in UTF-8; figures are references to files beside it."""
        return in_unicode("\n\n".join(self._markdown) + "\n")

    def html(self) -> str:
        """The whole page as one HTML file in UTF-8 with everything in it, but for `media`."""
        title = escape(self.title)
        text = "\n".join(
            [
                f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>',
                f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head><body>',
                *self._html,
                "</body></html>\n",
            ]
        )
        return in_unicode(text)

    def write(
        self,
        path: Path,
        *,
        results: Any = None,
        made_with: Mapping[str, Any] | None = None,
        files: Mapping[str, bytes | str] | None = None,
        earlier: Iterable[str] = (),
    ) -> Path:
        """Writes the page and, into the same folder, which is made if need be, all that belongs beside it, or nothing.

        Args:
            path: Of the page; written as Markdown if its suffix is `.md`, else as HTML.
            results: What goes into `results.json` as `to_json` has it, with the program that made it.
            made_with: What else to say there of how the results were made, such as the seed.
            files: Other files by name.
            earlier: Names of files that a page there before may have had, which go unless they are written now.

        Returns:
            `path`.

        Raises:
            OSError: If a file cannot be written.
        """
        written = {**self.files(path.name), **(files or {})}
        assert all(name.endswith(REPORT_SUFFIXES) for name in written), f"one would overwrite a user's file: {written}"
        with together():
            make_folder(path.parent)
            if results is not None:
                origin = {**provenance(), "command": running_command(), **(made_with or {})}
                record = {"made_with": origin, **to_json(results)}
                write_json_results(path.parent / "results.json", record)
            for name, data in written.items():
                write_atomic(path.parent / name, data.encode() if isinstance(data, str) else data)
            for name in set(earlier) - written.keys():
                remove_file(path.parent / name)
        return path

    def files(self, name: str) -> dict[str, bytes]:
        """What belongs into the folder of the page by its name: its figures, and last the page, called `name`."""
        text = self.markdown() if name.endswith(".md") else self.html()
        beside = {figure.file: figure.data for figure in self._figures if figure.file}
        return {**beside, name: text.encode()}

    def _add(self, markdown: str, its_html: str) -> None:
        self._markdown.append(markdown)
        self._html.append(its_html)


def _html_words(text: str) -> str:
    """Plain text as HTML; what is in backticks is code.

    >>> _html_words("`a` < b")
    '<code>a</code> &lt; b'
    """
    return re.sub("`([^`]+)`", r"<code>\1</code>", escape(text))


def _markdown_row(cells: Iterable[object]) -> str:
    return "| " + " | ".join(" ".join(str(cell).splitlines()).replace("|", "\\|") for cell in cells) + " |"
