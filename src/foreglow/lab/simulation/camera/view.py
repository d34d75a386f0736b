"""The part of the rendered field of view that a camera sees, at its own resolution."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Camera, Floats
from foreglow.lab.simulation.camera.optics import Image, LampPoints
from foreglow.lab.simulation.camera.profile import CameraProfile

T = TypeVar("T", bound=np.generic)

FINEST = 1.001
"""Largest ratio of the camera's and the rendering's focal lengths: beyond, pixels would be made up."""


class View:
    """A cut of the rendering, scaled to the camera's pixels.

    Attributes:
        camera: The calibration of what comes out.
        scale: Pixels of the camera for one of the rendering.
    """

    def __init__(self, profile: CameraProfile, rendered: Camera, origin: str | None = None) -> None:
        """The view of `profile` on images of the camera `rendered`.

        Args:
            profile: The profile.
            rendered: The camera of the rendering.
            origin: Where the profile is from, for messages; None for its name alone.

        Raises:
            ValueError: If the view does not fit the rendering; the message names `origin` and field.
        """
        origin = f"camera {profile.name}" if origin is None else origin
        spec = profile.view
        width = spec.width_px or rendered.width_px
        height = spec.height_px or rendered.height_px
        focal = spec.focal_px or rendered.focal_px[0] * width / rendered.width_px
        scale = focal / rendered.focal_px[0]
        if scale > FINEST:
            raise ValueError(
                f"{origin}: view.focal_px: expected up to {rendered.focal_px[0]:g} px, as a rendering of "
                f"{rendered.width_px}x{rendered.height_px} px has, got {focal:g}; render larger images"
            )
        cut = (width / scale, height / scale)
        if cut[0] > rendered.width_px + 0.5 or cut[1] > rendered.height_px + 0.5:
            raise ValueError(
                f"{origin}: view: expected a field of view within the rendering's {rendered.width_px}x"
                f"{rendered.height_px} px at {rendered.focal_px[0]:g} px, got {cut[0]:.0f}x{cut[1]:.0f} px of it"
            )
        self.scale = scale
        self._corner = ((rendered.width_px - cut[0]) / 2, (rendered.height_px - cut[1]) * (1.0 - spec.up))
        self._rendered = rendered
        self._is_whole = (width, height) == (rendered.width_px, rendered.height_px) and abs(scale - 1) < 1e-9
        self.camera = rendered
        if not self._is_whole:
            x, y = self.points_px(np.array([rendered.centre_px]))[0].tolist()
            focals = (rendered.focal_px[0] * scale, rendered.focal_px[1] * scale)
            self.camera = replace(rendered, width_px=width, height_px=height, focal_px=focals, centre_px=(x, y))

    def points_px(self, points_px: Floats) -> Floats:
        """Pixels of the camera, shape (N, 2), for pixels of the rendering."""
        return points_px if self._is_whole else (points_px - np.array(self._corner)) * self.scale

    def lamps(self, points: LampPoints) -> LampPoints:
        """Lamps in the rendering as the camera sees them."""
        if self._is_whole or not len(points.illuminances_lx):
            return points
        return LampPoints(self.points_px(points.positions_px), points.illuminances_lx, points.radii_px * self.scale)

    def light(self, image: Image) -> Image:
        """The camera's part of a luminance image of the rendering, averaged over its pixels."""
        if self._is_whole:
            return image
        (left, top), size = self._corner, (self.camera.width_px, self.camera.height_px)
        x0, y0 = round(left), round(top)
        x1 = min(image.shape[1], round(left + size[0] / self.scale))
        y1 = min(image.shape[0], round(top + size[1] / self.scale))
        cut = image[y0:y1, x0:x1]
        if cut.shape == size[::-1]:
            return np.ascontiguousarray(cut)
        return np.asarray(cv2.resize(cut, size, interpolation=cv2.INTER_AREA), np.float32)

    def nearest(self, image: NDArray[T]) -> NDArray[T]:
        """The camera's part of an image whose values cannot be averaged, such as numbers of materials."""
        if self._is_whole:
            return image
        if abs(self.scale - 1.0) < 1e-9:
            x0, y0 = (round(corner) for corner in self._corner)
            return image[y0 : y0 + self.camera.height_px, x0 : x0 + self.camera.width_px]
        rows = self._indices(self.camera.height_px, self._corner[1], image.shape[0])
        columns = self._indices(self.camera.width_px, self._corner[0], image.shape[1])
        return image[np.ix_(rows, columns)]

    def box_px(self, box: tuple[int, int, int, int] | None) -> tuple[int, int, int, int] | None:
        """A half-open box of the rendering, cut to the camera's image; None if nothing is left."""
        if box is None or self._is_whole:
            return box
        (x0, y0), (x1, y1) = self.points_px(np.array(box, np.float64).reshape(2, 2))
        left, top = max(0, int(np.floor(x0))), max(0, int(np.floor(y0)))
        right, bottom = min(self.camera.width_px, int(np.ceil(x1))), min(self.camera.height_px, int(np.ceil(y1)))
        return (left, top, right, bottom) if left < right and top < bottom else None

    def holds(self, x: float, y: float) -> bool:
        """Whether a pixel of the camera is in its image; NaN is not."""
        return 0 <= x < self.camera.width_px and 0 <= y < self.camera.height_px

    def _indices(self, num: int, corner: float, end: int) -> NDArray[np.intp]:
        at = corner + (np.arange(num) + 0.5) / self.scale
        return np.asarray(np.clip(np.floor(at), 0, end - 1), np.intp)
