"""The report on the distance experiment: Markdown, JSON, CSV, figures, and one HTML page with everything in it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from foreglow.config import config_to_toml
from foreglow.lab.reports.numbers import number, percent, signed
from foreglow.lab.reports.page import Figure, Page, Table
from foreglow.lab.studies.distance.figures import distance_figures
from foreglow.lab.studies.distance.lights import RangedLight
from foreglow.lab.studies.distance.metrics import ALL, PAPERS_GP, REACH_M, ErrorSummary, Finding, find
from foreglow.lab.studies.distance.run import DEFAULT_HEURISTIC, DistanceResults
from foreglow.provenance import processor_name

SIGN = "Relative error is (estimate - truth) / truth: positive where the light seems too far."

SECTIONS = {
    "range": ("By range", "Bins of the true range, the lower edge inclusive."),
    "reach": (f"Up to {REACH_M:g} m", "All lights, and those for which each of the methods here has a range."),
    "vehicle": ("Against the vehicle's range", "What the same estimates are worth as the distance of the vehicle."),
    "tracks": (
        "Tracks",
        "The range of the plausible track on a light's box, by our tracker with each of its filters, and that of the "
        "box alone. Without estimate: no plausible track.",
    ),
    "series": ("Five frames", "Mean and median of a light's latest five frames, by the time of the last one."),
    "localisation": ("By localisation error", "The largest error of the position on the map."),
    "terrain": ("By terrain", "The drive's scenario."),
    "kind": ("By what the light is seen on", ""),
    "pitch": ("By pitch error", "Added to the calibration, upwards."),
}
"""Heading and remark of each axis of the findings."""


def write_report(results: DistanceResults, folder: Path) -> Path:
    """Writes `results.json`, `lights.csv`, `config.toml`, `tables.md`, figures and `report.html`; returns the last.

    Raises:
        OSError: If a file cannot be written.
        ModuleNotFoundError: If matplotlib is not installed.
    """
    findings = find(results)
    files = {
        "lights.csv": lights_csv(results),
        "config.toml": config_to_toml(results.plan.config),
        "tables.md": _page(results, findings).markdown(),
    }
    record = {
        "split": results.name,
        "rate_hz": results.rate_hz,
        "num_images": results.num_images,
        "num_lights": len(results.lights),
        "left_out": dict(sorted(results.left_out.items())),
        "error": SIGN,
        "paper_gp_median": PAPERS_GP,
        "findings": findings,
    }
    made_with = {"processor": processor_name(), "seed": results.plan.seed}
    page = _page(results, findings, distance_figures(results, findings))
    return page.write(folder / "report.html", results=record, made_with=made_with, files=files)


def headline(findings: Sequence[Finding]) -> list[str]:
    """GP beside the paper, one fact a line; none without GP."""
    medians = {
        (found.axis, found.light): found.errors.median
        for found in findings
        if found.method.estimator == "gp" and found.method.is_default and found.group == ALL
    }
    return [
        f"GP, {light}: median relative error {signed(medians['range', light], 3)} of the range to the light, "
        f"{signed(medians['vehicle', light], 3)} of that to the vehicle (paper {papers:+.2f})"
        for light, papers in PAPERS_GP.items()
        if ("range", light) in medians
    ]


def lights_csv(results: DistanceResults) -> str:
    """A line for each light: what is known of it, and each method's range and sigma, metres; empty where none."""
    fields = [field.name for field in dataclasses.fields(RangedLight) if field.name not in ("box", "box_xyxy_px")]
    corners = ["x1_px", "y1_px", "x2_px", "y2_px"]
    names = [f"{method.name}: {what}" for method in results.methods for what in ("range_m", "sigma_m")]
    columns = [values[method] for method in results.methods for values in (results.ranges_m, results.sigmas_m)]
    rows = [
        [
            *(getattr(light, name) for name in fields),
            *light.box_xyxy_px,
            *(f"{value:.3f}" if math.isfinite(value) else "" for value in values),
        ]
        for light, *values in zip(results.lights, *columns, strict=True)
    ]
    return Table([*fields, *corners, *names], rows).csv()


def _page(results: DistanceResults, findings: Sequence[Finding], figures: Iterable[Figure] = ()) -> Page:
    left_out = ", ".join(f"{num} {reason}" for reason, num in sorted(results.left_out.items())) or "none"
    page = Page(f"Ranges on {results.name}")
    page.text(
        f"{len(results.lights)} labelled lights in {results.num_images} images, {results.rate_hz:g} a second; "
        f"left out: {left_out}.",
        "A light's box is the smallest proposal that holds its keypoint; its true range is that along the viewing ray.",
        SIGN,
        f"Where nothing else is said, the heuristic is {DEFAULT_HEURISTIC}.",
    )
    page.items(headline(findings))
    for figure in figures:
        page.figure(figure)
    page.section("All methods", "In brackets: 95 % of the resamples of drives.")
    page.table(_table([found for found in findings if found.axis == "range" and found.group == ALL], with_group=False))
    for axis, (heading, remark) in SECTIONS.items():
        chosen = [found for found in findings if found.axis == axis and found.method.is_default]
        if axis == "range":
            chosen = [found for found in chosen if found.light != ALL]
        if chosen:
            page.section(heading, remark)
            page.table(_table(chosen, with_group=axis != "vehicle"))
    return page


def _table(findings: Sequence[Finding], *, with_group: bool) -> Table:
    columns = COLUMNS if with_group else {head: cell for head, cell in COLUMNS.items() if head != "group"}
    return Table.of(columns, findings)


def _median_absolute(errors: ErrorSummary) -> str:
    """With its interval where it has one."""
    interval = f" [{errors.absolute_low:.2f}, {errors.absolute_high:.2f}]"
    return number(errors.median_absolute, 3) + ("" if math.isnan(errors.absolute_low) else interval)


COLUMNS: Mapping[str, Callable[[Finding], object]] = {
    "method": lambda found: found.method.name,
    "light": lambda found: found.light,
    "group": lambda found: found.group,
    "lights": lambda found: found.errors.num,
    "without estimate": lambda found: percent(found.errors.missing),
    "median": lambda found: signed(found.errors.median, 3),
    "median absolute": lambda found: _median_absolute(found.errors),
    "quartiles": lambda found: f"{signed(found.errors.lower_quartile, 3)} to {signed(found.errors.upper_quartile, 3)}",
    "within 1 sigma": lambda found: percent(found.errors.within_one_sigma),
    "within 2 sigma": lambda found: percent(found.errors.within_two_sigma),
}
