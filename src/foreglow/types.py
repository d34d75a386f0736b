"""The values that flow: Frame -> Proposals -> Detections -> Ranges -> Tracks -> BeamCommand, and the FrameResult that
keeps them.

Every type is frozen and checked once, when it is made. Arrays are plural, boxes are half-open
`xyxy` in full-frame pixels (x = column to the right, y = row downwards), and no array may be written to afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Camera

Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]
"""A grey image, shape (height, width), uint8 or uint16, linear index (row, column)."""

Boxes: TypeAlias = NDArray[np.int32]
"""Boxes, shape (N, 4), int32, columns x1, y1, x2, y2 in full-frame pixels, half-open."""


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    """A read-only view of `array`; the owner's own flag stays as it is."""
    view = array.view()
    view.flags.writeable = False
    return view


@dataclass(frozen=True, slots=True, eq=False)
class EgoMotion:
    """How our vehicle moves at the time of an image.

    Attributes:
        speed_mps: Forward speed.
        yaw_rate_radps: Rate of turn to the left.
        pitch_rad: How far the body's nose is up against the road under it, beyond its rest; NaN where no sensor tells.

    Raises:
        ValueError: If speed or yaw rate is not finite, or the pitch is infinite.
    """

    speed_mps: float
    yaw_rate_radps: float
    pitch_rad: float = math.nan

    def __post_init__(self) -> None:
        for name in ("speed_mps", "yaw_rate_radps"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"EgoMotion.{name}: expected a finite number, got {getattr(self, name)}")
        if math.isinf(self.pitch_rad):
            raise ValueError(f"EgoMotion.pitch_rad: expected a finite number or NaN, got {self.pitch_rad}")


@dataclass(frozen=True, slots=True, eq=False)
class RoadAhead:
    """The road in front of us as a map or a street message has it: a ribbon around the carriageway's centre line.

    It is written in the frame of the vehicle as the map believes it to stand: on the road, and along it.

    Attributes:
        points_m: Shape (N, 3), N >= 2, the centre line in the vehicle's frame, metres, in the order of driving and
            no two neighbours alike; it may end anywhere, and says nothing of what lies beyond.
        half_width_m: From the centre line to either edge.
        cross_slopes: Shape (N,), rise for each metre to the left, no unit; an empty array, where the map has none,
            becomes zeros.
        error_bound_m: How far along the road the believed position may be off; infinite where unknown.

    Raises:
        ValueError: If a shape is wrong, a number is not finite (the bound: NaN or negative), or two neighbouring
            points are the same.
    """

    points_m: NDArray[np.float64]
    half_width_m: float
    cross_slopes: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    error_bound_m: float = math.inf

    def __post_init__(self) -> None:
        points = np.array(self.points_m, np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2:
            raise ValueError(f"RoadAhead.points_m: expected shape (N, 3) with N >= 2, got {points.shape}")
        if not np.isfinite(points).all():
            raise ValueError("RoadAhead.points_m: expected finite numbers, got NaN or infinity")
        is_same = ~np.diff(points, axis=0).any(axis=1)
        if is_same.any():
            raise ValueError(
                f"RoadAhead.points_m: expected neighbours that differ, points {int(np.flatnonzero(is_same)[0])} and "
                "the next are the same"
            )
        if not (math.isfinite(self.half_width_m) and self.half_width_m > 0):
            raise ValueError(f"RoadAhead.half_width_m: expected a positive number, got {self.half_width_m}")
        if not self.error_bound_m >= 0:
            raise ValueError(f"RoadAhead.error_bound_m: expected a number of at least 0, got {self.error_bound_m}")
        slopes = np.array(self.cross_slopes, np.float64) if np.size(self.cross_slopes) else np.zeros(len(points))
        if slopes.shape != (len(points),) or not np.isfinite(slopes).all():
            raise ValueError(f"RoadAhead.cross_slopes: expected {len(points)} finite numbers, got {slopes.shape}")
        object.__setattr__(self, "points_m", _frozen(points))
        object.__setattr__(self, "cross_slopes", _frozen(slopes))

    def __len__(self) -> int:
        return len(self.points_m)


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One grey camera image, when it was taken, and what the car knew at that time.

    Attributes:
        image: Shape (height, width), uint8 or uint16, at least 1x1; any strides.
        timestamp_ns: Time of exposure in nanoseconds; the zero is the source's own.
        frame: Number that identifies the image in its source (PVDN: the image id; else its index from 0).
        sequence: Name of the sequence, empty where the source has none.
        path: Where the image came from, for messages; empty for an array in memory.
        camera: Calibration of an image of this size; None where unknown: then nothing has a range.
        motion: How our vehicle moves; None where unknown.
        road: The road ahead by a map or a street message; None where there is none.

    Raises:
        ValueError: If the image is not two-dimensional, is empty, or is neither uint8 nor uint16, or the camera is for
            images of another size.
    """

    image: Image
    timestamp_ns: int
    frame: int = 0
    sequence: str = ""
    path: str = ""
    camera: Camera | None = None
    motion: EgoMotion | None = None
    road: RoadAhead | None = None

    def __post_init__(self) -> None:
        origin = f"{self.path}: " if self.path else ""
        if not isinstance(self.image, np.ndarray) or self.image.ndim != 2:
            shape = getattr(self.image, "shape", type(self.image).__name__)
            raise ValueError(f"{origin}Frame.image: expected a grey array of shape (height, width), got {shape}")
        if self.image.dtype not in (np.uint8, np.uint16):
            raise ValueError(f"{origin}Frame.image: expected uint8 or uint16, got {self.image.dtype}")
        if self.image.size == 0:
            raise ValueError(f"{origin}Frame.image: expected at least one pixel, got shape {self.image.shape}")
        if self.camera is not None and (self.camera.height_px, self.camera.width_px) != self.image.shape:
            raise ValueError(
                f"{origin}Frame.camera: expected a calibration for images of {self.image.shape[1]}x"
                f"{self.image.shape[0]} px, got one for {self.camera.width_px}x{self.camera.height_px} px"
            )
        object.__setattr__(self, "image", _frozen(self.image))

    @property
    def width_px(self) -> int:
        """Number of columns."""
        return int(self.image.shape[1])

    @property
    def height_px(self) -> int:
        """Number of rows."""
        return int(self.image.shape[0])


@dataclass(frozen=True, slots=True, eq=False)
class Proposals:
    """Boxes that may hold a light artifact, sorted by y1, x1, y2, x2.

    Attributes:
        boxes_xyxy_px: Shape (N, 4), int32, half-open, full-frame pixels; N = 0 means that nothing stands out.

    Raises:
        ValueError: If the shape, the dtype or a box's order of corners is wrong.
    """

    boxes_xyxy_px: Boxes

    def __post_init__(self) -> None:
        boxes = self.boxes_xyxy_px
        if boxes.ndim != 2 or boxes.shape[1] != 4:
            raise ValueError(f"Proposals.boxes_xyxy_px: expected shape (N, 4), got {boxes.shape}")
        if boxes.dtype != np.int32:
            raise ValueError(f"Proposals.boxes_xyxy_px: expected int32, got {boxes.dtype}")
        is_ordered = boxes[:, :2] < boxes[:, 2:]
        if not np.logical_and.reduce(is_ordered, axis=None):
            bad = int(np.flatnonzero(~is_ordered.all(axis=1))[0])
            raise ValueError(
                f"Proposals.boxes_xyxy_px: box {bad} is {boxes[bad].tolist()}, expected x1 < x2 and y1 < y2"
            )
        object.__setattr__(self, "boxes_xyxy_px", _frozen(boxes))

    def __len__(self) -> int:
        return len(self.boxes_xyxy_px)


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """All proposals of a frame with their scores.

    Attributes:
        proposals: The proposals that were scored.
        scores: Shape (N,), float32 in [0, 1], one for each proposal: how sure the classifier is of a light artifact.
        score_threshold: A proposal is accepted when its score is above this.
        direct_probabilities: Shape (N,), float32 in [0, 1]: how sure the classifier is that it is the lamp itself, if
            it is light at all, before anything is known of how often either is seen; NaN where the model does not
            say. An empty array becomes NaNs.

    Raises:
        ValueError: If an array's shape or dtype is wrong, or a score is outside [0, 1] or NaN.
    """

    proposals: Proposals
    scores: NDArray[np.float32]
    score_threshold: float
    direct_probabilities: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))

    def __post_init__(self) -> None:
        scores, count = self.scores, len(self.proposals)
        if scores.shape != (count,) or scores.dtype != np.float32:
            raise ValueError(
                f"Detections.scores: expected float32 of shape ({count},), got {scores.dtype} of shape {scores.shape}"
            )
        if count and not (np.minimum.reduce(scores) >= 0.0 and np.maximum.reduce(scores) <= 1.0):
            raise ValueError("Detections.scores: expected values in [0, 1], got NaN or a value outside")
        direct = self.direct_probabilities
        if not len(direct):
            direct = np.full(count, np.nan, np.float32)
        if direct.shape != (count,) or direct.dtype != np.float32:
            raise ValueError(
                f"Detections.direct_probabilities: expected float32 of shape ({count},), got {direct.dtype} of shape "
                f"{direct.shape}"
            )
        object.__setattr__(self, "scores", _frozen(scores))
        object.__setattr__(self, "direct_probabilities", _frozen(direct))

    def __len__(self) -> int:
        return len(self.proposals)

    @property
    def boxes_xyxy_px(self) -> Boxes:
        """All scored boxes, shape (N, 4), int32, half-open, full-frame pixels."""
        return self.proposals.boxes_xyxy_px

    @property
    def is_accepted(self) -> NDArray[np.bool_]:
        """Shape (N,): which boxes are light artifacts; compared in double precision, as when files are evaluated."""
        return np.asarray(self.scores.astype(np.float64) > self.score_threshold)

    @property
    def accepted_boxes_xyxy_px(self) -> Boxes:
        """The accepted boxes, shape (M, 4), int32, half-open, full-frame pixels."""
        return self.boxes_xyxy_px[self.is_accepted]


@dataclass(frozen=True, slots=True, eq=False)
class Ranges:
    """How far away the light in each box is: from the camera along the viewing ray, to what shines or is lit.

    Attributes:
        detections: The boxes.
        ranges_m: Shape (N,), float64, positive; NaN where nothing is known.
        sigmas_m: Shape (N,), float64, standard deviation, positive; infinite where the range is NaN, or an estimator
            cannot tell how good it is.

    Raises:
        ValueError: If a shape or a dtype is wrong, a range is not positive, or a range that is NaN has a finite sigma.
    """

    detections: Detections
    ranges_m: NDArray[np.float64]
    sigmas_m: NDArray[np.float64]

    def __post_init__(self) -> None:
        count = len(self.detections)
        for name in ("ranges_m", "sigmas_m"):
            array = getattr(self, name)
            if array.shape != (count,) or array.dtype != np.float64:
                raise ValueError(
                    f"Ranges.{name}: expected float64 of shape ({count},), got {array.dtype} of shape {array.shape}"
                )
        is_unknown = np.isnan(self.ranges_m)
        if (self.ranges_m <= 0).any() or np.isinf(self.ranges_m).any():
            raise ValueError("Ranges.ranges_m: expected positive numbers or NaN, got zero, a negative or infinity")
        if not (self.sigmas_m > 0).all() or np.isfinite(self.sigmas_m[is_unknown]).any():
            raise ValueError("Ranges.sigmas_m: expected positive numbers, and infinity beside a range that is NaN")
        for name in ("ranges_m", "sigmas_m"):
            object.__setattr__(self, name, _frozen(getattr(self, name)))

    def __len__(self) -> int:
        return len(self.detections)


class TrackState(IntEnum):
    """Where a track is in its life."""

    TENTATIVE = 0
    """Not yet plausible: not to be acted on."""
    CONFIRMED = 1
    """Plausible, and detected in this frame."""
    COASTING = 2
    """Plausible, but not detected in this frame: predicted."""


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """The light artifacts that are followed over time, in the order of their ids.

    Attributes:
        ids: Shape (M,), int64, unique since the last reset, ascending; never given twice.
        states: Shape (M,), int64, a `TrackState` each.
        boxes_xyxy_px: Shape (M, 4), float64, filtered, half-open, full-frame pixels, x1 < x2 and y1 < y2.
        confidences: Shape (M,), float64 in [0, 1], the filtered score.
        num_hits: Shape (M,), int64, detections that the track has taken so far, at least 1.
        num_misses: Shape (M,), int64, frames in a row without one, up to this frame.
        ages_s: Shape (M,), float64, time since its first detection.
        ranges_m: Shape (M,), float64, filtered, from the camera along the viewing ray; NaN where unknown.
        sigmas_m: Shape (M,), float64, standard deviation of the range; infinite where unknown.
        detections: Shape (M,), int64, place of the box in this frame's `Detections`; -1 without one.
        direct_probabilities: Shape (M,), float64 in [0, 1], filtered: that it is a lamp itself and not its light on
            something; NaN where unknown. An empty array becomes NaNs.

    Raises:
        ValueError: If a shape or a dtype is wrong, ids do not ascend, or a box is not in order or not finite.
    """

    ids: NDArray[np.int64]
    states: NDArray[np.int64]
    boxes_xyxy_px: NDArray[np.float64]
    confidences: NDArray[np.float64]
    num_hits: NDArray[np.int64]
    num_misses: NDArray[np.int64]
    ages_s: NDArray[np.float64]
    ranges_m: NDArray[np.float64]
    sigmas_m: NDArray[np.float64]
    detections: NDArray[np.int64]
    direct_probabilities: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        count = len(self.ids)
        if not len(self.direct_probabilities):
            object.__setattr__(self, "direct_probabilities", np.full(count, np.nan))
        for name, dtype in _TRACK_DTYPES.items():
            array = getattr(self, name)
            shape = (count, 4) if name == "boxes_xyxy_px" else (count,)
            if array.shape != shape or array.dtype != dtype:
                raise ValueError(
                    f"Tracks.{name}: expected {np.dtype(dtype).name} of shape {shape}, got {array.dtype} of shape "
                    f"{array.shape}"
                )
            object.__setattr__(self, name, _frozen(array))
        boxes = self.boxes_xyxy_px
        if not (self.ids[1:] > self.ids[:-1]).all():
            raise ValueError(f"Tracks.ids: expected ascending numbers, got {self.ids.tolist()}")
        if not (np.isfinite(boxes).all() and (boxes[:, :2] < boxes[:, 2:]).all()):
            raise ValueError("Tracks.boxes_xyxy_px: expected finite boxes with x1 < x2 and y1 < y2")

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def is_plausible(self) -> NDArray[np.bool_]:
        """Shape (M,): which tracks may be acted on, confirmed or coasting."""
        return np.asarray(self.states != TrackState.TENTATIVE)


_TRACK_DTYPES: Mapping[str, type[np.generic]] = MappingProxyType(
    {
        "ids": np.int64,
        "states": np.int64,
        "boxes_xyxy_px": np.float64,
        "confidences": np.float64,
        "num_hits": np.int64,
        "num_misses": np.int64,
        "ages_s": np.float64,
        "ranges_m": np.float64,
        "sigmas_m": np.float64,
        "detections": np.int64,
        "direct_probabilities": np.float64,
    }
)


class BeamMode(IntEnum):
    """What our headlamps shine."""

    LOW = 0
    """Low beam alone: all LEDs above it are off."""
    GLARE_FREE = 1
    """High beam with dark gaps."""
    FULL = 2
    """High beam without any."""


@dataclass(frozen=True, slots=True, eq=False)
class BeamCommand:
    """What our matrix headlamps shall shine.

    Attributes:
        timestamp_ns: Time of exposure of the frame that it follows from, nanoseconds.
        mode: A `BeamMode`; with LOW all levels are 0 and there are no gaps.
        levels: Shape (2, L), float64 in [0, 1], left and right lamp, one for each LED above the low beam; as the lamp
            description numbers them.
        gaps_rad: Shape (G, 2), float64, right and left border of each dark gap: azimuth to the left in the vehicle's
            frame, right < left, from right to left and apart.
        gap_ranges_m: Shape (G,), float64, from the vehicle's origin to what each gap is for; NaN where unknown.
        faults: Why there is low beam although high beam was wanted; names of faults, empty without any.

    Raises:
        ValueError: If a shape or a dtype is wrong, a level is outside [0, 1] or NaN, gaps are not in order, or LOW has
            light above the low beam.
    """

    timestamp_ns: int
    mode: BeamMode
    levels: NDArray[np.float64]
    gaps_rad: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    gap_ranges_m: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    faults: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        levels, gaps, ranges_m = self.levels, self.gaps_rad, self.gap_ranges_m
        if levels.ndim != 2 or levels.shape[0] != 2 or levels.shape[1] == 0 or levels.dtype != np.float64:
            raise ValueError(
                f"BeamCommand.levels: expected float64 of shape (2, L), got {levels.dtype} of shape {levels.shape}"
            )
        if not (np.minimum.reduce(levels, axis=None) >= 0.0 and np.maximum.reduce(levels, axis=None) <= 1.0):
            raise ValueError("BeamCommand.levels: expected values in [0, 1], got NaN or a value outside")
        if gaps.ndim != 2 or gaps.shape[1] != 2 or ranges_m.shape != (len(gaps),):
            raise ValueError(
                f"BeamCommand.gaps_rad: expected shape (G, 2) and G ranges, got {gaps.shape} and {ranges_m.shape}"
            )
        if not (np.diff(gaps.ravel()) > 0).all() or not np.isfinite(gaps).all():
            raise ValueError(f"BeamCommand.gaps_rad: expected borders in order and apart, got {gaps.tolist()}")
        if self.mode == BeamMode.LOW and (len(gaps) or levels.any()):
            raise ValueError("BeamCommand.levels: expected 0 everywhere, and no gaps, with low beam")
        for name in ("levels", "gaps_rad", "gap_ranges_m"):
            object.__setattr__(self, name, _frozen(getattr(self, name)))

    @classmethod
    def low(cls, timestamp_ns: int, num_leds: int, *faults: str) -> BeamCommand:
        """Low beam, and why."""
        return cls(timestamp_ns, BeamMode.LOW, np.zeros((2, num_leds)), faults=faults)


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    """What the pipeline made of one frame.

    Attributes:
        frame: The frame's number in its source, as in `Frame.frame`.
        timestamp_ns: The frame's time of exposure in nanoseconds.
        proposals: Boxes that may hold a light artifact.
        detections: The scored proposals; None where no classifier is configured (never an empty stand-in).
        ranges: How far away the light in each box is; None without detections, without an estimator or where the
            frame has no camera.
        tracks: What is followed over time; None without detections or without a tracker.
        beam: What our headlamps shall shine; None without tracks, or where no beam is configured.
        stage_ms: Run-time of each stage in milliseconds, by stage name; a measurement, not part of the result's
            identity.
    """

    frame: int
    timestamp_ns: int
    proposals: Proposals
    detections: Detections | None
    stage_ms: Mapping[str, float] = field(default_factory=dict)
    ranges: Ranges | None = None
    tracks: Tracks | None = None
    beam: BeamCommand | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "stage_ms", MappingProxyType(dict(self.stage_ms)))
