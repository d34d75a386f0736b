"""The lights whose ranges are known, the boxes that hold them, and what the car knew: what ranges are measured on."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from foreglow.evaluation.matching import lies_in
from foreglow.geometry import Camera, Pose, rotation
from foreglow.proposals import Proposer
from foreglow.simulation.recording.truth_files import SequenceTruth
from foreglow.simulation.truth import Artifact, VehicleTruth
from foreglow.street import road_from_message
from foreglow.types import Boxes, Detections, EgoMotion, Frame, Proposals, RoadAhead

NO_DEPTH, NO_BOX, DOUBTFUL = "without a depth", "in no box", "doubtful"
"""Why a light is left out."""


class KnownVehicle:
    """What the car knew in a simulated drive, as `foreglow.datasets.vehicle_data` asks for it."""

    def __init__(self, truth: SequenceTruth) -> None:
        self._truth = truth

    def camera(self, frame: Frame) -> Camera | None:  # noqa: ARG002
        """The drive's calibration."""
        return self._truth.camera

    def motion(self, frame: Frame) -> EgoMotion | None:
        """Speed and yaw rate; no sensor tells the pitch."""
        known = self._truth.frame(frame.frame)
        return EgoMotion(known.ego_speed_mps, known.ego_yaw_rate_radps)

    def road(self, frame: Frame) -> RoadAhead | None:
        """The road of the street message, with its errors."""
        return road_from_message(self._truth.frame(frame.frame).street)


@dataclass(frozen=True, slots=True)
class RangedLight:
    """A labelled light with a box and a known range.

    Attributes:
        image_id: The image.
        sequence_id: Its drive.
        instance_id: The same through the drive.
        is_direct: Whether it is the lamp itself.
        kind: What it is seen on.
        truth_m: Its range along the viewing ray.
        vehicle_range_m: From the camera to the vehicle that causes it.
        scenario: Name of the drive's scene.
        error_class: Of the street message's longitudinal error.
        box_xyxy_px: The smallest proposal that holds its keypoint.
    """

    image_id: int
    sequence_id: int
    instance_id: int
    is_direct: bool
    kind: str
    truth_m: float
    vehicle_range_m: float
    scenario: str
    error_class: int
    box_xyxy_px: tuple[int, int, int, int]


def ranged_lights(
    frame: Frame, truth: SequenceTruth, proposer: Proposer, left_out: Counter[str]
) -> tuple[RangedLight, ...]:
    """The lights of an image with a range and a box; the others are counted in `left_out`.

    Raises:
        ValueError: If the image is none of the sequence.
    """
    known = truth.frame(frame.frame)
    boxes = proposer.propose(frame.image).boxes_xyxy_px
    lights = []
    for vehicle, artifact in _artifacts(known.vehicles):
        box = smallest_box(artifact.position_px, boxes)
        if artifact.is_doubtful:
            left_out[DOUBTFUL] += 1
        elif np.isnan(artifact.depth_m):
            left_out[NO_DEPTH] += 1
        elif box is None:
            left_out[NO_BOX] += 1
        else:
            lights.append(
                RangedLight(
                    image_id=frame.frame,
                    sequence_id=truth.sequence_id,
                    instance_id=artifact.instance_id,
                    is_direct=artifact.is_direct,
                    kind=artifact.kind,
                    truth_m=artifact.depth_m,
                    vehicle_range_m=vehicle.range_m,
                    scenario=truth.scene.name,
                    error_class=known.street.error_class,
                    box_xyxy_px=box,
                )
            )
    return tuple(lights)


def smallest_box(position_px: tuple[float, float], boxes_xyxy_px: Boxes) -> tuple[int, int, int, int] | None:
    """The smallest of the boxes that hold the point, the first one of equals; None if none does.

    >>> smallest_box((5.0, 5.0), np.array([[0, 0, 9, 9], [4, 4, 6, 6]], np.int32))
    (4, 4, 6, 6)
    """
    holding = boxes_xyxy_px[lies_in(np.array(position_px), boxes_xyxy_px)]
    if not len(holding):
        return None
    sizes_px = holding[:, 2:] - holding[:, :2]
    x1, y1, x2, y2 = holding[sizes_px.prod(axis=1).argmin()].tolist()
    return x1, y1, x2, y2


def detections_of(lights: tuple[RangedLight, ...]) -> Detections:
    """Their boxes as accepted detections, one a light, in the same order."""
    boxes = np.array([light.box_xyxy_px for light in lights], np.int32).reshape(-1, 4)
    return Detections(Proposals(boxes), np.ones(len(lights), np.float32), 0.5)


def tilted(frame: Frame, pitch_rad: float) -> Frame:
    """`frame` with a calibration that claims the camera to look up by `pitch_rad` more than it does."""
    camera = frame.camera
    assert camera is not None
    mount = camera.vehicle_from_camera
    claimed = Pose(mount.position_m, mount.rotation @ rotation(pitch_rad=pitch_rad))
    return dataclasses.replace(frame, camera=dataclasses.replace(camera, vehicle_from_camera=claimed))


def _artifacts(vehicles: tuple[VehicleTruth, ...]) -> Iterator[tuple[VehicleTruth, Artifact]]:
    for vehicle in vehicles:
        for artifact in vehicle.artifacts:
            yield vehicle, artifact
