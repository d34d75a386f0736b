"""A model's network in torch again, to go on training it. Importing this needs the `train` extra."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import numpy_helper
from torch import Tensor, nn

from foreglow.classifier import OnnxClassifier
from foreglow.classifier.inputs import InputSpec
from foreglow.config import ClassifierConfig
from foreglow.lab.learning.networks import BothNetwork, CompactNetwork, Hearing, RelatedNetwork, members_of
from foreglow.models import model_path
from foreglow.types import KINDS

_OPERATIONS = ("Conv", "Gemm", "MatMul")
"""The operations with weights."""


class FoldedNetwork(CompactNetwork):
    """A compact network whose normalisation is part of its convolutions, as in a model; training leaves it so.

    What was the normalisation is a scale and a shift for each channel, which are trained. Nothing is dropped out: the
    network in training computes what it does in use, as its teacher.
    """

    def train(self, mode: bool = True) -> Self:
        """As in `torch.nn.Module`, but in both modes the network computes the same."""
        super().train(mode)
        for layer in self.modules():
            if isinstance(layer, nn.BatchNorm2d | nn.Dropout | Hearing):
                layer.eval()
        return self


class FoldedRelatedNetwork(FoldedNetwork, RelatedNetwork):
    """The same of a network that compares the boxes of a frame."""


class FoldedBothNetwork(BothNetwork):
    """The mean of both; in training it computes what it does in use, too.

    Only the first network learns further, for the mean of both. How lamps stand to one another is learnt from many
    roads; from a user's few images, the second network would forget more than it gains.
    """

    def __init__(self, num_channels: int, num_features: int, num_outputs: int = 1) -> None:
        super().__init__(num_channels, num_features, num_outputs)
        self.alone = FoldedNetwork(num_channels, self.NUM_FEATURES_ALONE, num_outputs)
        self.related = FoldedRelatedNetwork(num_channels, num_features, num_outputs).requires_grad_(False)

    def learnt(self, crops: Tensor, features: Tensor, sizes: Sequence[int] | None = None) -> tuple[Tensor, ...]:
        """What it writes, so that nothing changes for the sake of samples on which both together are right."""
        return (self(crops, features, sizes),)


@dataclass(frozen=True, slots=True, eq=False)
class StartingPoint:
    """A model to go on from.

    Attributes:
        name: The path, or the name of a model that ships.
        network: Writes the model's logits of being light, or of all kinds.
        inputs: What it reads.
        digest: SHA-256 of the model's file.
        tells_direct: Whether the model also tells lamps from their light, by a logit that the network leaves out.
        has_kinds: Whether the model tells all kinds of light.
    """

    name: str
    network: FoldedNetwork | FoldedBothNetwork
    inputs: InputSpec
    digest: str
    tells_direct: bool
    has_kinds: bool


def read_model(model: Path) -> StartingPoint:
    """The network of a model of our recipes: of the one that ships, by its name, or of a file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is no model that the pipeline can run, of another network, or has weights that are not finite.
    """
    spec = OnnxClassifier(ClassifierConfig(model=model)).spec
    path = model_path(model)
    content = path.read_bytes()
    graph = onnx.load_model_from_string(content).graph
    constants = {tensor.name: numpy_helper.to_array(tensor) for tensor in graph.initializer}
    layers = [node for node in graph.node if node.op_type in _OPERATIONS]
    values: list[Any] = [constants.get(name) for node in layers for name in node.input[1:]]
    num_outputs = len(values[-1]) if values and values[-1] is not None else 0
    has_kinds = num_outputs == len(KINDS)
    network: FoldedNetwork | FoldedBothNetwork
    for make in (FoldedRelatedNetwork, FoldedBothNetwork) if spec.together else (FoldedNetwork,):
        network = make(spec.num_channels, spec.num_features, len(KINDS) if has_kinds else 1)
        wanted = [layer for member in members_of(network) for layer in _parameters(member)]
        is_alike = [node.op_type for node in layers] == [name for name, _ in wanted]
        if is_alike:
            break
    parameters = [parameter for _, layer in wanted for parameter in layer]
    is_alike = is_alike and len(values) == len(parameters)
    for parameter, value in zip(parameters, values, strict=False):
        is_alike = is_alike and value is not None and _fits(parameter, value)
    if not is_alike:
        raise ValueError(
            f"{path}: expected a model of the recipe foreglow, related or compact, whose network can be trained further"
        )
    for value in values:
        if not np.isfinite(value).all():
            raise ValueError(f"{path}: expected finite weights, got NaN or infinity")
    with torch.no_grad():
        for parameter, value in zip(parameters, values, strict=True):
            parameter.copy_(torch.from_numpy(np.array(value[: len(parameter)])))
        for layer in network.modules():
            if isinstance(layer, nn.BatchNorm2d) and layer.running_var is not None:
                layer.running_var.fill_(1 - layer.eps)
    digest = hashlib.sha256(content).hexdigest()
    return StartingPoint(str(model), network.eval(), spec, digest, num_outputs == 2, has_kinds)


def _parameters(network: Any) -> list[tuple[str, tuple[torch.Tensor, ...]]]:
    """Operation and parameters of each layer of a model; the bias of a convolution is that of its normalisation.

    Products without a bias read their weights transposed.
    """
    body: list[Any] = list(network.body)
    found: list[tuple[str, tuple[torch.Tensor, ...]]] = [
        ("Conv", (convolution.weight, norm.bias)) for convolution, norm in zip(body[0::3], body[1::3], strict=True)
    ]
    linear: list[Any] = [network.hidden]
    if isinstance(network, RelatedNetwork):
        linear.append(network.place)
        for each in network.rounds:
            linear += [each.hearer, each.teller, each.relation, each.update]
    for layer in (*linear, network.last):
        has_bias = layer.bias is not None
        found += [("Gemm", (layer.weight, layer.bias)) if has_bias else ("MatMul", (layer.weight.T,))]
    return found


def _fits(parameter: torch.Tensor, value: NDArray[Any]) -> bool:
    """Whether a model's constant is that of this parameter; the last layer may have a second output."""
    first = len(value) == len(parameter) or (len(value), len(parameter)) == (2, 1)
    return first and tuple(value.shape[1:]) == tuple(parameter.shape[1:])
