"""The size of a model, counted on its graph."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx")

from onnx import TensorProto, helper, numpy_helper, save

from foreglow.lab.learning.export import write_onnx
from foreglow.lab.learning.model_counts import count_model
from tests.lab.learning.networks import random_layers

pytestmark = pytest.mark.torch


def test_the_published_architecture(tmp_path: Path) -> None:
    """Wide layers are written as they are; only the rows and columns that nothing reads are cut off before."""
    layers = random_layers((32, 64, 64, 128, 128, 256, 128, 64))
    write_onnx(layers, tmp_path / "model.onnx", {})
    counts = count_model(tmp_path / "model.onnx")
    assert counts.num_parameters == layers.num_parameters
    assert 0.9 * layers.num_multiply_adds < counts.num_multiply_adds < layers.num_multiply_adds


def test_a_depthwise_convolution_and_a_product(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    constants = {
        "filters": random.normal(size=(4, 1, 3, 3)).astype(np.float32),
        "shape": np.array([-1, 4 * 6 * 6]),
        "matrix": random.normal(size=(144, 2)).astype(np.float32),
    }
    nodes = [
        helper.make_node("Conv", ["crops", "filters"], ["a"], group=4),
        helper.make_node("Reshape", ["a", "shape"], ["b"]),
        helper.make_node("Identity", ["matrix"], ["weights"]),
        helper.make_node("MatMul", ["b", "weights"], ["logits"]),
    ]
    graph = helper.make_graph(
        nodes,
        "g",
        [helper.make_tensor_value_info("crops", TensorProto.FLOAT, ["N", 4, 8, 8])],
        [helper.make_tensor_value_info("logits", TensorProto.FLOAT, ["N", 2])],
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )
    save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)]), tmp_path / "model.onnx")
    counts = count_model(tmp_path / "model.onnx")
    assert counts.num_multiply_adds == 6 * 6 * 4 * 9 + 144 * 2
    assert counts.num_parameters == 4 * 9 + 144 * 2


def test_no_model(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no such file, expected an ONNX model"):
        count_model(tmp_path / "absent.onnx")
    (tmp_path / "broken.onnx").write_bytes(b"\x0a\xff\xff")
    with pytest.raises(ValueError, match=r"broken\.onnx: expected an ONNX model"):
        count_model(tmp_path / "broken.onnx")
