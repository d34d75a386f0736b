"""PSD-3D+: PSD-3D after the road has been turned and shifted to the car's real pose on it.

Source: Ewecker et al., arXiv 2107.11302, distance estimation, method PSD-3D+.
"""

from __future__ import annotations

from typing import Protocol

from foreglow.config import DistanceConfig
from foreglow.distance.alignment import RoadAligner
from foreglow.distance.psd_3d import PSD3D
from foreglow.geometry import Floats, rotation
from foreglow.types import Frame


class YawAndOffset(Protocol):
    """The car's pose on the road, relative to what the map assumes: in the middle of the lane, heading along it."""

    @property
    def yaw_rad(self) -> float:
        """Heading to the left of the road's direction."""
        ...

    @property
    def left_m(self) -> float:
        """Offset to the left of the assumed position."""
        ...


class Aligner(Protocol):
    """Estimates the car's pose on the road, from lane markings or the vehicle's orientation."""

    def align(self, frame: Frame) -> YawAndOffset:
        """The pose in `frame`."""
        ...

    def reset(self) -> None:
        """Forgets earlier frames."""
        ...


class PSD3DPlus(PSD3D):
    """PSD-3D on the corrected road."""

    def __init__(self, config: DistanceConfig, aligner: Aligner | None = None) -> None:
        """As PSD-3D; by default the pose is taken from the lane markings in the image."""
        super().__init__(config)
        self._aligner = aligner or RoadAligner()

    def reset(self) -> None:
        """Forgets earlier frames, as at the start of a sequence."""
        super().reset()
        self._aligner.reset()

    def _road_points(self, frame: Frame) -> Floats:
        points_m = super()._road_points(frame)
        standing = self._aligner.align(frame)
        # From the assumed pose to the real one: the road is shifted to the right, then turned to the right.
        return (points_m - [0.0, standing.left_m, 0.0]) @ rotation(yaw_rad=standing.yaw_rad)
