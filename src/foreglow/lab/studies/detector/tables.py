"""The table of detectors as cells, for Markdown and HTML alike."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from foreglow.lab.reports.numbers import DASH
from foreglow.lab.studies.detector.run import RowResult

Cells: TypeAlias = list[str]


@dataclass(frozen=True, slots=True)
class Table:
    """A table of text.

    Attributes:
        head: Titles of the columns.
        rows: Cells, as many in each row.
        missing: For each row, why it has none but the first; empty if it has.
    """

    head: Cells
    rows: list[Cells]
    missing: list[str]


def main_table(rows: Sequence[RowResult]) -> Table:
    """The paper's table: size, run-time and metrics, in parentheses those of the labelled boxes themselves."""
    head = ["detector", "parameters", "multiply-adds", "a frame", "ms a frame", "median", "p99"]
    head += ["P", "R", "F", "q", "q_K", "q_B", "boxes a frame"]
    return _table(head, rows, _main_cells)


def kind_table(rows: Sequence[RowResult]) -> Table:
    """Recall by what a light is, with the number of lights in the head; that of all boxes in brackets."""
    aspects = ("kind", "strength", "sight")
    names: dict[tuple[str, str], int] = {}
    for row in rows:
        for aspect in aspects:
            for group in _groups(row, aspect):
                names[aspect, group["name"]] = group["num"]
    ordered = sorted(names, key=lambda key: aspects.index(key[0]))
    head = ["detector", *(f"{name} ({names[aspect, name]})" for aspect, name in ordered)]

    def cells(row: RowResult) -> Cells:
        by_name = {(aspect, one["name"]): one for aspect in aspects for one in _groups(row, aspect)}
        return [f"{_rate(by_name[key]['recall'])} [{_rate(by_name[key]['ceiling'])}]" for key in ordered]

    return _table(head, rows, cells)


def hidden_table(rows: Sequence[RowResult]) -> Table:
    """Recall of hidden vehicles' light at limits of false boxes in images without any vehicle's light."""
    limits = sorted({point["limit"] for row in rows for point in _points(row)})
    head = [
        "detector",
        "AP",
        "best F",
        *(f"at most {limit:g}" for limit in limits),
        "false boxes a frame",
        "found ahead",
    ]

    def cells(row: RowResult) -> Cells:
        ranking = row.examination["ranking"] or {}
        by_limit = {point["limit"]: point for point in _points(row)}
        hidden = [_rate(by_limit[limit]["recall_hidden"]) if limit in by_limit else DASH for limit in limits]
        false = row.examination["breakdown"]["false_boxes_empty"]["per_frame"]
        ahead = row.examination["share_found_ahead"]
        ranked = [_rate(ranking.get(name)) for name in ("average_precision", "best_f1")]
        return [*ranked, *hidden, _rate(false), _rate(ahead)]

    return _table(head, rows, cells)


def markdown(table: Table) -> list[str]:
    """Lines of Markdown; a row that could not be made says why."""
    lines = ["| " + " | ".join(table.head) + " |", "|---" * len(table.head) + "|"]
    for row, reason in zip(table.rows, table.missing, strict=True):
        cells = row if not reason else [row[0], f"*{reason}*", *[""] * (len(table.head) - 2)]
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return lines


def count(value: float) -> str:
    """A large number in words of three digits.

    >>> count(941761), count(195.4e6), count(28.1e9)
    ('942 k', '195 M', '28.1 G')
    """
    for unit, size in (("G", 1e9), ("M", 1e6), ("k", 1e3)):
        if value >= size:
            return f"{value / size:.3g} {unit}"
    return f"{value:.3g}"


def _table(head: Cells, rows: Sequence[RowResult], cells: Callable[[RowResult], Cells]) -> Table:
    head = head if len(head) > 1 else [*head, ""]  # of rows that could not be made nothing is known but why
    made = [[row.title, *(cells(row) if row.reason is None else [DASH] * (len(head) - 1))] for row in rows]
    return Table(head, made, [row.reason or "" for row in rows])


def _main_cells(row: RowResult) -> Cells:
    quality, ceiling, times = row.examination["quality"], row.ceiling, row.run_time_ms
    rates = [_rate(quality[name]) for name in ("precision", "recall", "f1", "q")]
    rates += [_with_spread(quality[name], quality[f"{name}_std"]) for name in ("q_k", "q_b")]
    names = ("precision", "recall", "f1", "q", "q_k", "q_b")
    return [
        count(row.num_parameters),
        count(row.num_multiply_adds),
        count(row.num_multiply_adds_frame),
        f"{_ms(times['mean'])} ± {_ms(times['std'])}",
        _ms(times["median"]),
        _ms(times["p99"]),
        *(f"{rate} ({_rate(ceiling[name])})" for rate, name in zip(rates, names, strict=True)),
        f"{row.num_boxes:.2f}",
    ]


def _groups(row: RowResult, aspect: str) -> list[dict[str, Any]]:
    groups: list[dict[str, Any]] = [] if row.reason else row.examination["breakdown"]["groups"][aspect]
    return groups


def _points(row: RowResult) -> list[dict[str, Any]]:
    ranking = None if row.reason else row.examination["ranking"]
    points: list[dict[str, Any]] = [] if ranking is None else ranking["operating_points"]
    return points


def _rate(value: float | None) -> str:
    return DASH if value is None else f"{value:.3f}".removeprefix("0") if 0 <= value < 1 else f"{value:.2f}"


def _with_spread(value: float | None, std: float | None) -> str:
    return DASH if value is None else f"{_rate(value)} ± {_rate(std)}"


def _ms(value: float) -> str:
    return f"{value:.2f}" if value < 100 else f"{value:.0f}"
