"""Export of our compact network as ONNX, with batch normalisation folded into the convolutions."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from foreglow.classifier import InputSpec
from foreglow.files import write_atomic
from foreglow.lab.learning.export import Graph

if TYPE_CHECKING:
    from onnx import ModelProto
    from torch import nn

    from foreglow.lab.learning.networks import CompactNetwork


def write_compact(network: CompactNetwork, spec: InputSpec, path: Path, metadata: Mapping[str, str]) -> None:
    """Writes `network` to `path` atomically.

    The model reads `crops`, float32 (N, C, S, S), and `features`, float32 (N, F), and writes `logits`, float32 (N, 1)
    or (N, 2). Its metadata describe its inputs.

    Raises:
        OSError: If the file cannot be written.
    """
    model = build_compact(network, spec, metadata)
    write_atomic(path, model.SerializeToString(deterministic=True))


def build_compact(network: CompactNetwork, spec: InputSpec, metadata: Mapping[str, str]) -> ModelProto:
    """`network` in evaluation mode as an ONNX model."""
    graph = Graph()
    name = "crops"
    for convolution, norm in _pairs(network.body):
        weight, bias = _folded(convolution, norm)
        side, stride = weight.shape[2], convolution.stride[0]
        name = graph.node(
            "Conv",
            name,
            graph.constant(weight),
            graph.constant(bias),
            kernel_shape=[side, side],
            strides=[stride, stride],
            pads=[side // 2] * 4,
        )
        name = graph.node("Relu", name)
    name = graph.node("Concat", graph.node("Flatten", name), "features", axis=1)
    name = graph.node("Relu", graph.linear(name, _array(network.hidden.weight), _array(network.hidden.bias)))
    graph.linear(name, _array(network.last.weight), _array(network.last.bias), output="logits")
    about = {"foreglow_version": version("foreglow"), "support": str(spec.support)}
    if spec.lag_s is not None:
        about["lag_s"] = repr(spec.lag_s)
    inputs = {"crops": (spec.num_channels, spec.size_px, spec.size_px), "features": (spec.num_features,)}
    return graph.model(inputs, {"logits": (network.last.out_features,)}, about | dict(metadata))


def _pairs(body: nn.Sequential) -> list[tuple[nn.Conv2d, nn.BatchNorm2d]]:
    """The convolutions with their batch normalisations; a ReLU follows each."""
    layers = list(body)
    return list(zip(layers[0::3], layers[1::3], strict=True))  # type: ignore[arg-type]


def _folded(convolution: nn.Conv2d, norm: nn.BatchNorm2d) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Weight and bias of the convolution with its batch normalisation folded in; exact up to rounding."""
    assert norm.running_var is not None
    assert norm.running_mean is not None
    scale = _array(norm.weight) / np.sqrt(_array(norm.running_var) + norm.eps)
    return _array(convolution.weight) * scale[:, None, None, None], _array(norm.bias) - scale * _array(
        norm.running_mean
    )


def _array(tensor: object) -> NDArray[np.float64]:
    return np.asarray(tensor.detach().cpu().double().numpy())  # type: ignore[attr-defined]
