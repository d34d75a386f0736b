"""What a simulator knows about an image, and how a line of `frames.jsonl` stores it.

Pydantic reads and writes these classes by their fields: a new label is a new field here, a new kind of light a new
name in `Kind`, and besides only the code that produces it changes. Numbers are exact, and null stands for NaN.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeAlias, get_args

import numpy as np
from pydantic import ConfigDict

from foreglow.config import FrozenModel
from foreglow.datasets.json_files import StoredAs, adapter, parse_json
from foreglow.datasets.pvdn.schema import Id, ImageCategory
from foreglow.geometry import Floats, Pose
from foreglow.street import StreetMessage

Kind: TypeAlias = Literal["lamp", "rail", "road", "verge", "foliage", "wall", "sign", "vehicle", "haze"]
"""What a light artifact is seen on; `lamp` is the lamp itself, `haze` the air."""

KINDS: tuple[Kind, ...] = get_args(Kind)

_Vector: TypeAlias = tuple[float, float, float]
_Pixel: TypeAlias = tuple[float, float]
_Row: TypeAlias = tuple[int, float, float, Kind, bool, bool, bool, float | None, float, float, int, str]


class _StoredPose(FrozenModel):
    position_m: _Vector
    rotation: tuple[_Vector, _Vector, _Vector]


def _to_rows(artifacts: tuple[Artifact, ...]) -> tuple[tuple[Any, ...], ...]:
    fields = (dataclasses.astuple(artifact) for artifact in artifacts)
    return tuple((number, x, y, *map(_to_null, others)) for number, (x, y), *others in fields)


def _from_rows(rows: tuple[Any, ...]) -> tuple[Artifact, ...]:
    return tuple(Artifact(number, (x, y), *map(_from_null, others)) for number, x, y, *others in rows)


def _to_null(value: Any) -> Any:
    return None if isinstance(value, float) and math.isnan(value) else value


def _from_null(value: Any) -> Any:
    return math.nan if value is None else value


_StoredVector: TypeAlias = Annotated[Floats, StoredAs(_Vector, np.array, lambda array: tuple(array.tolist()))]
_NumberOrNaN: TypeAlias = Annotated[float, StoredAs(float | None, _from_null, _to_null)]
_PixelOrNaN: TypeAlias = Annotated[
    _Pixel,
    StoredAs(
        _Pixel | None,
        lambda stored: stored or (math.nan, math.nan),
        lambda value: None if math.isnan(value[0]) else value,
    ),
]
_PoseOfVehicle: TypeAlias = Annotated[
    Pose,
    StoredAs(
        _StoredPose,
        lambda stored: Pose(np.array(stored.position_m), np.array(stored.rotation)),
        lambda pose: _StoredPose(
            position_m=tuple(pose.position_m.tolist()), rotation=tuple(map(tuple, pose.rotation.tolist()))
        ),
    ),
]


@dataclass(frozen=True, slots=True)
class Artifact:
    """A light artifact: a spot in the image that a vehicle's lamps cause.

    Attributes:
        instance_id: The same through the drive, unique in it; -1 where not yet given.
        position_px: Full-frame pixels x, y.
        kind: What the light is seen on.
        is_direct: Whether it is the lamp itself.
        is_rear: Whether it comes from the rear lamps.
        is_doubtful: Whether it meets only the divided thresholds: finding it and missing it are both right.
        depth_m: Distance along the viewing ray to what is lit, metres; NaN for haze.
        grey: Grey levels that the light adds at the peak, smoothed and noise-free; for a lamp its peak.
        contrast: The same over its noise.
        area_px: Pixels around it that reach half of the peak.
        lamp: Name of the lamp, of the first lamp if several are joined; empty for indirect light.
    """

    instance_id: int
    position_px: _Pixel
    kind: Kind
    is_direct: bool
    is_rear: bool
    is_doubtful: bool
    depth_m: _NumberOrNaN
    grey: float
    contrast: float
    area_px: int
    lamp: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class LampTruth:
    """A lamp of another vehicle.

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
    position_world_m: _StoredVector
    position_px: _PixelOrNaN
    radius_m: float
    intensity_cd: float
    visible_share: float

    @property
    def is_headlamp(self) -> bool:
        """Whether it is a headlamp, and neither a marker nor a rear lamp."""
        return self.name.startswith(("low", "high"))


@dataclass(frozen=True, slots=True, eq=False)
class VehicleTruth:
    """Another vehicle in a frame.

    Attributes:
        vehicle_id: Its index in `Scene.vehicles`.
        kind: Kind of vehicle, as the scene calls it.
        pose: world_from_vehicle.
        speed_mps: Along its own forward direction.
        size_m: Length, width, height of its box.
        box_centre_m: Shape (3,), centre of the box in the vehicle's frame.
        box_xyxy_px: Half-open box around its projection, cut to the image; None if it is outside or behind us.
        visible_share: Share of the points spread over its body that the camera sees, 0..1.
        range_m: From the camera to the middle between its headlamps (or to its box's centre).
        lamps: Its lamps.
        artifacts: What an annotator would mark, and doubtful artifacts.
        candidates: Peaks under much looser thresholds, to study the rule. There are many, so that the file stores
            each as a list: the fields of `Artifact` without their names, with x and y as two values.
        eye_world_m: Shape (3,), its driver's eye.
        eye_lx: Illuminance at the eye, by source: `ego`, other vehicles' ids, `fixed`.
    """

    vehicle_id: int
    kind: str
    pose: _PoseOfVehicle
    speed_mps: float
    size_m: _Vector
    box_centre_m: _StoredVector
    box_xyxy_px: tuple[int, int, int, int] | None
    visible_share: float
    range_m: float
    lamps: tuple[LampTruth, ...]
    artifacts: tuple[Artifact, ...]
    candidates: Annotated[tuple[Artifact, ...], StoredAs(tuple[_Row, ...], _from_rows, _to_rows)]
    eye_world_m: _StoredVector
    eye_lx: Mapping[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class FrameTruth:
    """What the simulator knows about an image.

    Attributes:
        image_id: The image's number: in the data set, or in the drive while there is no data set yet.
        timestamp_ns: Time of exposure, from the start of the drive.
        ego_pose: world_from_vehicle, with the body's motion.
        ego_s_m: Arc length of our rear axle along the main road.
        ego_speed_mps: Our speed.
        ego_yaw_rate_radps: Our rate of turn to the left.
        vehicles: The other vehicles.
        category: PVDN's category of the image.
        is_production_detected: Whether the modelled production system reports a vehicle.
        ego_eye_lx: Illuminance at our driver's eye, by vehicle id.
        street: The car's information about the road ahead.
    """

    __pydantic_config__ = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, ser_json_inf_nan="constants")

    image_id: Id
    timestamp_ns: int
    ego_pose: _PoseOfVehicle
    ego_s_m: float
    ego_speed_mps: float
    ego_yaw_rate_radps: float
    vehicles: tuple[VehicleTruth, ...]
    category: ImageCategory
    is_production_detected: bool
    ego_eye_lx: Mapping[str, float]
    street: StreetMessage

    def to_line(self) -> bytes:
        """The frame as a line of `frames.jsonl` that can be read back.

        Raises:
            ValueError: If a number that must be finite is not, or a value does not fit its field.
        """
        line: bytes = adapter(FrameTruth).dump_json(self)
        parse_json(line, FrameTruth, f"image {self.image_id}")
        return line + b"\n"
