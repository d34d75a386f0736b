"""The figures of the distance experiment."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from foreglow.geometry import Floats
from foreglow.lab.reports.figures import AMBER, BLUE, GREY, INK, png, subplots
from foreglow.lab.studies.distance.findings import ALL, PAPERS_GP, Finding, light_sorts
from foreglow.lab.studies.distance.metrics import relative_errors
from foreglow.lab.studies.distance.run import DistanceResults, Method

LIGHTS = {"direct": AMBER, "indirect": BLUE}
CURVES = (AMBER, BLUE, "#4c9a57", "#9a4c8f", GREY, INK)
WHISKERS = (5, 95)
LIMITS = (-1.05, 2.5)


def distance_plots(results: DistanceResults, findings: Sequence[Finding]) -> dict[str, bytes]:
    """PNG files by name; none without lights.

    Raises:
        ModuleNotFoundError: If matplotlib is not installed.
    """
    if not results.lights:
        return {}
    ranges_m = results.ranges_m
    plots = {
        "methods.png": _boxes(results, {method.estimator: ranges_m[method] for method in results.main_methods}),
        "series.png": _boxes(results, _series_columns(results)),
        "range.png": _bars(findings, "range"),
        "localisation.png": _bars(findings, "localisation"),
        "terrain.png": _bars(findings, "terrain"),
        "pitch.png": _pitch(findings),
    }
    for estimator in results.plan.estimators:
        of_it = {method.heuristic: ranges_m[method] for method in results.methods if method.estimator == estimator}
        if len(of_it) > 1:
            plots[f"heuristics_{estimator}.png"] = _boxes(results, of_it)
    return plots


def _series_columns(results: DistanceResults) -> dict[str, Floats]:
    columns: dict[str, Floats] = {}
    for method in results.main_methods:
        columns[f"{method.estimator}\nsingle"] = results.ranges_m[method]
        for (name, of), ranges_m in results.series_m.items():
            if of == method:
                columns[f"{method.estimator}\n{name.removesuffix(' of five frames')} of 5"] = ranges_m
    return columns


def _boxes(results: DistanceResults, columns: Mapping[str, Floats]) -> bytes:
    """Box plots of the relative error, direct beside indirect: median, quartiles, 5th and 95th percentile."""
    figure, (axes,) = subplots(1, width_in=2.0 + 1.1 * len(columns), height_in=4.0)
    truth_m, sorts = results.column("truth_m"), light_sorts(results)
    places = np.arange(len(columns))
    handles = []
    for shift, (light, colour) in zip((-0.19, 0.19), LIGHTS.items(), strict=True):
        errors = [relative_errors(truth_m, ranges_m)[sorts[light]] for ranges_m in columns.values()]
        drawn = axes.boxplot(
            [one[~np.isnan(one)] for one in errors],
            positions=places + shift,
            widths=0.32,
            whis=WHISKERS,
            showfliers=False,
            patch_artist=True,
            medianprops={"color": INK},
            boxprops={"facecolor": colour, "alpha": 0.75, "linewidth": 0.8},
        )
        handles.append(drawn["boxes"][0])
    axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.set(ylim=LIMITS, ylabel="(estimate - truth) / truth")
    axes.set_xticks(places, list(columns))
    figure.legend(handles, list(LIGHTS), frameon=False, loc="outside upper center", ncols=2)
    return png(figure)


def _bars(findings: Sequence[Finding], axis: str) -> bytes:
    """Median absolute relative error of the main methods by group, direct and indirect."""
    return _two_panels(findings, axis, lambda one: one.errors.median_absolute, "median |relative error|")


def _pitch(findings: Sequence[Finding]) -> bytes:
    """Median absolute relative error over the error of the calibration's pitch."""
    figure, axes = subplots(2)
    for panel, light in zip(axes, LIGHTS, strict=True):
        for colour, (estimator, ones) in zip(CURVES, _by_estimator(findings, "pitch", light).items(), strict=False):
            tilts = [one.method.tilt_deg for one in ones]
            panel.plot(tilts, [one.errors.median for one in ones], color=colour, marker="o", label=estimator)
        if light in PAPERS_GP:
            panel.axhline(PAPERS_GP[light], color=GREY, linewidth=0.8, linestyle="--", label="paper, gp")
        panel.axhline(0.0, color=INK, linewidth=0.8)
        panel.set(title=light, xlabel="error of the pitch, degrees upwards", ylim=(-1.05, 1.55))
    axes[0].set_ylabel("median relative error")
    _legend_above(figure, axes[0])
    return png(figure)


def _two_panels(findings: Sequence[Finding], axis: str, figure_of: Callable[[Finding], float], label: str) -> bytes:
    figure, axes = subplots(2, width_in=6.0)
    for panel, light in zip(axes, LIGHTS, strict=True):
        by_estimator = _by_estimator(findings, axis, light)
        groups = list(dict.fromkeys(one.group for ones in by_estimator.values() for one in ones))
        width = 0.8 / max(len(by_estimator), 1)
        for place, (estimator, ones) in enumerate(by_estimator.items()):
            shift = (place - (len(by_estimator) - 1) / 2) * width
            values = {one.group: figure_of(one) for one in ones}
            heights = [values.get(group, np.nan) for group in groups]
            colour = CURVES[place % len(CURVES)]
            panel.bar(np.arange(len(groups)) + shift, heights, width, color=colour, label=estimator)
        numbers = {one.group: one.errors.num for ones in by_estimator.values() for one in ones}
        panel.set_xticks(np.arange(len(groups)), [f"{group}\n{numbers[group]}" for group in groups], fontsize=8)
        panel.set_title(light)
    axes[0].set_ylabel(label)
    _legend_above(figure, axes[0])
    return png(figure)


def _legend_above(figure: Any, axes: Any) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, loc="outside upper center", ncols=len(labels))


def _by_estimator(findings: Sequence[Finding], axis: str, light: str) -> dict[str, list[Finding]]:
    """The main methods' findings on an axis, `all` of it left out."""
    chosen: dict[str, list[Finding]] = {}
    main = {one.method for one in findings if one.axis == "vehicle"}
    for one in findings:
        is_main = Method(one.method.estimator, one.method.heuristic) in main
        if one.axis == axis and one.light == light and one.group != ALL and is_main:
            chosen.setdefault(one.method.estimator, []).append(one)
    return chosen


def alt_text(name: str) -> str:
    """What a figure shows, for its caption."""
    if name.startswith("heuristics_"):
        return f"{name.removeprefix('heuristics_').removesuffix('.png')}: relative error by heuristic"
    return _CAPTIONS[name]


_CAPTIONS: Mapping[str, str] = {
    "methods.png": "Relative error by method; boxes are quartiles, whiskers the 5th and 95th percentile",
    "series.png": "Relative error of single frames, and of the mean and the median of a light's latest five frames",
    "range.png": "Median absolute relative error by range, with the number of lights",
    "localisation.png": "By the largest error of the position on the map, as the street message states it",
    "terrain.png": "By scenario",
    "pitch.png": "Median relative error when the calibration's pitch is wrong by so much",
}
