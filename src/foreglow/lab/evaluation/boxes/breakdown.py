"""Recall by what a light is, and false boxes by where they are: what one pooled F hides."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.datasets import Instance, LabelledSource, Vehicle
from foreglow.datasets.pvdn import PVDN_RATE_HZ
from foreglow.datasets.pvdn.schema import ImageRecord
from foreglow.datasets.simulated import has_truth, read_truth
from foreglow.files import fields_to_json
from foreglow.lab.evaluation.boxes.curves import RecallCurve, recall_curve, threshold_at_false_boxes
from foreglow.lab.evaluation.boxes.lights import (
    NUM_STRONGEST,
    SEEN_ON,
    Light,
    SplitShares,
    empty_images,
    read_lights,
    read_split_shares,
)
from foreglow.lab.evaluation.boxes.matching import NEVER, Matches, match_boxes
from foreglow.lab.evaluation.ratios import ratio, share
from foreglow.numbers import checked_share
from foreglow.runs.predictions import Predictions
from foreglow.types.arrays import check_kind, check_optional

RANGE_EDGES_M = (0.0, 30.0, 60.0, 90.0, 130.0, 200.0, 400.0)
"""Bins of the distance to the vehicle, metres; the lower edge belongs to a bin."""

FALSE_BOX_LIMITS = (0.05, 0.1, 0.2, 0.5, 1.0)
"""False boxes a frame in images without any vehicle's light, at which hidden vehicles' recall is given."""


@dataclass(frozen=True, slots=True)
class LightGroup:
    """How many lights of one group are found.

    Attributes:
        name: Of the group, such as `rail` or `30-60 m`.
        recall: Share of them in an accepted box; NaN without lights.
        ceiling: Share of them in any box, whatever its score: what the proposals leave to the classifier.
        f1: 2 P R / (P + R) of this recall and the precision of all boxes.
    """

    name: str
    num: int
    recall: float
    ceiling: float
    f1: float


@dataclass(frozen=True, slots=True)
class FalseBoxes:
    """The accepted boxes without a keypoint in some images.

    Attributes:
        num: Such boxes, as the metrics of the paper count them.
        num_doubtful: Those of them that hold doubtful light, which is neither right nor wrong to accept.
    """

    num_images: int
    num: int
    num_doubtful: int

    @property
    def per_frame(self) -> float:
        """Mean number per image; NaN without images."""
        return ratio(self.num, self.num_images)

    @property
    def per_frame_without_doubtful(self) -> float:
        """Mean number per image of those that hold no doubtful light either; NaN without images."""
        return ratio(self.num - self.num_doubtful, self.num_images)

    @property
    def per_minute(self) -> float:
        """In a minute of PVDN's 18 images a second, whatever the rate of the data set: boxes, not objects."""
        return self.per_frame * PVDN_RATE_HZ * 60.0

    def to_json(self) -> dict[str, Any]:
        """All fields and rates by name."""
        return fields_to_json(self, "per_frame", "per_frame_without_doubtful", "per_minute")


@dataclass(frozen=True, slots=True)
class ImageGroup:
    """The figures of some of the images alone, such as those in rain.

    Attributes:
        precision: Of the accepted boxes in these images; NaN without any.
    """

    name: str
    precision: float
    lights: LightGroup
    false_boxes: FalseBoxes


@dataclass(frozen=True, slots=True)
class Breakdown:
    """Recall by groups of lights, and false boxes.

    A false box has no kind and no distance. So `f1` of a group takes the precision of all boxes, tp / (tp + fp) as
    `evaluate_boxes` has it, beside the group's own recall: groups differ by their recall alone.

    Attributes:
        threshold: A box is accepted if its score is above.
        whole: All lights together; its `f1` is the F of `evaluate_boxes`.
        groups: By aspect (`kind`, `source`, `sight`, `strength`, `hidden kind`, `distance`), its groups in the order
            of a table; groups without lights are left out.
    """

    threshold: float
    precision: float
    whole: LightGroup
    groups: Mapping[str, tuple[LightGroup, ...]]
    weathers: tuple[ImageGroup, ...]
    scenarios: tuple[ImageGroup, ...]
    false_boxes: FalseBoxes
    false_boxes_empty: FalseBoxes

    def group(self, aspect: str, name: str) -> LightGroup | None:
        """The group `name` of an aspect; None where it has no lights."""
        return next((group for group in self.groups[aspect] if group.name == name), None)


@dataclass(frozen=True, slots=True)
class OperatingPoint:
    """What a limit on the false boxes in images without any vehicle's light leaves.

    Attributes:
        threshold: The lowest one that keeps to it.
    """

    limit: float
    threshold: float
    recall_hidden: float
    recall: float
    precision: float
    f1: float


@dataclass(frozen=True, slots=True, eq=False)
class SplitLabels:
    """What the labels of a split say, read once for any number of predictions.

    Attributes:
        name: The split, such as `day/val`.
        rate_hz: Its frames a second, as `LabelledSource.mean_rate_hz`.
        lights: By image id, for every image.
        doubtful_px: By image id, shape (D, 2): light that is neither an instance nor a fault to find.
        empty_images: Images in which no vehicle's light is to be seen, not even a doubtful one.
        weather_of: By image id, its sequence's weather, such as `dry`.
        sequence_of: By image id, its sequence's id.
        time_s: By image id, from the first image of its sequence, seconds.
        shares: Whose light is in the proposals; empty where that is not stored, or was not read.
        scenario_of: By image id, its sequence's scenario, such as `village`; empty where the split is not simulated.
        num_outside: Lights that lie outside their image, where no box can hold them.
        num_twins: Lights that the labels of an image have several times, as `num_twins` counts them.
    """

    name: str
    rate_hz: float
    lights: Mapping[int, tuple[Light, ...]]
    doubtful_px: Mapping[int, NDArray[np.float64]]
    empty_images: frozenset[int]
    weather_of: Mapping[int, str]
    sequence_of: Mapping[int, int]
    time_s: Mapping[int, float]
    shares: SplitShares = field(default_factory=dict)
    scenario_of: Mapping[int, str] = field(default_factory=dict)
    num_outside: int = 0
    num_twins: int = 0

    @property
    def keypoints_px(self) -> dict[int, NDArray[np.float64]]:
        """By image id, shape (K, 2): the positions of its lights, in their order."""
        return {image_id: _positions(lights) for image_id, lights in self.lights.items()}


@dataclass(frozen=True, slots=True, eq=False)
class LightMatches:
    """All lights and all boxes of a split, with what is needed to count any group of them.

    Attributes:
        lights: All lights, P of them.
        best_scores: Shape (P,), the highest score of the boxes around each; -inf without any.
        is_false: Shape (B,): whether a box is false if it is accepted: it holds no light.
        has_doubtful: Shape (B,): whether a box holds doubtful light.
        is_in_empty: Shape (B,): whether a box lies in an image without any vehicle's light.
    """

    lights: tuple[Light, ...]
    matches: Matches
    best_scores: NDArray[np.float64]
    is_false: NDArray[np.bool_]
    has_doubtful: NDArray[np.bool_]
    is_in_empty: NDArray[np.bool_]
    num_empty_images: int

    @property
    def is_hidden(self) -> NDArray[np.bool_]:
        """Shape (P,): whether the light's vehicle has not shown a lamp so far."""
        return np.array([light.is_hidden for light in self.lights], np.bool_)


def read_split_labels(dataset: LabelledSource, *, with_shares: bool = False) -> SplitLabels:
    """The labels of the selected images of `dataset`; if wanted, with the shares of light that are stored beside them.

    Raises:
        FileNotFoundError: If a label file is missing.
        ModuleNotFoundError: If there are shares to read, and the extra `parquet` is not installed.
        ValueError: If a file is broken, or there is no data set.
    """
    check_kind("dataset", dataset, LabelledSource)
    ids = dataset.frame_ids
    sequence_of = {image_id: dataset.sequence(image_id).id for image_id in ids}
    scenario_of: dict[int, str] = {}
    if has_truth(dataset.root):
        scenario = cache(read_truth(dataset.root).scenario)
        scenario_of = {image_id: scenario(sequence_id) for image_id, sequence_id in sequence_of.items()}
    lights = read_lights(dataset)
    return SplitLabels(
        name=dataset.name,
        rate_hz=dataset.mean_rate_hz,
        lights=lights,
        doubtful_px={image_id: _positions(dataset.doubtful(image_id)) for image_id in ids},
        empty_images=frozenset(empty_images(dataset)),
        weather_of={image_id: dataset.sequence(image_id).weather.name.lower() for image_id in ids},
        scenario_of=scenario_of,
        sequence_of=sequence_of,
        time_s={image_id: dataset.time_s(image_id) for image_id in ids},
        shares=read_split_shares(dataset) if with_shares else {},
        num_outside=sum(
            num_outside(dataset.image(image_id), (light.position_px for light in found))
            for image_id, found in lights.items()
            if found
        ),
        num_twins=sum(num_twins(dataset.annotations(image_id)) for image_id in ids),
    )


def num_outside(image: ImageRecord, positions_px: Iterable[Sequence[float]]) -> int:
    """How many points lie beyond the edges of their image, where no box can hold them."""
    return sum(not (0 <= x <= image.width_px and 0 <= y <= image.height_px) for x, y in positions_px)


def check_has_light(dataset: LabelledSource, image_ids: Sequence[int] | None = None) -> None:
    """Passes images among which is labelled light: by others, nothing can be chosen or judged.

    Args:
        dataset: The split.
        image_ids: Some of its images; None for all that are selected.

    Raises:
        FileNotFoundError: If an image has no file of key points.
        ValueError: If there is no key point within an image, or a label file is broken.
    """
    chosen = dataset.frame_ids if image_ids is None else image_ids
    for image_id in chosen:
        points = dataset.keypoints_px(image_id).tolist()
        if len(points) > num_outside(dataset.image(image_id), points):
            return
    raise ValueError(
        f"{dataset.root}: expected labelled light to choose and judge by, found no key point in {len(chosen)} of its "
        f"{len(dataset)} images"
    )


def num_beyond(dataset: LabelledSource, predictions: Predictions) -> int:
    """How many predicted boxes, whatever their score, lie wholly beyond the edges of their image."""
    total = 0
    for image_id in predictions.boxes_xyxy_px.keys() & set(dataset.frame_ids):
        x1, y1, x2, y2 = predictions.boxes_xyxy_px[image_id].T
        if len(x1):
            image = dataset.image(image_id)
            is_beyond = (x2 < 0) | (y2 < 0) | (x1 > image.width_px) | (y1 > image.height_px)
            total += int(is_beyond.sum())
    return total


def num_twin_boxes(dataset: LabelledSource, predictions: Predictions) -> int:
    """How many predicted boxes, whatever their score, are in their image again, at the same place."""
    found = (
        predictions.boxes_xyxy_px[image_id] for image_id in predictions.boxes_xyxy_px.keys() & set(dataset.frame_ids)
    )
    return sum(len(boxes) - len(np.unique(boxes, axis=0)) for boxes in found)


def num_twins(vehicles: Iterable[Vehicle]) -> int:
    """How many light artifacts of an image are in its labels again, with the same vehicle, instance and place."""
    lights = [(vehicle.oid, light.iid, light.position_px) for vehicle in vehicles for light in vehicle.instances]
    return len(lights) - len(set(lights))


def match_lights(labels: SplitLabels, predictions: Predictions) -> LightMatches:
    """Which lights, doubtful ones too, lie in which of the predicted boxes; edges belong to a box.

    Raises:
        ValueError: If an argument is of another type.
    """
    check_kind("labels", labels, SplitLabels)
    matches = match_boxes(labels.keypoints_px, predictions)
    doubtful_px = {image_id: labels.doubtful_px[image_id] for image_id in matches.image_ids}
    is_empty = np.array([image_id in labels.empty_images for image_id in matches.image_ids], np.bool_)
    return LightMatches(
        lights=tuple(light for lights in labels.lights.values() for light in lights),
        matches=matches,
        best_scores=matches.best_scores(),
        is_false=~matches.has_point,
        has_doubtful=match_boxes(doubtful_px, predictions).has_point,
        is_in_empty=is_empty[matches.image_of_box],
        num_empty_images=int(is_empty.sum()),
    )


def break_down(matched: LightMatches, threshold: float, labels: SplitLabels | None = None) -> Breakdown:
    """Recall by groups and false boxes, when boxes with a score above `threshold` are accepted.

    By weather and by scenario only where there are `labels`, those of the split.

    Raises:
        ValueError: If an argument is of another type, or the threshold is no number from 0 to 1.
    """
    check_kind("matched", matched, LightMatches)
    threshold = checked_share("threshold", threshold)
    check_optional("labels", labels, SplitLabels)
    matches = matched.matches
    is_found = matched.best_scores > threshold
    is_false = (matches.scores > threshold) & matched.is_false
    precision = ratio(is_found.sum(), is_found.sum() + is_false.sum())

    def group(name: str, members: NDArray[np.bool_], precision: float = precision) -> LightGroup:
        recall, ceiling = share(is_found[members]), share(matched.best_scores[members] > NEVER)
        return LightGroup(name, int(members.sum()), recall, ceiling, f1_of(precision, recall))

    def image_groups(name_of: Mapping[int, str]) -> tuple[ImageGroup, ...]:
        names = np.array([name_of.get(image_id, "") for image_id in matches.image_ids], object)
        found = []
        for name in sorted(set(name_of.values())):
            has_point, has_box = (names == name)[matches.image_of_point], (names == name)[matches.image_of_box]
            tp, fp = is_found[has_point].sum(), is_false[has_box].sum()
            false = _false_boxes(is_false & has_box, matched.has_doubtful, int((names == name).sum()))
            found.append(ImageGroup(name, ratio(tp, tp + fp), group(name, has_point, ratio(tp, tp + fp)), false))
        return tuple(found)

    return Breakdown(
        threshold=threshold,
        precision=precision,
        whole=group("all", np.ones(len(matched.lights), np.bool_)),
        groups={
            aspect: tuple(group(name, is_member) for name, is_member in members.items() if is_member.any())
            for aspect, members in _members(matched.lights).items()
        },
        weathers=() if labels is None else image_groups(labels.weather_of),
        scenarios=() if labels is None else image_groups(labels.scenario_of),
        false_boxes=_false_boxes(is_false, matched.has_doubtful, matches.num_images),
        false_boxes_empty=_false_boxes(is_false & matched.is_in_empty, matched.has_doubtful, matched.num_empty_images),
    )


def hidden_curve(matched: LightMatches) -> RecallCurve:
    """Recall of hidden vehicles' light over false boxes a frame in images without any vehicle's light."""
    false_scores = matched.matches.scores[matched.is_in_empty & matched.is_false]
    return recall_curve(matched.best_scores[matched.is_hidden], false_scores, matched.num_empty_images)


def threshold_for_empty_images(matched: LightMatches, limit: float) -> float:
    """The lowest threshold with at most `limit` false boxes a frame in images without any vehicle's light.

    Raises:
        ValueError: If there is no such image, the boxes have no scores, or the limit is negative.
    """
    if not matched.matches.is_scored:
        raise ValueError("threshold_for_empty_images: expected boxes with scores, got boxes without")
    false_scores = matched.matches.scores[matched.is_in_empty & matched.is_false]
    return threshold_at_false_boxes(false_scores, matched.num_empty_images, limit)


def operating_points(matched: LightMatches) -> tuple[OperatingPoint, ...]:
    """At each of `FALSE_BOX_LIMITS`; none without scores, or without images in which there is no vehicle's light."""
    points = []
    for limit in FALSE_BOX_LIMITS if matched.num_empty_images and matched.matches.is_scored else ():
        threshold = threshold_for_empty_images(matched, limit)
        at_limit = break_down(matched, threshold)
        hidden = at_limit.group("sight", "hidden")
        recall_hidden = math.nan if hidden is None else hidden.recall
        whole = at_limit.whole
        points.append(OperatingPoint(limit, threshold, recall_hidden, whole.recall, at_limit.precision, whole.f1))
    return tuple(points)


def range_bins(ranges_m: NDArray[np.float64]) -> dict[str, NDArray[np.bool_]]:
    """For each bin of `RANGE_EDGES_M`, by its name such as `30-60 m`, which ranges are in it; shape (N,) each."""
    return {f"{low:g}-{high:g} m": (low <= ranges_m) & (ranges_m < high) for low, high in pairwise(RANGE_EDGES_M)}


def f1_of(precision: float, recall: float) -> float:
    """2 P R / (P + R); 0 where nothing is found, whatever the precision, NaN where nothing was to be found.

    >>> f1_of(0.5, 1.0) == 2 / 3
    True
    """
    return 0.0 if recall == 0.0 else 2.0 * precision * recall / (precision + recall)


def _members(lights: Sequence[Light]) -> dict[str, dict[str, NDArray[np.bool_]]]:
    """By aspect and group, shape (P,): which lights belong to it."""
    kind = np.array([light.kind for light in lights], object)
    is_direct = np.array([light.is_direct for light in lights], np.bool_)
    is_hidden = np.array([light.is_hidden for light in lights], np.bool_)
    range_m = np.array([light.range_m for light in lights], np.float64)
    rank = np.array([light.rank for light in lights], np.int64)
    return {
        "kind": {name: kind == name for name in SEEN_ON},
        "source": {"direct": is_direct, "indirect": ~is_direct},
        "sight": {"hidden": is_hidden, "in sight": ~is_hidden},
        "strength": {"strongest three reflections": (rank >= 0) & (rank < NUM_STRONGEST)},
        "hidden kind": {name: is_hidden & (kind == name) for name in SEEN_ON},
        "distance": range_bins(range_m),
    }


def _false_boxes(is_false: NDArray[np.bool_], has_doubtful: NDArray[np.bool_], num_images: int) -> FalseBoxes:
    return FalseBoxes(num_images, int(is_false.sum()), int((is_false & has_doubtful).sum()))


def _positions(lights: Iterable[Light | Instance]) -> NDArray[np.float64]:
    return np.array([light.position_px for light in lights], np.float64).reshape(-1, 2)
