"""The report on run-times: the paper's box plots, tables, and the numbers as JSON and CSV."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from foreglow.config import config_to_toml
from foreglow.display.summary_lines import counted
from foreglow.lab.evaluation.ratios import mean
from foreglow.lab.reports.figures import AMBER, BLUE, GREEN, GREY, INK, PALE, box_plot, png, subplots
from foreglow.lab.reports.page import DASH, Figure, Missing, Page, Table, number
from foreglow.lab.studies.reproduction.claims import paper_value, paper_words
from foreglow.lab.studies.runtime.run import (
    COMPLETE,
    LIVE,
    MIN_FRAMES,
    NUM_WARM_UP,
    PARTS,
    NetworkTimes,
    RuntimeResults,
    frames_by_proposals,
    median_p99_max,
)

EDGES = (0, 10, 20, 30, 40, 60)
"""Numbers of proposals at which the groups begin."""

PAPER = "paper, with a GPU, on PVDN"
PAPER_NUM_FRAMES, PAPER_SHARE = paper_words("runtime-images"), paper_words("runtime-share")
PAPER_MEAN_MS = paper_value("runtime-mean")
"""Its row of the table: the images, how many took at most a frame's time, and the mean of the complete pipeline."""

COLOURS = (AMBER, BLUE, GREEN, GREY, INK)
WHISKERS = (1, 99)


def stage_figure(results: RuntimeResults) -> bytes:
    """The paper's figure: box plots of the parts, one group a part, one colour a network."""
    figure, (axes,) = subplots(1, width_in=9.0, height_in=4.0)
    width = 0.8 / max(1, len(results.networks))
    for index, (times, colour) in enumerate(zip(results.networks, COLOURS, strict=False)):
        shift = (index - (len(results.networks) - 1) / 2) * width
        known = {position: times.parts_ms[part] for position, part in enumerate(PARTS) if part in times.parts_ms}
        values = [column[np.isfinite(column)] for column in known.values()]
        positions = [position + shift for position in known]
        colours = [colour] * len(values)
        box_plot(axes, values, colours, alpha=0.6, positions=positions, widths=0.8 * width, whis=WHISKERS)
        axes.plot([], [], "s", color=colour, label=times.name)
    axes.axhline(1e3 * results.frame_s, color=INK, linestyle=":", linewidth=1)
    axes.plot(list(PARTS).index(COMPLETE), PAPER_MEAN_MS, "D", color=INK, markersize=5, label="mean (paper)")
    axes.set_yscale("log")
    axes.set_xticks(range(len(PARTS)), PARTS)
    axes.set(ylabel="ms", title="Run-time a frame: quartiles, whiskers 1 to 99 %; dotted: a frame's time")
    axes.grid(axis="y", color=PALE)
    axes.legend(frameon=False, ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.08))
    return png(figure)


def proposal_figure(results: RuntimeResults) -> bytes:
    """Box plots of the complete pipeline by number of proposals."""
    known = [times for times in results.networks if (times.num_proposals >= 0).any()]
    figure, panels = subplots(max(1, len(known)), width_in=5.5)
    for axes, times, colour in zip(panels, known, COLOURS, strict=False):
        groups = {words: complete for words, complete in frames_by_proposals(times, EDGES) if len(complete)}
        box_plot(axes, list(groups.values()), [colour] * len(groups), alpha=0.6, whis=WHISKERS)
        axes.set_xticks(range(1, len(groups) + 1), list(groups), rotation=20)
        axes.set(xlabel="proposals", ylabel="complete pipeline, ms", title=times.name)
        axes.set_ylim(bottom=0)
        axes.grid(axis="y", color=PALE)
    return png(figure)


def write_report(results: RuntimeResults, folder: Path) -> Path:
    """Writes `results.json`, `config.toml`, `frames.csv`, two plots and `report.md`, whose path it returns.

    Raises:
        ModuleNotFoundError: If matplotlib is not installed.
        OSError: If a file cannot be written.
    """
    page = Page(f"Run-time on {results.name}")
    frame_ms = 1e3 * results.frame_s
    page.text(f"{results.processor}; one thread for computing, no GPU. A frame's time is {frame_ms:.1f} ms.")
    page.table(_network_table(results))
    page.text(
        f"Medians in milliseconds: {', '.join(f'{part} {words}' for part, words in PARTS.items())}.",
        f"In process {COMPLETE} is from the array to the beam command, frames in memory, all of them. Elsewhere",
        "frames come at their own rate, and it is from their exposure until the command is sent.",
        f"Live, the first {NUM_WARM_UP} frames are run before the first that counts.",
    )
    page.items(_few_frames(results))
    page.figure(Figure(stage_figure(results), "Run-times by part", "stages.png"))
    for times in results.networks:
        between = {part: median_p99_max(values) for part, values in times.parts_ms.items() if part not in PARTS}
        if between:
            words = ", ".join(f"{part} {median:.2f} ({p99:.2f})" for part, (median, p99, _) in between.items())
            page.text(f"What comes between the stages, {times.name}, median (p99), ms: {words}.")
    page.section("By number of proposals")
    for times in results.networks:
        if (times.num_proposals >= 0).any():
            page.text(f"{times.name}, complete pipeline:")
            rows = [
                [words, len(complete), *map(number, median_p99_max(complete)[:2])]
                for words, complete in frames_by_proposals(times, EDGES)
            ]
            page.table(Table(["proposals", "frames", "median ms", "p99 ms"], rows))
    page.figure(Figure(proposal_figure(results), "Run-times by number of proposals", "proposals.png"))
    record = {
        "data": results.name,
        "frame_ms": frame_ms,
        "processor": results.processor,
        "networks": [_network_record(times, results.frame_s) for times in results.networks],
        "missing": results.missing,
    }
    files = {"config.toml": config_to_toml(results.config), "frames.csv": _frames_csv(results)}
    return page.write(folder / "report.md", results=record, files=files)


def summary_lines(results: RuntimeResults) -> list[str]:
    """What the command says: one line a network."""
    lines, frame_ms = [], 1e3 * results.frame_s
    for times in results.networks:
        median, p99, worst = median_p99_max(times.parts_ms[COMPLETE])
        lines.append(
            f"{times.name}: {median:.2f} ms (median), {p99:.2f} ms (p99), {worst:.2f} ms (worst) of {times.num_frames} "
            f"frames; {times.share_within(results.frame_s):.2%} within {frame_ms:.1f} ms, {times.num_dropped} dropped"
        )
    return [*lines, *_few_frames(results), *(f"{name}: {reason}" for name, reason in results.missing.items())]


def _few_frames(results: RuntimeResults) -> list[str]:
    """A line for each network of which too few frames count."""
    return [
        f"{times.name}: {counted(times.num_frames, 'frame')} counted"
        + (f", those after the first {NUM_WARM_UP}" if times.name == LIVE else "")
        + f": fewer than {MIN_FRAMES}, so that p99 says little"
        for times in results.networks
        if times.num_frames < MIN_FRAMES
    ]


def _network_table(results: RuntimeResults) -> Table:
    rows: list[list[Any]] = []
    for times in results.networks:
        medians = [number(median_p99_max(times.parts_ms.get(part, np.zeros(0)))[0]) for part in PARTS]
        _, p99, worst = map(number, median_p99_max(times.parts_ms[COMPLETE]))
        share = f"{times.share_within(results.frame_s):.2%}"
        average = number(mean(times.parts_ms[COMPLETE]))
        rows.append([times.name, times.num_frames, *medians, average, p99, worst, share, times.num_dropped])
    rows.append(
        [PAPER, PAPER_NUM_FRAMES, *[DASH] * len(PARTS), number(PAPER_MEAN_MS, 0), DASH, DASH, PAPER_SHARE, DASH]
    )
    rows += [[name, Missing(reason)] for name, reason in results.missing.items()]
    head = [
        "",
        "frames",
        *PARTS,
        f"mean of {COMPLETE}",
        f"p99 of {COMPLETE}",
        "worst",
        f"within {1e3 * results.frame_s:.1f} ms",
        "dropped",
    ]
    return Table(head, rows)


def _network_record(times: NetworkTimes, frame_s: float) -> dict[str, Any]:
    return {
        "name": times.name,
        "num_frames": times.num_frames,
        "num_dropped": times.num_dropped,
        "share_within_frame": times.share_within(frame_s),
        "parts_ms": {
            part: {"mean": mean(values), **dict(zip(("median", "p99", "max"), median_p99_max(values), strict=True))}
            for part, values in times.parts_ms.items()
            if np.isfinite(values).any()
        },
    }


def _frames_csv(results: RuntimeResults) -> str:
    parts = list(dict.fromkeys(part for times in results.networks for part in times.parts_ms))
    rows: list[list[Any]] = []
    for times in results.networks:
        for frame, count in enumerate(times.num_proposals.tolist()):
            cells = [number(times.parts_ms[part][frame], 4, "") if part in times.parts_ms else "" for part in parts]
            rows.append([times.name, frame, count if count >= 0 else "", *cells])
    return Table(["network", "place", "num_proposals", *(f"{part}_ms" for part in parts)], rows).csv()
