"""Export of a trained network as the ONNX model of the pipeline: calibrated, and compared with torch."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from foreglow.classifier.inputs import InputSpec
from foreglow.classifier.session import open_session
from foreglow.lab.learning.samples import Samples
from foreglow.lab.learning.score_calibrator import Calibrator

MAX_DIFFERENCE = 1e-3
"""Largest permitted difference of exported logits from torch's, relative to 1 + their absolute value."""


def calibrated(network: nn.Module, calibrator: Calibrator) -> nn.Module:
    """A copy of `network` whose first logit is calibrated, by changing its last linear layer.

    Raises:
        ValueError: If the network has no such layer of one or two outputs.
    """
    network = copy.deepcopy(network).eval()
    last = [layer for layer in network.modules() if isinstance(layer, nn.Linear) and layer.out_features in (1, 2)]
    if not last or last[-1].bias is None:
        raise ValueError("network: expected a linear layer of one or two outputs, with a bias, at its end")
    with torch.no_grad():
        last[-1].weight[0].div_(calibrator.temperature)
        last[-1].bias[0].div_(calibrator.temperature).add_(calibrator.shift)
    return network


def write_model(network: nn.Module, spec: InputSpec, path: Path, metadata: Mapping[str, str]) -> None:
    """Writes `network` to `path` as ONNX, atomically.

    Raises:
        ValueError: If it is not one of the networks that can be exported.
        OSError: If it cannot be written.
    """
    from foreglow.lab.learning.networks import ArtifactNetwork, CompactNetwork

    if isinstance(network, ArtifactNetwork):
        from foreglow.lab.learning.export import write_onnx
        from foreglow.lab.learning.layers import layers_from_state

        layers = layers_from_state({name: value.numpy() for name, value in network.state_dict().items()})
        write_onnx(layers, path, {"support": str(spec.support), **metadata})
    elif isinstance(network, CompactNetwork):
        from foreglow.lab.learning.export_compact import write_compact

        write_compact(network, spec, path, metadata)
    else:
        raise ValueError(f"network: expected one of networks.NETWORKS to export, got {type(network).__name__}")


def largest_difference(path: Path, samples: Samples, logits: NDArray[np.float32]) -> float:
    """Largest difference of the logits of the model at `path` from `logits`, shape (N, outputs), relative to 1 + size.

    Raises:
        ValueError: If the model cannot be run on these samples, or the difference is above `MAX_DIFFERENCE`.
    """
    session = open_session(path, num_threads=1)
    given = {"crops": samples.crops.astype(np.float32) / 255, "features": samples.features}
    wanted = [node.name for node in session.get_inputs()]
    if not set(wanted) <= given.keys():
        raise ValueError(f"{path}: inputs: expected crops, and features where they are read, got {', '.join(wanted)}")
    found = session.run(None, {name: given[name] for name in wanted})[0]
    difference = float(np.max(np.abs(found - logits) / (1 + np.abs(logits)), initial=0.0))
    if not difference <= MAX_DIFFERENCE:
        raise ValueError(f"{path}: expected the logits of torch to within {MAX_DIFFERENCE:g}, got {difference:.2g}")
    return difference
