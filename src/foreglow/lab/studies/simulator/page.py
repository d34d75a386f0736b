"""The report on a simulated data set: Markdown with tables, its figures, and the numbers as JSON."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from foreglow.display.summary_lines import counted
from foreglow.lab.evaluation.label_statistics import Spread
from foreglow.lab.reports.figures import AMBER, BLUE, GREY, INK, png, subplots
from foreglow.lab.reports.page import DASH, Figure, Page, Table, percent
from foreglow.lab.studies.reproduction.claims import paper_words
from foreglow.lab.studies.simulator.metrics import LAMP_RADII_PX, PERCENTILES, RuleEffect
from foreglow.lab.studies.simulator.run import SimulatorResults

BIN_S = 0.25
PROVIDENT, PRODUCTION, REAL = AMBER, BLUE, GREY


def leads_figure(results: SimulatorResults) -> bytes:
    """Histograms of both leads."""
    figure, (axes,) = subplots(1)
    times = [*results.leads_s, *results.production_delays_s, 0.0]
    edges = np.arange(np.floor(min(times) / BIN_S) * BIN_S, max(times) + 2 * BIN_S, BIN_S)
    axes.hist(results.leads_s, edges, color=PROVIDENT, alpha=0.75, label="first lamp")
    axes.hist(results.production_delays_s, edges, color=PRODUCTION, alpha=0.55, label="modelled production system")
    axes.axvline(0.0, color=INK, linewidth=0.8)
    axes.set(xlabel="seconds after the first indirect light", ylabel="drives")
    axes.legend(frameon=False)
    return png(figure)


def pixels_figure(results: SimulatorResults) -> bytes:
    """Grey levels over their share of the image, and over the distance from a lamp."""
    figure, axes = subplots(2)
    radii = [(low + high) / 2 for low, high in itertools.pairwise(LAMP_RADII_PX)]
    axes[0].plot(PERCENTILES, results.pixels.percentiles_grey, color=PROVIDENT, marker="o", label="simulated")
    axes[1].plot(radii, results.pixels.lamp_grey, color=PROVIDENT, marker="o", label="simulated")
    if results.pixel_rows is not None:
        real = {row.name: row.real for row in results.pixel_rows}
        axes[0].plot(
            PERCENTILES, [real[f"grey level, percentile {share:g}"] for share in PERCENTILES], color=REAL, label="real"
        )
        rings = [value for name, value in real.items() if name.startswith("lamp, ")]
        axes[1].plot(radii, rings, color=REAL, label="real")
    axes[0].set(xlabel="percentile of the pixels", ylabel="grey level")
    axes[1].set(xlabel="pixels from a lamp", ylabel="grey level", xscale="log")
    axes[0].legend(frameon=False)
    return png(figure)


def write_report(results: SimulatorResults, folder: Path) -> Path:
    """Writes `results.json`, `leads.png`, `pixels.png` and `report.md` to `folder`, and returns the last one's path.

    Raises:
        OSError: If a file cannot be written.
    """
    labels = results.labels
    page = Page(f"The simulated data set {results.name}")
    counts = {"drive": labels.num_sequences, "image": labels.num_images, "instance": labels.num_instances}
    page.text(f"{', '.join(counted(num, noun) for noun, num in counts.items())}.")
    _add_leads(page, results)
    page.section("Labels")
    _add_labels(page, results)
    which = "with a lamp in sight" if results.has_lamps else "without a lamp in sight, around their brightest spots"
    page.section("Pixels", f"Means over {results.pixels.num_images} images {which}.")
    page.figure(Figure(pixels_figure(results), "Grey levels, and those around a lamp", "pixels.png"))
    if results.pixel_rows is None:
        page.text("Without a real image to compare with (`--real-image`).")
    else:
        page.table(Table.of(COMPARED, results.pixel_rows))
    return page.write(folder / "report.md", results=results)


def summary_lines(results: SimulatorResults) -> list[str]:
    """What the command says: both leads, and what the paper states of them."""
    return [
        _in_words("Indirect light comes before the first lamp by", results.leads_s),
        _in_words(
            "The modelled production system reports after the first indirect light by", results.production_delays_s
        ),
        f"In the paper a human tells a vehicle {paper_words('human-reaction')} after its first light, "
        f"and {paper_words('human-lead')} before a production system does.",
    ]


def _add_leads(page: Page, results: SimulatorResults) -> None:
    page.section("Time that indirect light leads", *summary_lines(results))
    page.figure(Figure(leads_figure(results), "Time from the first indirect light", "leads.png"))
    page.text(
        "How first times move with the rule of what is perceivable: both thresholds are multiplied by the factor."
    )
    columns: dict[str, Callable[[RuleEffect], object]] = {
        "factor": lambda effect: f"{effect.factor:g}",
        "drives with light": lambda effect: effect.num_drives,
        "indirect first": lambda effect: _number(effect.share_indirect_first),
        "lead, median (quartiles), s": lambda effect: _spread(effect.lead_s),
        "first indirect moves by, s": lambda effect: _spread(effect.shift_s),
        "instances a hidden image": lambda effect: _number(effect.instances_per_hidden_frame),
    }
    page.table(Table.of(columns, results.effects))


def _add_labels(page: Page, results: SimulatorResults) -> None:
    if results.label_rows is None:
        page.text("Without real labels to compare with (`--real-labels`).")
        return
    num_close = sum(row.is_close for row in results.label_rows)
    page.text(f"{num_close} of {len(results.label_rows)} figures are within a factor 1.5 of the real ones.")
    page.table(
        Table.of({**COMPARED, "within 1.5": lambda row: "yes" if row.is_close else "**no**"}, results.label_rows)
    )


COMPARED: Mapping[str, Callable[[Any], str]] = {
    "figure": lambda row: row.name.replace("_", " "),
    "real": lambda row: _number(row.real),
    "simulated": lambda row: _number(row.simulated),
    "ratio": lambda row: _number(row.ratio),
}
"""Columns of figures of labels or pixels, beside real ones."""


def _in_words(what: str, values_s: Sequence[float]) -> str:
    if not values_s:
        return f"{what}: no drive has both."
    low, median, high = np.percentile(values_s, (25, 50, 75))
    ahead = percent(float(np.mean(np.array(values_s) > 0)))
    return f"{what} {median:.2f} s (quartiles {low:.2f} to {high:.2f} s; {len(values_s)} drives, {ahead} above 0)."


def _spread(values: Spread) -> str:
    return f"{_number(values.median)} ({_number(values.lower_quartile)} to {_number(values.upper_quartile)})"


def _number(value: float) -> str:
    return DASH if np.isnan(value) else f"{value:.3g}"
