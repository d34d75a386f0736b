"""Sampling: a ray through the centre of every pixel, and further rays through pixels with detail."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Camera, Floats
from foreglow.lab.simulation.light.llvm import dr, mi
from foreglow.lab.simulation.light.raycast import Number

TILE_PX = 4
"""Side of a tile: sixteen rays are traced together, and rays of a square stay together longer than those of a row."""


@dataclass(frozen=True, slots=True)
class RenderSettings:
    """Quality and cost of an image.

    Attributes:
        extra_samples: Number of further rays in pixels with edges or detail.
        max_extra_share: Largest share of the pixels that get further rays, those with most contrast first.
        edge_contrast: Smallest contrast of a pixel's neighbourhood, relative to its brightest pixel, for further rays.
        edge_cd_m2: Smallest difference of luminance in the neighbourhood for further rays.
        haze_cells: Columns, rows and steps of the grid of the haze.
        darkest_cd_m2: Light of a lamp below this luminance is left out.
    """

    extra_samples: int = 2
    max_extra_share: float = 0.06
    edge_contrast: float = 0.15
    edge_cd_m2: float = 4e-3
    haze_cells: tuple[int, int, int] = (80, 60, 28)
    darkest_cd_m2: float = 2e-4


QUALITIES: dict[str, RenderSettings] = {
    "fast": RenderSettings(extra_samples=0, haze_cells=(54, 40, 16), darkest_cd_m2=4e-4),
    "training": RenderSettings(),
    "fine": RenderSettings(
        extra_samples=8,
        max_extra_share=1.0,
        edge_contrast=0.03,
        edge_cd_m2=1e-3,
        haze_cells=(160, 120, 32),
        darkest_cd_m2=1e-6,
    ),
}
"""Settings by name; `training` is the default everywhere. A grey level of the long exposure is about 1e-3 cd/m^2."""


class Samples:
    """Directions through the pixels of a camera, computed once."""

    def __init__(self, camera: Camera, settings: RenderSettings) -> None:
        """Rays for the first and the further samples of every pixel, with the lens's distortion."""
        self._settings = settings
        self.shape = (camera.height_px, camera.width_px)
        y, x = np.indices(self.shape).reshape(2, -1)
        num_tiles = -(-camera.width_px // TILE_PX)
        tile = (y // TILE_PX) * num_tiles + x // TILE_PX
        order = np.lexsort((x, y, tile))
        self._ranks = np.empty(len(order), np.int64)
        self._ranks[order] = np.arange(len(order))
        self.pixels = mi.UInt32(order.astype(np.uint32))
        self._rays = [
            mi.Vector3f(np.ascontiguousarray(rays.reshape(-1, 3)[order].T, np.float32))
            for rays in _rays(camera, _offsets(settings.extra_samples))
        ]

    @property
    def first(self) -> Number:
        """Directions through the centres of the pixels, in the camera's frame and in the order of `pixels`."""
        return self._rays[0]

    @property
    def num(self) -> int:
        """Number of samples of a pixel with further samples."""
        return len(self._rays)

    def further(self, pixels: NDArray[np.intp]) -> list[Number]:
        """Directions through `pixels`, for each of the further samples."""
        ranks = mi.UInt32(self._ranks[pixels].astype(np.uint32))
        further = [dr.gather(mi.Vector3f, rays, ranks) for rays in self._rays[1:]]
        dr.eval(further)  # evaluated like the first rays, so that the same kernel is used
        return further

    def detailed(self, luminance_cd_m2: NDArray[np.float32]) -> NDArray[np.intp]:
        """Numbers of the pixels that need further samples, tile by tile; `luminance_cd_m2` has the image's shape."""
        if self.num == 1:
            return np.zeros(0, np.intp)
        around = np.ones((3, 3), np.uint8)
        high, low = cv2.dilate(luminance_cd_m2, around), cv2.erode(luminance_cd_m2, around)
        difference = (high - low).ravel()
        chosen = np.flatnonzero(difference >= self._settings.edge_cd_m2)
        contrast = difference[chosen] / np.maximum(high.ravel()[chosen], self._settings.edge_cd_m2)
        most = int(self._settings.max_extra_share * difference.size)
        least = self._settings.edge_contrast
        if np.count_nonzero(contrast > least) > most:
            least = float(np.partition(contrast, contrast.size - most - 1)[contrast.size - most - 1])
        chosen = chosen[contrast > least]
        return chosen[np.argsort(self._ranks[chosen])]


def _rays(camera: Camera, offsets: Sequence[tuple[float, float]]) -> Iterator[Floats]:
    """Directions through all pixels at each of `offsets`, the first of which are the centres; shape (H, W, 3).

    Those beside the centres are extrapolated from the centres', whose directions differ by less than a thousandth of a
    pixel's width from a linear change within the pixel, and are not normalised.
    """
    y, x = np.indices((camera.height_px, camera.width_px))
    centres = camera.rays(np.stack([x, y], -1) + offsets[0])
    yield centres
    if len(offsets) > 1:
        down, across = np.gradient(centres, axis=(0, 1))
        for right, lower in np.subtract(offsets[1:], offsets[0]):
            yield centres + right * across + lower * down


def _offsets(extra_samples: int) -> list[tuple[float, float]]:
    """Offsets of the samples in a pixel: its centre, and points on a circle with the same variance as the pixel's area.

    >>> offsets = np.array(_offsets(3)) - 0.5
    >>> np.allclose(np.mean(offsets**2, axis=0), 1 / 12)
    True
    """
    angles = np.pi / 2 + 2.0 * np.pi * np.arange(extra_samples) / max(extra_samples, 1)
    radius = np.sqrt((extra_samples + 1) / (6.0 * max(extra_samples, 1)))
    return [(0.5, 0.5), *((0.5 + radius * float(np.cos(a)), 0.5 + radius * float(np.sin(a))) for a in angles)]
