"""Classification of proposals by an ONNX model."""

from __future__ import annotations

from foreglow.config import ClassifierConfig
from foreglow.types import Detections, Image, Proposals


class OnnxClassifier:
    """Scores the crops of proposals with ONNX Runtime."""

    def __init__(self, config: ClassifierConfig) -> None:
        self.config = config

    def classify(self, image: Image, proposals: Proposals) -> Detections:
        """The proposals with their scores."""
        raise ValueError("not built yet")
