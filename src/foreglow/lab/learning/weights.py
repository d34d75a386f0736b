"""Import of the published classifier: from a torch state dict to an ONNX model."""

from __future__ import annotations

import hashlib
import pickle
import re
import tempfile
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.classifier.learnt import PROPOSALS, proposals_text
from foreglow.classifier.session import open_session
from foreglow.config import ProposalConfig, preset
from foreglow.lab.learning.export import SIZE_PX, Layers, layers_from_state, write_onnx
from foreglow.lab.learning.kept_files import UnreadableError, read_torch_file
from foreglow.lab.learning.training_run import MODEL, RECIPE, WEIGHTS, training_configuration
from foreglow.plugins import words_of


def import_weights(weights: Path | str, out: Path | str, fold: float | None = None) -> Layers:
    """Writes the published classifier as an ONNX model that `foreglow.classifier` reads, and returns its layers.

    The model says which boxes it knows: those of the preset `baseline`, or for weights in the folder of a training
    those of that training.

    Args:
        weights: A state dict of `networks.ArtifactNetwork`, as written by `torch.save`.
        out: The ONNX model to write; its folder must exist. An existing file is replaced atomically.
        fold: Tolerance of `folding.fold_constant_channels`, in units of the score; None keeps all channels.

    Raises:
        FileNotFoundError: If the weights, or the folder of `out`, do not exist.
        ValueError: If the file is damaged, is not a plain state dict of this network with finite values, or what it
            computes is not finite; or the tolerance is not in [0, 1). The message names path, field and expectation.
        ModuleNotFoundError: If the `train` extra is not installed.
    """
    weights, out = Path(weights), Path(out)
    if fold is not None and not 0 <= fold < 1:
        raise ValueError(f"fold: expected a tolerance of at least 0 and below 1, got {fold}")
    if not out.parent.is_dir():
        raise FileNotFoundError(f"{out.parent}: no such folder to write {out.name} to")
    if out.is_dir():
        raise ValueError(f"{out}: expected the path of a file to write, got a folder")
    layers = layers_from_state(read_state(weights))
    _check_logits(weights, layers)
    if fold is not None:
        from foreglow.lab.learning.folding import fold_constant_channels

        layers = fold_constant_channels(layers, fold)
    metadata = {
        "foreglow_version": version("foreglow"),
        "fold_tolerance": "none" if fold is None else repr(float(fold)),
        "source_sha256": hashlib.sha256(weights.read_bytes()).hexdigest(),
        PROPOSALS: proposals_text(_learnt_proposals(weights)),
    }
    write_onnx(layers, out, metadata)
    return layers


def _learnt_proposals(weights: Path) -> ProposalConfig:
    """Those of the training that the weights lie in, or else of the published code, by whose boxes the published
    weights were trained.

    Raises:
        ValueError: If the configuration of that training is broken.
    """
    if weights.name == WEIGHTS and weights.with_name(RECIPE).is_file():
        trained = training_configuration(weights.with_name(MODEL))
        if trained is not None:
            return trained.proposals
    return preset("baseline").proposals


def _check_logits(weights: Path, layers: Layers) -> None:
    """Checks that the network computes numbers, of black crops and of noise: weights may be finite, but too large.

    Raises:
        ValueError: If it does not.
    """
    noise = np.random.default_rng(1).random((1, SIZE_PX, SIZE_PX), np.float32)
    crops = np.stack([np.zeros_like(noise), noise])
    with tempfile.TemporaryDirectory() as folder, np.errstate(over="ignore"):
        model = Path(folder) / "model.onnx"
        write_onnx(layers, model, {})
        (logits,) = open_session(model, num_threads=1).run(None, {"crops": crops})
    if not np.isfinite(logits).all():
        raise ValueError(
            f"{weights}: expected weights whose logits are finite, got NaN or infinity: they are too large"
        )


def read_state(path: Path) -> dict[str, NDArray[Any]]:
    """The state dict in `path`, checked against `networks.ArtifactNetwork`; code in the file is never executed.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is damaged, or not a state dict of this network with finite values.
        ModuleNotFoundError: If the `train` extra is not installed.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file of weights")
    try:
        import onnx  # noqa: F401  (fails early if it is missing)
        import torch
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"importing weights needs the `train` extra: pip install 'foreglow[train]' ({error.name} is missing)",
            name=error.name,
        ) from error
    from foreglow.lab.learning.networks import ArtifactNetwork

    try:
        state = read_torch_file(path)
    except UnreadableError as error:
        # What torch says is long, has escape codes, and advises to run the code in the file.
        cause = error.__cause__
        other = re.search(r"GLOBAL ([\w.]+)", words_of(cause)) if isinstance(cause, pickle.UnpicklingError) else None
        found = f"that holds {other[1]}" if other else f"that torch cannot read ({type(cause).__name__})"
        raise ValueError(f"{path}: expected a plain torch state dict without code, got a file {found}") from error
    if not isinstance(state, Mapping):
        raise ValueError(f"{path}: expected a state dict, got {type(state).__name__}")
    arrays: dict[str, NDArray[Any]] = {}
    for name, expected in ArtifactNetwork().state_dict().items():
        if name.endswith("num_batches_tracked"):
            continue
        value = state.get(name)
        if (
            not isinstance(value, torch.Tensor)
            or value.is_meta
            or value.layout != torch.strided
            or not value.dtype.is_floating_point
        ):
            found = "nothing" if value is None else type(value).__name__
            if isinstance(value, torch.Tensor):
                is_plain = value.layout == torch.strided and not value.is_meta
                kind = "without values (meta)" if value.is_meta else f"of layout {str(value.layout)[6:]}"
                found = str(value.dtype) if is_plain else f"one {kind}"
            raise ValueError(f"{path}: {name}: expected a float tensor of shape {tuple(expected.shape)}, got {found}")
        if value.shape != expected.shape:
            raise ValueError(f"{path}: {name}: expected shape {tuple(expected.shape)}, got {tuple(value.shape)}")
        arrays[name] = value.detach().double().numpy()
        if not np.isfinite(arrays[name]).all():
            raise ValueError(f"{path}: {name}: expected finite values, got NaN or infinity")
        if name.endswith("running_var") and arrays[name].min() < 0:
            raise ValueError(f"{path}: {name}: expected no negative variance, got {arrays[name].min():g}")
    unknown = [str(name) for name in state if name not in arrays and not str(name).endswith("num_batches_tracked")]
    if unknown:
        raise ValueError(f"{path}: {unknown[0]}: expected no such entry in a state dict of the paper's classifier")
    return arrays
