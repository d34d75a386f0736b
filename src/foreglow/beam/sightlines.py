"""In which directions a lamp sees what the camera sees in a box."""

from __future__ import annotations

import numpy as np

from foreglow.config import GuardConfig
from foreglow.geometry import Camera, Floats

NUM_CELLS = 64
"""Along each axis of the image; rays inside a cell are interpolated, to 0.003 degrees with ordinary lenses."""

_CORNERS = ((0, 1), (2, 1), (0, 3), (2, 3))
"""Places of x and y of each corner in a box x1, y1, x2, y2."""


class Sightlines:
    """The directions, from two lamps, of whatever may be in boxes of one camera.

    The camera's rays are computed once, on a grid: undoing the lens's distortion for each box takes longer than all
    else.
    """

    def __init__(self, camera: Camera, lamps_m: Floats, config: GuardConfig) -> None:
        """Takes the camera, and where the lamps are in the vehicle, shape (2, 3)."""
        columns, rows = (np.linspace(0.0, size, NUM_CELLS + 1) for size in (camera.width_px, camera.height_px))
        pixels = np.stack(np.meshgrid(columns, rows), -1)
        mount = camera.vehicle_from_camera
        self._rays = (camera.rays(pixels) @ mount.rotation.T).reshape(-1, 3)
        self._neighbours = np.array([0, 1, NUM_CELLS + 1, NUM_CELLS + 2])
        self._cells_per_px = NUM_CELLS / np.array([camera.width_px, camera.height_px])
        self._offsets_m = (mount.position_m - lamps_m)[:, np.newaxis]
        self._config = config

    def rays(self, pixels: Floats) -> Floats:
        """Directions in the vehicle's frame, shape (..., 3), about unit, of pixels (x, y), shape (..., 2).

        A pixel outside the image is taken as the nearest one inside.
        """
        places = np.minimum(np.maximum(pixels * self._cells_per_px, 0.0), NUM_CELLS)
        cells = np.minimum(places.astype(np.intp), NUM_CELLS - 1)
        shares = places - cells
        u, v = shares[..., 0], shares[..., 1]
        both = u * v
        weights = np.empty((*u.shape, 4))
        weights[..., 0] = 1.0 - u - v + both
        weights[..., 1] = u - both
        weights[..., 2] = v - both
        weights[..., 3] = both
        firsts = cells[..., 1] * (NUM_CELLS + 1) + cells[..., 0]
        return np.asarray(
            np.einsum("...n,...nk->...k", weights, self._rays[firsts[..., np.newaxis] + self._neighbours])
        )

    def spans_rad(self, boxes_xyxy_px: Floats, ranges_m: Floats, sigmas_m: Floats) -> tuple[Floats, Floats]:
        """Where the lamps see what is in the boxes, and from how near.

        Args:
            boxes_xyxy_px: Shape (M, 4).
            ranges_m: Shape (M,), from the camera; NaN where unknown: then it may be anywhere.
            sigmas_m: Shape (M,), standard deviations.

        Returns:
            Shape (M, 2, 4), for the left and the right lamp: least and greatest azimuth, least and greatest elevation,
            in the vehicle's frame, up to the driver's eyes. Shape (M,), the least range.
        """
        spread_m = self._config.range_sigmas * sigmas_m
        nearest_m = np.fmax(ranges_m - spread_m, self._config.min_range_m)
        farthest_m = np.maximum(ranges_m + spread_m, nearest_m)
        # The direction of a point at range r is ray + offset / r: shape (M, near or far, lamp, corner, 3).
        nearness = np.empty((len(ranges_m), 2, 1, 1))
        nearness[:, 0, 0, 0] = 1.0 / nearest_m
        nearness[:, 1, 0, 0] = np.where(np.isnan(farthest_m), 0.0, 1.0 / farthest_m)
        rays = self.rays(boxes_xyxy_px[:, _CORNERS])
        directions = rays[:, np.newaxis, np.newaxis] + nearness[..., np.newaxis] * self._offsets_m
        x, y, z = directions[..., 0], directions[..., 1], directions[..., 2]
        forward = np.sqrt(x * x + y * y)
        azimuths = np.arctan2(y, x)
        spans = np.empty((len(ranges_m), 2, 4))
        np.minimum.reduce(azimuths, axis=(1, 3), out=spans[..., 0])
        np.maximum.reduce(azimuths, axis=(1, 3), out=spans[..., 1])
        np.minimum.reduce(np.arctan2(z, forward), axis=(1, 3), out=spans[..., 2])
        np.maximum.reduce(np.arctan2(z + self._config.eyes_above_m * nearness, forward), axis=(1, 3), out=spans[..., 3])
        return spans, nearest_m
