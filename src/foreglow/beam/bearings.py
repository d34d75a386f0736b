"""Where tracks are, seen from the vehicle: azimuth, elevation, angular rate and range.

Units: metres, radians, seconds; x forward, y left; azimuths to the left, elevations upwards. A box that the camera sees
at the azimuth a and the range r, as a camera at (x, y) in the vehicle's frame, is seen from the vehicle's origin at

    forward = x + r cos(a),   left = y + r sin(a),   azimuth = atan2(left, forward),   range = hypot            (1)

Without a range, the camera's azimuth is taken as it is. The rate of the azimuth is an exponential moving mean over
frames that are dt apart, at least `MIN_STEP_S`, with the same noise at any frame rate above 18 Hz:

    rate <- rate + g ((azimuth - azimuth before) / dt - rate),   g = 1 - 0.75^min(dt / (1/18 s), 1)             (2)
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from foreglow.beam.in_sight import lamps_in_sight
from foreglow.geometry import Camera, Floats
from foreglow.rays import RayCaster
from foreglow.types import MIN_STEP_S, Frame, Tracks

RATE_GAIN, RATE_STEP_S = 0.25, 1.0 / 18.0
"""Weight of a new rate in the filtered one after such a step or a longer one, (2); a rate from two frames alone would
be noise."""

NO_VEHICLE = -1
"""Stands for the id of a vehicle where none are known."""

LEAVING_S = 0.5
"""A light leaves the image if its box reaches the left or the right border within this time."""


@dataclass(slots=True)
class Bearing:
    """One track, seen from the vehicle's origin.

    Attributes:
        azimuth_rad: Azimuth of the box's centre.
        elevation_rad: Elevation of the box's centre.
        half_width_rad: Half the width of the box.
        rate_radps: Filtered rate of the azimuth.
        range_m: Range; NaN where unknown.
        sigma_m: Its standard deviation; infinite where it is unknown.
        direct: Probability that it is a lamp in sight, front or rear; NaN where unknown.
        front: Probability that it is a front lamp in sight; NaN where unknown.
        is_seen: Whether it was detected in this frame.
        is_lamp: Whether it is taken for one (`lamps_in_sight`).
        vehicle: The id of its vehicle; `NO_VEHICLE` without vehicles.
        confidence: The greatest confidence that the track ever had; that of its vehicle while it leads it, if greater.
        is_plausible: Whether the track may be acted on.
        is_leaving: Whether its box is at the left or the right border of the image, or will be within `LEAVING_S`.
    """

    azimuth_rad: float
    elevation_rad: float
    half_width_rad: float
    rate_radps: float
    range_m: float
    sigma_m: float
    direct: float
    front: float
    is_seen: bool
    is_lamp: bool
    vehicle: int
    confidence: float
    is_plausible: bool
    is_leaving: bool


class Bearings:
    """The bearings of all tracks by their ids, updated frame by frame."""

    def __init__(self, min_direct: float = 0.5) -> None:
        """Takes the probability above which a track is a lamp."""
        self._min_direct = min_direct
        self._caster = RayCaster()
        self.reset()

    def reset(self) -> None:
        """Forgets all tracks."""
        self._bearings: dict[int, Bearing] = {}
        self._timestamp_ns = 0

    def update(self, frame: Frame, tracks: Tracks) -> dict[int, Bearing]:
        """The bearings of `tracks` by their ids; the frame must have a camera."""
        assert frame.camera is not None
        step_s = (frame.timestamp_ns - self._timestamp_ns) / 1e9
        known, self._timestamp_ns, self._bearings = self._bearings, frame.timestamp_ns, {}
        if not len(tracks):
            return self._bearings
        azimuths, elevations, halves = self._directions(frame.camera, tracks)
        vehicles = np.full(len(tracks), NO_VEHICLE) if tracks.vehicles is None else tracks.vehicles.of_tracks
        rows = zip(
            tracks.ids.tolist(),
            azimuths,
            elevations,
            halves,
            tracks.ranges_m.tolist(),
            tracks.sigmas_m.tolist(),
            tracks.direct_probabilities.tolist(),
            tracks.light_kinds[:, 0].tolist(),
            (tracks.num_misses == 0).tolist(),
            lamps_in_sight(tracks, self._min_direct, frame.camera).tolist(),
            vehicles.tolist(),
            _confidences(tracks).tolist(),
            tracks.is_plausible.tolist(),
            tracks.boxes_xyxy_px[:, ::2].tolist(),
            strict=True,
        )
        gain = 1.0 - (1.0 - RATE_GAIN) ** min(max(step_s, 0.0) / RATE_STEP_S, 1.0)
        leaving_px, width_px = LEAVING_S * frame.camera.focal_px[0], frame.width_px
        x, y, _ = frame.camera.vehicle_from_camera.position_m.tolist()
        for track_id, azimuth, elevation, half, range_m, sigma_m, direct, front, is_seen, *others in rows:
            is_lamp, vehicle, confidence, is_plausible, (x1, x2) = others
            before, rate = known.get(track_id), 0.0
            azimuth, range_m = _from_origin(x, y, azimuth, range_m)
            if before is not None:
                rate, confidence = before.rate_radps, max(before.confidence, confidence)
                if step_s > 0.0:
                    rate += gain * ((azimuth - before.azimuth_rad) / max(step_s, MIN_STEP_S) - rate)  # (2)
            shift_px = leaving_px * rate
            is_leaving = x1 - max(shift_px, 0.0) <= 0.0 or x2 - min(shift_px, 0.0) >= width_px
            self._bearings[track_id] = Bearing(
                azimuth_rad=azimuth,
                elevation_rad=elevation,
                half_width_rad=half,
                rate_radps=rate,
                range_m=range_m,
                sigma_m=sigma_m,
                direct=direct,
                front=front,
                is_seen=is_seen,
                is_lamp=is_lamp,
                vehicle=vehicle,
                confidence=confidence,
                is_plausible=is_plausible,
                is_leaving=is_leaving,
            )
        return self._bearings

    def _directions(self, camera: Camera, tracks: Tracks) -> tuple[list[float], list[float], list[float]]:
        """Azimuth and elevation of each box's centre, and half its width, radians."""
        boxes = tracks.boxes_xyxy_px
        middles_px = 0.5 * (boxes[:, 1] + boxes[:, 3])
        pixels = np.empty((2 * len(boxes), 2))
        pixels[: len(boxes), 0], pixels[len(boxes) :, 0] = boxes[:, 0], boxes[:, 2]
        pixels[: len(boxes), 1] = pixels[len(boxes) :, 1] = middles_px
        forward, left, up = self._caster.cast(camera, pixels).directions.T
        lefts, rights = np.arctan2(left, forward).reshape(2, -1)
        elevations = np.arcsin(up.reshape(2, -1)).mean(axis=0)  # a mount may be rolled
        return (0.5 * (lefts + rights)).tolist(), elevations.tolist(), (0.5 * (lefts - rights)).tolist()


def _confidences(tracks: Tracks) -> Floats:
    """Those of `tracks`; a track that leads its vehicle is as sure as the vehicle is."""
    vehicles = tracks.vehicles
    if vehicles is None:
        return tracks.confidences
    confidences = tracks.confidences.copy()
    confidences[vehicles.leading] = np.maximum(confidences[vehicles.leading], vehicles.confidences)
    return confidences


def _from_origin(x: float, y: float, azimuth_rad: float, range_m: float) -> tuple[float, float]:
    """Azimuth and range from the vehicle's origin, by (1), of a camera at (x, y); unchanged if the range is unknown."""
    if math.isnan(range_m):
        return azimuth_rad, range_m
    forward, left = x + range_m * math.cos(azimuth_rad), y + range_m * math.sin(azimuth_rad)
    return math.atan2(left, forward), math.hypot(forward, left)
