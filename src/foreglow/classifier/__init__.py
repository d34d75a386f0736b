"""Stage 2: which proposals are light artifacts. Inference only; training lives in `foreglow.lab.learning`."""

from foreglow.classifier.inputs import FEATURES, ClassifierInputs, InputMaker, InputSpec
from foreglow.classifier.onnx import OnnxClassifier

__all__ = ["FEATURES", "ClassifierInputs", "InputMaker", "InputSpec", "OnnxClassifier"]
