"""Metrics: what the pipeline's results are worth."""

from foreglow.lab.evaluation.boxes.box_quality import BoxQuality, annotation_quality, evaluate_boxes, evaluate_split
from foreglow.lab.evaluation.boxes.breakdown import Breakdown, SplitLabels, break_down, match_lights, read_split_labels
from foreglow.lab.evaluation.boxes.examination import Examination, examine
from foreglow.lab.evaluation.boxes.split_run import SplitRun, run_split
from foreglow.lab.evaluation.boxes.whose_light import WhoseLight
from foreglow.runs.predictions import Predictions, read_predictions

__all__ = [
    "BoxQuality",
    "Breakdown",
    "Examination",
    "Predictions",
    "SplitLabels",
    "SplitRun",
    "WhoseLight",
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
