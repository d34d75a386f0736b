"""YOLO detectors for the same boxes as ours: export of the data, training and prediction with other libraries.

There are two back ends: `libreyolo` (MIT) and `ultralytics` (AGPL-3.0).
"""

from foreglow.lab.learning.yolo.backends import BACKENDS
from foreglow.lab.learning.yolo.export import PAPER_SIZE_PX, YoloExport, export_yolo
from foreglow.lab.learning.yolo.interface import Backend, Detector, YoloConfig
from foreglow.lab.learning.yolo.prediction import YoloPredictions, predict_yolo
from foreglow.lab.learning.yolo.training import YoloRun, read_yolo_run, train_yolo

__all__ = [
    "BACKENDS",
    "PAPER_SIZE_PX",
    "Backend",
    "Detector",
    "YoloConfig",
    "YoloExport",
    "YoloPredictions",
    "YoloRun",
    "export_yolo",
    "predict_yolo",
    "read_yolo_run",
    "train_yolo",
]
