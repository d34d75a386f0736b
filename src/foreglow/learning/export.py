"""Writing the classifier as ONNX, laid out so that ONNX Runtime's blocked convolutions run well.

The graph computes what `Layers` says, in an arrangement of its own. All of it is exact:

- The last row and column of conv4 are never pooled (23 is odd), so the last two rows and columns of the crop are
  read by nothing that counts: they are cut off, which saves 7 % of everything.
- A narrow convolution followed by the largest of 2x2 is written as one convolution of stride 2 with four times the
  channels, one for each place in the 2x2, and the largest over these four ("phases"). ONNX Runtime computes 8 or 16
  channels at the price of one, and a narrow layer leaves most of them idle.
- conv1, when it precedes such a layer, is written in phases too, so that conv2 reads them with filters of 2x2.
- Channel counts above 8 are filled up to multiples of four with zeros, without which a slower convolution is taken.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from foreglow.files import write_atomic
from foreglow.learning.layers import NUM_CONVOLUTIONS, POOLED, SIZE_PX, Layers

if TYPE_CHECKING:
    from onnx import ModelProto

# ReduceMax still has its axes as an attribute; read by every ONNX Runtime since 1.12.
_OPSET, _IR_VERSION = 17, 8
_READ_PX = SIZE_PX - 2
_MAX_CHANNELS_IN_PHASES = 12
_MAX_UNFILLED_CHANNELS = 8


def write_onnx(layers: Layers, path: Path, metadata: Mapping[str, str]) -> None:
    """Writes the network to `path`, replacing what is there only once the new file is complete.

    The model reads `crops`, float32 (N, 1, 64, 64), and writes `logits`, float32 (N, 1). Equal layers and metadata
    give equal bytes.

    Raises:
        OSError: If the file cannot be written; nothing is left behind then.
    """
    write_atomic(path, build_onnx(layers, metadata).SerializeToString(deterministic=True))


def build_onnx(layers: Layers, metadata: Mapping[str, str]) -> ModelProto:
    """The network as an ONNX model."""
    from onnx import TensorProto, checker, helper

    graph = _Graph()
    layers = _filled_up(layers)
    name, size_px = graph.cut("crops", _READ_PX), _READ_PX
    is_first_in_phases = _is_narrow(layers, 0) and _is_narrow(layers, 1)
    for index in range(NUM_CONVOLUTIONS):
        weight, bias = layers.weights[index], layers.biases[index]
        size_px -= weight.shape[2] - 1
        if index == 0 and is_first_in_phases:
            name = graph.convolution(name, in_phases(weight), np.tile(bias, 4), stride=2)
        elif index in POOLED and _is_narrow(layers, index):
            reads_phases = index == 1 and is_first_in_phases
            filters = between_phases(weight) if reads_phases else in_phases(weight)
            name = graph.convolution(name, filters, np.tile(bias, 4), stride=1 if reads_phases else 2)
            size_px //= 2
            name = graph.largest_phase(name, len(bias), size_px)
        else:
            name = graph.convolution(name, weight, bias, stride=1)
            if index in POOLED:
                size_px //= 2
                name = graph.node("MaxPool", name, kernel_shape=[2, 2], strides=[2, 2])
    name = graph.node("Flatten", graph.node("AveragePool", name, kernel_shape=[size_px, size_px]))
    for weight, bias in zip(layers.weights[NUM_CONVOLUTIONS:-1], layers.biases[NUM_CONVOLUTIONS:-1], strict=True):
        name = graph.node("Relu", graph.linear(name, weight, bias))
    graph.linear(name, layers.weights[-1], layers.biases[-1], output="logits")

    model = helper.make_model(
        helper.make_graph(
            graph.nodes,
            "foreglow_classifier",
            [helper.make_tensor_value_info("crops", TensorProto.FLOAT, ["N", 1, SIZE_PX, SIZE_PX])],
            [helper.make_tensor_value_info("logits", TensorProto.FLOAT, ["N", 1])],
            graph.constants,
        ),
        producer_name="foreglow",
        opset_imports=[helper.make_opsetid("", _OPSET)],
        ir_version=_IR_VERSION,
    )
    helper.set_model_props(model, dict(sorted(metadata.items())))
    checker.check_model(model)
    return model


def in_phases(weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Filters of stride 2 that compute a convolution at the four places of each 2x2.

    Args:
        weight: Shape (C, inputs, side, side).

    Returns:
        Shape (4 C, inputs, side + 1, side + 1): first all channels at the upper left, then upper right, lower left,
        lower right.
    """
    channels, inputs, side, _ = weight.shape
    result = np.zeros((4, channels, inputs, side + 1, side + 1))
    for phase in range(4):
        row, column = divmod(phase, 2)
        result[phase, :, :, row : row + side, column : column + side] = weight
    return result.reshape(4 * channels, inputs, side + 1, side + 1)


def between_phases(weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Filters of 2x2 that read an input in phases and compute a 3x3 convolution in phases.

    Args:
        weight: Shape (C, inputs, 3, 3).

    Returns:
        Shape (4 C, 4 inputs, 2, 2), phases ordered as in `in_phases` on both sides.
    """
    channels, inputs = weight.shape[:2]
    result = np.zeros((4, channels, 4, inputs, 2, 2))
    for phase in range(4):
        for tap in range(9):
            row, column = (place + shift for place, shift in zip(divmod(phase, 2), divmod(tap, 3), strict=True))
            read_phase = 2 * (row % 2) + column % 2
            result[phase, :, read_phase, :, row // 2, column // 2] = weight[:, :, tap // 3, tap % 3]
    return result.reshape(4 * channels, 4 * inputs, 2, 2)


def _is_narrow(layers: Layers, index: int) -> bool:
    return len(layers.biases[index]) <= _MAX_CHANNELS_IN_PHASES


def _filled_up(layers: Layers) -> Layers:
    """`layers` with dead channels, so that every convolution but the last has up to 8 or a multiple of four."""
    weights, biases = list(layers.weights), list(layers.biases)
    for index in range(NUM_CONVOLUTIONS - 1):
        num_channels = len(biases[index])
        if num_channels <= _MAX_UNFILLED_CHANNELS:
            continue
        num_added = -num_channels % 4
        biases[index] = np.pad(biases[index], (0, num_added))
        weights[index] = np.pad(weights[index], ((0, num_added), (0, 0), (0, 0), (0, 0)))
        weights[index + 1] = np.pad(weights[index + 1], ((0, 0), (0, num_added), (0, 0), (0, 0)))
    return Layers(tuple(weights), tuple(biases))


class _Graph:
    """Nodes and constants of an ONNX graph under construction; every method returns the name of a result."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def node(self, operator: str, *inputs: str, output: str = "", **attributes: Any) -> str:
        from onnx import helper

        output = output or f"{operator.lower()}{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, list(inputs), [output], name=output, **attributes))
        return output

    def constant(self, values: NDArray[Any] | list[int]) -> str:
        from onnx import numpy_helper

        array = np.array(values, np.int64) if isinstance(values, list) else np.ascontiguousarray(values, np.float32)
        name = f"constant{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(array, name))
        return name

    def cut(self, name: str, size_px: int) -> str:
        """The first `size_px` rows and columns."""
        bounds = (self.constant(values) for values in ([0, 0], [size_px, size_px], [2, 3]))
        return self.node("Slice", name, *bounds)

    def convolution(self, name: str, weight: NDArray[Any], bias: NDArray[Any], stride: int) -> str:
        """A convolution and ReLU."""
        result = self.node(
            "Conv",
            name,
            self.constant(weight),
            self.constant(bias),
            kernel_shape=list(weight.shape[2:]),
            strides=[stride, stride],
        )
        return self.node("Relu", result)

    def largest_phase(self, name: str, num_channels: int, size_px: int) -> str:
        shape = self.constant([0, 4, num_channels, size_px, size_px])
        return self.node("ReduceMax", self.node("Reshape", name, shape), axes=[1], keepdims=0)

    def linear(self, name: str, weight: NDArray[Any], bias: NDArray[Any], output: str = "") -> str:
        return self.node("Gemm", name, self.constant(weight), self.constant(bias), output=output, transB=1)
