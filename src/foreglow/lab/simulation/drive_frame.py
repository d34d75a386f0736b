"""What a simulated drive yields for each frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.datasets.simulated import FrameTruth
from foreglow.datasets.simulated.shares import BoxShares
from foreglow.geometry import Camera, Pose
from foreglow.types import Frame


@dataclass(frozen=True, slots=True, eq=False)
class DriveFrame(FrameTruth):
    """An image of a drive with all that is known about it.

    Attributes:
        frame: The image, as every source of frames yields it.
        camera: Its calibration.
        depth_m: Shape (height, width), float32, distance along each pixel's ray; NaN where there is only sky.
        shares: Whose light is in the proposals of some presets; empty if nobody asked.
        light_cd_m2: Shape (6, height // 4, width // 4), float32, the light of each source; None if nobody asked.
    """

    frame: Frame
    camera: Camera
    depth_m: NDArray[np.float32]
    shares: tuple[BoxShares, ...] = ()
    light_cd_m2: NDArray[np.float32] | None = None

    @property
    def camera_pose(self) -> Pose:
        """world_from_camera."""
        return self.ego_pose @ self.camera.vehicle_from_camera
