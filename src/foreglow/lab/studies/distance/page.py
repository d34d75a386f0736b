"""The report on the distance experiment: Markdown, JSON, CSV, figures, and one HTML page with everything in it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from foreglow.config import config_to_toml
from foreglow.display.tone import Tone
from foreglow.distance import ESTIMATORS
from foreglow.geometry import Floats
from foreglow.lab.reports.figures import AMBER, BLUE, GREY, INK, box_plot, jpeg, legend_above, png, subplots
from foreglow.lab.reports.page import Figure, Page, Table, number, percent, signed
from foreglow.lab.studies.distance.lights import RangedLight, Sample
from foreglow.lab.studies.distance.metrics import (
    ALL,
    PAPERS_GP,
    REACH_M,
    ErrorSummary,
    Finding,
    beside_paper,
    find,
    light_sorts,
    mean_ranges_m,
    relative_errors,
)
from foreglow.lab.studies.distance.run import DEFAULT_HEURISTIC, DistanceResults
from foreglow.provenance import processor_name

LIGHTS = {"direct": AMBER, "indirect": BLUE}
CURVES = (AMBER, BLUE, "#4c9a57", "#9a4c8f", GREY, INK)
WHISKERS = (5, 95)
LIMITS = (-1.05, 2.5)
PAPERS_NAMES = {"gp": "GP", "psd_3d": "PSD-3D", "psd_3d_plus": "PSD-3D+", "psd_2d": "PSD-2D"}
"""What the paper calls its estimators."""

IN_SERIES = ("gp", "road_surface")
"""Estimators of which series of frames are drawn: that of the paper's figure, and ours; the tables have all."""

CROP_MARGIN_PX = 60
DIRECT_BGR, INDIRECT_BGR = (80, 220, 80), (200, 100, 255)
PICTURE_WIDTH_PX, JPEG_QUALITY = 1920, 85


def distance_figures(results: DistanceResults, findings: Sequence[Finding]) -> list[Figure]:
    """All figures; none without lights.

    Raises:
        ModuleNotFoundError: If matplotlib is not installed.
    """
    if not results.lights:
        return []
    ranges_m = results.ranges_m
    methods, series = {}, {}
    for main in results.main_methods:
        methods[PAPERS_NAMES.get(main.estimator, main.estimator)] = ranges_m[main]
        if main.estimator not in IN_SERIES:
            continue
        series[f"{main.estimator}\nsingle"] = ranges_m[main]
        for (name, method), series_m in results.series_m.items():
            if method == main:
                series[f"{main.estimator}\n{name.removesuffix(' of five frames')} of 5"] = series_m
    boxes = "Relative error by method; boxes are quartiles, whiskers the 5th and 95th percentile"
    frames = "Relative error of single frames, and of the mean and the median of a light's latest five frames"
    by_range = "Median absolute relative error by range, with the number of lights"
    by_error = "By the largest error of the position on the map, as the street message states it"
    figures = [
        Figure(_error_boxes(results, methods, PAPERS_GP), boxes, "methods.png"),
        Figure(_error_boxes(results, series), frames, "series.png"),
        Figure(_bars(findings, "range"), by_range, "range.png"),
        Figure(_bars(findings, "localisation"), by_error, "localisation.png"),
        Figure(_bars(findings, "terrain"), "By scenario", "terrain.png"),
        Figure(_pitch(findings), "Median relative error when the calibration's pitch is wrong by so much", "pitch.png"),
    ]
    if results.example is not None:
        words = (
            "An image with the LiDAR's depths (brighter: farther), its lights' boxes (green: direct), and the depths"
        )
        figures.insert(0, Figure(_lidar_picture(results.example), words, "lidar.jpg"))
    for estimator in results.plan.estimators:
        methods_of = [method for method in results.methods if method.estimator == estimator]
        columns = {method.heuristic: ranges_m[method] for method in methods_of}
        if len(columns) > 1:
            plot, caption = _error_boxes(results, columns), f"{estimator}: relative error by heuristic"
            figures.append(Figure(plot, caption, f"heuristics_{estimator}.png"))
    return figures


def _error_boxes(
    results: DistanceResults, columns: Mapping[str, Floats], papers_gp: Mapping[str, float] | None = None
) -> bytes:
    """Box plots of the relative error, direct beside indirect: median, quartiles, 5th and 95th percentile.

    Args:
        results: Of the experiment.
        columns: Ranges by the name of the box.
        papers_gp: By light, the paper's median for the column `GP`; None marks nothing.
    """
    figure, (axes,) = subplots(1, width_in=2.0 + 1.1 * len(columns), height_in=4.0)
    truth_m, sorts = results.column("truth_m"), light_sorts(results)
    positions = np.arange(len(columns))
    handles = []
    for shift, (light, colour) in zip((-0.19, 0.19), LIGHTS.items(), strict=True):
        errors = [relative_errors(truth_m, ranges_m)[sorts[light]] for ranges_m in columns.values()]
        known = [column[~np.isnan(column)] for column in errors]
        options = {"positions": positions + shift, "widths": 0.32, "whis": WHISKERS}
        handles.append(box_plot(axes, known, [colour] * len(known), alpha=0.75, linewidth=0.8, **options)[0])
    axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.set(ylim=LIMITS, ylabel="(estimate - truth) / truth")
    axes.set_xticks(positions, list(columns))
    if papers_gp and "GP" in columns:
        at_gp = list(columns).index("GP") + np.array((-0.19, 0.19))
        handles.append(
            axes.scatter(at_gp, [papers_gp[light] for light in LIGHTS], marker="D", s=24, color=INK, zorder=3)
        )
    labels = [*LIGHTS, "median of gp (paper)"][: len(handles)]
    figure.legend(handles, labels, frameon=False, loc="outside upper center", ncols=len(handles))
    return png(figure)


def _lidar_picture(sample: Sample) -> bytes:
    """The image with depths drawn over it, with its lights' boxes, and the depths alone, side by side."""
    assert sample.depth_m is not None
    x1, y1, x2, y2 = _cropped(sample)
    tone = Tone.of(sample.frame.image)
    grey = tone.apply(sample.frame.image)[y1:y2, x1:x2]
    depth_m = np.nan_to_num(sample.depth_m[y1:y2, x1:x2])
    levels = np.where(depth_m > 0, 75.0 + 180.0 * np.sqrt(depth_m / depth_m.max(initial=1.0)), 0.0).astype(np.uint8)
    depths = cv2.dilate(levels, np.ones((2, 2), np.uint8))
    panels = [np.repeat(grey[..., None], 3, axis=2) for _ in range(2)]
    panels[0][depths > 0] = cv2.applyColorMap(depths, cv2.COLORMAP_VIRIDIS)[depths > 0]
    for light in sample.lights:
        left, top, right, bottom = np.array(light.box_xyxy_px) - (x1, y1, x1, y1)
        colour = DIRECT_BGR if light.is_direct else INDIRECT_BGR
        cv2.rectangle(panels[1], (int(left), int(top)), (int(right) - 1, int(bottom) - 1), colour, 1)
    panels.append(np.repeat(depths[..., None], 3, axis=2))
    factor = max(1, PICTURE_WIDTH_PX // (3 * (x2 - x1)))
    picture = cv2.resize(np.hstack(panels), None, fx=factor, fy=factor, interpolation=cv2.INTER_NEAREST)
    return jpeg(np.asarray(picture, np.uint8), PICTURE_WIDTH_PX, JPEG_QUALITY)


def _cropped(sample: Sample) -> tuple[int, int, int, int]:
    """The part of the image around the boxes, 4:3: left, top, right, bottom."""
    height_px, width_px = sample.frame.image.shape
    boxes = np.array([light.box_xyxy_px for light in sample.lights] or [(0, 0, width_px, height_px)])
    spread = np.array([boxes[:, 0].min(), boxes[:, 1].min(), boxes[:, 2].max(), boxes[:, 3].max()])
    across_px = max(spread[2] - spread[0], (spread[3] - spread[1]) * 4 // 3) + 2 * CROP_MARGIN_PX
    wide_px = int(min(across_px, width_px, height_px * 4 // 3))
    high_px = wide_px * 3 // 4
    left = int(np.clip((spread[0] + spread[2] - wide_px) // 2, 0, width_px - wide_px))
    top = int(np.clip((spread[1] + spread[3] - high_px) // 2, 0, height_px - high_px))
    return left, top, left + wide_px, top + high_px


def _pitch(findings: Sequence[Finding]) -> bytes:
    """Median relative error over the error of the calibration's pitch."""
    figure, panels = subplots(2)
    for axes, light in zip(panels, LIGHTS, strict=True):
        for colour, (estimator, by_tilt) in zip(CURVES, _by_estimator(findings, "pitch", light).items(), strict=False):
            tilts_deg = [finding.method.tilt_deg for finding in by_tilt]
            medians = [finding.errors.median for finding in by_tilt]
            axes.plot(tilts_deg, medians, color=colour, marker="o", label=estimator)
        axes.axhline(PAPERS_GP[light], color=GREY, linewidth=0.8, linestyle="--", label="paper, gp")
        axes.axhline(0.0, color=INK, linewidth=0.8)
        axes.set(title=light, xlabel="error of the pitch, degrees upwards", ylim=(-1.05, 1.55))
    panels[0].set_ylabel("median relative error")
    legend_above(figure, panels[0])
    return png(figure)


def _bars(findings: Sequence[Finding], axis: str) -> bytes:
    """Median absolute relative error of the main methods by group, direct and indirect."""
    figure, panels = subplots(2, width_in=6.0)
    for axes, light in zip(panels, LIGHTS, strict=True):
        by_estimator = _by_estimator(findings, axis, light)
        numbers = {found.group: found.errors.num for column in by_estimator.values() for found in column}
        width = 0.8 / max(len(by_estimator), 1)
        for index, (estimator, column) in enumerate(by_estimator.items()):
            shift = (index - (len(by_estimator) - 1) / 2) * width
            values = {found.group: found.errors.median_absolute for found in column}
            heights = [values.get(group, np.nan) for group in numbers]
            colour = CURVES[index % len(CURVES)]
            axes.bar(np.arange(len(numbers)) + shift, heights, width, color=colour, label=estimator)
        axes.set_xticks(range(len(numbers)), [f"{group}\n{num} lights" for group, num in numbers.items()], fontsize=8)
        axes.set_title(light)
    panels[0].set_ylabel("median |relative error|")
    legend_above(figure, panels[0])
    return png(figure)


def _by_estimator(findings: Sequence[Finding], axis: str, light: str) -> dict[str, list[Finding]]:
    """The main methods' findings on an axis, `all` of it left out."""
    chosen: dict[str, list[Finding]] = {}
    for finding in findings:
        if finding.axis == axis and finding.light == light and finding.group != ALL and finding.method.is_default:
            chosen.setdefault(finding.method.estimator, []).append(finding)
    return chosen


SIGN = "Relative error is (estimate - truth) / truth: positive where the light seems too far."

SECTIONS = {
    "range": ("By range", "Bins of the true range, the lower edge inclusive."),
    "reach": (f"Up to {REACH_M:g} m", "All lights, and those for which each of the methods here has a range."),
    "vehicle": ("Against the vehicle's range", "What the same estimates are worth as the distance of the vehicle."),
    "lidar": (
        "Against the LiDAR",
        "As the paper measured: the truth is the median of the depths in the box. Light without a depth is left out.",
    ),
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
        "mean_range_m": mean_ranges_m(results),
        "findings": findings,
    }
    made_with = {"processor": processor_name(), "seed": results.plan.seed}
    page = _page(results, findings, distance_figures(results, findings))
    earlier = ("lidar.jpg", *(f"heuristics_{estimator}.png" for estimator in ESTIMATORS))
    return page.write(folder / "report.html", results=record, made_with=made_with, files=files, earlier=earlier)


def headline(findings: Sequence[Finding]) -> list[str]:
    """GP beside the paper, one fact a line; none without GP."""
    medians = {
        (found.axis, found.light): found.errors.median
        for found in findings
        if found.method.estimator == "gp" and found.method.is_default and found.group == ALL
    }
    others = {"vehicle": "of that to the vehicle", "lidar": "of what the LiDAR measures"}
    return [
        f"GP, {light}: median relative error {signed(medians['range', light], 3)} of the range to the light"
        + "".join(
            f", {signed(medians[axis, light], 3)} {words}" for axis, words in others.items() if (axis, light) in medians
        )
        + f" (paper {papers:+.2f})"
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
            *("" if value != value else value for value in (getattr(light, name) for name in fields)),  # of NaN
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
        "A light's box is the smallest proposal that holds its keypoint, or drawn by hand;",
        "its true range is that along the viewing ray, or the median of the LiDAR's depths in a box drawn by hand.",
        SIGN,
        f"Where nothing else is said, the heuristic is {DEFAULT_HEURISTIC}.",
    )
    page.items([*headline(findings), *(beside_paper(results, findings) if findings else ())])
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
            page.table(_table(chosen, with_group=axis not in ("vehicle", "lidar")))
    return page


def _table(findings: Sequence[Finding], *, with_group: bool) -> Table:
    columns = COLUMNS if with_group else {head: cell for head, cell in COLUMNS.items() if head != "group"}
    return Table.of(columns, findings)


def _median_absolute(errors: ErrorSummary) -> str:
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
