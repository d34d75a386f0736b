"""The report on run-times: the paper's box plots, tables, and the numbers as JSON and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from foreglow.config import config_to_toml
from foreglow.files import write_atomic, write_json_results
from foreglow.geometry import Floats
from foreglow.lab.reports.figures import AMBER, BLUE, GREY, INK, PALE, png, subplots
from foreglow.lab.reports.numbers import DASH, number
from foreglow.lab.studies.runtime.run import COMPLETE, PARTS, NetworkTimes, RuntimeResults, frames_by_proposals
from foreglow.provenance import provenance

EDGES = (0, 10, 20, 30, 40, 60)
"""Numbers of proposals at which the groups begin."""

COLOURS = (AMBER, BLUE, "#2c9c4b", GREY)


def write_report(results: RuntimeResults, folder: Path) -> Path:
    """Writes `results.json`, `config.toml`, `frames.csv`, two plots and `report.md`, whose path it returns.

    Raises:
        ModuleNotFoundError: If matplotlib is not installed.
        OSError: If a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_json_results(folder / "results.json", {"made_with": provenance()} | _figures(results))
    write_atomic(folder / "config.toml", config_to_toml(results.config).encode())
    write_atomic(folder / "frames.csv", _frames_csv(results).encode())
    write_atomic(folder / "stages.png", _stage_figure(results))
    write_atomic(folder / "proposals.png", _proposal_figure(results))
    report = folder / "report.md"
    write_atomic(report, ("\n".join(_lines(results)) + "\n").encode())
    return report


def summary_lines(results: RuntimeResults) -> list[str]:
    """What the command says: one line a network."""
    lines, frame_ms = [], 1e3 * results.frame_s
    for one in results.networks:
        median, p99, worst = percentiles(one.parts_ms[COMPLETE])
        lines.append(
            f"{one.name}: {median:.2f} ms (median), {p99:.2f} ms (p99), {worst:.2f} ms (worst) of {_count(one)} "
            f"frames; {one.share_within(results.frame_s):.2%} within {frame_ms:.1f} ms, {one.num_dropped} dropped"
        )
    return [*lines, *(f"{name}: {reason}" for name, reason in results.missing.items())]


def percentiles(values: Floats) -> tuple[float, float, float]:
    """Median, p99 and the greatest of the finite values; NaN for none.

    >>> percentiles(np.array([1.0, 2.0, 3.0, np.nan]))
    (2.0, 2.98, 3.0)
    """
    finite = values[np.isfinite(values)]
    if not len(finite):
        return (float("nan"),) * 3
    median, p99, worst = np.percentile(finite, (50, 99, 100)).tolist()
    return median, p99, worst


def _count(times: NetworkTimes) -> int:
    return int(np.isfinite(times.parts_ms[COMPLETE]).sum())


def _lines(results: RuntimeResults) -> Iterator[str]:
    frame_ms = 1e3 * results.frame_s
    yield f"# Run-time on {results.name}"
    yield ""
    yield f"{results.processor}; one thread for computing, no GPU. A frame's time is {frame_ms:.1f} ms."
    yield ""
    yield f"| | frames | {' | '.join(PARTS)} | p99 of {COMPLETE} | worst | within {frame_ms:.1f} ms | dropped |"
    yield "|---" * (len(PARTS) + 6) + "|"
    for one in results.networks:
        medians = [number(percentiles(one.parts_ms[part])[0]) if part in one.parts_ms else DASH for part in PARTS]
        _, p99, worst = percentiles(one.parts_ms[COMPLETE])
        yield (
            f"| {one.name} | {_count(one)} | {' | '.join(medians)} | {number(p99)} | {number(worst)} "
            f"| {one.share_within(results.frame_s):.2%} | {one.num_dropped} |"
        )
    for name, reason in results.missing.items():
        yield f"| {name} | *{reason}* |" + " |" * (len(PARTS) + 4)
    yield ""
    yield f"Medians in milliseconds: {', '.join(f'{part} {words}' for part, words in PARTS.items())}."
    yield f"In process {COMPLETE} is from the array to the beam command, frames in memory, all of them. Elsewhere"
    yield "frames come at their own rate, and it is from their exposure until the command is sent."
    yield from ("", "![stages](stages.png)", "")
    for one in results.networks:
        between = {part: percentiles(values) for part, values in one.parts_ms.items() if part not in PARTS}
        if between:
            words = ", ".join(f"{part} {median:.2f} ({p99:.2f})" for part, (median, p99, _) in between.items())
            yield f"What comes between the stages, {one.name}, median (p99), ms: {words}."
            yield ""
    yield from ("## By number of proposals", "")
    for one in results.networks:
        if (one.num_proposals >= 0).any():
            yield from (
                f"{one.name}, complete pipeline:",
                "",
                "| proposals | frames | median ms | p99 ms |",
                "|---|---|---|---|",
            )
            for words, complete in frames_by_proposals(one, EDGES):
                median, p99, _ = percentiles(complete)
                yield f"| {words} | {len(complete)} | {number(median)} | {number(p99)} |"
            yield ""
    yield "![proposals](proposals.png)"


def _figures(results: RuntimeResults) -> dict[str, Any]:
    networks = []
    for one in results.networks:
        parts = {
            part: dict(zip(("median", "p99", "max"), percentiles(values), strict=True))
            for part, values in one.parts_ms.items()
            if np.isfinite(values).any()
        }
        networks.append(
            {
                "name": one.name,
                "num_frames": _count(one),
                "num_dropped": one.num_dropped,
                "share_within_frame": one.share_within(results.frame_s),
                "parts_ms": parts,
            }
        )
    return {
        "data": results.name,
        "frame_ms": 1e3 * results.frame_s,
        "processor": results.processor,
        "networks": networks,
        "missing": dict(results.missing),
    }


def _frames_csv(results: RuntimeResults) -> str:
    """A line a frame of every network."""
    parts = list(dict.fromkeys(part for one in results.networks for part in one.parts_ms))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["network", "place", "num_proposals", *(f"{part}_ms" for part in parts)])
    for one in results.networks:
        columns = [one.parts_ms.get(part) for part in parts]
        for place, count in enumerate(one.num_proposals.tolist()):
            cells = ["" if column is None or np.isnan(column[place]) else f"{column[place]:.4f}" for column in columns]
            writer.writerow([one.name, place, count if count >= 0 else "", *cells])
    return text.getvalue()


def _stage_figure(results: RuntimeResults) -> bytes:
    """The paper's figure: box plots of the parts, one group a part, one colour a network."""
    figure, (axes,) = subplots(1, width_in=9.0, height_in=4.0)
    width = 0.8 / max(1, len(results.networks))
    for place, (one, colour) in enumerate(zip(results.networks, COLOURS, strict=False)):
        known = [(number, part) for number, part in enumerate(PARTS) if part in one.parts_ms]
        values = [one.parts_ms[part][np.isfinite(one.parts_ms[part])] for _, part in known]
        positions = [number + (place - (len(results.networks) - 1) / 2) * width for number, _ in known]
        boxes = axes.boxplot(
            values,
            positions=positions,
            widths=0.8 * width,
            whis=(1, 99),
            showfliers=False,
            patch_artist=True,
            medianprops={"color": INK},
        )
        for box in boxes["boxes"]:
            box.set(facecolor=colour, alpha=0.6)
        axes.plot([], [], "s", color=colour, label=one.name)
    axes.axhline(1e3 * results.frame_s, color=INK, linestyle=":", linewidth=1)
    axes.set_yscale("log")
    axes.set_xticks(range(len(PARTS)), PARTS)
    axes.set(ylabel="ms", title="Run-time a frame: quartiles, whiskers 1 to 99 %; dotted: a frame's time")
    axes.grid(axis="y", color=PALE)
    axes.legend(frameon=False, ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.08))
    return png(figure)


def _proposal_figure(results: RuntimeResults) -> bytes:
    """Box plots of the complete pipeline by number of proposals."""
    known = [one for one in results.networks if (one.num_proposals >= 0).any()]
    figure, all_axes = subplots(max(1, len(known)), width_in=5.5)
    for axes, one, colour in zip(all_axes, known, COLOURS, strict=False):
        groups = [(words, complete) for words, complete in frames_by_proposals(one, EDGES) if len(complete)]
        boxes = axes.boxplot(
            [complete for _, complete in groups],
            whis=(1, 99),
            showfliers=False,
            patch_artist=True,
            medianprops={"color": INK},
        )
        for box in boxes["boxes"]:
            box.set(facecolor=colour, alpha=0.6)
        axes.set_xticks(range(1, len(groups) + 1), [words for words, _ in groups], rotation=20)
        axes.set(xlabel="proposals", ylabel="complete pipeline, ms", title=one.name)
        axes.set_ylim(bottom=0)
        axes.grid(axis="y", color=PALE)
    return png(figure)
