"""The lights whose ranges are known: of simulated drives, or boxes drawn by hand in images with a LiDAR's depth."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from foreglow.config import PipelineConfig
from foreglow.datasets import FrameSource, open_labelled
from foreglow.datasets.images import read_image
from foreglow.datasets.json_files import Record, read_json_lines
from foreglow.datasets.pvdn import PVDN_RATE_HZ
from foreglow.datasets.simulated import SequenceTruth, has_truth, read_truth
from foreglow.datasets.simulated.files import decoded_depth_m
from foreglow.geometry import Floats
from foreglow.lab.evaluation.boxes.matching import smallest_box
from foreglow.pipeline import Pipeline
from foreglow.types import Boxes, Detections, Frame, Proposals

NO_DEPTH, NO_BOX, DOUBTFUL = "without a depth", "in no box", "doubtful"
"""Reasons to leave a light out."""


@dataclass(frozen=True, slots=True)
class RangedLight:
    """A labelled light with a box and a known range.

    Attributes:
        instance_id: Identifies the light throughout the drive.
        truth_m: From the camera to the light; measured by the LiDAR where nothing better is known.
        lidar_m: Median of the LiDAR's depths in the box, as in the paper; NaN without any.
        vehicle_range_m: From the camera to the vehicle that causes it; NaN where unknown.
        error_class: Of the street message's longitudinal error; -1 where unknown.
        box: Index of its box among those of the image.
        box_xyxy_px: Its box: of simulated light the smallest proposal that holds its keypoint.
    """

    image_id: int
    sequence_id: int
    instance_id: int
    is_direct: bool
    kind: str
    truth_m: float
    lidar_m: float
    vehicle_range_m: float
    scenario: str
    error_class: int
    box: int
    box_xyxy_px: tuple[int, int, int, int]


class Sample(NamedTuple):
    """An image: all its boxes, the number of its scene, those of its lights whose ranges are known, and the LiDAR's
    depth, shape (height, width), NaN where there is none; None without a scanner.
    """

    frame: Frame
    detections: Detections
    scene_id: int
    lights: tuple[RangedLight, ...]
    depth_m: Floats | None


def lidar_range_m(depth_m: Floats, box_xyxy_px: NDArray[np.integer]) -> float:
    """Median of the depths in a box; NaN without any.

    Source: Ewecker et al., arXiv 2107.11302, distance evaluation data.

    >>> lidar_range_m(np.array([[9.0, 40.0, np.nan, 44.0]]), np.array([1, 0, 4, 1]))
    42.0
    """
    x1, y1, x2, y2 = np.maximum(box_xyxy_px, 0).tolist()
    depths = depth_m[y1:y2, x1:x2]
    known = depths[~np.isnan(depths)]
    return float(np.median(known)) if len(known) else math.nan


class SimulatedLights:
    """The labelled lights of a simulated split; iterating yields every image.

    Attributes:
        left_out: Numbers of the other lights by reason, once all images have been yielded.
    """

    def __init__(self, folder: Path, config: PipelineConfig, sequence_id: int | None = None) -> None:
        """Opens a split.

        Args:
            folder: The split.
            config: Has the detector that finds the boxes.
            sequence_id: The only drive to take; None for all.

        Raises:
            FileNotFoundError: If a file of the data set is missing.
            ValueError: If one is broken, or the set has no ranges, calibration and road beside its labels.
        """
        self._dataset = open_labelled(folder)
        if not has_truth(self._dataset.root):
            raise ValueError(
                f"{self._dataset.root}: expected the range of each light, a calibration and the road ahead beside the "
                "labels, as simulated drives have them in simulation/; found none"
            )
        self._truth = read_truth(self._dataset.root)
        self._sequence_id = sequence_id
        self._detector = Pipeline(config.detector_only)
        self.name, self.rate_hz, self.num_images = self._dataset.name, self._dataset.mean_rate_hz, len(self._dataset)
        self.left_out: Counter[str] = Counter()

    def __iter__(self) -> Iterator[Sample]:
        """The images, drive by drive."""
        self._detector.reset()
        for sequence in self._dataset.sequences:
            if self._sequence_id not in (None, sequence.id):
                continue
            drive = self._truth.sequence(sequence.id)
            has_depth = (drive.root / "depth").is_dir()
            for image in drive.frames:
                frame = self._dataset.read(image.image_id)
                detections = self._detections(frame)
                depth_m = drive.depth_m(image.image_id) if has_depth else None
                boxes = detections.boxes_xyxy_px
                lights = ranged_lights(image.image_id, drive, boxes, self.left_out, depth_m)
                yield Sample(frame, detections, sequence.id, lights, depth_m)

    def _detections(self, frame: Frame) -> Detections:
        """All boxes of the frame, as the stage of distance gets them; without a model all with the score 1."""
        result = self._detector.step(frame)
        if result.detections is not None:
            return result.detections
        return _unscored(result.proposals)


class DrawnBox(Record):
    """A line of a file of boxes: light that somebody marked in an image.

    Attributes:
        scene: Number of the drive.
        frame: Number of the image, as in the results of a run on the same source.
        instance: Identifies the light throughout the drive.
        direct: Whether it is a lamp itself.
        box_xyxy_px: Half-open, whole pixels of the full image.
    """

    scene: Annotated[int, Field(ge=0)]
    frame: Annotated[int, Field(ge=0)]
    instance: Annotated[int, Field(ge=0)]
    direct: bool
    box_xyxy_px: Annotated[tuple[int, int, int, int], Field(strict=False)]


class LidarLights:
    """Boxes drawn by hand in images with a LiDAR's depth, as in the paper; iterating yields every image with a box.

    A depth image is a 16-bit PNG of the image's size, `NUMBER.png` with six digits, in metres along the viewing ray
    times 256; 0 where there is none.

    Attributes:
        left_out: Numbers of boxes without a depth, once all images have been yielded.
    """

    def __init__(self, frames: FrameSource, boxes: Path, depth: Path) -> None:
        """Takes images with a calibration, the file of boxes and the folder of depth images.

        Raises:
            FileNotFoundError: If the file or the folder is missing.
            ValueError: If a box is broken.
        """
        if not depth.is_dir():
            raise FileNotFoundError(f"{depth}: no such folder, expected depth images")
        self._frames, self._depth = frames, depth
        self._boxes: dict[int, list[DrawnBox]] = {}
        for origin, box in read_json_lines(boxes, DrawnBox):
            x1, y1, x2, y2 = box.box_xyxy_px
            if not (0 <= x1 < x2 and 0 <= y1 < y2):
                raise ValueError(
                    f"{origin}: box_xyxy_px: expected x1 < x2 and y1 < y2, none below 0, got {[x1, y1, x2, y2]}"
                )
            self._boxes.setdefault(box.frame, []).append(box)
        self.name, self.rate_hz, self.num_images = boxes.name, PVDN_RATE_HZ, len(self._boxes)
        self.left_out: Counter[str] = Counter()

    def __iter__(self) -> Iterator[Sample]:
        """The images with boxes, in the order of the source.

        Raises:
            FileNotFoundError: If a depth image is missing.
            ValueError: If it is no depth image of the frame's size, a box leaves the frame, an image has boxes of
                several scenes or no calibration, or an image with boxes is not in the source.
        """
        missing = set(self._boxes)
        for frame in self._frames:
            drawn = self._boxes.get(frame.frame)
            if drawn is None:
                continue
            if frame.camera is None:
                raise ValueError(f"{self.name}: frame {frame.frame}: expected a calibration of its camera, got none")
            missing.discard(frame.frame)
            corners = np.array([box.box_xyxy_px for box in drawn], np.int32)
            if (corners[:, 2:] > (frame.width_px, frame.height_px)).any():
                size = f"{frame.width_px}x{frame.height_px}"
                raise ValueError(f"{self.name}: frame {frame.frame}: box_xyxy_px: expected boxes inside {size} px")
            scenes = {box.scene for box in drawn}
            if len(scenes) > 1:
                raise ValueError(f"{self.name}: frame {frame.frame}: scene: expected one, got {sorted(scenes)}")
            depth_m = self._depth_m(frame)
            lights = []
            for index, box in enumerate(drawn):
                range_m = lidar_range_m(depth_m, corners[index])
                if math.isnan(range_m):
                    self.left_out[NO_DEPTH] += 1
                    continue
                lights.append(
                    RangedLight(
                        image_id=frame.frame,
                        sequence_id=box.scene,
                        instance_id=box.instance,
                        is_direct=box.direct,
                        kind="direct" if box.direct else "indirect",
                        truth_m=range_m,
                        lidar_m=range_m,
                        vehicle_range_m=math.nan,
                        scenario="",
                        error_class=-1,
                        box=index,
                        box_xyxy_px=box.box_xyxy_px,
                    )
                )
            yield Sample(frame, _unscored(Proposals(corners)), drawn[0].scene, tuple(lights), depth_m)
        if missing:
            raise ValueError(f"{self.name}: frame: expected images of the source, it has no {min(missing)}")

    def _depth_m(self, frame: Frame) -> Floats:
        path = self._depth / f"{frame.frame:06d}.png"
        stored = read_image(path)
        if stored.dtype != np.uint16 or stored.shape != (frame.height_px, frame.width_px):
            raise ValueError(
                f"{path}: expected 16 bits and {frame.width_px}x{frame.height_px} px as its image has, "
                f"got {stored.dtype.itemsize * 8} bits and {stored.shape[1]}x{stored.shape[0]} px"
            )
        return decoded_depth_m(stored.astype(np.uint16, copy=False))


def _unscored(proposals: Proposals) -> Detections:
    return Detections(proposals, np.ones(len(proposals), np.float32), score_threshold=0.5)


def ranged_lights(
    image_id: int, truth: SequenceTruth, boxes_xyxy_px: Boxes, left_out: Counter[str], depth_m: Floats | None = None
) -> tuple[RangedLight, ...]:
    """The lights of an image with a range and one of its proposals; the others are counted in `left_out`.

    Args:
        image_id: The image.
        truth: Of its sequence.
        boxes_xyxy_px: Its proposals.
        left_out: Numbers of lights by reason, added to.
        depth_m: Its LiDAR-like depth, shape (height, width), NaN where there is none; None for no scanner.

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
                    lidar_m=math.nan if depth_m is None else lidar_range_m(depth_m, boxes_xyxy_px[box]),
                    vehicle_range_m=vehicle.range_m,
                    scenario=truth.scenario,
                    error_class=known.street.error_class,
                    box=box,
                    box_xyxy_px=tuple(boxes_xyxy_px[box].tolist()),
                )
            )
    return tuple(lights)
