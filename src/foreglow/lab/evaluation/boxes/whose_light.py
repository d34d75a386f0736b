"""A detector judged by whose light is in its boxes, where a simulated data set stores that beside its labels."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from foreglow.datasets.simulated import BoxShares
from foreglow.lab.evaluation.boxes.breakdown import (
    FalseBoxes,
    LightMatches,
    OperatingPoint,
    SplitLabels,
    break_down,
    operating_points,
)
from foreglow.lab.evaluation.boxes.curves import quality_curve
from foreglow.lab.evaluation.boxes.matching import Matches
from foreglow.lab.evaluation.boxes.score_calibration import expected_calibration_error
from foreglow.lab.evaluation.ratios import share
from foreglow.runs.predictions import Predictions

MIN_VEHICLE_SHARE = 0.1
"""A box with less of other vehicles' light is false."""


@dataclass(frozen=True, slots=True)
class WhoseLight:
    """Figures by whose light is in the boxes: one with less than `MIN_VEHICLE_SHARE` of vehicle light is false.

    Attributes:
        preset: The preset whose stored proposals fit the boxes best.
        num_unmatched: Boxes that are not among these proposals, whose light nobody knows. With any, all below is None
            or empty.
        precision: Share of the accepted boxes that are not false.
        average_precision: Area under precision over recall of boxes, as for key points. The boxes to find are the
            stored proposals that are not false.
        calibration_error: Of the scores as probabilities that a box is not false (ECE); NaN without both kinds.
        operating_points: At limits of such false boxes; lights are key points.
    """

    preset: str
    num_boxes: int
    num_unmatched: int
    precision: float = math.nan
    average_precision: float = math.nan
    calibration_error: float = math.nan
    false_boxes: FalseBoxes | None = None
    false_boxes_empty: FalseBoxes | None = None
    operating_points: tuple[OperatingPoint, ...] = ()


def whose_light(
    labels: SplitLabels, predictions: Predictions, matched: LightMatches, threshold: float
) -> WhoseLight | None:
    """The figures of `predictions` by the shares in `labels`; None without any. `matched` is what was made of both.

    Boxes and stored proposals are the same if their coordinates are equal.
    """
    if not labels.shares:
        return None
    matches = matched.matches
    boxes = [
        (image_id, *box)
        for image_id in matches.image_ids
        for box in predictions.boxes_xyxy_px.get(image_id, np.empty((0, 4))).tolist()
    ]
    stored = {preset: _vehicle_shares(by_image) for preset, by_image in labels.shares.items()}
    num_unmatched = {preset: sum(box not in known for box in boxes) for preset, known in stored.items()}
    preset = min(stored, key=num_unmatched.__getitem__)
    if num_unmatched[preset]:
        return WhoseLight(preset, len(boxes), num_unmatched[preset])
    known = stored[preset]
    is_false = np.array([known[box] < MIN_VEHICLE_SHARE for box in boxes], np.bool_)
    by_share = dataclasses.replace(matched, is_false=is_false)
    whole = break_down(by_share, threshold)
    return WhoseLight(
        preset=preset,
        num_boxes=len(boxes),
        num_unmatched=0,
        precision=share(~is_false[matches.scores > threshold]),
        average_precision=_average_precision(matches, boxes, known) if matches.is_scored else math.nan,
        calibration_error=_calibration_error(matches, ~is_false),
        false_boxes=whole.false_boxes,
        false_boxes_empty=whole.false_boxes_empty,
        operating_points=operating_points(by_share),
    )


_Box: TypeAlias = tuple[float, ...]
"""An image's id and the four edges of a box in it."""


def _vehicle_shares(by_image: Mapping[int, BoxShares]) -> dict[_Box, float]:
    return {
        (image_id, *box): vehicle_share
        for image_id, found in by_image.items()
        for box, vehicle_share in zip(found.boxes_xyxy_px.tolist(), found.vehicle_shares.tolist(), strict=True)
    }


def _average_precision(matches: Matches, boxes: list[_Box], known: Mapping[_Box, float]) -> float:
    """Each stored box with enough vehicle light is a point that lies in the predicted box with its coordinates."""
    index_of_image = {image_id: index for index, image_id in enumerate(matches.image_ids)}
    to_find = [box for box, vehicle_share in known.items() if vehicle_share >= MIN_VEHICLE_SHARE]
    index_of = {box: index for index, box in enumerate(to_find)}
    pairs = [(index_of[box], index) for index, box in enumerate(boxes) if box in index_of]
    pair_point, pair_box = np.array(pairs, np.intp).reshape(-1, 2).T
    by_box = dataclasses.replace(
        matches,
        image_of_point=_indices([index_of_image[int(box[0])] for box in to_find]),
        pair_point=pair_point,
        pair_box=pair_box,
    )
    return quality_curve(by_box).average_precision


def _calibration_error(matches: Matches, is_light: NDArray[np.bool_]) -> float:
    if not matches.is_scored or is_light.all() or not is_light.any():
        return math.nan
    return expected_calibration_error(matches.scores, is_light)


def _indices(values: list[int]) -> NDArray[np.intp]:
    return np.array(values, np.intp)
