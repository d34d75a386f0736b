"""A model's file becomes its network again, which can be trained further."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("onnx")

import torch

from foreglow.classifier import OnnxClassifier
from foreglow.classifier.inputs import InputSpec
from foreglow.classifier.session import open_session
from foreglow.config import ClassifierConfig
from foreglow.lab.learning.model_export import write_model
from foreglow.lab.learning.model_import import FoldedBothNetwork, read_model
from foreglow.lab.learning.networks import NETWORKS, ArtifactNetwork, BothNetwork, learnt_logits, members_of
from foreglow.lab.learning.old_samples import WIDEST
from foreglow.lab.learning.recipes import RECIPES
from foreglow.models import model_path

pytestmark = [pytest.mark.torch, pytest.mark.slow]

NARROW = InputSpec(size_px=32, lag_s=0.25, num_features=7)
ALONE = RECIPES["compact"].inputs


def model_at(path: Path, spec: InputSpec, num_outputs: int, seed: int = 3, network: str = "related") -> Any:
    torch.manual_seed(seed)
    made = NETWORKS[network if spec.together else "compact"](spec, num_outputs)
    made.train()
    made(torch.rand(16, spec.num_channels, 32, 32), torch.rand(16, spec.num_features))  # moves the statistics
    write_model(made.eval(), spec, path, {})
    return made


def given(spec: InputSpec) -> dict[str, Any]:
    random = np.random.default_rng(1)
    crops = random.random((5, spec.num_channels, 32, 32), np.float32)
    return {"crops": crops, "features": random.random((5, spec.num_features), np.float32)}


def logits_of(network: torch.nn.Module, arrays: dict[str, Any]) -> Any:
    with torch.inference_mode():
        return network(*(torch.from_numpy(array) for array in arrays.values())).numpy()


@pytest.mark.parametrize(
    ("spec", "num_outputs", "name"),
    [(NARROW, 1, "compact"), (ALONE, 5, "compact"), (WIDEST, 5, "related"), (WIDEST, 1, "both"), (WIDEST, 5, "both")],
)
def test_a_model_becomes_the_same_network_again(tmp_path: Path, spec: InputSpec, num_outputs: int, name: str) -> None:
    network = model_at(tmp_path / "model.onnx", spec, num_outputs, network=name)
    start = read_model(tmp_path / "model.onnx")
    assert start.inputs == spec
    assert (start.has_kinds, start.tells_direct) == (num_outputs == 5, False)
    arrays = given(spec)
    np.testing.assert_allclose(logits_of(start.network, arrays), logits_of(network, arrays), atol=1e-4)
    start.network.train()
    np.testing.assert_allclose(logits_of(start.network, arrays), logits_of(network, arrays), atol=1e-4)
    write_model(start.network.eval(), spec, tmp_path / "again.onnx", {})
    again = open_session(tmp_path / "again.onnx", 1).run(None, arrays)[0]
    np.testing.assert_allclose(again, logits_of(network, arrays), atol=1e-4)


def test_of_two_networks_the_first_learns_further_for_their_mean(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(BothNetwork, "LEAST_LOGIT", 1.6)  # some boxes are left to the first network
    model_at(tmp_path / "model.onnx", WIDEST, 5, network="both")
    network = read_model(tmp_path / "model.onnx").network
    members = members_of(network)
    crops, features = (torch.from_numpy(array) for array in given(WIDEST).values())
    (learnt,) = learnt_logits(network.train(), crops, features, [5])
    np.testing.assert_allclose(learnt.detach().numpy(), logits_of(network, given(WIDEST)), atol=1e-5)
    learnt.square().sum().backward()  # type: ignore[no-untyped-call]
    first, second = ({name for name, each in part.named_parameters() if each.grad is not None} for part in members)
    assert {"body.0.weight", "hidden.weight", "last.bias"} <= first
    assert not second


def test_the_model_that_ships_goes_on_too() -> None:
    start = read_model(Path("foreglow"))
    assert isinstance(start.network, FoldedBothNetwork)
    spec = OnnxClassifier(ClassifierConfig(model=Path("foreglow"))).spec
    assert start.inputs == spec
    expected = open_session(model_path(Path("foreglow")), 1).run(None, given(spec))[0]
    found = logits_of(start.network, given(spec))
    np.testing.assert_allclose(found, expected[:, : found.shape[1]], atol=1e-4)


def test_another_network_is_refused(tmp_path: Path) -> None:
    write_model(ArtifactNetwork().eval(), InputSpec(), tmp_path / "paper.onnx", {})
    with pytest.raises(ValueError, match=r"paper\.onnx: expected a model of the recipe foreglow, related or compact"):
        read_model(tmp_path / "paper.onnx")


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_weights_that_are_not_finite_are_refused(tmp_path: Path, value: float) -> None:
    network = model_at(tmp_path / "model.onnx", WIDEST, 5, network="both")
    with torch.no_grad():
        network.related.hidden.weight[3, 4] = value
    write_model(network, WIDEST, tmp_path / "model.onnx", {})
    with pytest.raises(ValueError, match=r"model\.onnx: expected finite weights, got NaN or infinity$"):
        read_model(tmp_path / "model.onnx")
