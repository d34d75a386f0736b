"""Small models, each of which would take much memory or time to run."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any


def onnx_model(path: Path, nodes: list[Any], functions: tuple[Any, ...] = (), opset: int = 17) -> None:
    """A model of crops with these nodes, of which the last gives the logits."""
    from onnx import TensorProto, helper

    crops = helper.make_tensor_value_info("crops", TensorProto.FLOAT, ["N", 1, 64, 64])
    logits = helper.make_tensor_value_info("logits", TensorProto.FLOAT, ["N"])
    graph = helper.make_graph(nodes, "graph", [crops], [logits])
    imports = [helper.make_opsetid("", opset), helper.make_opsetid("own", 1)]
    model = helper.make_model(graph, opset_imports=imports, functions=functions, ir_version=8)
    path.write_bytes(model.SerializeToString())


def huge_tensor(path: Path) -> None:
    """The crops are repeated 2^30 times."""
    from onnx import helper

    names = ["crops", *(f"a{k}" for k in range(30))]
    doubled = [helper.make_node("Concat", [a, a], [b], axis=1) for a, b in itertools.pairwise(names)]
    onnx_model(path, [*doubled, helper.make_node("ReduceMean", [names[-1]], ["logits"], axes=[1, 2, 3], keepdims=0)])


def doubled_text(path: Path) -> None:
    """A letter is joined to itself 33 times."""
    from onnx import TensorProto, helper

    text = TensorProto(data_type=TensorProto.STRING, dims=[1], string_data=[b"x"])
    letter = helper.make_node("Constant", [], ["a0"], value=text)
    names = [f"a{k}" for k in range(34)]
    doubled = [helper.make_node("StringConcat", [a, a], [b]) for a, b in itertools.pairwise(names)]
    onnx_model(
        path, [letter, *doubled, *added_to_mean(helper.make_node("Equal", [names[-1]] * 2, ["extra"]))], opset=20
    )


def expanded_text(path: Path) -> None:
    """200,000 texts of 20,000 letters."""
    from onnx import TensorProto, helper

    text = TensorProto(data_type=TensorProto.STRING, dims=[1], string_data=[b"x" * 20_000])
    constants = [
        helper.make_node("Constant", [], ["text"], value=text),
        helper.make_node("Constant", [], ["shape"], value_ints=[200_000]),
    ]
    expanded = helper.make_node("Expand", ["text", "shape"], ["texts"])
    equal = helper.make_node("Equal", ["texts", "text"], ["extra"])
    onnx_model(path, [*constants, expanded, *added_to_mean(equal)], opset=20)


def split_nothing(path: Path) -> None:
    """A sequence of 40 million tensors, all without elements."""
    from onnx import helper

    nodes = [
        helper.make_node("Constant", [], ["shape"], value_ints=[40_000_000, 0]),
        helper.make_node("ConstantOfShape", ["shape"], ["empty"]),
        helper.make_node("SplitToSequence", ["empty"], ["sequence"], axis=0),
    ]
    onnx_model(path, [*nodes, *added_to_mean(helper.make_node("SequenceLength", ["sequence"], ["extra"]))])


def added_to_mean(node: Any) -> list[Any]:
    """Nodes that give the logits, of a node that gives something extra."""
    from onnx import TensorProto, helper

    return [
        node,
        helper.make_node("Cast", ["extra"], ["number"], to=TensorProto.FLOAT),
        helper.make_node("ReduceMax", ["number"], ["greatest"], keepdims=0),
        helper.make_node("Flatten", ["crops"], ["pixels"]),
        helper.make_node("ArgMax", ["pixels"], ["place"], axis=1, keepdims=0),
        helper.make_node("Cast", ["place"], ["value"], to=TensorProto.FLOAT),
        helper.make_node("Add", ["value", "greatest"], ["logits"]),
    ]


def endless_loop(path: Path) -> None:
    """A loop of 2^62 rounds, in a branch."""
    from onnx import TensorProto, helper

    rounds = helper.make_node("Constant", [], ["rounds"], value_int=2**62)
    keep = helper.make_node("Constant", [], ["keep"], value=helper.make_tensor("", TensorProto.BOOL, [], [True]))
    mean = helper.make_node("ReduceMean", ["crops"], ["mean"], axes=[1, 2, 3], keepdims=0)
    kept, values = (
        helper.make_tensor_value_info(name, kind, shape)
        for name, kind, shape in (("kept", TensorProto.BOOL, []), ("values", TensorProto.FLOAT, ["N"]))
    )
    number = helper.make_tensor_value_info("number", TensorProto.INT64, [])
    before = [helper.make_tensor_value_info("before", TensorProto.FLOAT, ["N"])]
    was_kept = [helper.make_tensor_value_info("was_kept", TensorProto.BOOL, [])]
    same = [helper.make_node("Identity", [a], [b]) for a, b in (("was_kept", "kept"), ("before", "values"))]
    body = helper.make_graph(same, "body", [number, *was_kept, *before], [kept, values])
    loop = helper.make_node("Loop", ["rounds", "keep", "mean"], ["looped"], body=body)
    branch = helper.make_graph(
        [loop], "branch", [], [helper.make_tensor_value_info("looped", TensorProto.FLOAT, ["N"])]
    )
    choice = helper.make_node("If", ["keep"], ["logits"], then_branch=branch, else_branch=branch)
    onnx_model(path, [rounds, keep, mean, choice])


def many_operations(path: Path) -> None:
    from onnx import helper

    names = ["mean", *(f"a{k}" for k in range(20_000)), "logits"]
    chain = [helper.make_node("Abs", [a], [b]) for a, b in itertools.pairwise(names)]
    onnx_model(path, [helper.make_node("ReduceMean", ["crops"], ["mean"], axes=[1, 2, 3], keepdims=0), *chain])


def own_functions(path: Path) -> None:
    """Each function calls the next twice."""
    from onnx import helper

    imports = [helper.make_opsetid("", 17), helper.make_opsetid("own", 1)]
    functions = tuple(
        helper.make_function("own", f"f{k}", ["x"], ["z"], [
            helper.make_node(f"f{k + 1}", ["x"], ["y"], domain="own"),
            helper.make_node(f"f{k + 1}", ["y"], ["z"], domain="own"),
        ] if k < 30 else [helper.make_node("Abs", ["x"], ["z"])], imports)
        for k in range(31)
    )  # fmt: skip
    mean = helper.make_node("ReduceMean", ["crops"], ["mean"], axes=[1, 2, 3], keepdims=0)
    onnx_model(path, [mean, helper.make_node("f0", ["mean"], ["logits"], domain="own")], functions)
