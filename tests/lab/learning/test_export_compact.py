"""Our network as ONNX: the same logits as in torch, and a model that the classifier reads."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from foreglow.classifier import InputSpec, OnnxClassifier
from foreglow.config import ClassifierConfig
from foreglow.types import KINDS, Frame, Proposals

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

from foreglow.lab.learning.model_counts import count_model  # noqa: E402
from foreglow.lab.learning.model_export import (  # noqa: E402
    calibrated,
    write_model,
)
from foreglow.lab.learning.networks import CompactNetwork  # noqa: E402
from foreglow.lab.learning.scores import Calibrator  # noqa: E402

pytestmark = pytest.mark.torch

SPEC = InputSpec(32, 2, 0.25, 9)


def network(seed: int = 0, num_outputs: int = 1) -> CompactNetwork:
    """A network whose batch normalisations have seen something."""
    torch.manual_seed(seed)
    made = CompactNetwork(SPEC.num_channels, SPEC.num_features, num_outputs)
    made.train()
    for _ in range(3):
        made(torch.rand(64, 2, 32, 32), torch.rand(64, SPEC.num_features))
    return made.eval()


@pytest.mark.parametrize("num_outputs", [1, 5])
def test_same_logits_as_in_torch(tmp_path: Path, num_outputs: int) -> None:
    import onnxruntime as ort

    made = network(num_outputs=num_outputs)
    write_model(made, SPEC, tmp_path / "model.onnx", {})
    crops, features = torch.rand(9, 2, 32, 32), torch.rand(9, SPEC.num_features)
    with torch.no_grad():
        wanted = made(crops, features).numpy()
    session = ort.InferenceSession(str(tmp_path / "model.onnx"), providers=["CPUExecutionProvider"])
    (found,) = session.run(None, {"crops": crops.numpy(), "features": features.numpy()})
    assert found.shape == (9, num_outputs)
    np.testing.assert_allclose(found, wanted, atol=1e-5)


def test_a_model_says_what_its_outputs_are_and_its_licence(tmp_path: Path) -> None:
    import onnx

    for num_outputs, names in ((1, ("light_artifact",)), (5, KINDS)):
        write_model(network(num_outputs=num_outputs), SPEC, tmp_path / "model.onnx", {"license": "my own"})
        entries = {entry.key: entry.value for entry in onnx.load(tmp_path / "model.onnx").metadata_props}
        assert json.loads(entries["names"]) == {str(number): name for number, name in enumerate(names)}
        assert entries["license"] == "my own"
    write_model(network(), SPEC, tmp_path / "model.onnx", {})
    entries = {entry.key: entry.value for entry in onnx.load(tmp_path / "model.onnx").metadata_props}
    assert entries["license"] == "Apache-2.0"


def test_the_classifier_knows_what_it_reads(tmp_path: Path) -> None:
    write_model(network(), SPEC, tmp_path / "model.onnx", {"recipe": "test"})
    classifier = OnnxClassifier(ClassifierConfig(model=tmp_path / "model.onnx"))
    assert classifier.spec == SPEC
    random = np.random.default_rng(0)
    boxes = Proposals(np.array([[40, 30, 60, 42], [70, 50, 90, 60]], np.int32))
    scores = []
    for number in range(2):
        image = random.integers(0, 256, (96, 128)).astype(np.uint8)
        scores.append(classifier.classify(Frame(image, number * 250_000_000), boxes).scores)
    classifier.reset()
    alone = classifier.classify(Frame(image, 250_000_000), boxes).scores
    assert not np.array_equal(alone, scores[1]), "the earlier frame makes a difference"


@pytest.mark.parametrize("num_outputs", [1, 5])
def test_calibration_is_part_of_the_model(num_outputs: int) -> None:
    given = torch.rand(9, 2, 32, 32), torch.rand(9, SPEC.num_features)
    calibrator = Calibrator(2.0, 1.0)
    with torch.no_grad():
        before = network(0, num_outputs)(*given).numpy()
        after = calibrated(network(0, num_outputs), calibrator)(*given).numpy()
    np.testing.assert_allclose(after, calibrator.applied(before), atol=1e-5)


def test_equal_networks_give_equal_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_model(network(3), SPEC, tmp_path / f"{name}.onnx", {"seed": "3"})
    assert (tmp_path / "a.onnx").read_bytes() == (tmp_path / "b.onnx").read_bytes()


def test_within_the_budget_of_one_core(tmp_path: Path) -> None:
    made = network()
    assert sum(weights.numel() for weights in made.parameters()) <= 60_000
    write_model(made, SPEC, tmp_path / "model.onnx", {})
    counts = count_model(tmp_path / "model.onnx")
    assert counts.num_parameters <= 60_000
    assert counts.num_multiply_adds <= 10_000_000
    # conv 16x16x16x(2x5x5), 8x8x32x(16x3x3), 8x8x32x(32x3x3), 4x4x32x(32x3x3), 521x48, 48
    assert counts.num_multiply_adds == 204_800 + 294_912 + 589_824 + 147_456 + 25_008 + 48
