"""Viewing rays of pixels in the vehicle's frame, fast enough for a grid of pixels in every box."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from foreglow.geometry import Camera, Floats, rotation
from foreglow.types import Frame

if TYPE_CHECKING:
    from scipy.interpolate import RectBivariateSpline

NODE_SPACING_PX = 16.0
"""Distance between the nodes at which a camera's distortion is inverted exactly. Between them, the error of a cubic
spline is below 1e-8 for lenses like PVDN's."""

FURTHEST_RAD = math.radians(89.0)
"""No ray that goes beyond the image turns further from the camera's axis."""


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """Half-lines from the camera, in the vehicle's frame; z = 0 is the road under the car.

    Attributes:
        origin_m: Shape (3,), position of the camera.
        directions: Shape (M, 3), unit vectors.
        pitch_sigma_rad: Standard deviation of the pitch error that they share.
    """

    origin_m: Floats
    directions: Floats
    pitch_sigma_rad: float


def calibrated(frame: Frame) -> Camera:
    """The frame's camera.

    Raises:
        ValueError: If it has none.
    """
    if frame.camera is None:
        raise ValueError(f"Frame.camera: expected a calibration to estimate ranges, frame {frame.frame} has none")
    return frame.camera


class RayCaster:
    """Turns pixels into rays; remembers the splines of the latest camera, which depend on its intrinsics alone."""

    def __init__(self) -> None:
        # It takes half a second: whoever casts no ray need not wait for it, and the first frame must not.
        import scipy.interpolate  # noqa: F401

        self._key: tuple[object, ...] | None = None
        self._tangents: tuple[RectBivariateSpline, RectBivariateSpline] | None = None

    def cast(
        self,
        camera: Camera,
        pixels: Floats,
        pitch_rad: float = 0.0,
        pitch_sigma_rad: float = 0.0,
        *,
        beyond_rad: Floats | None = None,
    ) -> Rays:
        """The rays through `pixels`, shape (M, 2), when the body's nose is up by `pitch_rad` about the rear axle.

        Args:
            camera: The camera.
            pixels: The pixels, within the image where it has distortion.
            pitch_rad: Pitch of the body.
            pitch_sigma_rad: Its standard deviation.
            beyond_rad: Shape (M, 2), how much further right and down the rays go, for what lies beyond the image; up to
                `FURTHEST_RAD` from the camera's axis either way.

        Raises:
            ValueError: If the distortion has no inverse somewhere in the image.
        """
        mount = camera.vehicle_from_camera
        origin, turned = mount.position_m, mount.rotation
        if pitch_rad:
            body = rotation(pitch_rad=pitch_rad)
            origin, turned = body @ origin, body @ turned
        rays = np.empty((len(pixels), 3))
        rays[:, 0] = 1.0
        tangents = self._tangents_of(camera, pixels)
        if beyond_rad is not None:
            tangents = np.tan(np.clip(np.arctan(tangents) + beyond_rad, -FURTHEST_RAD, FURTHEST_RAD))
        np.negative(tangents, out=rays[:, 1:])
        directions = rays @ turned.T
        directions /= np.sqrt(np.einsum("ij,ij->i", rays, rays))[:, None]
        return Rays(origin, directions, pitch_sigma_rad)

    def _tangents_of(self, camera: Camera, pixels: Floats) -> Floats:
        """Coordinates to the right and downwards in the undistorted image at focal length 1, shape (M, 2)."""
        if not any(camera.distortion):
            return np.asarray((pixels - camera.centre_px) / camera.focal_px)
        key = (camera.width_px, camera.height_px, camera.focal_px, camera.centre_px, camera.distortion)
        if self._tangents is None or key != self._key:
            self._key, self._tangents = key, _splines(camera)
        x, y = pixels[:, 0], pixels[:, 1]
        across, down = self._tangents
        return np.column_stack([across.ev(x, y), down.ev(x, y)])


def _splines(camera: Camera) -> tuple[RectBivariateSpline, RectBivariateSpline]:
    """The two undistorted coordinates as functions of the pixel."""
    from scipy.interpolate import RectBivariateSpline

    columns, rows = (
        np.linspace(0.0, size_px, max(int(np.ceil(size_px / NODE_SPACING_PX)), 4) + 1)
        for size_px in (camera.width_px, camera.height_px)
    )
    rays = camera.node_rays(columns, rows)
    u, v = -rays[..., 1] / rays[..., 0], -rays[..., 2] / rays[..., 0]
    return RectBivariateSpline(columns, rows, u), RectBivariateSpline(columns, rows, v)
