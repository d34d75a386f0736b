"""The report on the distance experiment: Markdown, JSON, CSV, figures, and one HTML page with everything in it."""

from __future__ import annotations

import csv
import dataclasses
import html
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from foreglow.config import config_to_toml
from foreglow.files import write_atomic, write_json_results
from foreglow.lab.reports.html import STYLE, html_figure, html_table
from foreglow.lab.reports.numbers import number, percent, signed
from foreglow.lab.studies.detector.tables import Table, markdown
from foreglow.lab.studies.distance.figures import alt_text, distance_plots
from foreglow.lab.studies.distance.findings import ALL, PAPERS_GP, REACH_M, Finding, find
from foreglow.lab.studies.distance.lights import RangedLight
from foreglow.lab.studies.distance.run import DEFAULT_HEURISTIC, OWN_RULE, DistanceResults, Method
from foreglow.provenance import processor_name, provenance

SIGN = "Relative error is (estimate - truth) / truth: positive where the light seems too far."


def write_report(results: DistanceResults, folder: Path) -> Path:
    """Writes `results.json`, `lights.csv`, `config.toml`, `tables.md`, figures and `report.html`; returns the last.

    Raises:
        OSError: If a file cannot be written.
        ModuleNotFoundError: If matplotlib is not installed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    findings = find(results)
    plots = distance_plots(results, findings)
    write_json_results(folder / "results.json", _record(results, findings))
    write_atomic(folder / "lights.csv", lights_csv(results).encode())
    write_atomic(folder / "config.toml", config_to_toml(results.plan.config).encode())
    for name, plot in plots.items():
        write_atomic(folder / name, plot)
    write_atomic(folder / "tables.md", ("\n".join(_markdown_lines(results, findings)) + "\n").encode())
    report = folder / "report.html"
    write_atomic(report, "\n".join(_html_lines(results, findings, plots)).encode())
    return report


def headline(findings: Sequence[Finding]) -> list[str]:
    """GP beside the paper, one fact a line; none without GP."""
    lines = []
    for light, papers in PAPERS_GP.items():
        to_light = _one(findings, "range", "gp", light)
        to_vehicle = _one(findings, "vehicle", "gp", light)
        if to_light is not None and to_vehicle is not None:
            lines.append(
                f"GP, {light}: median relative error {signed(to_light.errors.median, 3)} of the range to the light, "
                f"{signed(to_vehicle.errors.median, 3)} of that to the vehicle (paper {papers:+.2f})"
            )
    return lines


def lights_csv(results: DistanceResults) -> str:
    """A line for each light: what is known of it, and each method's range and sigma, metres; empty where none."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    fields = [field.name for field in dataclasses.fields(RangedLight) if field.name not in ("place", "box_xyxy_px")]
    corners = ["x1_px", "y1_px", "x2_px", "y2_px"]
    names = [f"{method.name}: {what}" for method in results.methods for what in ("range_m", "sigma_m")]
    writer.writerow([*fields, *corners, *names])
    columns = [one[method] for method in results.methods for one in (results.ranges_m, results.sigmas_m)]
    for place, light in enumerate(results.lights):
        values = (float(column[place]) for column in columns)
        known = [getattr(light, name) for name in fields]
        writer.writerow([*known, *light.box_xyxy_px, *(f"{one:.3f}" if math.isfinite(one) else "" for one in values)])
    return buffer.getvalue()


def _record(results: DistanceResults, findings: Sequence[Finding]) -> dict[str, Any]:
    return {
        "made_with": provenance() | {"processor": processor_name(), "seed": results.plan.seed},
        "split": results.name,
        "rate_hz": results.rate_hz,
        "num_images": results.num_images,
        "num_lights": len(results.lights),
        "left_out": dict(sorted(results.left_out.items())),
        "error": SIGN,
        "paper_gp_median": PAPERS_GP,
        "findings": [one.to_json() for one in findings],
    }


def _preamble(results: DistanceResults) -> list[str]:
    left_out = ", ".join(f"{number} {reason}" for reason, number in sorted(results.left_out.items())) or "none"
    return [
        f"{len(results.lights)} labelled lights in {results.num_images} images, {results.rate_hz:g} a second; "
        f"left out: {left_out}.",
        "A light's box is the smallest proposal that holds its keypoint; its true range is that along the viewing ray.",
        SIGN,
        f"Where nothing else is said, the heuristic is {DEFAULT_HEURISTIC}.",
    ]


def _tables(findings: Sequence[Finding]) -> Iterator[tuple[str, str, Table]]:
    """Heading, remark and table of every section."""
    by_axis = {axis: [one for one in findings if one.axis == axis] for axis in _SECTIONS}
    whole = [one for one in by_axis["range"] if one.group == ALL]
    yield "All methods", "In brackets: 95 % of the resamples of drives.", _table(whole, with_group=False)
    for axis, (heading, remark) in _SECTIONS.items():
        if axis == "range":
            chosen = [one for one in by_axis[axis] if _is_main(one.method) and one.light != ALL]
        else:
            chosen = [one for one in by_axis[axis] if _is_main(one.method)]
        if chosen:
            yield heading, remark, _table(chosen, with_group=axis != "vehicle")


_SECTIONS = {
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


def _table(findings: Sequence[Finding], *, with_group: bool) -> Table:
    head = ["method", "light", *(["group"] if with_group else []), "lights", "without estimate", "median"]
    head += ["median absolute", "quartiles", "within 1 sigma", "within 2 sigma"]
    rows = []
    for one in findings:
        errors = one.errors
        interval = (
            "" if math.isnan(errors.absolute_low) else f" [{errors.absolute_low:.2f}, {errors.absolute_high:.2f}]"
        )
        rows.append(
            [
                one.method.name,
                one.light,
                *([one.group] if with_group else []),
                str(errors.num),
                percent(errors.missing),
                signed(errors.median, 3),
                f"{number(errors.median_absolute, 3)}{interval}",
                f"{signed(errors.lower_quartile, 3)} to {signed(errors.upper_quartile, 3)}",
                percent(errors.within_one_sigma),
                percent(errors.within_two_sigma),
            ]
        )
    return Table(head, rows, [""] * len(rows))


def _markdown_lines(results: DistanceResults, findings: Sequence[Finding]) -> Iterator[str]:
    yield f"# Ranges on {results.name}"
    yield ""
    yield from _preamble(results)
    yield ""
    yield from (f"- {line}" for line in headline(findings))
    for heading, remark, table in _tables(findings):
        yield from ("", f"## {heading}", "", remark, "", *markdown(table))


def _html_lines(results: DistanceResults, findings: Sequence[Finding], plots: Mapping[str, bytes]) -> Iterator[str]:
    title = html.escape(f"Ranges on {results.name}")
    yield "<!doctype html>"
    yield f'<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
    yield f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head><body>'
    yield f"<h1>{title}</h1>"
    yield f"<p>{html.escape(' '.join(_preamble(results)))}</p><ul>"
    yield from (f"<li>{html.escape(line)}</li>" for line in headline(findings))
    yield "</ul>"
    for name, plot in plots.items():
        yield html_figure(plot, alt_text(name))
    for heading, remark, table in _tables(findings):
        yield f"<h2>{html.escape(heading)}</h2><p>{html.escape(remark)}</p>"
        yield from html_table(table)
    yield "</body></html>"


def _is_main(method: Method) -> bool:
    return method.heuristic in (DEFAULT_HEURISTIC, OWN_RULE)


def _one(findings: Sequence[Finding], axis: str, estimator: str, light: str) -> Finding | None:
    """The main method's figures over all groups of an axis."""
    fits = (
        one
        for one in findings
        if (one.axis, one.method.estimator, one.light, one.group) == (axis, estimator, light, ALL)
        and _is_main(one.method)
    )
    return next(fits, None)
