"""The report on detection ranges: a table and a figure for each requirement."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from foreglow.lab.reports.figures import AMBER, BLUE, GREEN, GREY, INK, PALE, png, subplots
from foreglow.lab.reports.page import Figure, Page, Table, percent
from foreglow.lab.studies.detection_range.metrics import NEAR, REQUIREMENTS, Group, Requirement, View, groups

COLOURS = (BLUE, AMBER, GREEN, GREY, INK)
LINES = ("-", "--", ":")


def write_report(views: Sequence[View], roots: Sequence[Path], folder: Path) -> Path:
    """Writes `report.md`, whose path it returns, `results.json`, `views.csv` and the figures.

    Raises:
        ModuleNotFoundError: If matplotlib is not installed.
        OSError: If a file cannot be written.
    """
    page = Page("Detection by range")
    page.text(
        "UN R48, 6.1.9.3.1.2: on a straight level road the sensor system shall detect an oncoming vehicle at a",
        "distance extending to at least 400 m, and a preceding one at a distance extending to at least 100 m.",
    )
    page.text(
        "A vehicle counts in every image that shows one of its lamps, and is detected if an accepted box holds one.",
        f"*At* the required range means within {percent(NEAR)} of it. In parentheses: how many images.",
    )
    found = {requirement.name: groups(views, requirement) for requirement in REQUIREMENTS}
    for requirement in REQUIREMENTS:
        page.section(f"Vehicles {requirement.name}" if requirement.name == "ahead" else "Oncoming vehicles")
        page.table(_table(requirement, [row for rows in found[requirement.name].values() for row in rows]))
        caption = f"Share of the vehicles {requirement.name} that are detected, by range"
        page.figure(Figure(_figure(requirement, found[requirement.name]), caption, f"{requirement.name}.png"))
    names = [field.name for field in dataclasses.fields(View)]
    csv = Table(names, [[getattr(view, name) for name in names] for view in views]).csv()
    record = {"data": [str(root) for root in roots], "requirements": REQUIREMENTS, "groups": found}
    return page.write(folder / "report.md", results=record, files={"views.csv": csv})


def summary_lines(views: Sequence[View]) -> list[str]:
    """What the command says: a line for each requirement."""
    lines = []
    for requirement in REQUIREMENTS:
        (whole,) = groups(views, requirement)["all"]
        lines.append(
            f"{requirement.name} at {requirement.range_m:g} m (UN R48): {percent(whole.share_at)} of {whole.num_at} "
            f"views detected, in {whole.num_drives_at} drives"
        )
    return lines


def _table(requirement: Requirement, rows: Sequence[Group]) -> Table:
    def bin_cell(index: int) -> Callable[[Group], str]:
        return lambda row: f"{percent(row.shares[index])} ({row.counts[index]})"

    columns: dict[str, Callable[[Group], object]] = {
        "": lambda row: row.name,
        "drives": lambda row: row.num_drives,
        f"at {requirement.range_m:g} m": lambda row: f"**{percent(row.share_at)}** ({row.num_at})",
    }
    for index, (low, high) in enumerate(pairwise(requirement.edges_m)):
        columns[f"{low:g}-{high:g} m"] = bin_cell(index)
    return Table.of(columns, rows)


def _figure(requirement: Requirement, found: dict[str, tuple[Group, ...]]) -> bytes:
    """The shares by range, by weather on the left and by camera on the right; dotted: the required range."""
    figure, panels = subplots(2)
    middles_m = np.mean(list(pairwise(requirement.edges_m)), axis=1)
    for axes, aspect in zip(panels, ("weather", "camera"), strict=True):
        for index, row in enumerate(found[aspect]):
            colour, line = COLOURS[index % len(COLOURS)], LINES[index // len(COLOURS) % len(LINES)]
            axes.plot(middles_m, row.shares, "o" + line, color=colour, markersize=4, label=row.name)
        axes.axvline(requirement.range_m, color=INK, linestyle=":", linewidth=1)
        axes.set(
            title=f"{requirement.name}, by {aspect}", xlabel="range, m", ylabel="share detected", ylim=(-0.03, 1.03)
        )
        axes.grid(axis="y", color=PALE)
        if found[aspect]:
            axes.legend(frameon=False, fontsize=8)
    return png(figure)
