"""Export of the paper's classifier as ONNX, arranged so that ONNX Runtime's blocked convolutions run fast.

The graph computes what `Layers` describes, rearranged without approximation:

- The last row and column of conv4 are never pooled (23 is odd), so the last two rows and columns of the crop have no
  influence: they are cut off, which saves 7 % of the computation.
- A narrow convolution followed by max pooling over 2x2 is written as one convolution of stride 2 with four times the
  channels, one for each position ("phase") in the 2x2, and a maximum over the phases. ONNX Runtime computes 8 or 16
  channels at the price of one, and a narrow layer leaves most of them idle.
- conv1, when it precedes such a layer, is written in phases too: its block is fuller, and conv2 has small filters.
- Channel counts above 8 are padded with zeros to multiples of four; otherwise a slower convolution is chosen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from foreglow.whole_files import write_atomic

if TYPE_CHECKING:
    from onnx import ModelProto

SIZE_PX = 64
"""Side of the crops that the network reads."""

NUM_CONVOLUTIONS = 6
"""The first six layers are convolutions, the last three are fully connected."""

POOLED = (1, 3)
"""Indices of the convolutions that are followed by max pooling over 2x2 (paper: conv2 and conv4)."""

# Side of each convolution's output, to count operations: 64 -> 60 -> 58 | 29 -> 25 -> 23 | 11 -> 7 -> 5.
_OUTPUT_SIZES_PX = (60, 58, 25, 23, 7, 5)

_NAMES = (*(f"conv{i}" for i in range(1, 7)), *(f"int_out.afc{i}" for i in range(1, 4)))

# torch's default, which the published code uses.
_BATCH_NORM_EPS = 1e-5

# Far below the resolution of float32 sums (1e-7 of a value around 1), and its square is still a normal float32.
_DUST = 1e-18


@dataclass(frozen=True, slots=True, eq=False)
class Layers:
    """Weights and biases of the nine layers; ReLU follows all but the last, a mean over 5x5 follows the sixth.

    Attributes:
        weights: Six of shape (outputs, inputs, side, side), three of shape (outputs, inputs), float64.
        biases: Nine of shape (outputs,), float64.
    """

    weights: tuple[NDArray[np.float64], ...]
    biases: tuple[NDArray[np.float64], ...]

    @property
    def num_channels(self) -> tuple[int, ...]:
        """Channels of the eight hidden layers."""
        return tuple(len(bias) for bias in self.biases[:-1])

    @property
    def num_parameters(self) -> int:
        """Number of weights and biases."""
        return sum(weight.size for weight in self.weights) + sum(bias.size for bias in self.biases)

    @property
    def num_multiply_adds(self) -> int:
        """Multiplications with a weight for one crop."""
        areas = [*(side**2 for side in _OUTPUT_SIZES_PX), 1, 1, 1]
        return sum(weight.size * area for weight, area in zip(self.weights, areas, strict=True))

    def without(self, index: int, is_kept: NDArray[np.bool_], constants: NDArray[np.float64]) -> Layers:
        """The network with some channels of hidden layer `index` replaced by constants.

        No convolution is padded, so a constant channel adds the same to every output of the next layer: the sum of the
        weights that read it, times its value.

        Args:
            index: The hidden layer, 0 to 7.
            is_kept: Shape (channels,).
            constants: Shape (channels,): value of each channel after ReLU and pooling, for those that are not kept.
        """
        reader = self.weights[index + 1]
        weights, biases = list(self.weights), list(self.biases)
        weights[index], biases[index] = weights[index][is_kept], biases[index][is_kept]
        weights[index + 1] = reader[:, is_kept]
        biases[index + 1] = biases[index + 1] + _summed(reader)[:, ~is_kept] @ constants[~is_kept]
        return replace(self, weights=tuple(weights), biases=tuple(biases))


def layers_from_state(state: Mapping[str, NDArray[Any]]) -> Layers:
    """The layers of a state dict of `networks.ArtifactNetwork` in evaluation mode.

    Each batch normalisation, a scale and a shift of every channel, is folded into the layer that reads it. This is
    exact, since no convolution is padded.
    """
    values = {name: np.asarray(value, np.float64) for name, value in state.items()}
    weights = [values[f"{name}.weight"] for name in _NAMES]
    biases = [values.get(f"{name}.bias", np.zeros(len(values[f"{name}.weight"]))) for name in _NAMES]
    for number in (2, 4, 6):
        norm = f"batch{number}"
        scales = values[f"{norm}.weight"] / np.sqrt(values[f"{norm}.running_var"] + _BATCH_NORM_EPS)
        shifts = values[f"{norm}.bias"] - scales * values[f"{norm}.running_mean"]
        # The layer after conv2 is conv3, whose index is 2.
        biases[number] = biases[number] + _summed(weights[number]) @ shifts
        weights[number] = weights[number] * scales.reshape(1, -1, *[1] * (weights[number].ndim - 2))
    return Layers(tuple(_without_dust(weight) for weight in weights), tuple(_without_dust(bias) for bias in biases))


def _without_dust(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """`values` with zeros instead of numbers so small that they only make subnormal products.

    Weight decay leaves such numbers in dead channels, and subnormal numbers make the network 10 times slower.
    """
    return np.where(np.abs(values) < _DUST, 0.0, values)


def _summed(weight: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(weight.sum(axis=tuple(range(2, weight.ndim))))


# The last version in which ReduceMax has its axes as an attribute; read by every ONNX Runtime since 1.12.
OPSET, IR_VERSION = 17, 8
_READ_PX = SIZE_PX - 2
_MAX_CHANNELS_IN_PHASES = 12
_MAX_UNFILLED_CHANNELS = 8
# Channels that ONNX Runtime computes at a time with AVX-512.
_BLOCK = 16


def write_onnx(layers: Layers, path: Path, metadata: Mapping[str, str]) -> None:
    """Writes the network to `path` atomically.

    The model reads `crops`, float32 (N, 1, 64, 64), and writes `logits`, float32 (N, 1). Equal layers and metadata
    give equal bytes.

    Raises:
        OSError: If the file cannot be written.
    """
    write_atomic(path, build_onnx(layers, metadata).SerializeToString(deterministic=True))


def build_onnx(layers: Layers, metadata: Mapping[str, str]) -> ModelProto:
    """The network as an ONNX model."""
    graph = Graph()
    layers = _filled_up(layers)
    name, size_px = graph.cut("crops", _READ_PX), _READ_PX
    phases = (1, 1)  # of the image called `name`
    for index in range(NUM_CONVOLUTIONS):
        weight, bias = layers.weights[index], layers.biases[index]
        size_px -= weight.shape[2] - 1
        is_pooled_next = index == 0 and _is_narrow(layers, 0) and _is_narrow(layers, 1)
        if index in POOLED and _is_narrow(layers, index):
            name, phases = graph.convolution(name, weight, bias, phases, (2, 2)), (1, 1)
            size_px //= 2
            name = graph.largest_phase(name, len(bias), size_px)
        else:
            wanted = _phases_of_first(len(bias)) if is_pooled_next else (1, 1)
            name, phases = graph.convolution(name, weight, bias, phases, wanted), wanted
            if index in POOLED:
                size_px //= 2
                name = graph.node("MaxPool", name, kernel_shape=[2, 2], strides=[2, 2])
    name = graph.node("Flatten", graph.node("AveragePool", name, kernel_shape=[size_px, size_px]))
    for weight, bias in zip(layers.weights[NUM_CONVOLUTIONS:-1], layers.biases[NUM_CONVOLUTIONS:-1], strict=True):
        name = graph.node("Relu", graph.linear(name, weight, bias))
    graph.linear(name, layers.weights[-1], layers.biases[-1], output="logits")
    return graph.model({"crops": (1, SIZE_PX, SIZE_PX)}, {"logits": (1,)}, metadata)


def phase_filters(
    weight: NDArray[np.float64], reads: tuple[int, int] = (1, 1), writes: tuple[int, int] = (1, 1)
) -> NDArray[np.float64]:
    """Filters that compute the same convolution from an input in phases to an output in phases.

    An image in phases of (R, C) has the pixel (r, c) of each block of R x C pixels as channels of their own: channel
    (r C + c) x channels + channel. The stride that belongs to the filters is `writes` over `reads`, axis by axis.

    Args:
        weight: Shape (outputs, inputs, rows, columns).
        reads: Phases (rows, columns) of the input.
        writes: Phases of the output, whole multiples of those of the input.

    Returns:
        Shape (outputs x phases written, inputs x phases read, rows, columns), rows and columns in blocks read.
    """
    outputs, inputs, *sides = weight.shape
    cells = [-(-(write - 1 + side) // read) for side, read, write in zip(sides, reads, writes, strict=True)]
    result = np.zeros((*writes, outputs, *reads, inputs, *cells))
    for phase in np.ndindex(*writes):
        for tap in np.ndindex(*sides):
            (row, row_phase), (column, column_phase) = (
                divmod(at + shift, read) for at, shift, read in zip(phase, tap, reads, strict=True)
            )
            result[(*phase, slice(None), row_phase, column_phase, slice(None), row, column)] = weight[(..., *tap)]
    return result.reshape(outputs * writes[0] * writes[1], inputs * reads[0] * reads[1], *cells)


def _is_narrow(layers: Layers, index: int) -> bool:
    return len(layers.biases[index]) <= _MAX_CHANNELS_IN_PHASES


def _phases_of_first(num_channels: int) -> tuple[int, int]:
    """Phases of conv1 before a narrow conv2: two columns while their channels stay below one block of 16, else 2x2."""
    return (1, 2) if 2 * num_channels < _BLOCK else (2, 2)


def _filled_up(layers: Layers) -> Layers:
    """`layers` with zero channels added, so that every convolution but the last has up to 8 or a multiple of four."""
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


class Graph:
    """Nodes and constants of an ONNX graph under construction; every method returns the name of a result."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def node(self, operator: str, *inputs: str, output: str = "", **attributes: Any) -> str:
        """A node of the graph."""
        from onnx import helper

        output = output or f"{operator.lower()}{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, list(inputs), [output], name=output, **attributes))
        return output

    def constant(self, values: NDArray[Any] | list[int] | int) -> str:
        """A constant of the graph: float32 for an array, int64 for integers."""
        from onnx import numpy_helper

        array = (
            np.array(values, np.int64) if isinstance(values, (list, int)) else np.ascontiguousarray(values, np.float32)
        )
        name = f"constant{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(array, name))
        return name

    def cut(self, name: str, size_px: int) -> str:
        """The first `size_px` rows and columns."""
        bounds = (self.constant(values) for values in ([0, 0], [size_px, size_px], [2, 3]))
        return self.node("Slice", name, *bounds)

    def convolution(
        self, name: str, weight: NDArray[Any], bias: NDArray[Any], reads: tuple[int, int], writes: tuple[int, int]
    ) -> str:
        """A convolution and ReLU, from an image in phases `reads` to one in phases `writes`."""
        filters = phase_filters(weight, reads, writes)
        result = self.node(
            "Conv",
            name,
            self.constant(filters),
            self.constant(np.tile(bias, writes[0] * writes[1])),
            kernel_shape=list(filters.shape[2:]),
            strides=[write // read for read, write in zip(reads, writes, strict=True)],
        )
        return self.node("Relu", result)

    def largest_phase(self, name: str, num_channels: int, size_px: int) -> str:
        """The maximum over the four phases."""
        shape = self.constant([0, 4, num_channels, size_px, size_px])
        return self.node("ReduceMax", self.node("Reshape", name, shape), axes=[1], keepdims=0)

    def linear(self, name: str, weight: NDArray[Any], bias: NDArray[Any], output: str = "") -> str:
        """A fully connected layer."""
        return self.node("Gemm", name, self.constant(weight), self.constant(bias), output=output, transB=1)

    def model(
        self, inputs: Mapping[str, Sequence[int]], outputs: Mapping[str, Sequence[int]], metadata: Mapping[str, str]
    ) -> ModelProto:
        """The checked model of this graph; `inputs` and `outputs` have a shape by name, without the free first axis."""
        from onnx import TensorProto, checker, helper

        given, made = (
            [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["N", *shape]) for name, shape in shapes.items()]
            for shapes in (inputs, outputs)
        )
        model = helper.make_model(
            helper.make_graph(self.nodes, "foreglow_classifier", given, made, self.constants),
            producer_name="foreglow",
            opset_imports=[helper.make_opsetid("", OPSET)],
            ir_version=IR_VERSION,
        )
        helper.set_model_props(model, dict(sorted(metadata.items())))
        checker.check_model(model)
        return model
