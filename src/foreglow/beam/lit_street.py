"""Whether the road is lit: there the high beam stays off.

Lamps on posts are bright spots high in the image. Seen at the elevation e, a lamp that is h above the camera is at the
distance h / tan(e): at most 130 m for one of 10 m at the lowest elevation that counts here, so each that is seen soon
flows past us, and a street is lit where others take their place. With the number n of such spots in a frame, the
evidence E of a lit street, in seconds, changes over a frame interval dt:

    n = 0    E <- E - dt * on_s / off_s                                                                          (1)
    n = 1    E <- E + dt / 8                                                                                     (2)
    n >= 2   E <- E + dt                                                                                         (3)
    then     E <- clip(E, 0, on_s)                                                                               (4)

The road counts as lit once E reaches `on_s`, and until E is 0 again. A single lamp, as at a junction, is in view for
less than the 8 `on_s` that it would need at the speeds of high beam.

A spot is a group of neighbouring blocks of the image in which the greatest value is at least a share of white, twice
the median and 0.6 times the maximum of all blocks at these elevations. Groups that are wide or high are no lamps: walls
and billboards, or the glare of lamps near by. Nor are those more than twice as high as wide: a lit post below its lamp.
Spots at the same elevation count once: the marker lamps of a lorry ahead are a pair.
"""

from __future__ import annotations

import functools

import cv2
import numpy as np

from foreglow.config import LitStreetConfig
from foreglow.geometry import Camera, Floats
from foreglow.rays import RayCaster
from foreglow.types import Frame, Image

ROAD_LIT = "road_lit"
"""The reason in `BeamCommand.faults`."""

BLOCKS_ACROSS = 160
"""Blocks in a row of the image; a block is a third of a degree in a camera of 50 degrees."""

ONE_LAMP = 0.125
"""Weight of a single spot, (2)."""

MIN_OF_BRIGHTEST = 0.6
"""It also has at least this share of the brightest block: posts and walls are darker than the lamps that light them."""

APART_DEG = 1.0
"""Lamps at different distances differ at least so much in elevation."""

MAX_STEP_S = 0.5
"""A longer time between two frames counts as this one."""

MIN_CONTRAST = 2.0
"""A spot is brighter than the median of the blocks around by this factor: bright skies and walls hold no lamps."""


class LitStreet:
    """Decides frame by frame whether the road is lit."""

    def __init__(self, config: LitStreetConfig, white_level: int | None = None) -> None:
        """Takes the camera's white; None for that of the least bit depth that holds the brightest pixel so far."""
        self._config = config
        self._known_white = white_level
        self._caster = RayCaster()
        self._camera: Camera | None = None
        self.reset()

    def reset(self) -> None:
        """Forgets earlier frames: the road is not lit."""
        self._evidence_s = 0.0
        self._timestamp_ns: int | None = None
        self._white = self._known_white or 255
        self.is_lit = False

    def update(self, frame: Frame) -> bool:
        """Whether the road is lit, after `frame`; without a camera it is never."""
        if not self._config.enabled or frame.camera is None:
            return False
        step_s = 0.0 if self._timestamp_ns is None else (frame.timestamp_ns - self._timestamp_ns) / 1e9
        self._timestamp_ns = frame.timestamp_ns
        step_s = min(max(step_s, 0.0), MAX_STEP_S)
        num = self.num_lamps(frame.image, frame.camera)
        rate = 1.0 if num > 1 else ONE_LAMP if num else -self._config.on_s / self._config.off_s
        self._evidence_s = min(max(self._evidence_s + step_s * rate, 0.0), self._config.on_s)  # (1) to (4)
        self.is_lit = self._evidence_s >= self._config.on_s or (self.is_lit and self._evidence_s > 0.0)
        return self.is_lit

    def num_lamps(self, image: Image, camera: Camera) -> int:
        """The number of elevations at which spots in `image` may be lamps on posts."""
        if camera is not self._camera:
            self._look_through(camera)
        rows, size_px = self._rows, self._block_px
        columns = camera.width_px // size_px
        height_px = (rows.stop - rows.start) * size_px
        if height_px <= 0:
            return 0
        region = image[rows.start * size_px : rows.stop * size_px, : columns * size_px]
        every = 2 if size_px >= 8 else 1  # a lamp is more than a row high there
        lines = region.reshape(-1, size_px, columns * size_px)[:, ::every].max(axis=1)
        if image.dtype != np.uint8 and self._known_white is None:
            self._white = max(self._white, (1 << int(image.max()).bit_length()) - 1)
        bright = self._config.min_brightness * self._white
        if lines.max() < bright:
            return 0
        blocks = functools.reduce(np.maximum, (lines[:, column::size_px] for column in range(size_px)))
        is_bright = (blocks >= bright) & self._is_high
        if not is_bright.any():
            return 0
        high = blocks[self._is_high]
        is_bright &= blocks >= max(MIN_CONTRAST * np.median(high), MIN_OF_BRIGHTEST * high.max())
        most = self._max_blocks
        _, _, spots, _ = cv2.connectedComponentsWithStats(is_bright.astype(np.uint8))
        middles = sorted(
            2 * y + height
            for _, y, width, height, _ in spots[1:].tolist()  # the first are the blocks that are not bright
            if max(height, width) <= most and height <= 2 * width
        )
        num, last = 0, -np.inf
        for middle in middles:
            if middle - last >= 2 * self._apart_blocks:
                num, last = num + 1, middle
        return num

    def _look_through(self, camera: Camera) -> None:
        """Finds the blocks of `camera`'s images in which lamps on posts are seen."""
        self._camera = camera
        self._block_px = max(camera.width_px // BLOCKS_ACROSS, 1)
        shape = camera.height_px // self._block_px, camera.width_px // self._block_px
        elevations = np.degrees(np.arcsin(self._directions(camera, shape)[..., 2]))
        is_high = (elevations >= self._config.min_elevation_deg) & (elevations <= self._config.max_elevation_deg)
        high = np.flatnonzero(is_high.any(axis=1))
        self._rows = slice(high[0], high[-1] + 1) if len(high) else slice(0, 0)
        self._is_high = is_high[self._rows]
        block_deg = np.degrees(self._block_px / camera.focal_px[0])
        self._max_blocks = max(round(self._config.max_size_deg / block_deg), 2)
        self._apart_blocks = max(round(APART_DEG / block_deg), 1)

    def _directions(self, camera: Camera, shape: tuple[int, int]) -> Floats:
        """Unit vectors in the vehicle's frame through the middles of all blocks, shape (rows, columns, 3)."""
        y, x = (np.indices(shape) + 0.5) * self._block_px
        pixels = np.stack([x.ravel(), y.ravel()], axis=1)
        return self._caster.cast(camera, pixels).directions.reshape(*shape, 3)
