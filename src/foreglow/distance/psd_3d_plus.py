"""PSD-3D+: PSD-3D with the road turned and shifted to where the car really stands on it.

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
    """How we stand on the road, against what the map believes: along it, in the middle of the lane."""

    @property
    def yaw_rad(self) -> float:
        """How far we head to the left of the road's direction."""
        ...

    @property
    def left_m(self) -> float:
        """How far we stand to the left of the believed place."""
        ...


class Aligner(Protocol):
    """Says, from lane markings or the vehicle's orientation, how we stand on the road."""

    def align(self, frame: Frame) -> YawAndOffset:
        """How we stand in `frame`."""
        ...

    def reset(self) -> None:
        """Forgets earlier frames."""
        ...


class PSD3DPlus(PSD3D):
    """PSD-3D on the corrected road."""

    def __init__(self, config: DistanceConfig, aligner: Aligner | None = None) -> None:
        """As PSD-3D; by default the lane markings in the image tell how we stand."""
        super().__init__(config)
        self._aligner = aligner or RoadAligner()

    def reset(self) -> None:
        """Forgets earlier frames, as at the start of a sequence."""
        super().reset()
        self._aligner.reset()

    def _road_points(self, frame: Frame) -> Floats:
        points_m = super()._road_points(frame)
        standing = self._aligner.align(frame)
        # From the place that the map believes in to ours: shifted to the right, then turned to the right.
        return (points_m - [0.0, standing.left_m, 0.0]) @ rotation(yaw_rad=standing.yaw_rad)
