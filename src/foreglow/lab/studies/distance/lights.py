"""The labelled lights whose ranges are known, and the boxes around them: what ranges are measured on."""

from __future__ import annotations

import dataclasses
import functools
from collections import Counter
from dataclasses import dataclass

import numpy as np

from foreglow.datasets.simulated import SequenceTruth
from foreglow.geometry import Camera, Pose, rotation
from foreglow.lab.evaluation.boxes.matching import smallest_box
from foreglow.types import Boxes, Frame

NO_DEPTH, NO_BOX, DOUBTFUL = "without a depth", "in no box", "doubtful"
"""Reasons to leave a light out."""


@dataclass(frozen=True, slots=True)
class RangedLight:
    """A labelled light with a box and a known range.

    Attributes:
        image_id: The image.
        sequence_id: Its drive.
        instance_id: Identifies the light throughout the drive.
        is_direct: Whether it is the lamp itself.
        kind: What it is seen on.
        truth_m: Its range along the viewing ray.
        vehicle_range_m: From the camera to the vehicle that causes it.
        scenario: Name of the drive's scene.
        error_class: Of the street message's longitudinal error.
        box: Index, among the proposals of the image, of the smallest one that holds its keypoint.
        box_xyxy_px: That proposal.
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
    box: int
    box_xyxy_px: tuple[int, int, int, int]


def ranged_lights(
    image_id: int, truth: SequenceTruth, boxes_xyxy_px: Boxes, left_out: Counter[str]
) -> tuple[RangedLight, ...]:
    """The lights of an image with a range and one of its proposals; the others are counted in `left_out`.

    Raises:
        ValueError: If the image is none of the sequence.
    """
    known = truth.frame(image_id)
    lights = []
    for vehicle, artifact in ((seen, artifact) for seen in known.vehicles for artifact in seen.artifacts):
        box = smallest_box(artifact.position_px, boxes_xyxy_px)
        if artifact.is_doubtful:
            left_out[DOUBTFUL] += 1
        elif np.isnan(artifact.depth_m):
            left_out[NO_DEPTH] += 1
        elif box is None:
            left_out[NO_BOX] += 1
        else:
            lights.append(
                RangedLight(
                    image_id=image_id,
                    sequence_id=truth.sequence_id,
                    instance_id=artifact.instance_id,
                    is_direct=artifact.is_direct,
                    kind=artifact.kind,
                    truth_m=artifact.depth_m,
                    vehicle_range_m=vehicle.range_m,
                    scenario=truth.scenario,
                    error_class=known.street.error_class,
                    box=box,
                    box_xyxy_px=tuple(boxes_xyxy_px[box].tolist()),
                )
            )
    return tuple(lights)


def tilted(frame: Frame, pitch_rad: float) -> Frame:
    """`frame` with a calibration whose pitch is wrong by `pitch_rad`, upwards."""
    assert frame.camera is not None
    return dataclasses.replace(frame, camera=_tilted_camera(frame.camera, pitch_rad))


@functools.lru_cache(maxsize=64)  # the same camera for each frame: estimators remember what depends on it
def _tilted_camera(camera: Camera, pitch_rad: float) -> Camera:
    mount = camera.vehicle_from_camera
    claimed = Pose(mount.position_m, mount.rotation @ rotation(pitch_rad=pitch_rad))
    return dataclasses.replace(camera, vehicle_from_camera=claimed)
