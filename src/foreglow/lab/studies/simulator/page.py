"""The report on a simulated data set: Markdown with tables, its figures, and the numbers as JSON."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from foreglow.files import write_atomic, write_json_results
from foreglow.lab.reports.figures import AMBER, BLUE, GREY, INK, png, subplots
from foreglow.lab.studies.simulator.image_statistics import LAMP_RADII_PX, PERCENTILES
from foreglow.lab.studies.simulator.perceivability import RuleEffect
from foreglow.lab.studies.simulator.run import SimulatorResults

BIN_S = 0.25
PROVIDENT, PRODUCTION, REAL = AMBER, BLUE, GREY


def write_report(results: SimulatorResults, folder: Path) -> Path:
    """Writes `results.json`, `leads.png`, `pixels.png` and `report.md` to `folder`, and returns the last one's path.

    Raises:
        OSError: If a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_json_results(folder / "results.json", results.to_json())
    write_atomic(folder / "leads.png", _leads_figure(results))
    write_atomic(folder / "pixels.png", _pixels_figure(results))
    report = folder / "report.md"
    write_atomic(report, "\n".join(_lines(results)).encode())
    return report


def _lines(results: SimulatorResults) -> list[str]:
    labels = results.labels
    return [
        f"# The simulated data set {results.name}",
        "",
        f"{labels.num_sequences} drives, {labels.num_images} images, {labels.num_instances} instances.",
        "",
        "## Time that indirect light leads",
        "",
        _in_words("Indirect light comes before the first lamp by", results.leads_s),
        _in_words(
            "The modelled production system reports after the first indirect light by", results.production_delays_s
        ),
        "",
        "![leads](leads.png)",
        "",
        "How first times move with the rule of what is perceivable: both thresholds are multiplied by the factor.",
        "",
        "| factor | drives with light | indirect first | lead, median (quartiles), s | first indirect moves by, s "
        "| instances a hidden image |",
        "|---|---|---|---|---|---|",
        *(_effect_row(effect) for effect in results.effects),
        "",
        "## Labels",
        "",
        *_label_lines(results),
        "",
        "## Pixels",
        "",
        *_pixel_lines(results),
        "",
    ]


def _in_words(what: str, values_s: Sequence[float]) -> str:
    if not values_s:
        return f"{what}: no drive has both."
    low, median, high = np.percentile(values_s, (25, 50, 75))
    share = np.mean(np.array(values_s) > 0)
    return f"{what} {median:.2f} s (quartiles {low:.2f} to {high:.2f} s; {len(values_s)} drives, {share:.0%} above 0)."


def _effect_row(effect: RuleEffect) -> str:
    lead, shift = effect.lead_s, effect.shift_s
    return (
        f"| {effect.factor:g} | {effect.num_drives} | {_number(effect.share_indirect_first)} | {_number(lead.median)} "
        f"({_number(lead.lower_quartile)} to {_number(lead.upper_quartile)}) | {_number(shift.median)} "
        f"({_number(shift.lower_quartile)} to {_number(shift.upper_quartile)}) "
        f"| {_number(effect.instances_per_hidden_frame)} |"
    )


def _label_lines(results: SimulatorResults) -> list[str]:
    if results.label_rows is None:
        return ["Without real labels to compare with (`--real-labels`)."]
    num_close = sum(row.is_close for row in results.label_rows)
    return [
        f"{num_close} of {len(results.label_rows)} figures are within a factor 1.5 of the real ones.",
        "",
        "| figure | real | simulated | ratio | within 1.5 |",
        "|---|---|---|---|---|",
        *(
            f"| {row.name.replace('_', ' ')} | {_number(row.real)} | {_number(row.simulated)} | {_number(row.ratio)} "
            f"| {'yes' if row.is_close else '**no**'} |"
            for row in results.label_rows
        ),
    ]


def _pixel_lines(results: SimulatorResults) -> list[str]:
    lines = [f"Means over {results.pixels.num_images} images with a lamp in sight.", "", "![pixels](pixels.png)", ""]
    if results.pixel_rows is None:
        return [*lines, "Without a real image to compare with (`--real-image`)."]
    return [
        *lines,
        "| figure | real | simulated | ratio |",
        "|---|---|---|---|",
        *(
            f"| {row.name} | {_number(row.real)} | {_number(row.simulated)} | {_number(row.ratio)} |"
            for row in results.pixel_rows
        ),
    ]


def _number(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:.3g}"


def _leads_figure(results: SimulatorResults) -> bytes:
    """Histograms of both leads."""
    figure, axes = subplots(1)
    times = [*results.leads_s, *results.production_delays_s, 0.0]
    edges = np.arange(np.floor(min(times) / BIN_S) * BIN_S, max(times) + 2 * BIN_S, BIN_S)
    axes[0].hist(results.leads_s, edges, color=PROVIDENT, alpha=0.75, label="first lamp")
    axes[0].hist(results.production_delays_s, edges, color=PRODUCTION, alpha=0.55, label="modelled production system")
    axes[0].axvline(0.0, color=INK, linewidth=0.8)
    axes[0].set(xlabel="seconds after the first indirect light", ylabel="drives")
    axes[0].legend(frameon=False)
    return png(figure)


def _pixels_figure(results: SimulatorResults) -> bytes:
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
