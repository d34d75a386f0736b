"""Classification of proposals by an ONNX model."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from foreglow import _native
from foreglow.config import ClassifierConfig
from foreglow.types import Detections, Image, Proposals

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

# Crops of one run: bounds the memory, and the activations of the first layers stay in the second-level cache.
_MAX_BATCH = 8
_HALF = np.float32(0.5)


class OnnxClassifier:
    """Scores the crops of proposals with ONNX Runtime on the CPU.

    The model reads float32 crops of shape (N, 1, S, S) in [0, 1], N free, and writes one logit a crop, shape (N,) or
    (N, 1). S is read from the model.
    """

    def __init__(self, config: ClassifierConfig) -> None:
        """Opens `config.model`.

        Raises:
            FileNotFoundError: If the model does not exist.
            ValueError: If no model is configured, the file is not an ONNX model, or its input or output is not as
                above; the message names path, field and expectation.
        """
        if config.model is None:
            raise ValueError("classifier.model: expected the path of an ONNX model, got none")
        self.config = config
        self._path = config.model
        self._session = _open(config.model, config.num_threads)
        self._input, self._size_px = _checked_input(config.model, self._session)
        self._outputs = [_checked_output(config.model, self._session)]

    @property
    def size_px(self) -> int:
        """Side of the square crops that the model reads."""
        return self._size_px

    def classify(self, image: Image, proposals: Proposals) -> Detections:
        """The proposals with their scores; without proposals the model is not run.

        Args:
            image: The frame, shape (height, width), uint8 or uint16, any strides.
            proposals: Boxes in this frame.

        Raises:
            ValueError: If the model writes something else than one finite logit a crop.
        """
        boxes, threshold = proposals.boxes_xyxy_px, self.config.score_threshold
        if len(boxes) == 0:
            return Detections(proposals, np.zeros(0, np.float32), threshold)
        pixels: Any = image if image.strides[1] == image.itemsize else np.ascontiguousarray(image)
        crops = _native.extract_crops(pixels, np.ascontiguousarray(boxes), self.config.support, self._size_px)
        batches = [self._run(crops[start : start + _MAX_BATCH]) for start in range(0, len(crops), _MAX_BATCH)]
        logits = batches[0] if len(batches) == 1 else np.concatenate(batches)
        if not math.isfinite(np.add.reduce(logits)):
            raise ValueError(f"{self._path}: output: expected finite logits, got NaN or infinity")
        return Detections(proposals, _sigmoid(logits), threshold)

    def _run(self, batch: NDArray[np.float32]) -> NDArray[np.float32]:
        output: NDArray[np.float32] = self._session.run(self._outputs, {self._input: batch})[0]
        if output.shape not in ((len(batch),), (len(batch), 1)):
            raise ValueError(
                f"{self._path}: output: expected one logit for each of {len(batch)} crops, got shape {output.shape}"
            )
        return output.reshape(-1)


def _sigmoid(logits: NDArray[np.float32]) -> NDArray[np.float32]:
    """1 / (1 + exp(-x)) as (1 + tanh(x / 2)) / 2: cannot overflow, within 1e-7, float32.

    >>> _sigmoid(np.array([-1000, 0, 1000], np.float32)).tolist()
    [0.0, 0.5, 1.0]
    """
    scores = logits * _HALF
    np.tanh(scores, scores)
    scores *= _HALF
    scores += _HALF
    return scores


def _open(path: Path, num_threads: int) -> InferenceSession:
    """A sequential session on the CPU that does not spin while it waits."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such model file")
    # Newer versions would keep a device id in the home folder and report to their makers. Read when they are loaded.
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    import onnxruntime as ort
    from onnxruntime.capi import onnxruntime_pybind11_state as errors

    ort.disable_telemetry_events()  # where someone else loaded it before
    options = ort.SessionOptions()
    options.intra_op_num_threads = num_threads
    options.inter_op_num_threads = 1
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_ENABLE_ALL
    options.log_severity_level = 4  # errors are raised; nothing is to be printed as well
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.add_session_config_entry("session.inter_op.allow_spinning", "0")
    unusable = (
        errors.EPFail,
        errors.Fail,
        errors.InvalidArgument,
        errors.InvalidGraph,
        errors.InvalidProtobuf,
        errors.NoSuchFile,
        errors.NotImplemented,
        errors.RuntimeException,
    )
    try:
        return ort.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except unusable as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{path}: expected an ONNX model that can be run: {reason}") from error


def _checked_input(path: Path, session: InferenceSession) -> tuple[str, int]:
    """Name and side of the model's only input."""
    name, shape = _only(path, session.get_inputs(), "input")
    expected = "expected shape (N, 1, S, S) with a free N and a fixed S"
    if len(shape) != 4:
        raise ValueError(f"{path}: input {name}: {expected}, got {len(shape)} dimensions {shape}")
    batch, channels, height, width = shape
    if isinstance(batch, int):
        raise ValueError(f"{path}: input {name}: {expected}, got a fixed batch of {batch} in {shape}")
    if channels != 1:
        raise ValueError(f"{path}: input {name}: {expected}, got {channels} channels in {shape}")
    if not isinstance(height, int) or height != width or height < 1:
        raise ValueError(f"{path}: input {name}: {expected}, got {shape}")
    return name, height


def _checked_output(path: Path, session: InferenceSession) -> str:
    """Name of the model's only output; what its shape leaves open is checked on every run."""
    name, shape = _only(path, session.get_outputs(), "output")
    if len(shape) not in (1, 2) or isinstance(shape[0], int) or (len(shape) == 2 and shape[1] != 1):
        raise ValueError(f"{path}: output {name}: expected shape (N,) or (N, 1) with a free N, got {shape}")
    return name


def _only(path: Path, nodes: list[Any], what: str) -> tuple[str, tuple[int | str | None, ...]]:
    """Name and shape of the only one of a model's inputs or outputs; free dimensions are names or None."""
    if len(nodes) != 1:
        raise ValueError(f"{path}: {what}s: expected one, got {len(nodes)}")
    if nodes[0].type != "tensor(float)":
        raise ValueError(f"{path}: {what} {nodes[0].name}: expected float32, got {nodes[0].type}")
    return str(nodes[0].name), tuple(nodes[0].shape)
