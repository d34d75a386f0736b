"""`import_weights`: the published scores from the published weights, and one clear line for every bad file."""

from __future__ import annotations

import builtins
import hashlib
import json
import re
from collections import OrderedDict
from pathlib import Path
from typing import Any, TypeAlias

import cv2
import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("onnx")

import onnx
import torch

from foreglow.classifier import OnnxClassifier
from foreglow.classifier.learnt import learnt_proposals
from foreglow.config import ClassifierConfig, config_to_toml, preset
from foreglow.lab.learning import import_weights
from foreglow.lab.learning.export import Layers
from foreglow.lab.learning.folding import render_probes
from foreglow.lab.studies.detector.rows import check_given
from foreglow.lab.studies.paper_chain import paper_chain
from foreglow.options import PipelineOptions
from foreglow.types import Frame, Proposals
from tests.lab.learning.networks import onnx_logits, random_network
from tests.shared_data import shared_file

Published: TypeAlias = dict[float | None, tuple[Path, Layers]]

pytestmark = pytest.mark.torch


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Published:
    """The published model by the tolerance of its folding."""
    weights, folder = shared_file("data/pvdn_weights_pretrained.pt"), tmp_path_factory.mktemp("models")
    paths = {fold: folder / f"{fold}.onnx" for fold in (None, 0.0, 1e-3)}
    return {fold: (path, import_weights(weights, path, fold)) for fold, path in paths.items()}


@pytest.mark.parametrize(("fold", "tolerance"), [(None, 1e-3), (0.0, 1e-3), (1e-3, 5e-3)])
def test_published_scores(published: Published, fold: float | None, tolerance: float) -> None:
    image: Any = cv2.imread(str(shared_file("data/pvdn_frame_047433.png")), cv2.IMREAD_GRAYSCALE)
    path, layers = published[fold]
    if fold:
        assert layers.num_multiply_adds < 10e6
    classifier = OnnxClassifier(ClassifierConfig(model=path))
    for name in ("optimised", "baseline"):
        golden = json.loads(shared_file(f"reference/golden/{name}_scores.json").read_text())
        detections = classifier.classify(Frame(image, 0), Proposals(np.array(golden["boxes"], np.int32)))
        expected = np.array(golden["dataset_sup2_minmax_score"])
        np.testing.assert_allclose(detections.scores, expected, rtol=0, atol=tolerance)
        np.testing.assert_array_equal(detections.is_accepted, expected > 0.5)


def test_folding_holds_beyond_its_own_probes(published: Published) -> None:
    """Crops from another seed than those that folding tried."""
    crops = render_probes(64, 64, seed=12345)
    logits = [onnx_logits(published[fold][0].read_bytes(), crops).astype(np.float64) for fold in (None, 1e-3)]
    scores = [1 / (1 + np.exp(-values)) for values in logits]
    change = np.abs(scores[1] - scores[0])
    assert np.quantile(change, 0.9) < 1e-3
    assert change.max() < 5e-3


DAMAGED = r"weights\.pt: expected a whole checkpoint, found it damaged$"


def flip_bit(path: Path, share: float) -> None:
    """Makes one bit wrong, at a place from 0, the begin of the file, to 1, its end."""
    content = bytearray(path.read_bytes())
    content[int(share * len(content))] ^= 1
    path.write_bytes(content)


def save(path: Path, **changes: Any) -> Path:
    """The state of a random network with entries replaced, or left out where None."""
    state = OrderedDict(random_network().state_dict())
    for name, value in changes.items():
        if value is None:
            del state[name]
        else:
            state[name] = value
    torch.save(state, path)
    return path


def test_metadata_and_figures(tmp_path: Path) -> None:
    weights = save(tmp_path / "weights.pt")
    layers = import_weights(weights, tmp_path / "model.onnx")
    properties = {entry.key: entry.value for entry in onnx.load(tmp_path / "model.onnx").metadata_props}
    assert properties["source_sha256"] == hashlib.sha256(weights.read_bytes()).hexdigest()
    assert properties["fold_tolerance"] == "none"
    assert properties["foreglow_version"]
    assert layers.num_multiply_adds == 195_371_584
    assert layers.num_parameters == 941_761


def test_the_model_judges_the_boxes_that_its_weights_have_learnt(tmp_path: Path) -> None:
    """It ran on those of any preset, and nothing was said."""
    model, training = tmp_path / "base.onnx", tmp_path / "training"
    import_weights(save(tmp_path / "weights.pt"), model)
    wanted = f"expected --preset baseline with --model {model}, which knows the boxes of these proposals only"
    for name in (None, "paper"):
        with pytest.raises(ValueError, match=re.escape(wanted)):
            PipelineOptions(preset=name, model=model).configuration()
    with pytest.raises(ValueError, match=re.escape(f"{model}: metadata: proposals: expected those of Paper's preset")):
        paper_chain(model)
    assert PipelineOptions(preset="baseline", model=model).configuration().classifier.model == model
    check_given({"published": model})
    own = tmp_path / "own.toml"
    own.write_text("[proposals]\nkappa = 0.3\n")
    assert PipelineOptions(config=own, model=model).configuration().proposals.kappa == 0.3
    training.mkdir()
    weights = save(training / "weights.pt")
    (training / "recipe.toml").write_text("")
    (training / "config.toml").write_text(config_to_toml(preset("foreglow").changed("proposals", kappa=0.3)))
    import_weights(weights, model)
    with pytest.raises(ValueError, match="expected a --config of its training's proposals with --model"):
        PipelineOptions(model=model).configuration()
    assert learnt_proposals(model) == preset("foreglow").changed("proposals", kappa=0.3).proposals


def test_a_model_that_says_nothing_usable_of_its_boxes(tmp_path: Path) -> None:
    model = tmp_path / "model.onnx"
    import_weights(save(tmp_path / "weights.pt"), model)
    for text, message in (
        ("{", "expected those of a training or of `import-weights`, as JSON"),
        ('{"kapa": 1}', "kapa: unknown"),
    ):
        proto = onnx.load(model)
        onnx.helper.set_model_props(proto, {"proposals": text})
        onnx.save(proto, tmp_path / "other.onnx")
        with pytest.raises(ValueError, match=rf"other\.onnx: metadata: proposals: {message}"):
            PipelineOptions(model=tmp_path / "other.onnx").configuration()
    proto = onnx.load(model)
    onnx.helper.set_model_props(proto, {})
    onnx.save(proto, tmp_path / "older.onnx")
    (tmp_path / "broken.onnx").write_bytes(b"\xff" * 20)
    for name in ("older", "broken", "none"):
        assert learnt_proposals(tmp_path / f"{name}.onnx") is None


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"conv3.bias": None}, r"conv3\.bias: expected a float tensor of shape \(64,\), got nothing"),
        ({"conv1.weight": torch.zeros(32, 1, 3, 3)}, r"conv1\.weight: expected shape \(32, 1, 5, 5\), got"),
        ({"conv2.bias": torch.zeros(64)}, r"conv2\.bias: expected no such entry"),
        ({"int_out.afc3.bias": torch.tensor([torch.nan])}, r"int_out\.afc3\.bias: expected finite values"),
        ({"batch6.running_var": -torch.ones(256)}, r"batch6\.running_var: expected no negative variance"),
        ({"conv1.bias": torch.zeros(32, dtype=torch.int64)}, r"conv1\.bias: expected a float tensor"),
        (
            {"conv1.bias": torch.zeros(32, device="meta")},
            r"conv1\.bias: .* got one without values \(meta\)",
        ),
        (
            {"conv1.bias": torch.zeros(32).to_sparse()},
            r"conv1\.bias: .* got one of layout sparse_coo",
        ),
        ({"conv1.bias": 3}, r"conv1\.bias: expected a float tensor .* got int"),
    ],
)
def test_wrong_state(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    weights = save(tmp_path / "weights.pt", **changes)
    with pytest.raises(ValueError, match=message) as caught:
        import_weights(weights, tmp_path / "model.onnx")
    assert str(weights) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "model.onnx").exists()


def test_a_wrong_bit_in_the_former_format_is_told(tmp_path: Path) -> None:
    """Its tensors name their storages, which follow under these names; torch asserts that they are the same."""
    weights, state = tmp_path / "weights.pt", random_network().state_dict()
    torch.save(state, weights, _use_new_zipfile_serialization=False)
    key = str(next(iter(state.values())).untyped_storage()._cdata).encode()
    content = weights.read_bytes()
    place = content.index(key) + len(key) - 1
    weights.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
    with pytest.raises(ValueError, match=r"weights\.pt: expected a plain torch state dict .* torch cannot read"):
        import_weights(weights, tmp_path / "model.onnx")


def test_missing_weights(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no such file of weights"):
        import_weights(tmp_path / "none.pt", tmp_path / "model.onnx")
    with pytest.raises(ValueError, match="expected a file, is a folder"):
        import_weights(tmp_path, tmp_path / "model.onnx")


@pytest.mark.parametrize("content", [b"", b"not weights at all", bytes(300)])
def test_not_a_checkpoint(tmp_path: Path, content: bytes) -> None:
    weights = tmp_path / "weights.pt"
    weights.write_bytes(content)
    with pytest.raises(ValueError, match=r"weights\.pt: expected a plain torch state dict") as caught:
        import_weights(weights, tmp_path / "model.onnx")
    assert "\n" not in str(caught.value)
    assert re.search(r"without code, got a file that torch cannot read \(\w+\)$", str(caught.value))


@pytest.mark.parametrize("share", [0.1, 0.5, 0.99])
def test_truncated_checkpoint(tmp_path: Path, share: float) -> None:
    weights = save(tmp_path / "weights.pt")
    content = weights.read_bytes()
    weights.write_bytes(content[: int(share * len(content))])
    with pytest.raises(ValueError, match=DAMAGED):
        import_weights(weights, tmp_path / "model.onnx")


@pytest.mark.parametrize("share", [0.01, 0.3, 0.7, 0.95])
def test_one_wrong_bit_is_noticed(tmp_path: Path, share: float) -> None:
    """Torch itself reads such a file, and gives another number."""
    weights = save(tmp_path / "weights.pt")
    flip_bit(weights, share)
    with pytest.raises(ValueError, match=DAMAGED):
        import_weights(weights, tmp_path / "model.onnx")
    assert not (tmp_path / "model.onnx").exists()


def test_weights_in_torchs_former_format_have_no_checksum(tmp_path: Path) -> None:
    torch.save(random_network().state_dict(), tmp_path / "weights.pt", _use_new_zipfile_serialization=False)
    import_weights(tmp_path / "weights.pt", tmp_path / "model.onnx")
    assert (tmp_path / "model.onnx").exists()


@pytest.mark.parametrize("fold", [None, 1e-3])
def test_weights_that_are_too_large_to_compute_with(tmp_path: Path, fold: float | None) -> None:
    weights = save(tmp_path / "weights.pt", **{"conv1.weight": torch.full((32, 1, 5, 5), 3e38)})
    with pytest.raises(ValueError, match=r"weights\.pt: expected weights whose logits are finite, got NaN or infinity"):
        import_weights(weights, tmp_path / "model.onnx", fold)
    assert not (tmp_path / "model.onnx").exists()


def test_a_zip_that_torch_did_not_write(tmp_path: Path) -> None:
    weights = tmp_path / "weights.pt"
    weights.write_bytes(b"PK\x03\x04 broken")
    with pytest.raises(ValueError, match=DAMAGED):
        import_weights(weights, tmp_path / "model.onnx")
    np.savez_compressed(tmp_path / "weights.npz", a=np.zeros(9))
    with pytest.raises(ValueError, match=r"weights\.npz: expected a whole checkpoint"):
        import_weights(tmp_path / "weights.npz", tmp_path / "model.onnx")


class _Code:
    def __reduce__(self) -> tuple[Any, ...]:
        return (print, ("this must never run",))


def test_code_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    weights = tmp_path / "weights.pt"
    torch.save({"conv1.weight": _Code()}, weights)
    with pytest.raises(
        ValueError, match=r"expected a plain torch state dict without code, got a file that holds (\w+\.)?print$"
    ):
        import_weights(weights, tmp_path / "model.onnx")
    assert capsys.readouterr().out == ""


def test_not_a_mapping(tmp_path: Path) -> None:
    torch.save([1, 2], tmp_path / "weights.pt")
    with pytest.raises(ValueError, match="expected a state dict, got list"):
        import_weights(tmp_path / "weights.pt", tmp_path / "model.onnx")


def test_bad_arguments(tmp_path: Path) -> None:
    weights = save(tmp_path / "weights.pt")
    with pytest.raises(ValueError, match="fold: expected a tolerance"):
        import_weights(weights, tmp_path / "model.onnx", fold=-1)
    with pytest.raises(FileNotFoundError, match="no such folder"):
        import_weights(weights, tmp_path / "none" / "model.onnx")
    with pytest.raises(ValueError, match="got a folder"):
        import_weights(weights, tmp_path)


def test_train_extra_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    weights = save(tmp_path / "weights.pt")
    original = builtins.__import__

    def without_torch(name: str, *args: Any, **kwargs: Any) -> Any:
        if name == "torch":
            raise ModuleNotFoundError("No module named 'torch'", name="torch")
        return original(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without_torch)
    with pytest.raises(ModuleNotFoundError, match="needs the `train` extra"):
        import_weights(weights, tmp_path / "model.onnx")
