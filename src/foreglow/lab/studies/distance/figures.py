"""The figures of the distance experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from foreglow.geometry import Floats
from foreglow.lab.reports.figures import AMBER, BLUE, GREY, INK, box_plot, legend_above, png, subplots
from foreglow.lab.reports.page import Figure
from foreglow.lab.studies.distance.metrics import ALL, PAPERS_GP, Finding, light_sorts, relative_errors
from foreglow.lab.studies.distance.run import DistanceResults

LIGHTS = {"direct": AMBER, "indirect": BLUE}
CURVES = (AMBER, BLUE, "#4c9a57", "#9a4c8f", GREY, INK)
WHISKERS = (5, 95)
LIMITS = (-1.05, 2.5)


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
        methods[main.estimator] = series[f"{main.estimator}\nsingle"] = ranges_m[main]
        for (name, method), series_m in results.series_m.items():
            if method == main:
                series[f"{main.estimator}\n{name.removesuffix(' of five frames')} of 5"] = series_m
    boxes = "Relative error by method; boxes are quartiles, whiskers the 5th and 95th percentile"
    frames = "Relative error of single frames, and of the mean and the median of a light's latest five frames"
    by_range = "Median absolute relative error by range, with the number of lights"
    by_error = "By the largest error of the position on the map, as the street message states it"
    figures = [
        Figure(_error_boxes(results, methods), boxes, "methods.png"),
        Figure(_error_boxes(results, series), frames, "series.png"),
        Figure(_bars(findings, "range"), by_range, "range.png"),
        Figure(_bars(findings, "localisation"), by_error, "localisation.png"),
        Figure(_bars(findings, "terrain"), "By scenario", "terrain.png"),
        Figure(_pitch(findings), "Median relative error when the calibration's pitch is wrong by so much", "pitch.png"),
    ]
    for estimator in results.plan.estimators:
        methods_of = [method for method in results.methods if method.estimator == estimator]
        columns = {method.heuristic: ranges_m[method] for method in methods_of}
        if len(columns) > 1:
            plot, caption = _error_boxes(results, columns), f"{estimator}: relative error by heuristic"
            figures.append(Figure(plot, caption, f"heuristics_{estimator}.png"))
    return figures


def _error_boxes(results: DistanceResults, columns: Mapping[str, Floats]) -> bytes:
    """Box plots of the relative error, direct beside indirect: median, quartiles, 5th and 95th percentile."""
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
    figure.legend(handles, list(LIGHTS), frameon=False, loc="outside upper center", ncols=2)
    return png(figure)


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
        axes.set_xticks(range(len(numbers)), [f"{group}\n{num}" for group, num in numbers.items()], fontsize=8)
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
