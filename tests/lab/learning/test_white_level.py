"""What learns from a camera of few bits sees its images as the pipeline does: as those of one that fills its type."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from foreglow.config import GuardConfig, PipelineConfig
from foreglow.datasets import LabelledSource, open_labelled, split_folder
from foreglow.datasets.images import read_image
from foreglow.lab.evaluation.boxes.split_run import SplitRun
from foreglow.lab.learning.annotation import annotate_split
from foreglow.lab.learning.recipes import RECIPES
from foreglow.lab.learning.sample_cache import samples_digest
from foreglow.lab.learning.samples import SampleConfig, Samples, joined, samples_by_image
from foreglow.lab.simulation.camera.likeness import LookSink
from foreglow.pipeline import Pipeline
from tests.cli.commands import foreglow_command
from tests.lab.learning.night_set import make_night_set
from tests.lab.learning.tiny_drives import CONFIG, CONFIG_TOML, make_drives
from tests.stand_ins import result_of

WHITE = 4080
"""16 times 255: of 12 bits, so that an image of 8 bits is scaled to 16 bits without rounding."""

GUARD_TOML = f"[guard]\nwhite_level = {WHITE}\n"


def as_bits(data: Path, factor: int, copy: Path) -> Path:
    """A copy of a data set whose images have 16 bits, with grey levels of 8 bits times `factor`."""
    shutil.copytree(data, copy)
    for path in copy.rglob("*.png"):
        assert cv2.imwrite(str(path), read_image(path).astype(np.uint16) * np.uint16(factor))
    return copy


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The same drives by a camera that fills 16 bits, and by one of 12."""
    folder = tmp_path_factory.mktemp("bits")
    data = make_drives(folder / "8")
    return as_bits(data, 257, folder / "16"), as_bits(data, WHITE // 255, folder / "12")


def samples_of(data: Path, white_level: int | None) -> Samples:
    dataset = open_labelled(split_folder(data, "train"), white_level)
    return joined(list(samples_by_image(dataset, SampleConfig(proposals=CONFIG, inputs=RECIPES["foreglow"].inputs))))


def test_samples_are_those_of_a_camera_that_fills_its_type(drives: tuple[Path, Path]) -> None:
    whole, few = drives
    wanted, found, missed = samples_of(whole, None), samples_of(few, WHITE), samples_of(few, None)
    np.testing.assert_array_equal(found.boxes_xyxy_px, wanted.boxes_xyxy_px)
    np.testing.assert_array_equal(found.crops, wanted.crops)
    np.testing.assert_array_equal(found.features, wanted.features)
    assert np.abs(missed.features - wanted.features).max() > 0.3
    seen = (open_labelled(split_folder(few, "train"), white) for white in (None, 1023, WHITE))
    assert len({samples_digest(each, SampleConfig()) for each in seen}) == 3


def test_boxes_of_annotate_say_the_white_level(drives: tuple[Path, Path], tmp_path: Path) -> None:
    roots = [shutil.copytree(split_folder(data, "val"), tmp_path / data.name / "val") for data in drives]
    config = PipelineConfig(proposals=CONFIG.model_copy(update={"normalise": False}))
    with_white = config.changed("guard", white_level=WHITE)
    wanted, found = annotate_split(roots[0], config), annotate_split(roots[1], with_white)
    assert wanted.num_positive > 4
    assert dataclasses.replace(found, root=wanted.root) == wanted
    record = roots[1] / "labels/bounding_boxes.toml"
    assert f"white_level = {WHITE}" in record.read_text()
    assert annotate_split(roots[1], config).num_boxes == 0, "made anew, without a white level"
    assert "white_level" not in record.read_text()


def test_a_drive_looks_like_the_same_camera(drives: tuple[Path, Path]) -> None:
    whole, few = LookSink(8), LookSink(8, WHITE)
    for sink, data in zip((whole, few), drives, strict=True):
        for frame in open_labelled(split_folder(data, "val")):
            sink.write(frame, result_of(frame, []))
    np.testing.assert_array_equal(few._looks, whole._looks)
    assert few.brightest is not None
    assert few.brightest <= WHITE


@pytest.mark.torch
@pytest.mark.slow
def test_a_training_says_its_white_level_and_goes_on_with_no_other(drives: tuple[Path, Path], tmp_path: Path) -> None:
    _, few = drives
    (tmp_path / "config.toml").write_text(CONFIG_TOML + GUARD_TOML)
    (tmp_path / "without.toml").write_text(CONFIG_TOML)
    options = ["--preset", "paper", "--recipe", "compact", "--device", "cpu", "--epochs", 1, "--out", tmp_path / "run"]
    done = foreglow_command("train", few, "--config", tmp_path / "config.toml", *options)
    assert done.exit_code == 0, done.output
    assert "16 bits" not in done.stdout
    assert json.loads((tmp_path / "run/summary.json").read_text())["white_level"] == WHITE
    assert GUARD_TOML.splitlines()[1] in (tmp_path / "run/config.toml").read_text()
    refused = foreglow_command("train", few, "--config", tmp_path / "without.toml", *options)
    assert f"white_level: expected that of the training begun here, {WHITE}, got None" in refused.stderr
    assert "images of 16 bits, none brighter than" in refused.stdout
    assert refused.exit_code == 2


@pytest.mark.torch
@pytest.mark.slow
def test_a_search_goes_by_the_white_level(tmp_path: Path) -> None:
    data = make_night_set(tmp_path / "8", num_images=3)
    drives = {"16": as_bits(data, 257, tmp_path / "16"), "12": as_bits(data, WHITE // 255, tmp_path / "12")}
    losses = {}
    for name, given in (("16", []), ("12", ["--white-level", WHITE])):
        out = tmp_path / f"out{name}"
        done = foreglow_command("tune", drives[name], "--trials", 3, "--out", out, *given)
        assert done.exit_code == 0, done.output
        losses[name] = json.loads((out / "summary.json").read_text())["finalists"]
    assert losses["12"] == losses["16"]
    assert GUARD_TOML in (tmp_path / "out12/best.toml").read_text()


def test_disturbed_images_are_on_the_scale_of_all_bits(
    drives: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    from foreglow.lab.evaluation.boxes import robustness

    seen: list[tuple[int | None, int | None]] = []

    def variants(dataset: LabelledSource, made: dict[str, tuple[Pipeline, object]], *_: object) -> dict[str, SplitRun]:
        seen.extend((dataset.white_level, each.config.guard.white_level) for each, _ in made.values())
        return {}

    monkeypatch.setattr(robustness, "run_variants", variants)
    dataset = open_labelled(split_folder(drives[1], "val"))
    config = PipelineConfig(guard=GuardConfig(white_level=WHITE))
    robustness.robustness(dataset, None, config, disturbances=[robustness.gain(2.0)])  # type: ignore[arg-type]
    assert seen == [(WHITE, None)]
