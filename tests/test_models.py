"""The model that ships."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

import foreglow
from foreglow.classifier import OnnxClassifier
from foreglow.config import ClassifierConfig
from foreglow.datasets import read_image
from foreglow.lab.learning.recipes import recipe, recipe_to_toml
from foreglow.models import BUNDLED, SHA256, model_path
from foreglow.types import Frame
from tests.shared_data import shared_file
from tests.stand_ins import night_image


def test_it_has_a_card_and_is_small() -> None:
    path = model_path(Path(BUNDLED))
    assert path.stat().st_size <= 1_000_000
    assert path.with_suffix(".md").read_text(encoding="utf-8").startswith("# ")


def test_its_checksums_are_those_of_the_file() -> None:
    path = model_path(Path(BUNDLED))
    assert hashlib.sha256(path.read_bytes()).hexdigest() == SHA256
    assert f"SHA-256 begins {SHA256[:16]}" in path.with_suffix(".md").read_text(encoding="utf-8")


def test_a_wrong_bit_in_its_weights_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = model_path(Path(BUNDLED))
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    (tmp_path / "foreglow.onnx").write_bytes(data)
    monkeypatch.setattr("foreglow.models.__file__", str(tmp_path / "__init__.py"))
    with pytest.raises(ValueError, match=r"foreglow\.onnx: expected the model that ships, found it damaged"):
        foreglow.Pipeline()


def test_a_model_of_a_training_is_the_one_that_it_wrote(tmp_path: Path) -> None:
    model, summary = tmp_path / "model.onnx", tmp_path / "summary.json"
    data = model_path(Path(BUNDLED)).read_bytes()
    model.write_bytes(data)
    summary.write_text(json.dumps({"model_sha256": hashlib.sha256(data).hexdigest()}))
    config = ClassifierConfig(model=model)
    assert OnnxClassifier(config).spec.together
    for place in (len(data) // 3, len(data) // 2, len(data) - 20_000):
        damaged = bytearray(data)
        damaged[place] ^= 1
        model.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"model\.onnx: expected the model of the training here, .* damaged"):
            OnnxClassifier(config)
    for other in ("junk", "[]", "{}", '{"model_sha256": null}', '{"is_complete": true}'):  # no training's
        summary.write_text(other)
        OnnxClassifier(config)
    summary.unlink()
    OnnxClassifier(config)


def test_a_damaged_summary_of_a_training_does_not_hide_a_damaged_model(tmp_path: Path) -> None:
    model, summary = tmp_path / "model.onnx", tmp_path / "summary.json"
    model.write_bytes(model_path(Path(BUNDLED)).read_bytes())
    (tmp_path / "recipe.toml").write_text(recipe_to_toml(recipe("compact")))
    config = ClassifierConfig(model=model)
    for damaged in ("", '{"model_sha256": "', "[]", "{}", *(f'{{"model_sha256": {v}}}' for v in ("3", "null", '""'))):
        summary.write_text(damaged)
        with pytest.raises(
            ValueError, match=r"summary\.json: model_sha256: expected the SHA-256 of model\.onnx"
        ) as told:
            OnnxClassifier(config)
        assert "\n" not in str(told.value)
    summary.unlink()
    OnnxClassifier(config)  # such as a copy


def test_the_default_pipeline_classifies() -> None:
    pipeline = foreglow.Pipeline()
    assert pipeline.config == foreglow.preset("foreglow")
    for number in range(3):
        result = pipeline.step(Frame(night_image(number, 960, 1280), number * 55_555_556))
        assert result.detections is not None
        assert len(result.detections) == len(result.proposals)


def test_it_reads_a_moment_of_the_past_and_all_boxes_together() -> None:
    spec = OnnxClassifier(foreglow.preset("foreglow").classifier).spec
    assert spec.lag_s == pytest.approx(0.25)
    assert spec.together


def test_the_model_tells_kinds() -> None:
    pipeline = foreglow.Pipeline()
    for number in range(3):
        detections = pipeline.step(Frame(night_image(number, 960, 1280), number * 55_555_556)).detections
        assert detections is not None
        assert detections.light_kinds.shape == (len(detections), 4)
        assert len(detections) == 0 or np.isfinite(detections.light_kinds).all()


def test_a_drive_scores_alike_whenever_it_comes() -> None:
    """Results depend on the frames of the sequence alone, not on what ran before."""
    frames = [Frame(night_image(number, 960, 1280), number * 55_555_556) for number in range(8)]
    pipeline = foreglow.Pipeline()
    first = [pipeline.step(frame).detections for frame in frames]
    pipeline.reset()
    for one, frame in zip(first, frames, strict=True):
        again = pipeline.step(frame).detections
        assert one is not None
        assert again is not None
        np.testing.assert_array_equal(one.scores, again.scores)


def test_an_own_model_stays_where_it_is() -> None:
    assert model_path(Path("runs/foreglow/model.onnx")) == Path("runs/foreglow/model.onnx")


def test_the_real_frame() -> None:
    """Both headlamps are found, the two trees are not; the model has never seen a real image."""
    path = shared_file("data/pvdn_frame_047433.png")
    detections = foreglow.Pipeline().step(Frame(read_image(path), 0)).detections
    assert detections is not None

    def best_score(x: int, y: int) -> float:
        x1, y1, x2, y2 = detections.boxes_xyxy_px.T
        is_around = (x1 <= x) & (x <= x2) & (y1 <= y) & (y <= y2)
        return float(detections.scores[is_around].max(initial=0.0))

    for headlamp in ((713, 490), (728, 489)):
        assert best_score(*headlamp) > 0.9
    for tree in ((1105, 640), (1207, 655)):
        assert best_score(*tree) < detections.score_threshold
