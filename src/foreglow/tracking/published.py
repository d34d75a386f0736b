"""The tracker of the paper's published code, with its behaviour as it is: for comparison, not for driving.

It departs from the paper: a detection is matched by the share of the track's area that it covers instead of IoU, each
gain is applied twice, several detections may each take a copy of the same track, and the velocity is the last
innovation. It returns a single object.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from foreglow.config import TrackerConfig
from foreglow.tracking.interface import Tracker
from foreglow.types import Detections, Frame, Ranges, Tracks, TrackState
from foreglow.types.arrays import check_kind, check_optional

Box: TypeAlias = tuple[float, float, float, float]
"""Either x1, y1, x2, y2 or centre x, y, width, height, pixels."""

_AT_REST = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Sighting:
    """A detection in the form that this tracker uses.

    Attributes:
        box: x1, y1, x2, y2, pixels.
        score: The classifier's.
        distance_m: Range to the light; None where unknown.
        detection: Index in the frame's detections.
    """

    box: Box
    score: float
    distance_m: float | None
    detection: int = -1


@dataclass(frozen=True, slots=True)
class PublishedObject:
    """A tracked object.

    Attributes:
        track_id: Unique, unlike in the published code; a copy of an object gets a new one.
        birth_s: Time of its first detection, which a copy shares.
        box: x1, y1, x2, y2; clipped to the image from the second frame on.
        future_box: Where it is expected next, not clipped.
        score: Filtered.
        distance_m: Filtered; None before the first one.
        num_hits: Number of detections, the first included (count_visibility).
        num_lost: Frames in a row without a detection (count_lost).
        momentum: Last innovation of centre x, y, width, height; None before the second detection.
        momentum_m: Last innovation of the distance; None before the second one.
        detection: Index of its detection in the latest frame; -1 without one.
    """

    track_id: int
    birth_s: float
    box: Box
    future_box: Box
    score: float
    distance_m: float | None
    num_hits: int = 1
    num_lost: int = 0
    momentum: Box | None = None
    momentum_m: float | None = None
    detection: int = -1


class PublishedTracker(Tracker):
    """The tracker of the published code with all its quirks; it counts frames, not time.

    It uses the configuration fields that `TrackerConfig` marks with p, and the frame's size and time. Ids and ages are
    our addition: the first detection that takes an object keeps its id; every further copy gets a new one. Ranges have
    no standard deviation.
    """

    def __init__(self, config: TrackerConfig) -> None:
        check_kind("config", config, TrackerConfig)
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Forgets all objects, as at the start of a sequence; ids begin again."""
        self._objects: tuple[PublishedObject, ...] = ()
        self._next_id = 0

    @property
    def objects(self) -> tuple[PublishedObject, ...]:
        """All objects, in the order of the published code's list."""
        return self._objects

    @property
    def focus(self) -> PublishedObject | None:
        """The single object that the published code returns, or None.

        Among those with enough confidence it is the one with most detections, then the most confident, then the last
        in the list; it must have at least `min_hits` detections.
        """
        best: PublishedObject | None = None
        for candidate in reversed(self._objects):
            if candidate.score > self._config.min_confidence and (
                best is None or (candidate.num_hits, candidate.score) > (best.num_hits, best.score)
            ):
                best = candidate
        return best if best is not None and best.num_hits >= self._config.min_hits else None

    def update(self, frame: Frame, detections: Detections, ranges: Ranges | None) -> Tracks:
        """The tracks after `frame`."""
        check_kind("frame", frame, Frame)
        check_kind("detections", detections, Detections)
        check_optional("ranges", ranges, Ranges)
        boxes, scores = detections.boxes_xyxy_px.astype(np.float64).tolist(), detections.scores.tolist()
        distances_m = [math.nan] * len(boxes) if ranges is None else ranges.ranges_m.tolist()
        sightings = [
            Sighting((x1, y1, x2, y2), score, None if math.isnan(distance_m) else distance_m, index)
            for index, ((x1, y1, x2, y2), score, distance_m) in enumerate(zip(boxes, scores, distances_m, strict=True))
        ]
        now_s = frame.timestamp_ns / 1e9
        self.follow(sightings, (frame.width_px - 1.0, frame.height_px - 1.0), now_s)
        return self._as_tracks(now_s)

    def follow(self, sightings: list[Sighting], limits_px: tuple[float, float], now_s: float) -> None:
        """The published code's step.

        Args:
            sightings: All detections.
            limits_px: Greatest x and y of a box; the published code stops one pixel short of the half-open image.
            now_s: The time, used for ages only.
        """
        followed: list[PublishedObject] = []
        found: set[int] = set()
        for sighting in sightings:
            if sighting.score < self._config.min_score:
                continue
            index = self._best_object(sighting, limits_px)
            if index is None:
                followed.append(self._started(sighting, now_s))  # not clipped before its second frame
                continue
            source = self._objects[index]
            if index in found:
                source = replace(source, track_id=self._new_id())
            found.add(index)
            followed.append(_clipped(self._updated(source, sighting), limits_px))
        lost = [_clipped(self._lost(obj), limits_px) for index, obj in enumerate(self._objects) if index not in found]
        self._objects = tuple(
            obj for obj in followed + lost if obj.num_lost <= self._config.max_misses and _is_ordered(obj.box)
        )

    def _new_id(self) -> int:
        self._next_id += 1
        return self._next_id - 1

    def _best_object(self, sighting: Sighting, limits_px: tuple[float, float]) -> int | None:
        """Index of the object that a detection covers most; ties go to more hits, more confidence, then the last."""
        x, y, width, height = _centre_size(sighting.box)
        grow = self._config.enlargement
        grown = _clip(_corners((x, y, grow * width, grow * height)), limits_px)
        shares = [(_share_covered(obj.future_box, grown), obj.num_hits, obj.score) for obj in self._objects]
        candidates = [(*share, index) for index, share in enumerate(shares) if share[0] >= self._config.min_iou]
        return max(candidates)[-1] if candidates else None

    def _started(self, sighting: Sighting, now_s: float) -> PublishedObject:
        return PublishedObject(
            self._new_id(),
            now_s,
            sighting.box,
            sighting.box,
            sighting.score,
            sighting.distance_m,
            detection=sighting.detection,
        )

    def _updated(self, obj: PublishedObject, sighting: Sighting) -> PublishedObject:
        """The object after a detection: both gains are applied twice, and the future box moves on as far again."""
        config = self._config
        old, new = _centre_size(obj.box), _centre_size(sighting.box)
        momentum = (new[0] - old[0], new[1] - old[1], new[2] - old[2], new[3] - old[3])
        moved = _moved(old, momentum, 2.0 * config.alpha_centre, 2.0 * config.alpha_size)
        distance_m, momentum_m = obj.distance_m, obj.momentum_m
        if sighting.distance_m is not None:
            if distance_m is None:
                distance_m = sighting.distance_m
            else:
                momentum_m = sighting.distance_m - distance_m
                distance_m += config.alpha_range * momentum_m
        return replace(
            obj,
            box=_corners(moved),
            future_box=_corners(_moved(moved, momentum, 2.0 * config.alpha_centre, 0.0)),
            score=config.alpha_confidence * sighting.score + (1.0 - config.alpha_confidence) * obj.score,
            distance_m=distance_m,
            num_hits=obj.num_hits + 1,
            num_lost=0,
            momentum=momentum,
            momentum_m=momentum_m,
            detection=sighting.detection,
        )

    def _lost(self, obj: PublishedObject) -> PublishedObject:
        """The object without a detection: it moves on by its last innovation, which never decays."""
        gain = 2.0 * self._config.alpha_centre
        momentum = obj.momentum or _AT_REST
        moved = _moved(_centre_size(obj.box), momentum, gain, 0.0)
        distance_m = obj.distance_m
        if distance_m is not None and obj.momentum_m is not None:
            distance_m += self._config.alpha_range * obj.momentum_m
        return replace(
            obj,
            box=_corners(moved),
            future_box=obj.future_box if obj.momentum is None else _corners(_moved(moved, momentum, gain, 0.0)),
            distance_m=distance_m,
            num_lost=obj.num_lost + 1,
            detection=-1,
        )

    def _as_tracks(self, now_s: float) -> Tracks:
        objects = sorted(self._objects, key=lambda obj: obj.track_id)
        # Negative distances were clipped to 0 m, which is no range.
        ranges_m = np.array([obj.distance_m or math.nan for obj in objects], np.float64)
        return Tracks(
            ids=np.array([obj.track_id for obj in objects], np.int64),
            states=np.array([self._state(obj) for obj in objects], np.int64),
            boxes_xyxy_px=np.array([obj.box for obj in objects], np.float64).reshape(-1, 4),
            confidences=np.array([obj.score for obj in objects], np.float64),
            num_hits=np.array([obj.num_hits for obj in objects], np.int64),
            num_misses=np.array([obj.num_lost for obj in objects], np.int64),
            ages_s=np.array([max(0.0, now_s - obj.birth_s) for obj in objects], np.float64),
            ranges_m=ranges_m,
            sigmas_m=np.full(len(objects), np.inf),
            detections=np.array([obj.detection for obj in objects], np.int64),
        )

    def _state(self, obj: PublishedObject) -> TrackState:
        if obj.num_hits < self._config.min_hits or not obj.score > self._config.min_confidence:
            return TrackState.TENTATIVE
        return TrackState.COASTING if obj.num_lost else TrackState.CONFIRMED


def _centre_size(box: Box) -> Box:
    x1, y1, x2, y2 = box
    return (x1 + x2) / 2.0, (y1 + y2) / 2.0, x2 - x1, y2 - y1


def _corners(centre_size: Box) -> Box:
    x, y, width, height = centre_size
    return x - width / 2.0, y - height / 2.0, x + width / 2.0, y + height / 2.0


def _moved(centre_size: Box, momentum: Box, gain_centre: float, gain_size: float) -> Box:
    x, y, width, height = centre_size
    dx, dy, dw, dh = momentum
    width, height = width + gain_size * dw, height + gain_size * dh
    return x + gain_centre * dx, y + gain_centre * dy, width, height


def _clip(box: Box, limits_px: tuple[float, float]) -> Box:
    (x1, y1, x2, y2), (right, bottom) = box, limits_px
    return max(x1, 0.0), max(y1, 0.0), min(x2, right), min(y2, bottom)


def _is_ordered(box: Box) -> bool:
    x1, y1, x2, y2 = box
    return x1 < x2 and y1 < y2


def _clipped(obj: PublishedObject, limits_px: tuple[float, float]) -> PublishedObject:
    """The object clipped to the image, with a distance of at least 0 and a future box of positive size."""
    x, y, width, height = _centre_size(obj.future_box)
    is_sound = width > 0.0 and height > 0.0
    sound = (x, y, width if width > 0.0 else 1.0, height if height > 0.0 else 1.0)
    return replace(
        obj,
        box=_clip(obj.box, limits_px),
        future_box=obj.future_box if is_sound else _corners(sound),
        distance_m=None if obj.distance_m is None else max(obj.distance_m, 0.0),
    )


def _share_covered(box: Box, by: Box) -> float:
    width, height = min(box[2], by[2]) - max(box[0], by[0]), min(box[3], by[3]) - max(box[1], by[1])
    if width <= 0.0 or height <= 0.0:
        return 0.0
    return width * height / ((box[2] - box[0]) * (box[3] - box[1]))
