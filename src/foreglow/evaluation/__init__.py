"""Metrics: what the pipeline's results are worth."""

from foreglow.evaluation.box_quality import BoxQuality, annotation_quality, evaluate_boxes, evaluate_split
from foreglow.evaluation.predictions import Predictions, read_predictions

__all__ = ["BoxQuality", "Predictions", "annotation_quality", "evaluate_boxes", "evaluate_split", "read_predictions"]
