"""Whole numbers are divided by constants other than 0 and -1, or the model is refused: the process would end."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foreglow.classifier import OnnxClassifier
from foreglow.config import ClassifierConfig
from foreglow.models import BUNDLED, model_path

onnx = pytest.importorskip("onnx")

from onnx import TensorProto, helper, numpy_helper  # noqa: E402

LEAST = np.array([-(2**63)], np.int64)


def written(path: Path, nodes: list[Any], constants: dict[str, Any], **settings: Any) -> Path:
    """A model whose logits are the means of the crops, beside which `nodes` make `quotient` of `constants`."""
    crops = helper.make_tensor_value_info("crops", TensorProto.FLOAT, ["N", 1, 16, 16])
    logits = helper.make_tensor_value_info("logits", TensorProto.FLOAT, ["N"])
    mean = helper.make_node("ReduceMean", ["crops"], ["mean"], axes=[1, 2, 3], keepdims=0)
    last = [
        helper.make_node("Cast", ["quotient"], ["number"], to=TensorProto.FLOAT),
        helper.make_node("ReduceMax", ["number"], ["greatest"], keepdims=0),
        helper.make_node("Add", ["mean", "greatest"], ["logits"]),
    ]
    tensors = [
        each if isinstance(each, onnx.TensorProto) else numpy_helper.from_array(np.asarray(each), name)
        for name, each in constants.items()
    ]
    graph = helper.make_graph([mean, *nodes, *last], "graph", [crops], [logits], tensors)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8, **settings)
    path.write_bytes(model.SerializeToString())
    return path


def divided(path: Path, divisor: Any, dividend: Any = LEAST) -> Path:
    division = helper.make_node("Div", ["dividend", "divisor"], ["quotient"])
    return written(path, [division], {"dividend": dividend, "divisor": divisor})


def tensor(kind: int, *numbers: int, dims: list[int] | None = None, **fields: Any) -> Any:
    """A divisor whose numbers are in a list of their own, instead of in `raw_data`."""
    made = helper.make_tensor("divisor", kind, dims or [len(numbers)], numbers) if numbers else onnx.TensorProto()
    made.MergeFrom(onnx.TensorProto(name="divisor", data_type=kind, **fields))
    return made


def of_constant(path: Path, *divisor: int) -> Path:
    constant = helper.make_node("Constant", [], ["divisor"], value=numpy_helper.from_array(np.array(divisor, np.int64)))
    division = helper.make_node("Div", ["dividend", "divisor"], ["quotient"])
    return written(path, [constant, division], {"dividend": LEAST})


def of_shape(path: Path, factor: int) -> Path:
    """A divisor that is the number of channels, 1, times a factor."""
    nodes = [
        helper.make_node("Shape", ["crops"], ["shape"]),
        helper.make_node("Gather", ["shape", "index"], ["channels"]),
        helper.make_node("Mul", ["channels", "factor"], ["divisor"]),
        helper.make_node("Div", ["dividend", "divisor"], ["quotient"]),
    ]
    return written(
        path, nodes, {"index": np.array([1], np.int64), "factor": np.array([factor], np.int64), "dividend": LEAST}
    )


def in_branch(path: Path, divisor: str) -> Path:
    """A division in a branch, by a value of the graph around it."""
    division = helper.make_node("Div", ["dividend", divisor], ["y"])
    branch = helper.make_graph([division], "branch", [], [helper.make_tensor_value_info("y", TensorProto.INT64, [1])])
    nodes = [
        helper.make_node("Identity", ["divisor"], ["computed"]),
        helper.make_node("If", ["is"], ["quotient"], then_branch=branch, else_branch=branch),
    ]
    return written(path, nodes, {"is": np.array(True), "divisor": np.array([3], np.int64), "dividend": LEAST})


def of_two(path: Path) -> Path:
    """Two tensors of one name, of which a reader takes the one or the other."""
    model = onnx.load(divided(path, np.array([3], np.int64)))
    model.graph.initializer.append(numpy_helper.from_array(np.array([-1], np.int64), "divisor"))
    path.write_bytes(model.SerializeToString())
    return path


@pytest.mark.parametrize(
    ("make", "found"),
    [
        (lambda path: divided(path, np.array([-1], np.int64)), "'divisor' with 0 or -1"),
        (lambda path: divided(path, np.array([2, 0], np.int64)), "'divisor' with 0 or -1"),
        (
            lambda path: divided(path, np.array([-1], np.int32), np.array([-(2**31)], np.int32)),
            "'divisor' with 0 or -1",
        ),
        (lambda path: divided(path, tensor(TensorProto.INT64, 3, -1)), "'divisor' with 0 or -1"),
        (
            lambda path: divided(path, tensor(TensorProto.INT32, -1), np.array([-(2**31)], np.int32)),
            "'divisor' with 0 or -1",
        ),
        (lambda path: divided(path, tensor(TensorProto.INT64, dims=[1])), "'divisor' without its numbers"),
        (
            lambda path: divided(path, tensor(TensorProto.INT64, *range(1, 5000))),
            "more than 4096 bytes of them in 'divisor'",
        ),
        (lambda path: of_constant(path, -1), "'divisor' with 0 or -1"),
        (lambda path: of_shape(path, -1), "'divisor', which is computed, of 'tensor\\(int64\\)'"),
        (lambda path: in_branch(path, "computed"), "'computed', which is computed, in a branch"),
        (of_two, "'divisor' with 0 or -1"),
    ],
)
def test_a_division_that_would_end_the_process(tmp_path: Path, make: Callable[[Path], Path], found: str) -> None:
    path = make(tmp_path / "model.onnx")
    expected = "expected a model that divides whole numbers by constants other than 0 and -1, got .*"
    with pytest.raises(ValueError, match=expected + found) as caught:
        OnnxClassifier(ClassifierConfig(model=path))
    assert str(caught.value).startswith(f"{path}: ")


def floats(path: Path, kind: int = TensorProto.FLOAT) -> Path:
    """As a norm is divided by."""
    nodes = [
        helper.make_node("Cast", ["crops"], ["narrow"], to=kind),
        helper.make_node("ReduceSum", ["narrow"], ["norm"], keepdims=1),
        helper.make_node("Div", ["narrow", "norm"], ["quotient"]),
    ]
    return written(path, nodes, {})


@pytest.mark.parametrize(
    "make",
    [
        floats,
        lambda path: floats(path, TensorProto.FLOAT16),
        lambda path: floats(path, TensorProto.DOUBLE),
        lambda path: divided(path, np.array([2], np.int64)),
        lambda path: divided(path, tensor(TensorProto.INT64, -2, 2**32 - 1)),
        lambda path: divided(path, np.array([0], np.float32), np.array([1], np.float32)),
        lambda path: of_constant(path, 2, 3),
        lambda path: in_branch(path, "divisor"),
    ],
)
def test_other_divisions_are_done(tmp_path: Path, make: Callable[[Path], Path]) -> None:
    session = OnnxClassifier(ClassifierConfig(model=make(tmp_path / "model.onnx")))._session
    assert session.run(None, {"crops": np.ones((2, 1, 16, 16), np.float32)})[0].shape == (2,)


def test_a_model_with_its_weights_beside_it(tmp_path: Path) -> None:
    """As torch writes larger ones: they are found from the copy without divisions, too."""
    path = floats(tmp_path / "model.onnx")
    model = onnx.load(path)
    model.graph.initializer.append(numpy_helper.from_array(np.ones(1000, np.float32), "weights"))
    model.graph.node.insert(1, helper.make_node("ReduceSum", ["weights"], ["sum"], keepdims=0))
    model.graph.node.insert(2, helper.make_node("Div", ["mean", "sum"], ["mean2"]))
    onnx.save(model, path, save_as_external_data=True, location="weights.bin", size_threshold=0)
    assert (tmp_path / "weights.bin").stat().st_size == 4000
    OnnxClassifier(ClassifierConfig(model=path))


def test_the_process_goes_on(tmp_path: Path) -> None:
    code = (
        "import sys; from foreglow.config import ClassifierConfig; from foreglow.classifier import OnnxClassifier\n"
        "try:\n    OnnxClassifier(ClassifierConfig(model=sys.argv[1]))\nexcept ValueError:\n    sys.exit(7)"
    )
    for path in (of_shape(tmp_path / "a.onnx", -1), divided(tmp_path / "b.onnx", np.array([-1], np.int64))):
        assert subprocess.run([sys.executable, "-c", code, path]).returncode == 7


def test_the_model_that_ships_is_taken() -> None:
    OnnxClassifier(ClassifierConfig(model=model_path(Path(BUNDLED))))
