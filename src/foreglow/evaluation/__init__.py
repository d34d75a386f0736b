"""Metrics: what the pipeline's results are worth."""

from foreglow.evaluation.box_quality import BoxQuality, annotation_quality, evaluate_boxes, evaluate_split
from foreglow.evaluation.breakdown import Breakdown, SplitLabels, break_down, match_lights, read_split_labels
from foreglow.evaluation.examination import Examination, examine
from foreglow.evaluation.predictions import Predictions, read_predictions
from foreglow.evaluation.split_run import SplitRun, run_split

__all__ = [
    "BoxQuality",
    "Breakdown",
    "Examination",
    "Predictions",
    "SplitLabels",
    "SplitRun",
    "annotation_quality",
    "break_down",
    "evaluate_boxes",
    "evaluate_split",
    "examine",
    "match_lights",
    "read_predictions",
    "read_split_labels",
    "run_split",
]
