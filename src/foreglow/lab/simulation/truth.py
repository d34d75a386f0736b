"""What the simulator knows of a frame, exactly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.datasets.pvdn_schema import ImageCategory
from foreglow.geometry import Camera, Floats, Pose
from foreglow.lab.simulation.world.materials import Kind
from foreglow.types import Frame


@dataclass(frozen=True, slots=True)
class Artifact:
    """A light artifact: a spot in the image that a vehicle's lamps cause.

    Attributes:
        instance_id: The same through the drive, unique in it; -1 where not yet given.
        position_px: Full-frame pixels x, y.
        kind: What the light is seen on.
        is_direct: Whether it is the lamp itself.
        is_rear: Whether it comes from the rear lamps.
        is_doubtful: Whether it only meets the divided thresholds; nobody should be blamed for either answer.
        depth_m: Distance along the viewing ray to what is lit, metres; NaN for haze.
        grey: Grey levels that the light adds at the peak, smoothed and noise-free; for a lamp its peak.
        contrast: The same over its noise.
        area_px: Pixels around it that reach half of the peak.
        lamp: Name of the lamp, of the first one where several are seen as one; empty for indirect light.
    """

    instance_id: int
    position_px: tuple[float, float]
    kind: Kind
    is_direct: bool
    is_rear: bool
    is_doubtful: bool
    depth_m: float
    grey: float
    contrast: float
    area_px: int
    lamp: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class LampTruth:
    """One lamp of another vehicle.

    Attributes:
        name: Such as `low_left` or `rear_right`.
        is_rear: Whether it shines backwards.
        position_world_m: Shape (3,).
        position_px: Projection, full-frame pixels x, y; NaN behind the camera.
        radius_m: Of its disc.
        intensity_cd: Towards the camera.
        visible_share: Of its disc, 0..1; 0 outside the image.
    """

    name: str
    is_rear: bool
    position_world_m: Floats
    position_px: tuple[float, float]
    radius_m: float
    intensity_cd: float
    visible_share: float


@dataclass(frozen=True, slots=True, eq=False)
class VehicleTruth:
    """Another vehicle in one frame.

    Attributes:
        vehicle_id: Its place in `Scene.vehicles`.
        kind: car, van, lorry or motorcycle.
        pose: world_from_vehicle.
        speed_mps: Along its own forward direction.
        size_m: Length, width, height of its box.
        box_centre_m: Shape (3,), centre of the box in the vehicle's frame.
        box_xyxy_px: Half-open box around its projection, cut to the image; None if it is outside or behind us.
        visible_share: Share of the points spread over its body that the camera sees, 0..1.
        range_m: From the camera to the middle between its headlamps (or to its box's centre).
        lamps: Its lamps.
        artifacts: What an annotator would mark, and the doubtful ones.
        candidates: Peaks under much looser thresholds, to study the rule.
        eye_world_m: Shape (3,), its driver's eye.
        eye_lx: Illuminance at the eye, by source: `ego`, other vehicles' ids, `fixed`.
    """

    vehicle_id: int
    kind: str
    pose: Pose
    speed_mps: float
    size_m: tuple[float, float, float]
    box_centre_m: Floats
    box_xyxy_px: tuple[int, int, int, int] | None
    visible_share: float
    range_m: float
    lamps: tuple[LampTruth, ...]
    artifacts: tuple[Artifact, ...]
    candidates: tuple[Artifact, ...]
    eye_world_m: Floats
    eye_lx: Mapping[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class DriveFrame:
    """One image of a drive with all that is known of it.

    Attributes:
        frame: The image, as every source of frames yields it.
        camera: Its calibration.
        ego_pose: world_from_vehicle, with the body's motion.
        ego_s_m: Arc length of our rear axle along the main road.
        ego_speed_mps: Our speed.
        ego_yaw_rate_radps: Our rate of turn to the left.
        vehicles: The other vehicles.
        category: PVDN's category of the image.
        is_production_detected: Whether the modelled production system reports a vehicle.
        depth_m: Shape (height, width), float32, distance along each pixel's ray; NaN where there is only sky.
        ego_eye_lx: Illuminance at our driver's eye, by vehicle id.
    """

    frame: Frame
    camera: Camera
    ego_pose: Pose
    ego_s_m: float
    ego_speed_mps: float
    ego_yaw_rate_radps: float
    vehicles: tuple[VehicleTruth, ...]
    category: ImageCategory
    is_production_detected: bool
    depth_m: NDArray[np.float32]
    ego_eye_lx: Mapping[str, float]

    @property
    def camera_pose(self) -> Pose:
        """world_from_camera."""
        return self.ego_pose @ self.camera.vehicle_from_camera
