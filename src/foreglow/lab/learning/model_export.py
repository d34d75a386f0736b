"""Export of a trained network as the ONNX model of the pipeline: calibrated, and compared with torch."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from foreglow.classifier.inputs import InputSpec
from foreglow.classifier.session import open_session
from foreglow.lab.learning.export import Graph, layers_from_state, write_onnx
from foreglow.lab.learning.networks import (
    ArtifactNetwork,
    BothNetwork,
    CompactNetwork,
    RelatedNetwork,
    Round,
    members_of,
)
from foreglow.lab.learning.samples import Samples, set_bounds
from foreglow.lab.learning.scores import Calibrator
from foreglow.types import KINDS
from foreglow.whole_files import write_atomic

if TYPE_CHECKING:
    from onnx import ModelProto


MAX_DIFFERENCE = 1e-3
"""Largest permitted difference of exported logits from torch's, relative to 1 + their absolute value."""

LICENSE = "Apache-2.0"
"""Of a model, unless the metadata given say another."""


def calibrated(network: nn.Module, calibrator: Calibrator) -> nn.Module:
    """A copy of `network` with calibrated logits, by changing its last linear layer, or that of each of its members.

    Raises:
        ValueError: If the network has no such layer with a bias.
    """
    network = copy.deepcopy(network).eval()
    for member in members_of(network):
        linear = [layer for layer in member.modules() if isinstance(layer, nn.Linear)]
        last = member.last if isinstance(member, CompactNetwork) else linear[-1] if linear else None
        if last is None or last.bias is None or last.out_features not in (1, len(KINDS)):
            raise ValueError(f"network: expected a linear layer of 1 or {len(KINDS)} outputs, with a bias, at its end")
        with torch.no_grad():
            last.weight.div_(calibrator.temperature)
            last.bias.div_(calibrator.temperature)
            last.bias[: max(1, last.out_features - 1)].add_(calibrator.shift)
    return network


def write_model(network: nn.Module, spec: InputSpec, path: Path, metadata: Mapping[str, str]) -> None:
    """Writes `network`, in evaluation mode, to `path` as ONNX, atomically.

    Its metadata describe its inputs, name its outputs (`names`, JSON by number) and the licence (`license`).

    Raises:
        ValueError: If it is not one of the networks that can be exported.
        OSError: If it cannot be written.
    """
    members = [member for member in members_of(network) if isinstance(member, CompactNetwork)]
    num_outputs = members[0].last.out_features if members else 1
    names = KINDS if num_outputs == len(KINDS) else ("light_artifact",)
    metadata = {"names": json.dumps(dict(enumerate(names))), "license": LICENSE, **metadata}
    if isinstance(network, ArtifactNetwork):
        layers = layers_from_state({name: value.numpy() for name, value in network.state_dict().items()})
        write_onnx(layers, path, {"support": str(spec.support), **metadata})
    elif members:
        model = _our_model(members, spec, metadata)
        write_atomic(path, model.SerializeToString(deterministic=True))
    else:
        raise ValueError(f"network: expected one of networks.NETWORKS to export, got {type(network).__name__}")


def largest_difference(path: Path, samples: Samples, logits: NDArray[np.float32]) -> float:
    """Largest difference of the logits of the model at `path` from `logits`, shape (N, outputs), relative to 1 + size.

    The model is run set by set.

    Raises:
        ValueError: If the model cannot be run on these samples, or the difference is above `MAX_DIFFERENCE`.
    """
    session = open_session(path, num_threads=1)
    given: dict[str, NDArray[Any]] = {"crops": samples.crops.astype(np.float32) / 255, "features": samples.features}
    wanted = [node.name for node in session.get_inputs()]
    if not set(wanted) <= given.keys():
        raise ValueError(f"{path}: inputs: expected crops, and features where they are read, got {', '.join(wanted)}")
    parts = [
        session.run(None, {name: given[name][start:end] for name in wanted})[0]
        for start, end in set_bounds(samples.sets)
    ]
    found = np.concatenate(parts) if parts else logits[:0]
    difference = float(np.max(np.abs(found - logits) / (1 + np.abs(logits)), initial=0.0))
    if not difference <= MAX_DIFFERENCE:
        raise ValueError(f"{path}: expected the logits of torch to within {MAX_DIFFERENCE:g}, got {difference:.2g}")
    return difference


def _our_model(members: Sequence[CompactNetwork], spec: InputSpec, metadata: Mapping[str, str]) -> ModelProto:
    """A network, or the mean of two as in `networks.BothNetwork`, as an ONNX model.

    The model reads `crops`, float32 (N, C, S, S), and `features`, float32 (N, F), and writes `logits`, float32 (N, 1)
    or (N, 5).
    """
    graph = Graph()
    if len(members) == 1:
        _compact(graph, members[0], "crops", "features", output="logits")
    else:
        _both(graph, *members)
    about = {"foreglow_version": version("foreglow"), "support": str(spec.support)}
    if spec.lag_s is not None:
        about["lag_s"] = repr(spec.lag_s)
    if spec.context is not None:
        about["context"] = str(spec.context)
    if spec.together:
        about["together"] = "1"
    inputs = {"crops": (spec.num_channels, spec.size_px, spec.size_px), "features": (spec.num_features,)}
    return graph.model(inputs, {"logits": (members[0].last.out_features,)}, about | dict(metadata))


def _both(graph: Graph, alone: CompactNetwork, related: CompactNetwork) -> None:
    """The mean of two networks; `related` judges the boxes that `alone` takes for possible light, or one of them."""
    columns = (graph.constant(values) for values in ([0], [alone.num_features], [1]))
    logits = _compact(graph, alone, "crops", graph.node("Slice", "features", *columns))
    light = logits
    if alone.last.out_features > 1:
        kinds, none = (
            graph.node("Slice", logits, *(graph.constant([value]) for value in bounds))
            for bounds in ((0, -1, 1), (-1, len(KINDS), 1))
        )
        light = graph.node("Sub", graph.node("ReduceLogSumExp", kinds, axes=[1], keepdims=1), none)
    light = graph.node("Reshape", light, graph.constant([-1]))
    least = graph.constant(np.array([BothNetwork.LEAST_LOGIT]))
    least = graph.node("Min", least, graph.node("ReduceMax", light, keepdims=1))
    is_possible = graph.node("GreaterOrEqual", light, least)
    numbers = graph.node("Range", graph.constant(0), graph.node("Size", light), graph.constant(1))
    chosen = graph.node("Compress", numbers, is_possible, axis=0)
    crops, features, before = (graph.node("Gather", name, chosen, axis=0) for name in ("crops", "features", logits))
    mean = graph.node("Mean", before, _compact(graph, related, crops, features))
    rows = graph.node("Unsqueeze", chosen, graph.constant([1]))
    graph.node("ScatterND", logits, rows, mean, output="logits")


def _compact(graph: Graph, network: CompactNetwork, crops: str, features: str, output: str = "") -> str:
    """The logits of `network`, its batch normalisation folded into the convolutions: exact up to rounding."""
    name = crops
    body: list[Any] = list(network.body)
    for convolution, norm in zip(body[0::3], body[1::3], strict=True):  # a ReLU follows each
        scale = _array(norm.weight) / np.sqrt(_array(norm.running_var) + norm.eps)
        weight = _array(convolution.weight) * scale[:, None, None, None]
        bias = _array(norm.bias) - scale * _array(norm.running_mean)
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
    name = graph.node("Concat", graph.node("Flatten", name), features, axis=1)
    name = graph.node("Relu", graph.linear(name, _array(network.hidden.weight), _array(network.hidden.bias)))
    if isinstance(network, RelatedNetwork):
        name = _related(graph, network, features, name)
    return graph.linear(name, _array(network.last.weight), _array(network.last.bias), output=output)


def _related(graph: Graph, network: RelatedNetwork, features: str, hidden: str) -> str:
    """What the boxes tell one another, as in `networks.RelatedNetwork`; `hidden` has shape (N, size)."""
    place = graph.linear(features, _array(network.place.weight), _array(network.place.bias))
    hidden = graph.node("Add", hidden, place)
    compared = graph.node("Gather", features, graph.constant(list(network.COMPARED)), axis=1)
    compared = graph.node("Mul", compared, graph.constant(np.array(network.SCALES)))
    tellers, hearers = (graph.node("Unsqueeze", compared, graph.constant([axis])) for axis in (0, 1))
    differences = graph.node("Sub", tellers, hearers)
    across, along = (graph.node("Gather", differences, graph.constant([index]), axis=2) for index in (0, 1))
    squares = [graph.node("Mul", each, each) for each in (across, along)]
    square = graph.node("Add", graph.node("Add", *squares), graph.constant(np.array([network.LEAST_SQUARE])))
    distances = graph.node("Sqrt", square)
    # log2(x) / 8 as a natural logarithm of the square.
    logarithms = graph.node("Mul", graph.node("Log", square), graph.constant(np.array([1 / (16 * np.log(2))])))
    falling = graph.node("Exp", graph.node("Mul", distances, graph.constant(np.array([-8.0]))))
    relations = graph.node("Concat", differences, graph.node("Abs", across), logarithms, falling, axis=2)
    for each in network.rounds:
        assert isinstance(each, Round)
        heard = graph.linear(hidden, _array(each.hearer.weight), _array(each.hearer.bias))
        told = graph.node("MatMul", hidden, graph.constant(_array(each.teller.weight).T))
        told = graph.node(
            "Add",
            graph.node("Unsqueeze", heard, graph.constant([1])),
            graph.node("Unsqueeze", told, graph.constant([0])),
        )
        told = graph.node("Add", told, graph.node("MatMul", relations, graph.constant(_array(each.relation.weight).T)))
        told = graph.node("Relu", told)
        mean, greatest = (graph.node(name, told, axes=[1], keepdims=0) for name in ("ReduceMean", "ReduceMax"))
        both = graph.node("Concat", hidden, mean, greatest, axis=1)
        update = graph.linear(both, _array(each.update.weight), _array(each.update.bias))
        hidden = graph.node("Add", hidden, graph.node("Relu", update))
    return hidden


def _array(tensor: Any) -> NDArray[np.float64]:
    return np.asarray(tensor.detach().cpu().double().numpy())
