"""Which tracks are lamps in sight: those that the network takes for one, unless a front lamp beside them is surer.

A front lamp lights what is beside it, and some of that light looks half like a lamp: on a rail or on leaves close to
the lamp. As long as no lamp of the vehicle is surely in sight, such a track may be the lamp itself. Once a front lamp
is, the others of the same vehicle count as its light, unless they are as sure or too far aside. Light of rear lamps
hardly looks like a lamp.

In dense traffic, lights of many vehicles may count as one vehicle's. Its sure lamps are further apart then than those
of one vehicle, and nothing is taken for their light.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Camera
from foreglow.types import Tracks

SURE_DIRECT = 0.9
"""A track is surely a lamp if its probability of that is above this: chosen in decision 21."""

VEHICLE_M = 1.3
"""Distance across the line of sight from a visible lamp to beyond the driver's eyes: a lorry is 2.5 m wide."""

SPAN_M = 2.0 * VEHICLE_M
"""Two lamps of a vehicle are at most so far apart."""

BESIDE_M = 6.0
"""Light further aside of its lamp than this, at the lamp's range, is no longer told from another vehicle's lamp."""


def lamps_in_sight(tracks: Tracks, min_direct: float, camera: Camera | None) -> NDArray[np.bool_]:
    """Which of `tracks` are lamps in sight, front or rear, shape (M,); also those of which it is unknown.

    Args:
        tracks: The tracks of a frame.
        min_direct: A track is a lamp above this probability.
        camera: That of the frame; without one, or without a range, nobody knows what is beside a lamp.
    """
    direct = tracks.direct_probabilities
    is_lamp = np.asarray(~(direct <= min_direct))
    if tracks.vehicles is None or camera is None:
        return is_lamp
    of_tracks, is_sure = tracks.vehicles.of_tracks, tracks.is_plausible & (direct > SURE_DIRECT)
    is_front = is_sure & (tracks.light_kinds[:, 0] > SURE_DIRECT)
    is_unsure = is_lamp & (direct <= SURE_DIRECT)
    left_m, right_m = tracks.boxes_xyxy_px.T[::2] / camera.focal_px[0]  # at a range of 1 m
    for vehicle in np.unique(of_tracks[is_front]):
        is_its = of_tracks == vehicle
        sure, front, unsure = (np.flatnonzero(is_its & found) for found in (is_sure, is_front, is_unsure))
        ranges_m, middles = tracks.ranges_m[sure], 0.5 * (left_m + right_m)[sure]
        apart_m = np.abs(middles[:, np.newaxis] - middles) * np.minimum(ranges_m[:, np.newaxis], ranges_m)
        if apart_m.max() <= SPAN_M:  # not with a range that is unknown, NaN
            aside = np.maximum(left_m[unsure, np.newaxis] - right_m[front], left_m[front] - right_m[unsure, np.newaxis])
            aside_m = np.maximum(aside, 0.0) * tracks.ranges_m[front]
            is_lamp[unsure] = ~(aside_m <= BESIDE_M).any(axis=1)
    return is_lamp
