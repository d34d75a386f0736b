"""Where tracks are, seen from the vehicle: directions, how fast they move aside, how far away they are."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from foreglow.geometry import Camera
from foreglow.rays import RayCaster
from foreglow.types import Frame, Tracks, TrackState

RATE_GAIN = 0.25
"""Share of a new rate in the filtered one: a rate of single frames would be noise."""


@dataclass(slots=True)
class Bearing:
    """One track, seen from the vehicle's origin.

    Attributes:
        azimuth_rad: Of the box's centre, to the left.
        half_width_rad: Of the box.
        rate_radps: How fast it moves to the left.
        range_m: From the camera; NaN where unknown.
        sigma_m: Standard deviation of the range; infinite where unknown.
        direct: Probability that it is a lamp itself; NaN where unknown.
        is_plausible: Whether it may be acted on.
        plausible_s: Since when it has been plausible, seconds; 0 where it is not.
        seen_ns: When it was last detected.
    """

    azimuth_rad: float
    half_width_rad: float
    rate_radps: float
    range_m: float
    sigma_m: float
    direct: float
    is_plausible: bool
    plausible_s: float
    seen_ns: int


class Bearings:
    """The bearings of all tracks, frame after frame, by their ids."""

    def __init__(self) -> None:
        self._caster = RayCaster()
        self.reset()

    def reset(self) -> None:
        """Forgets all tracks."""
        self._bearings: dict[int, Bearing] = {}
        self._timestamp_ns = 0

    def update(self, frame: Frame, tracks: Tracks) -> dict[int, Bearing]:
        """The bearings of `tracks`; the frame has a camera."""
        assert frame.camera is not None
        step_s = (frame.timestamp_ns - self._timestamp_ns) / 1e9
        known, self._timestamp_ns, self._bearings = self._bearings, frame.timestamp_ns, {}
        if not len(tracks):
            return self._bearings
        azimuths, halves = self._directions(frame.camera, tracks)
        rows = zip(
            tracks.ids.tolist(),
            azimuths,
            halves,
            tracks.ranges_m.tolist(),
            tracks.sigmas_m.tolist(),
            tracks.direct_probabilities.tolist(),
            tracks.states.tolist(),
            tracks.num_misses.tolist(),
            strict=True,
        )
        for one, azimuth, half, range_m, sigma_m, direct, state, num_misses in rows:
            before = known.get(one)
            rate, plausible_s, seen_ns = 0.0, 0.0, frame.timestamp_ns
            is_plausible = state != TrackState.TENTATIVE
            if before is not None:
                rate = before.rate_radps
                if step_s > 0.0:
                    rate += RATE_GAIN * ((azimuth - before.azimuth_rad) / step_s - rate)
                plausible_s = before.plausible_s + step_s if is_plausible and before.is_plausible else 0.0
                seen_ns = before.seen_ns if num_misses else seen_ns
            self._bearings[one] = Bearing(
                azimuth, half, rate, range_m, sigma_m, direct, is_plausible, plausible_s, seen_ns
            )
        return self._bearings

    def _directions(self, camera: Camera, tracks: Tracks) -> tuple[list[float], list[float]]:
        """Azimuth of each box's centre, and half its width, radians."""
        boxes = tracks.boxes_xyxy_px
        middles_px = 0.5 * (boxes[:, 1] + boxes[:, 3])
        pixels = np.empty((2 * len(boxes), 2))
        pixels[: len(boxes), 0], pixels[len(boxes) :, 0] = boxes[:, 0], boxes[:, 2]
        pixels[: len(boxes), 1] = pixels[len(boxes) :, 1] = middles_px
        forward, left, _ = self._caster.cast(camera, pixels).directions.T
        lefts, rights = np.arctan2(left, forward).reshape(2, -1)
        return (0.5 * (lefts + rights)).tolist(), (0.5 * (lefts - rights)).tolist()


def range_bounds_m(bearing: Bearing, num_sigmas: float) -> tuple[float, float]:
    """Nearest and farthest range that is likely; from `NEAREST_M` to infinity where nothing is known."""
    if math.isnan(bearing.range_m):
        return NEAREST_M, math.inf
    spread_m = num_sigmas * bearing.sigma_m
    return max(bearing.range_m - spread_m, NEAREST_M), max(bearing.range_m + spread_m, NEAREST_M)


NEAREST_M = 8.0
"""Nearer vehicles are beside the beam."""
