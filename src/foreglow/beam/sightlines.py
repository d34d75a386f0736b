"""The directions from a lamp to whatever the camera sees in a box."""

from __future__ import annotations

import numpy as np

from foreglow.config import GuardConfig
from foreglow.geometry import Camera, Floats
from foreglow.rays import RayCaster

NUM_PARTS = 4
"""Each side of a box is looked at in so many parts: between the corners of a wide one, directions reach further."""

_AROUND = (
    np.array(
        [(x, y) for x, y in np.ndindex(NUM_PARTS + 1, NUM_PARTS + 1) if x in (0, NUM_PARTS) or y in (0, NUM_PARTS)]
    )
    / NUM_PARTS
)
"""Points around a box, shape (P, 2), in shares of its width and height."""

CLOSEST_M = 4.0
"""No vehicle is nearer to the camera: about as far away is the front end of ours."""


class Sightlines:
    """The directions from two lamps to whatever the camera sees in boxes."""

    def __init__(self, lamps_m: Floats, config: GuardConfig) -> None:
        """Takes the lamps' positions in the vehicle's frame, shape (2, 3)."""
        self._caster = RayCaster()
        self._lamps_m = lamps_m
        self._config = config

    def spans_rad(
        self, camera: Camera, boxes_xyxy_px: Floats, ranges_m: Floats, sigmas_m: Floats
    ) -> tuple[Floats, Floats]:
        """The spans of directions from the lamps to the contents of the boxes, and the nearest ranges.

        Args:
            camera: The camera.
            boxes_xyxy_px: Shape (M, 4); what lies beyond the image counts with the angles of pixels in its middle, the
                largest without distortion, up to a right angle.
            ranges_m: Shape (M,), from the camera; NaN where unknown: then any range from `min_range_m` on is possible.
            sigmas_m: Shape (M,), standard deviations; infinite where unknown: a vehicle of known range may then be
                anywhere from `CLOSEST_M` on.

        Returns:
            Spans, shape (M, 2, 4), for the left and the right lamp: least and greatest azimuth, least and greatest
            elevation, in the vehicle's frame, up to the driver's eyes. And the nearest range, shape (M,).

        Raises:
            ValueError: If the camera's distortion cannot be undone.
        """
        count = len(ranges_m)
        spread_m = self._config.range_sigmas * sigmas_m
        nearest_m = np.where(np.isfinite(ranges_m), np.fmax(ranges_m - spread_m, CLOSEST_M), self._config.min_range_m)
        farthest_m = np.maximum(ranges_m + spread_m, nearest_m)
        nearness = np.empty((count, 2, 1, 1))
        nearness[:, 0, 0, 0] = 1.0 / nearest_m
        nearness[:, 1, 0, 0] = np.where(np.isnan(farthest_m), 0.0, 1.0 / farthest_m)
        size_px = np.array((camera.width_px, camera.height_px), np.float64)
        sides = np.minimum(np.maximum(boxes_xyxy_px, 0.0), np.tile(size_px, 2))
        beyond_px = np.minimum(boxes_xyxy_px[:, :2], 0.0), np.maximum(boxes_xyxy_px[:, 2:] - size_px, 0.0)
        is_beyond = beyond_px[0].any() or beyond_px[1].any()
        rays = self._caster.cast(
            camera,
            _around(sides[:, :2], sides[:, 2:]),
            beyond_rad=_around(*beyond_px) / camera.focal_px if is_beyond else None,
        )
        # A point at range r lies in the direction ray + offset / r; shape (M, near or far, lamp, P, 3).
        offsets_m = (rays.origin_m - self._lamps_m)[:, np.newaxis]
        seen = rays.directions.reshape(count, 1, 1, len(_AROUND), 3) + nearness[..., np.newaxis] * offsets_m
        x, y, z = seen[..., 0], seen[..., 1], seen[..., 2]
        forward = np.sqrt(x * x + y * y)
        azimuths = np.arctan2(y, x)
        # From the farthest range to the nearest, it turns by less than half a circle, past -180 degrees or not.
        (near_x, far_x), (near_y, far_y) = x.swapaxes(0, 1), y.swapaxes(0, 1)
        azimuths[:, 0] = azimuths[:, 1] + np.arctan2(far_x * near_y - far_y * near_x, far_x * near_x + far_y * near_y)
        eyes = z + self._config.eyes_above_m * nearness
        spans = np.empty((count, 2, 4))
        np.minimum.reduce(azimuths, axis=(1, 3), out=spans[..., 0])
        np.maximum.reduce(azimuths, axis=(1, 3), out=spans[..., 1])
        np.minimum.reduce(np.arctan2(z, forward), axis=(1, 3), out=spans[..., 2])
        np.maximum.reduce(np.arctan2(eyes, forward), axis=(1, 3), out=spans[..., 3])
        return spans, nearest_m

    def from_origin_m(self, camera: Camera, boxes_xyxy_px: Floats, ranges_m: Floats) -> Floats:
        """The ranges from the vehicle's origin, seen from above, of what the camera sees in the boxes' middles.

        Args:
            camera: The camera.
            boxes_xyxy_px: Shape (M, 4).
            ranges_m: Shape (M,), from the camera; NaN where unknown.

        Returns:
            Shape (M,); NaN where unknown.

        Raises:
            ValueError: If the camera's distortion cannot be undone.
        """
        middles = np.clip(0.5 * (boxes_xyxy_px[:, :2] + boxes_xyxy_px[:, 2:]), 0.0, (camera.width_px, camera.height_px))
        rays = self._caster.cast(camera, middles)
        places_m = rays.origin_m[:2] + ranges_m[:, np.newaxis] * rays.directions[:, :2]
        return np.asarray(np.hypot(places_m[:, 0], places_m[:, 1]))


def _around(first: Floats, last: Floats) -> Floats:
    """Points around boxes, shape (M * P, 2), from their corners of shape (M, 2)."""
    return np.asarray(first[:, np.newaxis] * (1.0 - _AROUND) + last[:, np.newaxis] * _AROUND).reshape(-1, 2)
