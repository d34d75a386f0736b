"""How well kinds of light are told apart, direct from indirect above all, and two lamps known as one vehicle's."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.calibration import read_calibration
from foreglow.datasets import LabelledSource
from foreglow.files import fields_to_json
from foreglow.geometry import Camera
from foreglow.lab.evaluation.boxes.breakdown import SplitLabels
from foreglow.lab.evaluation.boxes.lights import Light
from foreglow.lab.evaluation.boxes.matching import lies_in
from foreglow.lab.evaluation.lamp_pairs import group_vehicles
from foreglow.lab.evaluation.ratios import ratio, share
from foreglow.runs.predictions import Predictions
from foreglow.types import KINDS, Tracks


def balanced_accuracy(is_true: NDArray[np.bool_], is_called: NDArray[np.bool_]) -> float:
    """The mean of the shares of both classes that are called what they are; NaN where one has no member.

    >>> balanced_accuracy(np.array([True, True, False]), np.array([True, False, False]))
    0.75
    """
    if is_true.all() or not is_true.any():
        return math.nan
    return float(is_called[is_true].mean() + (~is_called[~is_true]).mean()) / 2


@dataclass(frozen=True, slots=True)
class DirectQuality:
    """How well boxes with light are called direct or indirect, at a probability of 0.5.

    A box is direct if it holds a lamp, whatever else it holds. Boxes without a labelled light do not count.

    Attributes:
        num_direct: Boxes with a lamp.
        num_indirect: Boxes with other light alone.
        recall_direct: Share of the boxes with a lamp that are called direct; NaN without such boxes.
        recall_indirect: Share of the others that are called indirect; NaN without such boxes.
    """

    num_direct: int
    num_indirect: int
    recall_direct: float
    recall_indirect: float

    @property
    def balanced_accuracy(self) -> float:
        """The mean of the two recalls."""
        return (self.recall_direct + self.recall_indirect) / 2

    def to_json(self) -> dict[str, Any]:
        """All fields and their mean by name."""
        return fields_to_json(self, "balanced_accuracy")


@dataclass(frozen=True, slots=True)
class VehicleQuality:
    """How well plausible tracks are grouped into vehicles, image by image.

    Attributes:
        precision: Share of the pairs in which both tracks hold a lamp of the same vehicle; NaN without pairs.
        num_vehicles: Vehicles with two lamps in tracks of their own.
        recall: Share of these vehicles for which such a pair was made; NaN without vehicles.
    """

    num_pairs: int
    precision: float
    num_vehicles: int
    recall: float


@dataclass(frozen=True, slots=True)
class Directness:
    """How well direct and indirect light are distinguished in a run.

    Attributes:
        boxes: Of the accepted boxes; None where the predictions do not say direct or indirect.
        tracks: Of the plausible tracks of every image; None without tracks, or where they do not say it.
        vehicles: Of the plausible tracks; None without tracks or without calibrations.
    """

    boxes: DirectQuality | None = None
    tracks: DirectQuality | None = None
    vehicles: VehicleQuality | None = None


def directness(
    labels: SplitLabels,
    predictions: Predictions,
    threshold: float,
    tracks: Mapping[int, Tracks] | None = None,
    cameras: Mapping[int, Camera] | None = None,
) -> Directness:
    """All figures of a run."""
    return Directness(
        boxes=directness_of_boxes(labels, predictions, threshold),
        tracks=None if tracks is None else directness_of_tracks(labels, tracks),
        vehicles=None if tracks is None else vehicles_of_tracks(labels, tracks, cameras or {}),
    )


def directness_of_boxes(labels: SplitLabels, predictions: Predictions, threshold: float) -> DirectQuality | None:
    """How well the accepted boxes are classified; None where the predictions do not say direct or indirect."""
    return _quality(
        labels,
        {
            image_id: (predictions.boxes_xyxy_px[image_id], probabilities, predictions.scores[image_id] > threshold)
            for image_id, probabilities in predictions.direct_probabilities.items()
        },
    )


def directness_of_tracks(labels: SplitLabels, tracks: Mapping[int, Tracks]) -> DirectQuality | None:
    """How well plausible tracks are classified, by what lies in their boxes, once in each image; None as for boxes."""
    return _quality(
        labels,
        {
            image_id: (found.boxes_xyxy_px, found.direct_probabilities, found.is_plausible)
            for image_id, found in tracks.items()
        },
    )


def vehicles_of_tracks(
    labels: SplitLabels, tracks: Mapping[int, Tracks], cameras: Mapping[int, Camera]
) -> VehicleQuality | None:
    """How well `lamp_pairs.group_vehicles` finds which two tracks are one vehicle's."""
    num_pairs, num_right, num_vehicles, num_found = 0, 0, 0, 0
    for image_id, in_image in tracks.items():
        camera = cameras.get(labels.sequence_of.get(image_id, -1))
        if camera is None:
            continue
        held = _lamps_held(labels.lights[image_id], in_image)
        vehicle_ids = set().union(*(lamps.keys() for lamps in held))
        vehicles = {vehicle_id for vehicle_id in vehicle_ids if _is_apart(held, vehicle_id)}
        pairs = [group for group in group_vehicles(in_image, camera) if len(group) == 2]
        right = [held[left].keys() & held[right].keys() for left, right in pairs]
        num_pairs += len(pairs)
        num_right += sum(map(bool, right))
        num_vehicles += len(vehicles)
        num_found += len(vehicles & set().union(*right))
    if not cameras:
        return None
    return VehicleQuality(num_pairs, ratio(num_right, num_pairs), num_vehicles, ratio(num_found, num_vehicles))


def read_cameras(dataset: LabelledSource) -> dict[int, Camera]:
    """The calibrations of a simulated split, by sequence id; none where it has none.

    Raises:
        ValueError: If one is broken.
    """
    paths = {
        sequence.id: dataset.root / "simulation" / sequence.directory / "camera.toml" for sequence in dataset.sequences
    }
    return {sequence_id: read_calibration(path) for sequence_id, path in paths.items() if path.is_file()}


def _lamps_held(lights: tuple[Light, ...], tracks: Tracks) -> list[dict[int, set[int]]]:
    """For each track the lamps in its box, by vehicle, as indices of `lights`; nothing for tracks not plausible."""
    held: list[dict[int, set[int]]] = [{} for _ in range(len(tracks))]
    for index, light in enumerate(lights):
        if light.is_direct:
            is_in = lies_in(np.array(light.position_px), tracks.boxes_xyxy_px) & tracks.is_plausible
            for track in np.flatnonzero(is_in):
                held[track].setdefault(light.vehicle_id, set()).add(index)
    return held


def _is_apart(held: list[dict[int, set[int]]], vehicle_id: int) -> bool:
    """Whether two tracks hold different lamps of the vehicle."""
    return len({frozenset(lamps[vehicle_id]) for lamps in held if vehicle_id in lamps}) > 1


def _sources(lights: tuple[Light, ...], boxes_xyxy_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shape (N,): 1 for a box with a lamp, 0 for one with other light alone, NaN without a light."""
    sources = np.full(len(boxes_xyxy_px), np.nan)
    for light in sorted(lights, key=lambda light: light.is_direct):
        sources[lies_in(np.array(light.position_px), boxes_xyxy_px)] = light.is_direct
    return sources


def _quality(
    labels: SplitLabels, found: Mapping[int, tuple[NDArray[Any], NDArray[Any], NDArray[np.bool_]]]
) -> DirectQuality | None:
    """Of boxes, their probabilities and whether they count, by image id; None without any box that is rated."""
    truth, calls = [np.zeros(0)], [np.zeros(0)]
    for image_id, (boxes_xyxy_px, probabilities, is_counted) in found.items():
        if image_id in labels.lights:
            is_rated = is_counted & ~np.isnan(probabilities)
            truth.append(_sources(labels.lights[image_id], boxes_xyxy_px[is_rated]))
            calls.append(probabilities[is_rated])
    is_direct, called = np.concatenate(truth), np.concatenate(calls) > 0.5
    if not len(called):
        return None
    direct, indirect = called[is_direct == 1], called[is_direct == 0]
    return DirectQuality(len(direct), len(indirect), share(direct), share(~indirect))


NONE = KINDS.index("none")


@dataclass(frozen=True, slots=True, eq=False)
class KindConfusion:
    """What boxes are against what they are called.

    A box is of the kind with the greatest share of its light; our own and fixed light together are `none`. It is called
    `none` unless it is accepted, and otherwise the most probable kind of light.

    Attributes:
        counts: Shape (5, 5), of boxes: true kinds in the rows, called kinds in the columns, both as `KINDS`.
        num_unknown: Boxes in labelled images that the data set stores no shares of, or of which a model does not tell
            the kind.
    """

    counts: NDArray[np.int64]
    num_unknown: int

    @property
    def kinds(self) -> tuple[str, ...]:
        """The order of rows and columns."""
        return KINDS

    @property
    def recalls(self) -> tuple[float, ...]:
        """Of each kind's boxes, the share that is called by it; NaN without boxes."""
        return tuple(ratio(int(row[index]), int(row.sum())) for index, row in enumerate(self.counts))

    @property
    def right(self) -> float:
        """Share of the accepted boxes whose kind is right; NaN without any."""
        accepted = self.counts[:, :NONE]
        return ratio(int(np.trace(accepted)), int(accepted.sum()))

    def to_json(self) -> dict[str, Any]:
        """All by name."""
        return fields_to_json(self, "kinds", "recalls", "right")


def kind_confusion(labels: SplitLabels, predictions: Predictions, threshold: float) -> KindConfusion | None:
    """The table of `predictions` by the shares in `labels`; None without shares, or if the predictions tell no kinds.

    Boxes and stored proposals, of whatever preset, are the same if their coordinates are equal.
    """
    if not (labels.shares and predictions.light_kinds):
        return None
    counts = np.zeros((len(KINDS), len(KINDS)), np.int64)
    for image_id, light_kinds in predictions.light_kinds.items():
        if image_id not in labels.lights:
            continue
        stored = [by_image[image_id] for by_image in labels.shares.values() if image_id in by_image]
        kind_of = {
            tuple(box): kind
            for found in stored
            for box, kind in zip(found.boxes_xyxy_px.tolist(), found.kinds.argmax(axis=1).tolist(), strict=True)
        }
        is_accepted = predictions.scores[image_id] > threshold
        called = np.where(is_accepted, light_kinds.argmax(axis=1), NONE)
        boxes = map(tuple, predictions.boxes_xyxy_px[image_id].tolist())
        for box, call, is_unknown in zip(boxes, called, np.isnan(light_kinds[:, 0]), strict=True):
            if box in kind_of and not is_unknown:
                counts[kind_of[box], call] += 1
    num_boxes = sum(len(boxes) for image_id, boxes in predictions.boxes_xyxy_px.items() if image_id in labels.lights)
    return KindConfusion(counts, num_boxes - int(counts.sum()))
