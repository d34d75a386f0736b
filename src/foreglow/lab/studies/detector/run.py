"""The paper's table of detectors: every row measured on the same split, with the same metrics, on one thread."""

from __future__ import annotations

import contextlib
import itertools
import os
import warnings
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from foreglow.config import ProposalConfig
from foreglow.datasets import LabelledSource, open_labelled, split_folder
from foreglow.datasets.json_files import Record, read_json
from foreglow.files import to_json
from foreglow.lab.evaluation import (
    Predictions,
    SplitLabels,
    evaluate_boxes,
    examine,
    read_predictions,
    read_split_labels,
)
from foreglow.lab.evaluation.bootstrap import f1, paired_bootstrap, scene_counts
from foreglow.lab.evaluation.boxes.matching import match_boxes
from foreglow.lab.evaluation.boxes.split_run import run_split
from foreglow.lab.learning.annotation import POSITIVE, check_current, label_boxes
from foreglow.lab.learning.apart import check_apart
from foreglow.lab.learning.kept_files import file_checksum
from foreglow.lab.studies.detector.rows import (
    COMPARISONS,
    ROWS,
    THRESHOLD,
    DetectorPlan,
    Workspace,
    classifier_model,
    missing_reason,
    row_key,
    yolo_note,
    yolo_run,
)
from foreglow.lab.studies.progress import Progress
from foreglow.pipeline import Pipeline
from foreglow.proposals.reference import working_sizes
from foreglow.provenance import processor_name, provenance
from foreglow.runs.predictions import write_predictions
from foreglow.types import Frame
from foreglow.whole_files import RemadeWarning, write_atomic

if TYPE_CHECKING:
    from foreglow.lab.learning.training_progress import RunProgress
    from foreglow.lab.learning.yolo import YoloRun


NOT_MADE = {"name", "title", "reason"}
"""Fields of a row that could not be made; its figures would be taken for measured ones."""


class RowResult(Record):
    """One row of the table.

    Attributes:
        name: Of `ROWS`.
        title: For the reader.
        reason: Why it could not be made; None if it was. All below are empty then.
        key: Digest of what decides its figures.
        note: How the model came about.
        image_size_px: Width and height of the image that proposals are found in, or of a YOLO's.
        num_multiply_adds: For one crop, or for one image of a YOLO.
        num_multiply_adds_frame: For one frame: a crop's times the mean number of proposals, or a YOLO's.
        run_time_ms: `mean`, `std`, `median` and `p99` of a frame, decoding excluded, one thread.
        load: Programs that wanted a core when it was measured, over the cores.
        num_proposals: Mean boxes a frame, whatever their score.
        num_boxes: Mean boxes a frame with a score above the threshold.
        ceiling: The metrics of the labelled boxes themselves, a `BoxQuality` as `to_json` has it; empty for a YOLO that
            learnt from boxes which the split does not have.
        examination: The metrics and all else, an `Examination` as `to_json` has it.
    """

    name: str
    title: str
    reason: str | None = None
    key: str = ""
    note: str = ""
    image_size_px: Annotated[tuple[int, int], Field(strict=False)] = (0, 0)
    num_parameters: int = 0
    num_multiply_adds: int = 0
    num_multiply_adds_frame: float = 0.0
    run_time_ms: dict[str, float] = Field(default_factory=dict)
    load: float = 0.0
    num_proposals: float = 0.0
    num_boxes: float = 0.0
    ceiling: dict[str, Any] = Field(default_factory=dict)
    examination: dict[str, Any] = Field(default_factory=dict)
    made_with: dict[str, Any] = Field(default_factory=dict)


class KeptRow(RowResult):
    """What `rows/NAME.json` holds: a row, and what tells whether it is still the one that was written.

    Attributes:
        checksums: CRC-32 of the `row` without this, and of the file of its `predictions`.
    """

    checksums: dict[str, int] = Field(default_factory=dict)

    @property
    def row(self) -> RowResult:
        """The row alone."""
        return RowResult.model_validate(self.model_dump(exclude={"checksums"}))


@dataclass(frozen=True, slots=True, eq=False)
class DetectorResults:
    """The whole experiment.

    Attributes:
        data: The data set, as the user gave it.
        predictions: By row, of those that were made.
        comparisons: Differences of F between rows, with their names as `a` and `b`.
    """

    data: str
    labels: SplitLabels
    plan: DetectorPlan
    rows: tuple[RowResult, ...]
    predictions: Mapping[str, Predictions]
    comparisons: tuple[dict[str, Any], ...]

    def to_json(self) -> dict[str, Any]:
        """Everything but the predictions by name, for JSON."""
        return {
            "data": self.data,
            "split": self.labels.name,
            "num_images": len(self.labels.lights),
            "num_sequences": len(set(self.labels.sequence_of.values())),
            "threshold": THRESHOLD,
            "seed": self.plan.seed,
            "rows": [row.model_dump(include=None if row.reason is None else NOT_MADE) for row in self.rows],
            "comparisons": list(self.comparisons),
        }


def run_experiment(
    data: Path, out: Path, plan: DetectorPlan, *, progress: Progress | None = None, training: RunProgress | None = None
) -> DetectorResults:
    """Makes the rows of the table that can be made, and gives the reason for the others.

    Every row is kept in `out/rows`, its predictions in `out/predictions`, its training in `out/models`: an interrupted
    call goes on, and a repeated one measures nothing twice. A row whose files have changed since they were written is
    made again, with a `RemadeWarning`.

    Raises:
        FileNotFoundError: If a file of the data set or of a given model is missing.
        ValueError: If one is broken, does not fit, or has changed when a row is made, or the split has no image.
        ModuleNotFoundError: If an extra that is needed is not installed.
    """
    workspace = Workspace(data, out, plan, progress, training)
    dataset = open_labelled(split_folder(data, plan.split))
    if not dataset.frame_ids:
        raise ValueError(f"{dataset.root}: expected images to measure on, found none")
    keys = {name: row_key(name, workspace) for name in plan.rows if missing_reason(name, plan) is None}
    labels = read_split_labels(dataset, with_shares=True)  # once for all rows, after what the keys say of them
    rows = tuple(_row(name, workspace, dataset, labels, keys.get(name)) for name in plan.rows)
    predictions = {row.name: read_predictions(_predictions_file(out, row.name)) for row in rows if row.reason is None}
    return DetectorResults(str(data), labels, plan, rows, predictions, _compared(labels, predictions, plan.seed))


def _row(name: str, workspace: Workspace, dataset: LabelledSource, labels: SplitLabels, key: str | None) -> RowResult:
    """The row from its file where that has the same key, else made now; None stands for one that cannot be made."""
    if key is None:
        return RowResult(name=name, title=ROWS[name].title, reason=missing_reason(name, workspace.plan))
    path = workspace.out / "rows" / f"{name}.json"
    known = _kept_row(path, _predictions_file(workspace.out, name), key)
    if known is not None:
        return known
    if name not in workspace.plan.given and workspace.plan.split != "train":  # a network is trained here
        check_apart([split_folder(workspace.data, "train")], [dataset.root])
    make = _yolo_row if ROWS[name].kind == "yolo" else _classifier_row
    row = make(name, workspace, dataset, labels).model_copy(update={"key": key})
    if row_key(name, workspace) != key:
        words = "expected the data, and the given models, as they were when this began, they have changed since"
        raise ValueError(f"{workspace.data}: {words}, so that the row {name} is not kept; repeat the command")
    path.parent.mkdir(parents=True, exist_ok=True)
    row = RowResult.model_validate_json(row.model_dump_json())  # as it is read: JSON knows no infinite threshold
    kept = KeptRow(**row.model_dump(), checksums=_checksums(row, _predictions_file(workspace.out, name)))
    write_atomic(path, (kept.model_dump_json(indent=1) + "\n").encode())
    return row


def _kept_row(path: Path, predictions: Path, key: str) -> RowResult | None:
    """The row in the file `path`; None if there is none of this key, or it or its predictions are damaged."""
    if not path.exists() or not predictions.exists():
        return None
    with contextlib.suppress(ValueError):
        kept = read_json(path, KeptRow)
        if kept.key != key:
            return None
        if kept.checksums == _checksums(kept.row, predictions):
            return kept.row
    warnings.warn(RemadeWarning(f"{path}: the row kept here is damaged, and is made again"), stacklevel=2)
    return None


def _checksums(row: RowResult, predictions: Path) -> dict[str, int]:
    return {"row": zlib.crc32(row.model_dump_json().encode()), "predictions": file_checksum(predictions)}


def _classifier_row(name: str, workspace: Workspace, dataset: LabelledSource, labels: SplitLabels) -> RowResult:
    from foreglow.lab.learning.model_counts import count_model

    config, note = classifier_model(name, workspace)
    assert config.classifier.model is not None
    counts = count_model(config.classifier.model)
    pipeline = Pipeline(config.detector_only)
    first = dataset.read(dataset.frame_ids[0])
    pipeline.step(first)  # buffers are made with the first frame
    progress, done = workspace.progress_of(f"{name}: images"), itertools.count(1)
    run = run_split(dataset, pipeline, progress and (lambda *_: progress(next(done), len(dataset))))
    row = _measured(name, run.predictions, run.total_ms, workspace, labels)
    return row.model_copy(
        update={
            "note": note,
            "image_size_px": _working_size_px(config.proposals, first),
            "num_parameters": counts.num_parameters,
            "num_multiply_adds": counts.num_multiply_adds,
            "num_multiply_adds_frame": counts.num_multiply_adds * row.num_proposals,
            "ceiling": _ceiling(run.predictions, labels),
        }
    )


def _yolo_row(name: str, workspace: Workspace, dataset: LabelledSource, labels: SplitLabels) -> RowResult:
    from foreglow.lab.learning.yolo import predict_yolo

    trained = yolo_run(name, workspace)
    ceiling = _yolo_ceiling(trained, dataset, labels)
    progress = workspace.progress_of(f"{name}: images")
    found = predict_yolo(trained, dataset, device="cpu", num_threads=1, progress=progress)
    return _measured(name, found.predictions, found.frame_ms, workspace, labels).model_copy(
        update={
            "note": yolo_note(trained),
            "image_size_px": (trained.settings.training.image_size_px,) * 2,
            "num_parameters": trained.results.num_parameters,
            "num_multiply_adds": trained.results.num_multiply_adds,
            "num_multiply_adds_frame": float(trained.results.num_multiply_adds),
            "ceiling": ceiling,
        }
    )


def _yolo_ceiling(run: YoloRun, dataset: LabelledSource, labels: SplitLabels) -> dict[str, Any]:
    """The metrics of boxes like those that a YOLO learnt from; empty where they are not in the split."""
    from foreglow.lab.learning.yolo import positive_boxes, proposer_of

    proposer = proposer_of(run.settings.boxes)
    if proposer is None:
        if any(dataset.boxes(image_id) is None for image_id in dataset.frame_ids):
            return {}
        check_current(dataset.root)
    boxes = {frame.frame: positive_boxes(dataset, frame, proposer) for frame in dataset}
    quality: dict[str, Any] = to_json(evaluate_boxes(labels.keypoints_px, _unscored(boxes)))
    return quality


def _working_size_px(config: ProposalConfig, frame: Frame) -> tuple[int, int]:
    """Width and height of the reduced image, in which proposals are found."""
    if config.working_size_px is not None:
        return config.working_size_px
    reduction = working_sizes(config, frame.width_px).reduction
    return frame.width_px // reduction, frame.height_px // reduction


def _measured(
    name: str, predictions: Predictions, frame_ms: NDArray[np.float64], workspace: Workspace, labels: SplitLabels
) -> RowResult:
    """The row's figures, but for those of the model; keeps the predictions."""
    path = _predictions_file(workspace.out, name)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_predictions(path, predictions)
    title = ROWS[name].title
    num_images = len(labels.lights)
    scores = np.concatenate([np.zeros(0), *predictions.scores.values()])
    median, p99 = np.percentile(frame_ms, (50, 99)).tolist()
    times = {"mean": float(frame_ms.mean()), "std": float(frame_ms.std()), "median": median, "p99": p99}
    return RowResult(
        name=name,
        title=title,
        run_time_ms={key: round(value, 4) for key, value in times.items()},
        load=round(os.getloadavg()[0] / (os.cpu_count() or 1), 4),
        num_proposals=len(scores) / num_images,
        num_boxes=int((scores > THRESHOLD).sum()) / num_images,
        examination=to_json(examine(labels, predictions, THRESHOLD, title)),
        made_with=provenance() | {"processor": processor_name()},
    )


def _ceiling(proposed: Predictions, labels: SplitLabels) -> dict[str, Any]:
    """The metrics of the boxes with a key point in them, which a perfect classifier would accept.

    Source: the paper's table, in parentheses.
    """
    keypoints_px = labels.keypoints_px
    positive = {
        image_id: boxes[label_boxes(boxes, keypoints_px[image_id]) == POSITIVE]
        for image_id, boxes in proposed.boxes_xyxy_px.items()
    }
    quality: dict[str, Any] = to_json(evaluate_boxes(keypoints_px, _unscored(positive)))
    return quality


def _unscored(boxes_xyxy_px: Mapping[int, NDArray[np.float64]]) -> Predictions:
    scores = {image_id: np.ones(len(boxes)) for image_id, boxes in boxes_xyxy_px.items()}
    return Predictions(boxes_xyxy_px, scores, is_scored=False)


def _compared(labels: SplitLabels, predictions: Mapping[str, Predictions], seed: int) -> tuple[dict[str, Any], ...]:
    counts = {
        name: found
        for name, predicted in predictions.items()
        for found in [scene_counts(match_boxes(labels.keypoints_px, predicted), labels.sequence_of, THRESHOLD)]
        if not np.isnan(f1(found.sum(axis=0)))  # without lights and false boxes there is no F
    }
    return tuple(
        {"row": a, "other": b, **to_json(paired_bootstrap(counts[a], counts[b], f1, seed=seed))}
        for a, b in COMPARISONS
        if a in counts and b in counts
    )


def _predictions_file(out: Path, name: str) -> Path:
    return out / "predictions" / f"{name}.json"
