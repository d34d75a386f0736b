"""YOLO detectors for the same boxes as ours: export of the data, training and prediction with other libraries."""

from foreglow.lab.learning.yolo.backends import YoloConfig
from foreglow.lab.learning.yolo.export import export_yolo, positive_boxes, proposer_of
from foreglow.lab.learning.yolo.run import YoloRun, check_usable, predict_yolo, read_yolo_run, train_yolo

__all__ = [
    "YoloConfig",
    "YoloRun",
    "check_usable",
    "export_yolo",
    "positive_boxes",
    "predict_yolo",
    "proposer_of",
    "read_yolo_run",
    "train_yolo",
]
