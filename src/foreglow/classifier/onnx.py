"""Classification of proposals by an ONNX model."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from foreglow.classifier.colour import kinds_by_colour, redness
from foreglow.classifier.inputs import (
    MAX_CROP_PX,
    MAX_CROPS_BYTES,
    NUMS_FEATURES,
    ClassifierInputs,
    InputMaker,
    InputSpec,
)
from foreglow.classifier.session import check_whole, model_errors, open_session, unusable
from foreglow.config import ClassifierConfig
from foreglow.models import model_path
from foreglow.types import KINDS, Detections, Frame, Proposals
from foreglow.types.arrays import check_kind
from foreglow.types.kinds import kinds_of_direct
from foreglow.wording import shortened

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

# Crops of one run: bounds the memory, and the activations of the first layers stay in the second-level cache.
_MAX_BATCH = 8

MAX_TOGETHER = 128
"""Boxes that a model compares with one another; the boxes of a frame that has more are compared in parts, from above
downwards, since time and memory grow with the square of their number."""

_HALF = np.float32(0.5)
_PUBLISHED_SUPPORT = 2
_MAX_SUPPORT = 100  # far more than any box is from the border of its image
_NUM_LOGITS = (1, 2, len(KINDS))


class OnnxClassifier:
    """Scores the crops of proposals with ONNX Runtime.

    The model reads float32 crops of shape (N, C, S, S) in [0, 1], N free, and may read features of shape (N, F), as
    `classifier.inputs` makes them. It writes the logits of the five `KINDS`, shape (N, 5); or logits of being light of
    a vehicle, shape (N,) or (N, 1), or these together with logits of being a lamp itself, shape (N, 2). Its metadata
    may give a `support`, and must give the `lag_s` for a channel of an earlier frame, and the `context` for
    one of the surroundings. With `together` in its metadata, it is given all boxes of a frame at once; `names`, a JSON
    object of its outputs' names by number, may not put the `KINDS` in another order.
    """

    def __init__(self, config: ClassifierConfig) -> None:
        """Opens `config.model`.

        Raises:
            FileNotFoundError: If the model does not exist.
            ValueError: If no model is configured, the file is not an ONNX model, not the one that ships or that a
                training wrote there, or its input or output is not as described above; the message names path, field
                and expectation.
        """
        check_kind("config", config, ClassifierConfig)
        if config.model is None:
            raise ValueError("classifier.model: expected the path of an ONNX model, got none")
        self.config = config
        self._path = model_path(config.model)
        check_whole(self._path)
        self._session = open_session(self._path, config.num_threads, config.device)
        try:
            self._names, self.spec = _checked_inputs(self._path, config.support, self._session)
            self._outputs = [_checked_output(self._path, self._session)]
            _check_names(self._path, self.metadata, self._session)
        except model_errors() as error:
            raise unusable(self._path, error) from error
        self._maker = InputMaker(self.spec)
        self._batch = MAX_TOGETHER if self.spec.together else _MAX_BATCH

    @property
    def metadata(self) -> dict[str, str]:
        """What the model says of itself, by name."""
        found: dict[str, str] = self._session.get_modelmeta().custom_metadata_map
        return found

    def reset(self) -> None:
        """Forgets earlier frames, as at the start of a sequence."""
        self._maker.reset()

    def classify(self, frame: Frame, proposals: Proposals) -> Detections:
        """The proposals with their scores; without proposals the model is not run.

        Args:
            frame: The frame; if the model uses earlier frames, frames must come in order.
            proposals: Boxes in this frame.

        Raises:
            ValueError: If the model cannot be run, or writes anything other than 1, 2 or 5 finite logits per crop.
        """
        check_kind("frame", frame, Frame)
        check_kind("proposals", proposals, Proposals)
        threshold = self.config.score_threshold
        num_batches = max(1, MAX_CROPS_BYTES // (self._batch * self.spec.bytes_a_box))
        parts = self._maker.make_parts(frame, proposals, num_batches * self._batch)
        if len(proposals) == 0:
            return Detections(proposals, np.zeros(0, np.float32), threshold)
        logits = np.concatenate([self._logits(part) for part in parts])
        if not math.isfinite(np.add.reduce(logits, axis=None)):
            raise ValueError(f"{self._path}: output: expected finite logits, got NaN or infinity")
        scores, *light_kinds = _probabilities(logits)
        if frame.red_chroma is not None and self.config.colour:
            reds = redness(frame, proposals.boxes_xyxy_px)
            light_kinds = [kinds_by_colour(each, reds) for each in light_kinds]
        return Detections(proposals, scores, threshold, *light_kinds)

    def _logits(self, inputs: ClassifierInputs) -> NDArray[np.float32]:
        """Shape (N, 1), (N, 2) or (N, 5), batch by batch."""
        arrays = (inputs.crops, inputs.features)[: len(self._names)]
        starts = range(0, len(inputs.crops), self._batch)
        batches = [self._run([array[start : start + self._batch] for array in arrays]) for start in starts]
        return batches[0] if len(batches) == 1 else np.concatenate(batches)

    def _run(self, batch: list[NDArray[np.float32]]) -> NDArray[np.float32]:
        inputs = dict(zip(self._names, batch, strict=True))
        try:
            output: NDArray[np.float32] = self._session.run(self._outputs, inputs)[0]
        except model_errors() as error:
            raise unusable(self._path, error) from error
        num_crops = len(batch[0])
        if output.shape != (num_crops,) and output.shape not in [(num_crops, size) for size in _NUM_LOGITS]:
            raise ValueError(
                f"{self._path}: output: expected 1, 2 or 5 logits for each of {num_crops} crops, "
                f"got shape {output.shape}"
            )
        return output.reshape(num_crops, -1)


def _probabilities(logits: NDArray[np.float32]) -> tuple[NDArray[np.float32], ...]:
    """The scores, and the kinds of light if there is more than one logit.

    The softmax over all kinds is that over the kinds of light, times the score: so neither loses digits near 0 or 1.

    >>> [each.tolist() for each in _probabilities(np.array([[0, 0, 0, 0, np.log(4)]], np.float32))]
    [[0.5], [[0.25, 0.25, 0.25, 0.25]]]
    """
    if logits.shape[1] < len(KINDS):
        scores, *direct = _sigmoid(logits).T
        return scores, *map(kinds_of_direct, direct)
    greatest = logits[:, :-1].max(axis=1)
    light_kinds = np.exp(logits[:, :-1] - greatest[:, None])
    sums = light_kinds.sum(axis=1)
    return _sigmoid(greatest + np.log(sums) - logits[:, -1]), light_kinds / sums[:, None]


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


def _checked_inputs(path: Path, wanted_support: int | None, session: InferenceSession) -> tuple[list[str], InputSpec]:
    """Names of the model's inputs, crops first, and their specification; `wanted_support` overrides the model's."""
    nodes = session.get_inputs()
    if len(nodes) not in (1, 2):
        raise ValueError(f"{path}: inputs: expected crops, or crops and features, got {len(nodes)}")
    name, shape = _checked(path, nodes[0], "input")
    expected = "expected shape (N, C, S, S) with a free N, C of 1 to 3, and a fixed S"
    if len(shape) != 4:
        raise ValueError(f"{path}: input {name}: {expected}, got {len(shape)} dimensions {shape}")
    batch, channels, height, width = shape
    if isinstance(batch, int):
        raise ValueError(f"{path}: input {name}: {expected}, got a fixed batch of {batch} in {shape}")
    if channels not in (1, 2, 3):
        raise ValueError(f"{path}: input {name}: {expected}, got {channels} channels in {shape}")
    if not isinstance(height, int) or height != width or not 1 <= height <= MAX_CROP_PX:
        raise ValueError(f"{path}: input {name}: {expected}, got {shape}")
    names, num_features = [name], 0
    for node in nodes[1:]:
        name, shape = _checked(path, node, "input")
        if len(shape) != 2 or isinstance(shape[0], int) or shape[1] not in NUMS_FEATURES[1:]:
            raise ValueError(
                f"{path}: input {name}: expected shape (N, F) with a free N and F of {NUMS_FEATURES[1:]}, got {shape}"
            )
        names.append(name)
        num_features = shape[1]
    metadata = session.get_modelmeta().custom_metadata_map
    support = wanted_support or (_whole(path, metadata, "support") if "support" in metadata else _PUBLISHED_SUPPORT)
    context = _whole(path, metadata, "context") if "context" in metadata else None
    is_together = "together" in metadata
    if is_together and metadata["together"] != "1":
        raise ValueError(f"{path}: metadata: together: expected 1, or none, got {shortened(metadata['together'])}")
    num_earlier = channels - 1 - (context is not None)
    if num_earlier not in (0, 1):
        raise ValueError(
            f"{path}: input {name}: expected one channel, one more for lag_s and one for context, got {shape}"
        )
    lag_s = _number(path, metadata, "lag_s") if num_earlier else None
    try:
        return names, InputSpec(height, support, lag_s, num_features, context, is_together)
    except ValueError as error:
        raise ValueError(f"{path}: metadata: {error}") from error


def _number(path: Path, metadata: dict[str, str], name: str) -> float:
    text = metadata.get(name)
    try:
        return float(text or "")
    except ValueError as error:
        raise ValueError(f"{path}: metadata: {name}: expected a number, got {shortened(text)}") from error


def _whole(path: Path, metadata: dict[str, str], name: str) -> int:
    number = _number(path, metadata, name)
    if not number.is_integer() or not 1 <= number <= _MAX_SUPPORT:
        got = shortened(metadata[name])
        raise ValueError(f"{path}: metadata: {name}: expected a whole number from 1 to {_MAX_SUPPORT}, got {got}")
    return int(number)


def _checked_output(path: Path, session: InferenceSession) -> str:
    """Name of the model's only output; free dimensions of its shape are checked on every run."""
    nodes = session.get_outputs()
    if len(nodes) != 1:
        raise ValueError(f"{path}: outputs: expected one, got {len(nodes)}")
    name, shape = _checked(path, nodes[0], "output")
    if len(shape) not in (1, 2) or isinstance(shape[0], int) or (len(shape) == 2 and shape[1] not in _NUM_LOGITS):
        expected = "expected shape (N,), (N, 1), (N, 2) or (N, 5) with a free N"
        raise ValueError(f"{path}: output {name}: {expected}, got {shape}")
    return name


def _check_names(path: Path, metadata: dict[str, str], session: InferenceSession) -> None:
    """ValueError if a model names its outputs, and they are in another order than `KINDS`.

    Names that are not known, and texts of other programs, say nothing.
    """
    try:
        names = json.loads(metadata.get("names", ""))
    except (ValueError, RecursionError):
        return
    if isinstance(names, list):
        names = {str(number): name for number, name in enumerate(names)}
    if not isinstance(names, dict):
        return
    shape = session.get_outputs()[0].shape
    wanted = dict(zip(map(str, range(len(KINDS))), KINDS, strict=True))
    is_of_kinds = any(isinstance(name, str) and name in KINDS for name in names.values())
    if is_of_kinds and (shape[1:] != [len(KINDS)] or names != wanted):
        got = shortened(list(names.values()))
        raise ValueError(f"{path}: metadata: names: expected {list(KINDS)} for five outputs, got {got}")


def _checked(path: Path, node: Any, what: str) -> tuple[str, tuple[int | str | None, ...]]:
    """Name and shape of one of a model's inputs or outputs; free dimensions are names or None."""
    if node.type != "tensor(float)":
        raise ValueError(f"{path}: {what} {node.name}: expected float32, got {node.type}")
    return str(node.name), tuple(node.shape)
