"""Number of parameters and multiply-adds of an ONNX model, counted on its graph."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from foreglow.plugins import first_line_of

# Index of the weights among a node's inputs.
_CONVOLUTIONS = {"Conv": 1, "ConvInteger": 1, "QLinearConv": 3}
_PRODUCTS = {"Gemm": 1, "MatMul": 1, "MatMulInteger": 1, "QLinearMatMul": 3}
# Nodes that pass weights on without changing their number.
_PASSED_ON = ("DequantizeLinear", "QuantizeLinear", "Transpose", "Identity", "Cast", "Reshape")


@dataclass(frozen=True, slots=True)
class ModelCounts:
    """The size of a model.

    Attributes:
        num_parameters: Numbers among its constants that are multiplied or added, not shapes and the like.
        num_multiply_adds: Multiplications with a weight for one input (one crop), including those with padded zeros;
            where inputs are compared with one another, for one comparison.
    """

    num_parameters: int
    num_multiply_adds: int


def count_model(path: Path) -> ModelCounts:
    """The size of the ONNX model at `path`: its convolutions and matrix products.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not an ONNX model, or one of its shapes cannot be inferred.
        ModuleNotFoundError: If the `train` extra is not installed.
    """
    import onnx
    from google.protobuf.message import DecodeError

    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file, expected an ONNX model")
    try:
        graph = onnx.shape_inference.infer_shapes(onnx.load(path), data_prop=True).graph
    except (DecodeError, onnx.shape_inference.InferenceError) as error:
        raise ValueError(f"{path}: expected an ONNX model: {first_line_of(error)}") from error
    constants: dict[str, Any] = {tensor.name: tensor for tensor in graph.initializer}
    for node in graph.node:
        if node.op_type == "Constant":  # None for a plain number
            constants[node.output[0]] = next((entry.t for entry in node.attribute if entry.name == "value"), None)
    shapes = {value.name: _shape(value) for value in (*graph.value_info, *graph.output)}
    makers = {node.output[0]: node for node in graph.node}
    multiply_adds = 0
    for node in graph.node:
        index = (_CONVOLUTIONS | _PRODUCTS).get(node.op_type)
        weights = None if index is None else _weights(node.input[index], constants, makers)
        if weights is None:
            continue
        shape = shapes.get(node.output[0], ())
        is_convolution = node.op_type in _CONVOLUTIONS
        sides = shape[2:] if is_convolution else shape[1:-1]
        known = [side for side in sides if side is not None]
        if not shape or (is_convolution and len(known) < len(sides)):
            raise ValueError(f"{path}: {node.name or node.op_type}: expected an output of known shape, got {shape}")
        multiply_adds += math.prod(weights.dims) * math.prod(known)
    floats = (onnx.TensorProto.FLOAT, onnx.TensorProto.FLOAT16, onnx.TensorProto.BFLOAT16, onnx.TensorProto.INT8)
    parameters = sum(
        math.prod(tensor.dims) for tensor in constants.values() if tensor is not None and tensor.data_type in floats
    )
    return ModelCounts(parameters, multiply_adds)


def _weights(name: str, constants: dict[str, Any], makers: dict[str, Any]) -> Any:
    """The constant behind the value `name`, or None if it is computed from the input."""
    while name not in constants:
        maker = makers.get(name)
        if maker is None or maker.op_type not in _PASSED_ON:
            return None
        name = maker.input[0]
    return constants[name]


def _shape(value: Any) -> tuple[int | None, ...]:
    """The shape of a value, None for a side that is not a fixed number."""
    sides = value.type.tensor_type.shape.dim
    return tuple(side.dim_value if side.HasField("dim_value") else None for side in sides)
