"""How well boxes explain annotated light artifacts: precision, recall, F1, and the box qualities q, q_K, q_B.

Source: Ewecker et al., Provident Vehicle Detection at Night for Advanced Driver Assistance Systems, arXiv 2107.11302;
counted as in the code published with PVDN.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.datasets import PVDN, LabelledSource, open_labelled
from foreglow.datasets.exchange import LabelFile
from foreglow.datasets.exchange.transfer import RENUMBERED
from foreglow.files import checked_path
from foreglow.lab.evaluation.boxes.breakdown import num_beyond, num_outside, num_twin_boxes, num_twins
from foreglow.lab.evaluation.boxes.matching import match_boxes
from foreglow.lab.evaluation.ratios import ratio
from foreglow.numbers import checked_share
from foreglow.runs.labels_of_run import LabelsOfRun, check_times, labels_of_run
from foreglow.runs.predictions import Predictions, is_coco_results, read_predictions, run_threshold


@dataclass(frozen=True, slots=True)
class BoxQuality:
    """The metrics of one set of images. All rates lie in [0, 1]; NaN where nothing was there to be rated.

    The published code gives -1 for an undefined precision, recall or F1, and NaN for the others; here all are NaN.

    Attributes:
        precision: tp / (tp + fp); NaN without any prediction.
        recall: tp / (tp + fn); NaN without any keypoint.
        f1: tp / (tp + (fp + fn) / 2); NaN without both.
        q: q_k * q_b, of the unrounded values.
        q_k: Mean over the boxes with a keypoint of 1 / keypoints in the box: 1 if no box holds two.
        q_k_std: Its population standard deviation.
        q_b: Mean over the keypoints in a box of 1 / boxes around the keypoint: 1 if no keypoint lies in two.
        q_b_std: Its population standard deviation.
        tp: Keypoints in at least one box.
        fp: Boxes without a keypoint.
        fn: Keypoints in no box.
        num_missing: Those of them that the predictions do not mention; they count as without boxes.
        num_unknown: Images of the predictions without ground truth; they are ignored.
        is_scored: False if the boxes had no scores and all of them count.
    """

    precision: float
    recall: float
    f1: float
    q: float
    q_k: float
    q_k_std: float
    q_b: float
    q_b_std: float
    tp: int
    fp: int
    fn: int
    num_images: int
    num_missing: int
    num_unknown: int
    is_scored: bool
    threshold: float

    def rounded_as_published(self) -> BoxQuality:
        """With the published rounding: every rate to 4 decimals, and q as the product of the rounded rates."""
        names = ("precision", "recall", "f1", "q_k", "q_k_std", "q_b", "q_b_std")
        rounded: dict[str, Any] = {name: round(getattr(self, name), 4) for name in names}
        return dataclasses.replace(self, **rounded, q=round(rounded["q_k"] * rounded["q_b"], 4))


def evaluate_boxes(
    keypoints_px: Mapping[int, NDArray[Any]], predictions: Predictions, threshold: float = 0.5
) -> BoxQuality:
    """How well `predictions` explain `keypoints_px`, over all images together.

    A keypoint lies in a box if x1 <= x <= x2 and y1 <= y <= y2: all four edges belong to the box, although boxes are
    half-open elsewhere. True positives and false negatives are keypoints, false positives are boxes. There is no
    matching: a box may explain several keypoints, and a keypoint several boxes, which q_k and q_b measure.

    Args:
        keypoints_px: By image id, shape (K, 2), columns x and y, full-frame pixels; an image without vehicles has
            K = 0.
        predictions: Boxes and scores by image id.
        threshold: A box counts if its score is above this; without effect on boxes without scores.

    Raises:
        ValueError: If an argument is of another type, the keypoints have another shape or are not finite, or the
            threshold is no number from 0 to 1.

    >>> keypoints = {7: np.array([[10, 10], [90, 90]])}
    >>> boxes = Predictions({7: np.array([[5.0, 5.0, 10.0, 10.0]])}, {7: np.array([0.9])})
    >>> quality = evaluate_boxes(keypoints, boxes)
    >>> quality.precision, quality.recall, quality.q
    (1.0, 0.5, 1.0)
    """
    threshold = checked_share("threshold", threshold)
    matches = match_boxes(keypoints_px, predictions)
    keypoints_in_box = matches.points_in_box[matches.scores > threshold]  # n_K of each box that counts
    boxes_around_keypoint = matches.boxes_around_point(threshold)  # n_B of each keypoint

    tp = int(np.count_nonzero(boxes_around_keypoint))
    fn = matches.num_points - tp
    fp = int(np.count_nonzero(keypoints_in_box == 0))
    q_k, q_k_std = _mean_and_std(1.0 / keypoints_in_box[keypoints_in_box > 0])
    q_b, q_b_std = _mean_and_std(1.0 / boxes_around_keypoint[boxes_around_keypoint > 0])
    return BoxQuality(
        precision=ratio(tp, tp + fp),
        recall=ratio(tp, tp + fn),
        f1=ratio(tp, tp + 0.5 * (fp + fn)),
        q=q_k * q_b,
        q_k=q_k,
        q_k_std=q_k_std,
        q_b=q_b,
        q_b_std=q_b_std,
        tp=tp,
        fp=fp,
        fn=fn,
        num_images=len(keypoints_px),
        num_missing=len(keypoints_px.keys() - predictions.boxes_xyxy_px.keys()),
        num_unknown=len(predictions.boxes_xyxy_px.keys() - keypoints_px.keys()),
        is_scored=predictions.is_scored,
        threshold=threshold,
    )


def evaluate_split(split: Path | str, predictions: Path | str, threshold: float | None = None) -> BoxQuality:
    """How well the predictions in a file explain a PVDN split.

    Every image of the split counts, with all its instances: direct, indirect and rear; if the predictions are of a run
    on one of its folders, every image there. Each must have its keypoint file. Image files are not needed, but the
    folder of a sequence that is named is. A warning tells what makes the figures others than the boxes deserve: images
    without predictions, predictions for images that are not in the split, key points outside their image, and key
    points that the labels of an image have several times, boxes that lie beyond their image; labels of which nothing
    tells whether they are for what the run was made from; and labels that are for more than that.

    Args:
        split: The split's folder, or a sequence's for this sequence alone.
        predictions: A file as `read_predictions` takes it.
        threshold: A box counts if its score is above this; None for that of the run, or 0.5 without a run.

    Raises:
        FileNotFoundError: If the split, a label file or the predictions are missing.
        ValueError: If one of them is broken, the predictions are for other images, or the threshold is no number from 0
            to 1.
    """
    given = None if threshold is None else checked_share("threshold", threshold)
    checked_path(split, "split")
    found = read_predictions(predictions)
    least = run_threshold(predictions) if given is None else given
    labels, found = compared_labels(Path(predictions), found, Path(split), open_labelled(split))
    dataset = labels.dataset
    keypoints_px = split_keypoints_px(dataset)
    quality = evaluate_boxes(keypoints_px, found, least)
    outside = sum(num_outside(dataset.image(image_id), points.tolist()) for image_id, points in keypoints_px.items())
    twins = sum(num_twins(dataset.annotations(image_id)) for image_id in keypoints_px)
    for line in labels.lines:
        warnings.warn(line, stacklevel=2)
    for number, words in (
        (quality.num_missing, f"images of {split} without predictions, counted as without boxes"),
        (quality.num_unknown, f"images with predictions that {split} does not have, which are ignored"),
        (outside, f"key points of {split} outside of their image, so that no box finds them"),
        (num_beyond(dataset, found), "boxes wholly beyond the image, as of images of another size"),
        (num_twin_boxes(dataset, found), "boxes that are in their image again, at the same place, and count again"),
        (twins, f"key points of {split} that are there again, same vehicle, instance and place, and count again"),
    ):
        if number:
            warnings.warn(f"{predictions}: {number} {words}", stacklevel=2)
    return quality


def compared_labels(
    path: Path, predictions: Predictions, split: Path, dataset: LabelledSource
) -> tuple[LabelsOfRun, Predictions]:
    """The labels that predictions are compared with, and these by the images of the labels.

    Args:
        path: The file of the predictions.
        predictions: What is in it.
        split: The split.
        dataset: It, opened.

    Raises:
        ValueError: If they are for none of its images, in relative coordinates, or by a run on something else, or the
            run's summary is broken.
    """
    is_of_run = path.name == "frames.jsonl"
    found = labels_of_run(path.parent, split, dataset) if is_of_run else LabelsOfRun(dataset)
    if isinstance(dataset, LabelFile) and dataset.coco_ids and is_coco_results(path):
        line = f"{path}: its image ids are taken for those in {split}, not for numbers of frames"
        found = LabelsOfRun(dataset, dataset.coco_ids, line)
    elif isinstance(dataset, PVDN) and RENUMBERED in dataset.labels.images_file.info and is_coco_results(path):
        file = dataset.labels.images_file.info[RENUMBERED]
        line = f"{path}: its image ids are taken for numbers of frames, not for those in {file}, of which {split} is"
        found = LabelsOfRun(dataset, doubt=line)
    images = predictions.boxes_xyxy_px.keys()
    if images and images.isdisjoint(dataset.frame_ids if found.ids is None else found.ids):
        raise ValueError(f"{path}: expected boxes in images of {split}, got those of others, such as {min(images)}")
    most_px = max((float(boxes.max()) for boxes in predictions.boxes_xyxy_px.values() if boxes.size), default=math.inf)
    if most_px <= 1:
        raise ValueError(
            f"{path}: expected boxes in pixels, got none beyond 1, as of coordinates relative to the image"
        )
    compared = found.of_images(predictions)
    if is_of_run:
        check_times(path.parent, split, dataset, compared.times_ns)
    return found, compared


def annotation_quality(split: Path | str) -> BoxQuality:
    """How well the split's own generated boxes with label 1 explain its keypoints: the upper bound of any classifier.

    Precision is 1 by construction. The paper's table gives these values in parentheses.

    Raises:
        FileNotFoundError: If the split or one of its label files is missing.
        ValueError: If one of them is broken.
    """
    dataset = open_labelled(checked_path(split, "split"))
    boxes: dict[int, NDArray[np.float64]] = {}
    labels: dict[int, NDArray[np.float64]] = {}
    for image_id in dataset.frame_ids:
        found = dataset.boxes(image_id)
        if found is not None:
            boxes[image_id] = np.array(found.boxes_xyxy_px, np.float64).reshape(-1, 4)
            labels[image_id] = np.array(found.labels, np.float64)
    return evaluate_boxes(split_keypoints_px(dataset), Predictions(boxes, labels))


def split_keypoints_px(dataset: LabelledSource) -> dict[int, NDArray[np.int32]]:
    """The keypoints of all selected images by id, each of shape (K, 2), int32.

    Raises:
        FileNotFoundError: If an image has no keypoint file.
        ValueError: If a keypoint file is broken.
    """
    return {image_id: dataset.keypoints_px(image_id) for image_id in dataset.frame_ids}


def _mean_and_std(values: NDArray[np.float64]) -> tuple[float, float]:
    return (float(values.mean()), float(values.std())) if len(values) else (math.nan, math.nan)
