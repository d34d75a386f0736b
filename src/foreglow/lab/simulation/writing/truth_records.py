"""How the truth of a frame lies in a file: one strict JSON object, and the way from `DriveFrame` to it and back.

Numbers are exact, NaN is null. Rotations are rows of a matrix world_from_vehicle.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, TypeAlias

import numpy as np
from pydantic import AfterValidator, Field

from foreglow.config import FrozenModel
from foreglow.datasets.pvdn_schema import Id, ImageCategory
from foreglow.geometry import Floats, Pose
from foreglow.lab.simulation.truth import Artifact, DriveFrame, LampTruth, VehicleTruth
from foreglow.lab.simulation.world.materials import KINDS, Kind
from foreglow.street import StreetMessage


@dataclass(frozen=True, slots=True, eq=False)
class FrameTruth:
    """What the simulator knows of one image: a `DriveFrame` without its pixels.

    Attributes:
        image_id: The image's number in the data set.
        timestamp_ns: Time of exposure, zero at the start of the drive.
        ego_pose: world_from_vehicle, with the body's motion.
        ego_s_m: Arc length of our rear axle along the main road.
        ego_speed_mps: Our speed.
        ego_yaw_rate_radps: Our rate of turn to the left.
        vehicles: The other vehicles.
        category: PVDN's category of the image.
        is_production_detected: Whether the modelled production system reports a vehicle.
        ego_eye_lx: Illuminance at our driver's eye, by vehicle id.
        street: What the car is told about the road ahead.
    """

    image_id: int
    timestamp_ns: int
    ego_pose: Pose
    ego_s_m: float
    ego_speed_mps: float
    ego_yaw_rate_radps: float
    vehicles: tuple[VehicleTruth, ...]
    category: ImageCategory
    is_production_detected: bool
    ego_eye_lx: Mapping[str, float]
    street: StreetMessage

    @classmethod
    def of(cls, image_id: int, known: DriveFrame, street: StreetMessage) -> FrameTruth:
        """What is kept of `known` as image `image_id`."""
        return cls(
            image_id=image_id,
            timestamp_ns=known.frame.timestamp_ns,
            ego_pose=known.ego_pose,
            ego_s_m=known.ego_s_m,
            ego_speed_mps=known.ego_speed_mps,
            ego_yaw_rate_radps=known.ego_yaw_rate_radps,
            vehicles=known.vehicles,
            category=known.category,
            is_production_detected=known.is_production_detected,
            ego_eye_lx=known.ego_eye_lx,
            street=street,
        )


_Vector: TypeAlias = tuple[float, float, float]
_Pixel: TypeAlias = tuple[float, float]
_Maybe: TypeAlias = float | None
"""A number, or null for NaN."""


def _known_kind(name: str) -> str:
    if name not in KINDS:
        raise ValueError(f"expected one of {', '.join(KINDS)}")
    return name


_Kind: TypeAlias = Annotated[str, AfterValidator(_known_kind)]

_Candidate: TypeAlias = tuple[int, float, float, _Kind, bool, bool, bool, _Maybe, float, float, int, str]
"""An artifact's fields in the order of `_ArtifactRecord`, without names: there are many of them."""


class _PoseRecord(FrozenModel):
    position_m: _Vector
    rotation: tuple[_Vector, _Vector, _Vector]

    @classmethod
    def of(cls, pose: Pose) -> _PoseRecord:
        first, second, third = (_vector(row) for row in pose.rotation)
        return cls(position_m=_vector(pose.position_m), rotation=(first, second, third))

    def pose(self) -> Pose:
        return Pose(np.array(self.position_m), np.array(self.rotation))


class _ArtifactRecord(FrozenModel):
    instance_id: int
    position_px: _Pixel
    kind: _Kind
    is_direct: bool
    is_rear: bool
    is_doubtful: bool
    depth_m: _Maybe
    grey: float
    contrast: float
    area_px: int
    lamp: str

    @classmethod
    def of(cls, artifact: Artifact) -> _ArtifactRecord:
        return cls(
            instance_id=int(artifact.instance_id),
            position_px=_pixel(artifact.position_px),
            kind=artifact.kind,
            is_direct=bool(artifact.is_direct),
            is_rear=bool(artifact.is_rear),
            is_doubtful=bool(artifact.is_doubtful),
            depth_m=_maybe(artifact.depth_m),
            grey=float(artifact.grey),
            contrast=float(artifact.contrast),
            area_px=int(artifact.area_px),
            lamp=artifact.lamp,
        )

    @classmethod
    def of_candidate(cls, row: _Candidate) -> _ArtifactRecord:
        number, x, y, *others = row
        fields = dict(zip(cls.model_fields, (number, (x, y), *others), strict=True))
        return cls.model_validate(fields)

    def candidate(self) -> _Candidate:
        return (
            *(self.instance_id, *self.position_px, self.kind, self.is_direct, self.is_rear, self.is_doubtful),
            *(self.depth_m, self.grey, self.contrast, self.area_px, self.lamp),
        )

    def artifact(self) -> Artifact:
        kind: Kind = KINDS[KINDS.index(self.kind)]
        return Artifact(
            instance_id=self.instance_id,
            position_px=self.position_px,
            kind=kind,
            is_direct=self.is_direct,
            is_rear=self.is_rear,
            is_doubtful=self.is_doubtful,
            depth_m=_number(self.depth_m),
            grey=self.grey,
            contrast=self.contrast,
            area_px=self.area_px,
            lamp=self.lamp,
        )


class _LampRecord(FrozenModel):
    name: str
    is_rear: bool
    position_world_m: _Vector
    position_px: _Pixel | None
    radius_m: float
    intensity_cd: float
    visible_share: float

    @classmethod
    def of(cls, lamp: LampTruth) -> _LampRecord:
        return cls(
            name=lamp.name,
            is_rear=bool(lamp.is_rear),
            position_world_m=_vector(lamp.position_world_m),
            position_px=None if np.isnan(lamp.position_px).any() else _pixel(lamp.position_px),
            radius_m=float(lamp.radius_m),
            intensity_cd=float(lamp.intensity_cd),
            visible_share=float(lamp.visible_share),
        )

    def lamp(self) -> LampTruth:
        return LampTruth(
            name=self.name,
            is_rear=self.is_rear,
            position_world_m=np.array(self.position_world_m),
            position_px=self.position_px or (math.nan, math.nan),
            radius_m=self.radius_m,
            intensity_cd=self.intensity_cd,
            visible_share=self.visible_share,
        )


class _VehicleRecord(FrozenModel):
    vehicle_id: int
    kind: str
    pose: _PoseRecord
    speed_mps: float
    size_m: _Vector
    box_centre_m: _Vector
    box_xyxy_px: tuple[int, int, int, int] | None
    visible_share: float
    range_m: float
    lamps: tuple[_LampRecord, ...]
    artifacts: tuple[_ArtifactRecord, ...]
    candidates: tuple[_Candidate, ...]
    eye_world_m: _Vector
    eye_lx: dict[str, float]

    @classmethod
    def of(cls, vehicle: VehicleTruth) -> _VehicleRecord:
        box = vehicle.box_xyxy_px
        return cls(
            vehicle_id=vehicle.vehicle_id,
            kind=vehicle.kind,
            pose=_PoseRecord.of(vehicle.pose),
            speed_mps=float(vehicle.speed_mps),
            size_m=_vector(vehicle.size_m),
            box_centre_m=_vector(vehicle.box_centre_m),
            box_xyxy_px=None if box is None else (int(box[0]), int(box[1]), int(box[2]), int(box[3])),
            visible_share=float(vehicle.visible_share),
            range_m=float(vehicle.range_m),
            lamps=tuple(_LampRecord.of(lamp) for lamp in vehicle.lamps),
            artifacts=tuple(_ArtifactRecord.of(artifact) for artifact in vehicle.artifacts),
            candidates=tuple(_ArtifactRecord.of(artifact).candidate() for artifact in vehicle.candidates),
            eye_world_m=_vector(vehicle.eye_world_m),
            eye_lx=_illuminances(vehicle.eye_lx),
        )

    def vehicle(self) -> VehicleTruth:
        return VehicleTruth(
            vehicle_id=self.vehicle_id,
            kind=self.kind,
            pose=self.pose.pose(),
            speed_mps=self.speed_mps,
            size_m=self.size_m,
            box_centre_m=np.array(self.box_centre_m),
            box_xyxy_px=self.box_xyxy_px,
            visible_share=self.visible_share,
            range_m=self.range_m,
            lamps=tuple(record.lamp() for record in self.lamps),
            artifacts=tuple(record.artifact() for record in self.artifacts),
            candidates=tuple(_ArtifactRecord.of_candidate(row).artifact() for row in self.candidates),
            eye_world_m=np.array(self.eye_world_m),
            eye_lx=self.eye_lx,
        )


class FrameRecord(FrozenModel):
    """A line of `frames.jsonl`: the fields of `FrameTruth`, and those of the classes in it."""

    image_id: Id
    timestamp_ns: int
    ego_pose: _PoseRecord
    ego_s_m: float
    ego_speed_mps: float
    ego_yaw_rate_radps: float
    vehicles: tuple[_VehicleRecord, ...]
    category: Annotated[ImageCategory, Field(strict=False)]
    is_production_detected: bool
    ego_eye_lx: dict[str, float]
    street: StreetMessage

    @classmethod
    def of(cls, frame: FrameTruth) -> FrameRecord:
        """The record of `frame`.

        Raises:
            ValueError: If a number that must be finite is not.
        """
        return cls(
            image_id=frame.image_id,
            timestamp_ns=frame.timestamp_ns,
            ego_pose=_PoseRecord.of(frame.ego_pose),
            ego_s_m=float(frame.ego_s_m),
            ego_speed_mps=float(frame.ego_speed_mps),
            ego_yaw_rate_radps=float(frame.ego_yaw_rate_radps),
            vehicles=tuple(_VehicleRecord.of(vehicle) for vehicle in frame.vehicles),
            category=frame.category,
            is_production_detected=bool(frame.is_production_detected),
            ego_eye_lx=_illuminances(frame.ego_eye_lx),
            street=frame.street,
        )

    def frame(self) -> FrameTruth:
        """The frame of the record."""
        return FrameTruth(
            image_id=self.image_id,
            timestamp_ns=self.timestamp_ns,
            ego_pose=self.ego_pose.pose(),
            ego_s_m=self.ego_s_m,
            ego_speed_mps=self.ego_speed_mps,
            ego_yaw_rate_radps=self.ego_yaw_rate_radps,
            vehicles=tuple(record.vehicle() for record in self.vehicles),
            category=self.category,
            is_production_detected=self.is_production_detected,
            ego_eye_lx=self.ego_eye_lx,
            street=self.street,
        )


def _vector(values: Sequence[float] | Floats) -> _Vector:
    x, y, z = values
    return float(x), float(y), float(z)


def _pixel(values: tuple[float, float]) -> _Pixel:
    return float(values[0]), float(values[1])


def _maybe(value: float) -> _Maybe:
    return None if math.isnan(value) else float(value)


def _number(value: _Maybe) -> float:
    return math.nan if value is None else value


def _illuminances(values: Mapping[str, float]) -> dict[str, float]:
    return {str(source): float(lux) for source, lux in values.items()}
