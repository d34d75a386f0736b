"""Models of anything but tensors of numbers are refused before a session is made."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest

from foreglow.classifier import OnnxClassifier
from foreglow.classifier.operations import OPERATIONS, check_operations
from foreglow.classifier.session import open_session
from foreglow.config import ClassifierConfig
from foreglow.models import BUNDLED, model_path

onnx = pytest.importorskip("onnx")

from onnx import TensorProto, helper, numpy_helper  # noqa: E402

TEXT = onnx.TensorProto(name="text", data_type=TensorProto.STRING, dims=[1], string_data=[b"x"])
SPARSE = helper.make_sparse_tensor(
    helper.make_tensor("values", TensorProto.FLOAT, [1], [1.0]),
    helper.make_tensor("indices", TensorProto.INT64, [1], [0]),
    [40_000, 40_000],
)
NUMBERS = helper.make_tensor_type_proto(TensorProto.FLOAT, ["N"])
MEAN = helper.make_node("ReduceMean", ["crops"], ["logits"], axes=[1, 2, 3], keepdims=0)
ABS = helper.make_node("Abs", ["logits"], ["other"])


def model_of(*nodes: Any) -> Any:
    """A model that can be run if the nodes can."""
    crops = helper.make_tensor_value_info("crops", TensorProto.FLOAT, ["N", 1, 16, 16])
    logits = helper.make_tensor_value_info("logits", TensorProto.FLOAT, ["N"])
    graph = helper.make_graph([MEAN, *nodes], "graph", [crops], [logits])
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


def with_value(field: str, kind: Any) -> Any:
    model = model_of()
    getattr(model.graph, field).append(helper.make_value_info("more", kind))
    return model


def with_initializer(field: str, tensor: Any) -> Any:
    model = model_of()
    getattr(model.graph, field).append(tensor)
    return model


def in_branch(node: Any) -> Any:
    branch = helper.make_graph([node], "branch", [], [helper.make_tensor_value_info("y", TensorProto.FLOAT, ["N"])])
    condition = helper.make_node("Constant", [], ["is"], value=numpy_helper.from_array(np.array(True)))
    return model_of(condition, helper.make_node("If", ["is"], ["y"], then_branch=branch, else_branch=branch))


def node(name: str, *inputs: str, domain: str = "", **attributes: Any) -> Any:
    return helper.make_node(name, list(inputs), ["y"], domain=domain, **attributes)


@pytest.mark.parametrize(
    ("make", "found"),
    [
        (lambda: with_value("input", helper.make_tensor_type_proto(TensorProto.STRING, [1])), "a tensor of texts"),
        (lambda: with_value("output", helper.make_tensor_type_proto(TensorProto.STRING, [1])), "a tensor of texts"),
        (lambda: with_value("value_info", helper.make_tensor_type_proto(TensorProto.STRING, [1])), "tensor of texts"),
        (lambda: with_value("input", helper.make_sequence_type_proto(NUMBERS)), "a value that is a sequence"),
        (lambda: with_value("value_info", helper.make_optional_type_proto(NUMBERS)), "a value that is a sequence"),
        (lambda: with_value("value_info", helper.make_map_type_proto(TensorProto.INT64, NUMBERS)), "a value that is a"),
        (
            lambda: with_value("input", helper.make_sparse_tensor_type_proto(TensorProto.FLOAT, [9])),
            "a value that is a sequence, a map, optional or sparse",
        ),
        (lambda: with_initializer("initializer", TEXT), "a tensor of texts"),
        (lambda: with_initializer("sparse_initializer", SPARSE), "a sparse tensor"),
        (lambda: model_of(node("Constant", value=TEXT)), "a tensor of texts"),
        (lambda: model_of(node("Constant", value_string="x")), "a Constant of texts"),
        (lambda: model_of(node("Constant", value_strings=["x", "y"])), "a Constant of texts"),
        (lambda: model_of(node("Constant", sparse_value=SPARSE)), "a sparse tensor"),
        (lambda: model_of(node("ConstantOfShape", "shape", value=TEXT)), "a tensor of texts"),
        (lambda: model_of(node("Cast", "logits", to=TensorProto.STRING)), "a Cast to texts"),
        (lambda: in_branch(node("Cast", "logits", to=TensorProto.STRING)), "a Cast to texts"),
        (lambda: in_branch(node("SplitToSequence", "logits")), "the operation 'SplitToSequence'"),
        (lambda: model_of(node("Optional", "logits")), "the operation 'Optional'"),
        (lambda: model_of(node("NonZero", "logits")), "the operation 'NonZero'"),
        (lambda: model_of(node("StringNormalizer", "text")), "the operation 'StringNormalizer'"),
        (lambda: model_of(node("Abs", "logits", domain="ai.onnx.ml")), "of the domain 'ai.onnx.ml'"),
        (lambda: model_of(node("Loop\n\x1b[31m" + "x" * 1000)), r"the operation 'Loop\\n\\x1b"),
    ],
)
def test_other_values_than_numbers_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, make: Callable[[], Any], found: str
) -> None:
    monkeypatch.setattr(onnxruntime, "InferenceSession", lambda *_, **__: pytest.fail("a session was made"))
    path = tmp_path / "model.onnx"
    path.write_bytes(make().SerializeToString())
    with pytest.raises(ValueError, match="expected a model of .*numbers.*, got .*" + found) as caught:
        OnnxClassifier(ClassifierConfig(model=path))
    assert str(caught.value).startswith(f"{path}: ")
    assert len(str(caught.value)) < len(str(path)) + 200
    assert "\n" not in str(caught.value)


def test_a_text_in_more_bits_than_protobuf_reads() -> None:
    """Of a whole number of 32 bits, others read the last bits."""
    content = model_of(node("Constant", value=TEXT)).SerializeToString()
    plain = bytes([0x10, TensorProto.STRING])  # field 2, the type of the elements
    assert content.count(plain) == 1
    tensor = TEXT.SerializeToString()
    longer = tensor.replace(plain, bytes([0x10, TensorProto.STRING | 0x80, 0x80, 0x80, 0x80, 0x10]))
    assert onnx.TensorProto.FromString(longer).data_type == TensorProto.STRING
    model = model_of()
    graph = model.graph.SerializeToString() + bytes([0x2A, len(longer)]) + longer  # field 5, an initializer
    with pytest.raises(ValueError, match="got a tensor of texts"):
        check_operations(memoryview(bytes([0x3A, len(graph) & 0x7F | 0x80, len(graph) >> 7]) + graph))


def test_a_graph_in_a_field_that_others_read_as_the_graph() -> None:
    graph = model_of(node("SplitToSequence", "logits")).graph.SerializeToString()
    key = bytes([0x3A | 0x80, 0x80, 0x80, 0x80, 0x10])  # field 7 + 2^29
    size = bytes([len(graph) & 0x7F | 0x80, len(graph) >> 7])
    with pytest.raises(ValueError, match=r"expected an ONNX model that can be run: field .*: expected a number"):
        check_operations(memoryview(key + size + graph))


def test_whatever_its_name_a_model_is_read_as_what_was_checked(tmp_path: Path) -> None:
    """ONNX Runtime reads `.ort` as a format of its own, of which nothing is checked."""
    path = tmp_path / "model.ort"
    path.write_bytes(model_of().SerializeToString())
    (logits,) = open_session(path, num_threads=1).run(None, {"crops": np.ones((2, 1, 16, 16), np.float32)})
    assert logits.tolist() == [1, 1]


def test_usual_models_are_taken(tmp_path: Path) -> None:
    check_operations(memoryview(model_path(Path(BUNDLED)).read_bytes()))
    half = [helper.make_node("Cast", ["logits"], ["half"], to=TensorProto.FLOAT16)]
    check_operations(memoryview(in_branch(node("Softmax", "logits")).SerializeToString()))
    path = tmp_path / "model.onnx"
    path.write_bytes(model_of(*half, ABS).SerializeToString())
    OnnxClassifier(ClassifierConfig(model=path))


def test_no_operation_makes_anything_but_tensors() -> None:
    """Of what ONNX knows; an operation that hands on what it is given has nothing else to hand on."""
    known = {schema.name: schema for schema in onnx.defs.get_all_schemas() if schema.domain == ""}
    assert known.keys() >= OPERATIONS
    for name in sorted(OPERATIONS - {"Identity", "If"}):
        schema = known[name]
        kinds = {constraint.type_param_str: constraint.allowed_type_strs for constraint in schema.type_constraints}
        given = {value.type_str for value in schema.inputs}
        for output in schema.outputs:
            made = kinds.get(output.type_str, [output.type_str])
            assert all(kind.startswith("tensor(") for kind in made), name
            is_handed_on = output.type_str in given or name in ("Cast", "Constant", "ConstantOfShape")
            assert is_handed_on or "tensor(string)" not in made, name
