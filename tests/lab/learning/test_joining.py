"""One model of two."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

from foreglow.classifier import OnnxClassifier  # noqa: E402
from foreglow.config import ClassifierConfig  # noqa: E402
from foreglow.lab.learning.joining import join  # noqa: E402
from foreglow.lab.learning.model_export import write_model  # noqa: E402
from foreglow.lab.learning.model_import import read_model  # noqa: E402
from foreglow.lab.learning.networks import NETWORKS, BothNetwork  # noqa: E402
from foreglow.lab.learning.recipes import RECIPES  # noqa: E402
from foreglow.lab.learning.training import score_samples  # noqa: E402
from tests.lab.learning.test_fine_tuning import made_up  # noqa: E402

pytestmark = pytest.mark.torch


def model(folder: Path, name: str) -> Path:
    torch.manual_seed(len(name))
    spec = RECIPES[name].inputs
    write_model(NETWORKS[name](spec, 5).eval(), spec, folder / f"{name}.onnx", {})
    return folder / f"{name}.onnx"


def test_the_mean_of_two_models_is_calibrated(tmp_path: Path) -> None:
    alone, related = model(tmp_path, "compact"), model(tmp_path, "related")
    samples = made_up(120)
    calibrator = join(alone, related, samples, tmp_path / "both.onnx")
    both = read_model(tmp_path / "both.onnx")
    assert isinstance(both.network, BothNetwork)
    assert OnnxClassifier(ClassifierConfig(model=tmp_path / "both.onnx")).spec == RECIPES["foreglow"].inputs
    cpu = torch.device("cpu")
    first = dataclasses.replace(samples, features=samples.features[:, :9])
    for path, read, network in ((alone, first, both.network.alone), (related, samples, both.network.related)):
        wanted = calibrator.applied(score_samples(read_model(path).network, read, cpu))
        np.testing.assert_allclose(score_samples(network, read, cpu), wanted, atol=1e-3)


def test_other_models_are_refused(tmp_path: Path) -> None:
    alone, related = model(tmp_path, "compact"), model(tmp_path, "related")
    with pytest.raises(ValueError, match=r"related\.onnx: expected a model of the recipe compact"):
        join(related, alone, made_up(40), tmp_path / "both.onnx")
    assert not (tmp_path / "both.onnx").exists()
