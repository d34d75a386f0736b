"""Everything that a split says of one set of predictions, in one place; what `foreglow evaluate` reports."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np

from foreglow.files import fields_to_json
from foreglow.lab.evaluation.boxes.box_quality import BoxQuality, evaluate_boxes
from foreglow.lab.evaluation.boxes.breakdown import (
    Breakdown,
    OperatingPoint,
    SplitLabels,
    break_down,
    hidden_curve,
    match_lights,
    operating_points,
)
from foreglow.lab.evaluation.boxes.curves import QualityCurve, RecallCurve, quality_curve
from foreglow.lab.evaluation.boxes.directness import Directness, KindConfusion, directness_of_boxes, kind_confusion
from foreglow.lab.evaluation.boxes.lights import unsaid
from foreglow.lab.evaluation.boxes.robustness import RobustnessRow
from foreglow.lab.evaluation.boxes.score_calibration import Calibration, calibration
from foreglow.lab.evaluation.boxes.whose_light import WhoseLight, whose_light
from foreglow.lab.evaluation.vehicles import FirstFound, first_found, share_found_ahead
from foreglow.numbers import checked_share
from foreglow.runs.predictions import Predictions
from foreglow.types.arrays import check_kind, check_optional

RunTime: TypeAlias = Mapping[str, float | None]
"""`median`, `p95` and `p99` of one stage, milliseconds."""

CURVE_THRESHOLDS = np.round(np.arange(0.0, 1.0, 0.01), 2)


@dataclass(frozen=True, slots=True, eq=False)
class Ranking:
    """What scores add: figures over all thresholds.

    Attributes:
        average_precision: Area under precision over recall.
        best_threshold: The lowest threshold with the highest F.
        curve: The metrics at hundredths.
        hidden: Hidden vehicles' recall over false boxes in images without any vehicle's light.
        operating_points: At `FALSE_BOX_LIMITS`; empty without such images.
        calibration: Whether scores are probabilities; None where all boxes are of one class.
    """

    average_precision: float
    best_threshold: float
    best_f1: float
    curve: QualityCurve
    hidden: RecallCurve
    operating_points: tuple[OperatingPoint, ...]
    calibration: Calibration | None


@dataclass(frozen=True, slots=True, eq=False)
class Examination:
    """All figures of one set of predictions on one split.

    Attributes:
        rate_hz: The split's frames a second.
        ranking: Figures over all thresholds; None for boxes without scores.
        run_time_ms: By stage and `total`, median, p95 and p99; empty for predictions from a file.
        robustness: Figures under disturbances; empty where not asked for.
        directness: How well direct and indirect light are distinguished, and lamps grouped into vehicles.
        whose_light: Figures by whose light is in the boxes; None where the split does not store that.
        is_complete: False if the predictions are of a run that was interrupted, or has lost frames since.
        kinds: Which kinds are taken for which; None where a run tells none or the data set stores no shares.
        num_outside: Lights that lie outside their image.
        num_twins: Lights that the labels have several times, which count as often.
        num_beyond: Boxes of a file that lie wholly beyond their image.
        num_twin_boxes: Boxes of a file that are in their image again, which count as often.
        notes: What is to be said of the labels, and of what is missing in them, one line each.
    """

    name: str
    detector: str
    rate_hz: float
    quality: BoxQuality
    breakdown: Breakdown
    vehicles: tuple[FirstFound, ...]
    ranking: Ranking | None
    run_time_ms: Mapping[str, RunTime]
    robustness: tuple[RobustnessRow, ...] = ()
    directness: Directness = field(default_factory=Directness)
    whose_light: WhoseLight | None = None
    kinds: KindConfusion | None = None
    is_complete: bool = True
    num_outside: int = 0
    num_twins: int = 0
    num_beyond: int = 0
    num_twin_boxes: int = 0
    notes: tuple[str, ...] = ()

    @property
    def share_found_ahead(self) -> float:
        """See `share_found_ahead`."""
        return share_found_ahead(self.vehicles)

    def to_json(self) -> dict[str, Any]:
        """Everything by name."""
        return fields_to_json(self, "share_found_ahead")


def rank(labels: SplitLabels, predictions: Predictions) -> Ranking:
    """Figures of scored `predictions` over all thresholds.

    Raises:
        ValueError: If the boxes have no scores.
    """
    matched = match_lights(labels, predictions)
    matches = matched.matches
    every = quality_curve(matches)
    best_threshold, best_f1 = every.best
    is_true = matches.has_point
    is_certain = is_true | ~matched.has_doubtful
    has_both = 0 < is_true[is_certain].sum() < is_certain.sum()
    return Ranking(
        average_precision=every.average_precision,
        best_threshold=best_threshold,
        best_f1=best_f1,
        curve=quality_curve(matches, CURVE_THRESHOLDS),
        hidden=hidden_curve(matched).corners(),
        operating_points=operating_points(matched),
        calibration=calibration(matches.scores[is_certain], is_true[is_certain]) if has_both else None,
    )


def examine(
    labels: SplitLabels,
    predictions: Predictions,
    threshold: float,
    detector: str,
    run_time_ms: Mapping[str, RunTime] | None = None,
) -> Examination:
    """All figures of `predictions` on a split, but for those of robustness and of tracks.

    Raises:
        ValueError: If an argument is of another type, or the threshold is no number from 0 to 1.
    """
    check_kind("detector", detector, str)
    threshold = checked_share("threshold", threshold)
    check_optional("run_time_ms", run_time_ms, Mapping)
    matched = match_lights(labels, predictions)
    return Examination(
        name=labels.name,
        detector=detector,
        rate_hz=labels.rate_hz,
        quality=evaluate_boxes(labels.keypoints_px, predictions, threshold),
        breakdown=break_down(matched, threshold, labels),
        vehicles=first_found(labels, matched, threshold),
        ranking=rank(labels, predictions) if matched.matches.is_scored else None,
        run_time_ms=run_time_ms or {},
        directness=Directness(directness_of_boxes(labels, predictions, threshold)),
        whose_light=whose_light(labels, predictions, matched, threshold),
        kinds=kind_confusion(labels, predictions, threshold),
        num_outside=labels.num_outside,
        num_twins=labels.num_twins,
        notes=unsaid(labels.lights),
    )
