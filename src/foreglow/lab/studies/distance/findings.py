"""The figures of the distance experiment: a summary of errors for each method, sort of light and group."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats
from foreglow.lab.studies.distance.metrics import ErrorSummary, median_interval, range_bins, relative_errors, summarise
from foreglow.lab.studies.distance.run import TILTS_DEG, DistanceResults, Method
from foreglow.street import ERROR_BOUNDS_M

ALL = "all"

REACH_M = 200.0
"""Lights beyond are left out of the axis `reach`."""

PAPERS_GP = {"direct": 0.12, "indirect": -0.32}
"""Median relative error of GP. Source: Ewecker et al., arXiv 2107.11302."""


@dataclass(frozen=True, slots=True)
class Finding:
    """How well a method does on some lights.

    Attributes:
        axis: What the groups differ in: `range`, `reach`, `series`, `tracks`, `pitch`, `localisation`, `terrain`,
            `kind`, or `vehicle`, where the truth is the range of the vehicle and not that of the light.
        method: The method.
        light: `direct`, `indirect` or `all`.
        group: Within the axis, such as `30-60 m`; `all` of it.
        errors: The figures.
    """

    axis: str
    method: Method
    light: str
    group: str
    errors: ErrorSummary

    def to_json(self) -> dict[str, Any]:
        """All fields on one level, for JSON: null instead of NaN."""
        keys = {"axis": self.axis, **dataclasses.asdict(self.method), "light": self.light, "group": self.group}
        return keys | self.errors.to_json()


def find(results: DistanceResults) -> tuple[Finding, ...]:
    """All figures of the report."""
    if not results.lights:
        return ()
    lights = light_sorts(results)
    truth_m = results.column("truth_m")
    return tuple(
        finding
        for name, is_it in lights.items()
        for finding in (
            *_by_range(results, name, is_it, truth_m),
            *_by_reach(results, name, is_it, truth_m),
            *_by_series(results, name, is_it, truth_m),
            *_by_tracks(results, name, is_it, truth_m),
            *_by_group(results, name, is_it, truth_m),
            *_by_pitch(results, name, is_it, truth_m),
        )
    )


def light_sorts(results: DistanceResults) -> dict[str, NDArray[np.bool_]]:
    """Which of the lights are direct, indirect, and all of them; shape (N,) each."""
    is_direct = results.column("is_direct").astype(np.bool_)
    return {"direct": is_direct, "indirect": ~is_direct, ALL: np.ones_like(is_direct)}


def _by_range(results: DistanceResults, light: str, is_it: NDArray[np.bool_], truth_m: Floats) -> Iterator[Finding]:
    drives = results.column("sequence_id")
    for method in results.methods:
        ranges_m, sigmas_m = results.ranges_m[method], results.sigmas_m[method]
        absolute = np.abs(relative_errors(truth_m, ranges_m))
        low, high = median_interval(absolute[is_it], drives[is_it], results.plan.seed)
        whole = summarise(truth_m[is_it], ranges_m[is_it], sigmas_m[is_it])
        yield Finding("range", method, light, ALL, dataclasses.replace(whole, absolute_low=low, absolute_high=high))
        for name, is_in in range_bins(truth_m).items():
            chosen = is_it & is_in
            errors = summarise(truth_m[chosen], ranges_m[chosen], sigmas_m[chosen])
            yield Finding("range", method, light, name, errors)


def _by_reach(results: DistanceResults, light: str, is_it: NDArray[np.bool_], truth_m: Floats) -> Iterator[Finding]:
    """Up to `REACH_M`: all lights, and those for which every estimator has a range, so that all answer the same."""
    is_near = is_it & (truth_m < REACH_M)
    is_common = is_near & np.all([~np.isnan(results.ranges_m[method]) for method in results.main_methods], axis=0)
    for method in results.main_methods:
        ranges_m, sigmas_m = results.ranges_m[method], results.sigmas_m[method]
        for name, chosen in {"all": is_near, "with a range by all methods": is_common}.items():
            yield Finding("reach", method, light, name, summarise(truth_m[chosen], ranges_m[chosen], sigmas_m[chosen]))


def _by_series(results: DistanceResults, light: str, is_it: NDArray[np.bool_], truth_m: Floats) -> Iterator[Finding]:
    for (name, method), ranges_m in results.series_m.items():
        yield Finding("series", method, light, name, summarise(truth_m[is_it], ranges_m[is_it]))


def _by_tracks(results: DistanceResults, light: str, is_it: NDArray[np.bool_], truth_m: Floats) -> Iterator[Finding]:
    for (name, method), (ranges_m, sigmas_m) in results.tracked.items():
        yield Finding("tracks", method, light, name, summarise(truth_m[is_it], ranges_m[is_it], sigmas_m[is_it]))


def _by_group(results: DistanceResults, light: str, is_it: NDArray[np.bool_], truth_m: Floats) -> Iterator[Finding]:
    for axis, groups in _groups(results).items():
        for method in results.main_methods:
            ranges_m, sigmas_m = results.ranges_m[method], results.sigmas_m[method]
            for name, is_in in groups.items():
                chosen = is_it & is_in
                if chosen.any():
                    errors = summarise(truth_m[chosen], ranges_m[chosen], sigmas_m[chosen])
                    yield Finding(axis, method, light, name, errors)
    vehicle_m = results.column("vehicle_range_m")
    for method in results.main_methods:
        yield Finding("vehicle", method, light, ALL, summarise(vehicle_m[is_it], results.ranges_m[method][is_it]))


def _by_pitch(results: DistanceResults, light: str, is_it: NDArray[np.bool_], truth_m: Floats) -> Iterator[Finding]:
    for main in results.main_methods:
        for tilt_deg in TILTS_DEG:
            method = dataclasses.replace(main, tilt_deg=tilt_deg)
            ranges_m, sigmas_m = results.ranges_m[method], results.sigmas_m[method]
            errors = summarise(truth_m[is_it], ranges_m[is_it], sigmas_m[is_it])
            yield Finding("pitch", method, light, f"{tilt_deg:+.1f}°", errors)


def _groups(results: DistanceResults) -> Mapping[str, Mapping[str, NDArray[np.bool_]]]:
    """By axis and group, which lights are in it."""
    classes, scenarios, kinds = (results.column(name) for name in ("error_class", "scenario", "kind"))
    return {
        "localisation": {f"{bound:g} m": classes == number for number, bound in enumerate(ERROR_BOUNDS_M)},
        "terrain": {str(name): scenarios == name for name in np.unique(scenarios)},
        "kind": {str(name): kinds == name for name in np.unique(kinds)},
    }
