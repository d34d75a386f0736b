"""How wrong ranges are, and how honest their sigmas: by method, sort of light and group."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.files import fields_to_json
from foreglow.geometry import Floats
from foreglow.lab.evaluation.bootstrap import resampled
from foreglow.lab.evaluation.boxes.breakdown import range_bins
from foreglow.lab.evaluation.ratios import median, percentiles, share
from foreglow.lab.studies.distance.run import DEFAULT_HEURISTIC, TILTS_DEG, DistanceResults, Method
from foreglow.lab.studies.reproduction.claims import paper_value
from foreglow.street import ERROR_BOUNDS_M

NUM_RESAMPLES = 1000

ALL = "all"

REACH_M = 200.0
"""Lights beyond are left out of the axis `reach`."""

PAPERS_GP = {light: paper_value(f"gp-{light}") for light in ("direct", "indirect")}
"""Median relative error of GP."""

PAPERS_MEAN_RANGE_M = {light: paper_value(f"mean-range-{light}") for light in PAPERS_GP}
"""Mean range of the lights there."""

PAPERS_METHODS = ("gp", "psd_3d", "psd_3d_plus", "psd_2d")
"""Its estimators, of which it finds GP the best."""


@dataclass(frozen=True, slots=True)
class ErrorSummary:
    """Relative errors of some lights: (estimate - truth) / truth, positive where the light seems too far.

    Attributes:
        num: Lights.
        missing: Share of them without an estimate; NaN without lights.
        median: Median error of those with one, as all below; NaN without any.
        median_absolute: Median of its absolute value.
        lower_quartile: 25th percentile.
        upper_quartile: 75th percentile.
        within_one_sigma: Share whose truth is at most one sigma from the estimate, of those with a finite sigma.
        within_two_sigma: As `within_one_sigma`, for two sigmas.
        absolute_low: Lower end of the 95 % interval of `median_absolute`; NaN where it was not asked for.
    """

    num: int
    missing: float
    median: float
    median_absolute: float
    lower_quartile: float
    upper_quartile: float
    within_one_sigma: float
    within_two_sigma: float
    absolute_low: float = math.nan
    absolute_high: float = math.nan


def relative_errors(truth_m: Floats, ranges_m: Floats) -> Floats:
    """(estimate - truth) / truth; NaN without estimate.

    >>> relative_errors(np.array([50.0]), np.array([60.0])).tolist()
    [0.2]
    """
    return np.asarray((ranges_m - truth_m) / truth_m)


def summarise(truth_m: Floats, ranges_m: Floats, sigmas_m: Floats | None = None) -> ErrorSummary:
    """The errors of N lights; without sigmas, coverage is NaN.

    Args:
        truth_m: Shape (N,), positive.
        ranges_m: Shape (N,), NaN where there is no estimate.
        sigmas_m: Shape (N,).
    """
    is_known = ~np.isnan(ranges_m)
    errors = relative_errors(truth_m, ranges_m)[is_known]
    lower, middle, upper = percentiles(errors, (25, 50, 75))
    sigmas_off = np.zeros(0)
    if sigmas_m is not None:
        has_sigma = is_known & np.isfinite(sigmas_m)
        sigmas_off = np.abs(ranges_m - truth_m)[has_sigma] / sigmas_m[has_sigma]
    return ErrorSummary(
        num=len(truth_m),
        missing=share(~is_known),
        median=middle,
        median_absolute=median(np.abs(errors)),
        lower_quartile=lower,
        upper_quartile=upper,
        within_one_sigma=share(sigmas_off <= 1.0),
        within_two_sigma=share(sigmas_off <= 2.0),
    )


def median_interval(values: Floats, drives: NDArray[np.int64], seed: int = 0) -> tuple[float, float]:
    """The 95 % interval of the median, had other drives of the same sort been driven; NaN with fewer than two.

    Whole drives are drawn with replacement, since lights of a drive depend on each other.

    Args:
        values: Shape (N,); NaN ones are left out.
        drives: Shape (N,), the drive of each.
        seed: Of the draws.

    Source: Efron and Tibshirani, An Introduction to the Bootstrap, 1993, chapter 13 (percentile interval).
    """
    is_known = ~np.isnan(values)
    if len(np.unique(drives[is_known])) < 2:  # every resample would be that drive
        return math.nan, math.nan
    names, drive_of = np.unique(drives, return_inverse=True)
    order = np.argsort(values[is_known], kind="stable")
    ordered, drive_of_ordered = values[is_known][order], drive_of[is_known][order]

    def medians(weights: Floats) -> Floats:
        cumulative = weights[:, drive_of_ordered].cumsum(axis=1)
        total = cumulative[:, -1:]
        found = ordered[(2 * cumulative >= total).argmax(axis=1)]
        return np.where(total[:, 0] > 0, found, math.nan)  # a resample may draw drives without values only

    low, high = percentiles(resampled(medians, len(names), NUM_RESAMPLES, seed), (2.5, 97.5))
    return low, high


@dataclass(frozen=True, slots=True)
class Finding:
    """How well a method does on some lights.

    Attributes:
        axis: What the groups differ in: `range`, `reach`, `series`, `tracks`, `pitch`, `localisation`, `terrain`,
            `kind`, or `vehicle` or `lidar`, where the truth is the range of the vehicle, or the median of the LiDAR's
            depths in the box.
        light: `direct`, `indirect` or `all`.
        group: Within the axis, such as `30-60 m`; `all` of it.
    """

    axis: str
    method: Method
    light: str
    group: str
    errors: ErrorSummary

    def to_json(self) -> dict[str, Any]:
        """All fields on one level."""
        keys = {"axis": self.axis, **fields_to_json(self.method), "light": self.light, "group": self.group}
        return keys | fields_to_json(self.errors)


def find(results: DistanceResults) -> tuple[Finding, ...]:
    """All figures of the report."""
    if not results.lights:
        return ()
    sorts = light_sorts(results)
    return tuple(finding for light, is_light in sorts.items() for finding in _findings(results, light, is_light))


def light_sorts(results: DistanceResults) -> dict[str, NDArray[np.bool_]]:
    """Which of the lights are direct, indirect, and all of them; shape (N,) each."""
    is_direct = results.column("is_direct").astype(np.bool_)
    return {"direct": is_direct, "indirect": ~is_direct, ALL: np.ones_like(is_direct)}


def mean_ranges_m(results: DistanceResults) -> dict[str, float]:
    """The mean range of direct and of indirect light; without any of a sort, not that one."""
    truth_m, sorts = results.column("truth_m"), light_sorts(results)
    return {light: float(truth_m[sorts[light]].mean()) for light in PAPERS_MEAN_RANGE_M if sorts[light].any()}


def beside_paper(results: DistanceResults, findings: Sequence[Finding]) -> Iterator[str]:
    """What the paper states beside its medians, and whether it holds here: a line each."""
    means = (
        f"{mean_m:.0f} m {light} (paper {PAPERS_MEAN_RANGE_M[light]:.0f} m)"
        for light, mean_m in mean_ranges_m(results).items()
    )
    yield f"Mean range: {', '.join(means)}"
    errors = {
        (found.method.estimator, found.method.heuristic, found.light): found.errors
        for found in findings
        if found.axis == "range" and found.group == ALL and not math.isnan(found.errors.median_absolute)
    }
    for light in PAPERS_GP:
        medians = {
            name: errors[name, DEFAULT_HEURISTIC, light].median_absolute
            for name in PAPERS_METHODS
            if (name, DEFAULT_HEURISTIC, light) in errors
        }
        if len(medians) > 1 and "gp" in medians:
            best = min(medians, key=lambda name: medians[name])
            beside = "" if best == "gp" else f"; gp {medians['gp']:.2f}"
            yield (
                f"Of the paper's methods, {light} light: {best} has the least median absolute error, "
                f"{medians[best]:.2f}{beside}. {_verdict(best == 'gp')}, in which gp is the best"
            )
    centre, maximum = (errors.get(("gp", heuristic, "indirect")) for heuristic in (DEFAULT_HEURISTIC, "maximum"))
    if centre is not None and maximum is not None:
        is_better = maximum.median_absolute < centre.median_absolute
        yield (
            f"gp with the maximum of the box, indirect light: median {maximum.median:+.2f}, absolute "
            f"{maximum.median_absolute:.2f}; with the centre {centre.median:+.2f}, {centre.median_absolute:.2f}. "
            f"{_verdict(is_better)}, in which only the maximum improves it"
        )


def _verdict(holds: bool) -> str:
    return "As in the paper" if holds else "This contradicts the paper"


def _findings(results: DistanceResults, light: str, is_light: NDArray[np.bool_]) -> Iterator[Finding]:
    truth_m, main_methods = results.column("truth_m"), results.main_methods

    def errors(ranges_m: Floats, sigmas_m: Floats | None, truth_m: Floats = truth_m) -> ErrorSummary:
        return summarise(truth_m[is_light], ranges_m[is_light], None if sigmas_m is None else sigmas_m[is_light])

    def errors_of_group(method: Method, is_member: NDArray[np.bool_]) -> ErrorSummary:
        chosen = is_light & is_member
        return summarise(truth_m[chosen], results.ranges_m[method][chosen], results.sigmas_m[method][chosen])

    drives = results.column("sequence_id")[is_light]
    for method in results.methods:
        absolute = np.abs(relative_errors(truth_m, results.ranges_m[method]))[is_light]
        low, high = median_interval(absolute, drives, results.plan.seed)
        whole = errors(results.ranges_m[method], results.sigmas_m[method])
        yield Finding("range", method, light, ALL, dataclasses.replace(whole, absolute_low=low, absolute_high=high))
        for group, is_member in range_bins(truth_m).items():
            yield Finding("range", method, light, group, errors_of_group(method, is_member))
    for method in main_methods:
        for group, is_member in _reach_groups(results).items():
            yield Finding("reach", method, light, group, errors_of_group(method, is_member))
    for (name, method), ranges_m in results.series_m.items():
        yield Finding("series", method, light, name, errors(ranges_m, None))
    for (name, method), (ranges_m, sigmas_m) in results.tracked.items():
        yield Finding("tracks", method, light, name, errors(ranges_m, sigmas_m))
    for axis, groups in _groups(results).items():
        for method in main_methods:
            for group, is_member in groups.items():
                if (is_light & is_member).any():
                    yield Finding(axis, method, light, group, errors_of_group(method, is_member))
    for axis, column in {"vehicle": "vehicle_range_m", "lidar": "lidar_m"}.items():
        others_m = results.column(column)
        chosen = is_light & ~np.isnan(others_m)
        for method in main_methods if not np.isnan(others_m).all() else ():
            # A sigma is that of the range to the light, not to its vehicle.
            its_sigmas_m = results.sigmas_m[method][chosen] if axis == "lidar" else None
            to_other = summarise(others_m[chosen], results.ranges_m[method][chosen], its_sigmas_m)
            yield Finding(axis, method, light, ALL, to_other)
    for main in main_methods:
        for tilt_deg in TILTS_DEG:
            method = dataclasses.replace(main, tilt_deg=tilt_deg)
            tilted = errors(results.ranges_m[method], results.sigmas_m[method])
            yield Finding("pitch", method, light, f"{tilt_deg:+.1f}°", tilted)


def _reach_groups(results: DistanceResults) -> dict[str, NDArray[np.bool_]]:
    """Lights up to `REACH_M`: all, and those for which every estimator has a range, so that all answer the same."""
    is_near = results.column("truth_m") < REACH_M
    has_all = np.all([~np.isnan(results.ranges_m[method]) for method in results.main_methods], axis=0)
    return {ALL: is_near, "with a range by all methods": is_near & has_all}


def _groups(results: DistanceResults) -> Mapping[str, Mapping[str, NDArray[np.bool_]]]:
    classes, scenarios, kinds = (results.column(name) for name in ("error_class", "scenario", "kind"))
    return {
        "localisation": {f"{bound:g} m": classes == number for number, bound in enumerate(ERROR_BOUNDS_M)},
        "terrain": {str(name): scenarios == name for name in np.unique(scenarios) if name},
        "kind": {str(name): kinds == name for name in np.unique(kinds)},
    }
