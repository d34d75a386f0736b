"""`foreglow train`: from a data set to a model that `foreglow run` uses."""

from __future__ import annotations

import builtins
import csv
import dataclasses
import itertools
import json
import math
import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("onnx")

from foreglow.classifier.learnt import have_same_boxes, learnt_proposals
from foreglow.cli.learning import _kept_lines, _training_lines, _worse_lines
from foreglow.config import PipelineConfig, preset, read_config
from foreglow.datasets import PVDN
from foreglow.lab.evaluation import evaluate_boxes
from foreglow.lab.evaluation.boxes.box_quality import split_keypoints_px
from foreglow.lab.learning.annotation import NEGATIVE, POSITIVE
from foreglow.lab.learning.fine_tuning import Judged
from foreglow.lab.learning.recipes import RECIPES, read_recipe
from foreglow.lab.learning.training import curves_csv
from foreglow.lab.learning.training_progress import Epoch, TrainingBar
from foreglow.lab.learning.training_run import TEXTS, train_model
from foreglow.lab.reports import training_pictures
from foreglow.lab.reports.training_pictures import draw_curves, draw_training
from foreglow.options import PipelineOptions
from foreglow.pipeline import Pipeline
from foreglow.runs.predictions import Predictions
from tests.cli.commands import complaint, foreglow_command
from tests.lab.learning.tiny_drives import CONFIG_TOML, make_drives
from tests.lab.learning.tiny_training import make_samples

pytestmark = [pytest.mark.torch, pytest.mark.slow]

QUICK = """
patience = 40
batch_size = 8
learning_rate = 0.02
[augmentation]
history_dropout = 0.0
[jitter]
num_copies = 1
"""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_drives(tmp_path_factory.mktemp("data"), num_images=6)


@pytest.fixture
def options(data: Path, tmp_path: Path) -> list[object]:
    """All options but the epochs and the output."""
    (tmp_path / "quick.toml").write_text(QUICK)
    (tmp_path / "config.toml").write_text(CONFIG_TOML)
    files: list[object] = ["--recipe-file", tmp_path / "quick.toml", "--config", tmp_path / "config.toml"]
    return ["train", data, *files, "--preset", "paper", "--device", "cpu"]


def test_a_model_is_trained_exported_and_run(data: Path, tmp_path: Path, options: list[object]) -> None:
    out = tmp_path / "run"
    done = foreglow_command(*options, "--out", out, "--epochs", 12, "--seed", 5)
    assert done.exit_code == 0, done.output
    assert "train: 12 boxes with light, 24 without, 0 doubtful" in done.stdout, "copies are no boxes of their own"
    names = {path.name for path in out.iterdir()}
    assert names == {
        *("model.onnx", "weights.pt", "checkpoint.pt", "summary.json", "recipe.toml", "config.toml"),
        *("curves.csv", "curves.png", "checksums.json", "samples"),
    }
    summary = json.loads((out / "summary.json").read_text())
    assert summary["samples"]["train"] == {"positive": 24, "negative": 48, "ignored": 0}  # with copies
    assert summary["samples"]["val"] == {"positive": 12, "negative": 24, "ignored": 0}
    assert (summary["seed"], summary["network"], summary["num_epochs"]) == (5, "both", 12)
    assert summary["largest_difference_of_export"] < 1e-3
    figures = summary["validation"]
    assert f"and shift {figures['shift']:.2f}: calibration error" in done.stdout
    assert f"calibrated: P {figures['precision']:.3f}, R {figures['recall']:.3f}, F {figures['f1']:.3f}" in done.stdout
    threshold = read_config(out / "config.toml").classifier.score_threshold
    assert f" at a score of {threshold:g}\n" in done.stdout
    assert figures["threshold"] == threshold
    assert summary["model_bytes"] == (out / "model.onnx").stat().st_size
    assert {"version", "commit", "has_local_changes", "seconds", "device", "data"} <= summary.keys()
    with (out / "curves.csv").open(newline="") as file:
        assert [float(row["number"]) for row in csv.DictReader(file)] == list(range(1, 13))
    picture = cv2.imread(str(out / "curves.png"))
    assert picture is not None
    assert picture.shape[0] > 100
    assert read_recipe(out / "recipe.toml", RECIPES["paper"]).model_dump(mode="json") == summary["recipe"]

    copy = shutil.copy(out / "model.onnx", tmp_path / "copy.onnx")
    known = learnt_proposals(Path(copy))
    assert known is not None
    assert have_same_boxes(known, read_config(out / "config.toml").proposals)
    with pytest.raises(ValueError, match=r"--model .*copy\.onnx, which knows the boxes of these proposals only"):
        PipelineOptions(model=Path(copy)).configuration()

    dataset, pipeline = PVDN(data / "day/val"), Pipeline(read_config(out / "config.toml"))
    boxes, scores = {}, {}
    for sequence in dataset.sequences:
        pipeline.reset()
        for image_id in sorted(sequence.image_ids):
            detections = pipeline.step(dataset.read(image_id)).detections
            assert detections is not None
            boxes[image_id] = detections.boxes_xyxy_px.astype(float)
            scores[image_id] = detections.scores.astype(float)
    quality = evaluate_boxes(split_keypoints_px(dataset), Predictions(boxes, scores))
    # One light a box here, so boxes and lights count alike: the pipeline finds what validation promised.
    assert quality.f1 == pytest.approx(summary["validation"]["f1"])
    assert quality.recall > 0.8


def test_the_summary_appears_last(tmp_path: Path, options: list[object], monkeypatch: pytest.MonkeyPatch) -> None:
    """It says that the training is complete: what was killed before lacks it, also while the curves are drawn."""
    seen: list[set[str]] = []

    def draw(folder: Path, judged: Sequence[Judged] = ()) -> None:
        seen.append({path.name for path in folder.iterdir()})
        draw_training(folder, judged)

    monkeypatch.setattr(training_pictures, "draw_training", draw)
    done = foreglow_command(*options, "--out", tmp_path / "run", "--epochs", 1)
    assert done.exit_code == 0, done.output
    assert [names & {"model.onnx", "weights.pt", "curves.csv"} for names in seen] == [
        {"model.onnx", "weights.pt", "curves.csv"}
    ]
    assert not seen[0] & {"summary.json", "config.toml", "recipe.toml", "curves.png"}
    assert (tmp_path / "run/curves.png").is_file()


def test_several_data_sets_are_joined(data: Path, tmp_path: Path, options: list[object]) -> None:
    """Their images may have the same numbers."""
    more = make_drives(tmp_path / "more", num_images=2)
    done = foreglow_command("train", data, more, *options[2:], "--out", tmp_path / "run", "--epochs", 1)
    assert done.exit_code == 0, done.output
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["data"] == [str(data), str(more)]
    assert summary["samples"]["train"] == {"positive": 24 + 8, "negative": 48 + 16, "ignored": 0}
    assert summary["samples"]["val"] == {"positive": 12 + 4, "negative": 24 + 8, "ignored": 0}
    assert len(list((tmp_path / "run" / "samples").iterdir())) == 4


def test_single_splits_are_trained_on(data: Path, tmp_path: Path, options: list[object]) -> None:
    more = make_drives(tmp_path / "more", num_images=2) / "day" / "train"
    done = foreglow_command("train", data, more, *options[2:], "--out", tmp_path / "run", "--epochs", 1)
    assert done.exit_code == 0, done.output
    samples = json.loads((tmp_path / "run" / "summary.json").read_text())["samples"]
    assert samples["train"] == {"positive": 24 + 8, "negative": 48 + 16, "ignored": 0}
    assert samples["val"] == {"positive": 12, "negative": 24, "ignored": 0}
    line = complaint("train", more, *options[2:], "--out", tmp_path / "other")
    assert f"{more}: expected at least one data set with a split val, got single splits alone" in line


@pytest.mark.parametrize(
    ("place", "complaint_of_it"),
    [
        ("day/val", "expected a split to train on, got one that judges what is learnt"),
        ("day/other", "expected a split outside the data sets that are given, got one of "),
        ("day/test", "expected a split to train on, got a test split, which is never learnt from"),
    ],
)
def test_what_judges_is_never_learnt_from(
    tmp_path: Path, options: list[object], place: str, complaint_of_it: str
) -> None:
    """All figures were too good then, without a word."""
    data, out = make_drives(tmp_path / "own", num_images=1), tmp_path / "run"
    if place != "day/val":
        shutil.copytree(data / "day" / "train", data / place)
    for extra in ([], ["--from", "foreglow"]):
        command = options[2:] if not extra else ["--device", "cpu", "--config", tmp_path / "config.toml", "--mix", data]
        line = complaint("train", data, data / place, *command, *extra, "--out", out)
        assert f"foreglow: {data / place}: {complaint_of_it}" in line
        assert not out.exists()


def test_images_that_judge_are_never_learnt_from(data: Path, tmp_path: Path, options: list[object]) -> None:
    """Copies of them, in a split with another name."""
    more = shutil.copytree(data / "day" / "val", tmp_path / "more" / "train")
    line = complaint("train", data, more, *options[2:], "--out", tmp_path / "run")
    assert f"{data / 'day' / 'val' / 'images'}" in line
    assert f": expected an image that nothing is learnt from, got that of {more / 'images'}" in line
    assert not (tmp_path / "run").exists()


def test_the_same_command_goes_on_and_another_is_refused(tmp_path: Path, options: list[object]) -> None:
    out = tmp_path / "run"
    first = foreglow_command(*options, "--out", out, "--epochs", 2)
    model = (out / "model.onnx").read_bytes()
    again = foreglow_command(*options, "--out", out, "--epochs", 2)
    assert first.exit_code == again.exit_code == 0, again.output
    assert (out / "model.onnx").read_bytes() == model
    line = complaint(*options, "--out", out, "--epochs", 3)
    assert "checkpoint.pt: epochs: expected that of the training begun here, 2, got 3; choose another folder" in line
    more, before = make_drives(tmp_path / "more", num_images=1), sorted(out.rglob("*"))
    for data in ([more], [options[1], more]):
        line = complaint("train", *data, *options[2:], "--out", out, "--epochs", 2)
        assert "checkpoint.pt: train data: expected that of the training begun here" in line
    assert sorted(out.rglob("*")) == before  # no samples of the refused data


def test_damaged_results_are_made_anew(tmp_path: Path, options: list[object]) -> None:
    """Damaged curves ended the same command with an internal error."""
    out = tmp_path / "run"
    command = (*options, "--out", out, "--epochs", 2)
    assert foreglow_command(*command).exit_code == 0
    made = {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()}
    for damage in (
        lambda data: data[:100],
        lambda _: b"junk",
        lambda data: data.replace(b"0.", b"NaN."),
        lambda _: b"",
    ):
        for name in made.keys() - {"checkpoint.pt", "checksums.json", *TEXTS}:
            (out / name).write_bytes(damage(made[name]))
        again = foreglow_command(*command)
        assert again.exit_code == 0, again.output
        for name in made.keys() - {"summary.json", "checksums.json"}:  # which say when it was
            assert (out / name).read_bytes() == made[name], name
        assert json.loads((out / "summary.json").read_text()).keys() == json.loads(made["summary.json"]).keys()


def test_texts_that_a_user_has_changed_stay(tmp_path: Path, options: list[object]) -> None:
    """They were replaced without a word, such as a threshold in config.toml, whether the training was over or not."""
    out = tmp_path / "run"
    command = (*options, "--out", out, "--epochs", 1)
    out.mkdir()
    assert foreglow_command(*command).exit_code == 0
    commands = [command, ("train", options[1], "--from", "foreglow", "--device", "cpu", "--out", out)]
    for name in TEXTS:
        made = (out / name).read_bytes()
        (out / name).write_bytes(made.replace(b"0.", b"0.0", 1))
        assert (out / name).read_bytes() != made
        before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
        for each in commands:
            assert f"{out / name}: expected the file as this command wrote it" in complaint(*each)
        assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before
        (out / name).unlink()
        assert foreglow_command(*command).exit_code == 0
        assert (out / name).is_file()


def test_a_refused_training_tells_of_no_damaged_curves(tmp_path: Path, options: list[object]) -> None:
    out = tmp_path / "run"
    assert foreglow_command(*options, "--out", out, "--epochs", 1).exit_code == 0
    (out / "curves.csv").write_text("junk")
    line = complaint(*options, "--out", out, "--epochs", 3)
    assert "checkpoint.pt: epochs: expected that of the training begun here, 1, got 3" in line


CURVES = curves_csv([dataclasses.asdict(Epoch(1, 0.1, 0.5, 0.25, math.nan, 0.0, math.nan, math.nan, 2.0))])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected a line for each epoch of a training, got none"),
        ("junk\n", "expected a line for each epoch of a training, got none"),
        ("junk\nmore\n", "line 2: number: expected a number, got nothing"),
        (CURVES.replace("0.25", "x"), "line 2: val_loss: expected a number, got 'x'"),
        (CURVES[: CURVES.rindex(",")], "line 2: threshold: expected a number, got nothing"),
        (CURVES.replace("0.25", '"' + "1" * 200_000), "expected the curves of a training: field larger than"),
    ],
)
def test_damaged_curves_are_told_by_their_place(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "curves.csv").write_text(text)
    with pytest.raises(ValueError, match=f"^{re.escape(str(tmp_path))}/curves.csv: {re.escape(message)}"):
        draw_curves(tmp_path / "curves.csv", tmp_path / "curves.png")
    assert not (tmp_path / "curves.png").exists()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["--recipe", "best"], "recipe: expected one of paper, compact, related, foreglow, got 'best'"),
        (["--precision", "fp16"], "precision: Input should be 'fp32' or 'bf16'"),
        (["--device", "tpu"], "device: expected one of auto, cpu, cuda, got 'tpu'"),
        (["--recipe-file", "none.toml"], "none.toml: no such file"),
    ],
)
def test_bad_options_are_one_line(tmp_path: Path, options: list[object], given: list[str], message: str) -> None:
    pairs = dict(zip(options[2::2], options[3::2], strict=True)) | {given[0]: given[1]}
    assert message in complaint(
        *options[:2], *itertools.chain(*pairs.items()), "--out", tmp_path / "run", "--epochs", 1
    )


def test_a_device_that_is_not_there_is_said_before_samples_are_made(
    tmp_path: Path, options: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    import torch

    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    for given in ((), ("--from", "foreglow")):
        line = complaint("train", options[1], *given, "--out", tmp_path / "run", "--device", "cuda")
        assert line == "foreglow: device: expected a GPU that torch can use for cuda, found none; cpu needs none\n"
        assert not (tmp_path / "run").exists()


def test_inputs_that_the_network_cannot_read(tmp_path: Path, options: list[object]) -> None:
    path = tmp_path / "quick.toml"
    for size_px in (1, 48):
        path.write_text(f"[inputs]\nsize_px = {size_px}\n")
        line = complaint(*options, "--out", tmp_path / "run", "--epochs", 1)
        expected = "expected crops of 32 px, and what else the network both reads"
        assert line.startswith(f"foreglow: {path}: inputs: {expected}, got InputSpec(size_px={size_px},")
    path.write_text('network = "x"\n')
    line = complaint(*options, "--out", tmp_path / "run", "--epochs", 1)
    assert f"foreglow: {path}: network: expected one of paper, compact, related, both, got 'x'" in line
    assert not (tmp_path / "run").exists()


def test_a_figure_that_is_undefined_is_a_dash(capsys: pytest.CaptureFixture[str]) -> None:
    with TrainingBar() as bar:
        bar.epoch(Epoch(1, 0.1, 0.5, 0.25, math.nan, 0.0, math.nan, math.nan, 2.0), 3)
    assert "P – R 0.000 F – at a score > 0.5" in capsys.readouterr().err
    figures: dict[str, Any] = {"temperature": 1.0, "shift": 0.0, "calibration_error": {"before": 0.5, "after": 0.25}}
    figures |= {"precision": math.nan, "recall": 0.0, "f1": math.nan, "threshold": 0.5}
    counts = {name: {"positive": 1, "negative": 1, "ignored": 0} for name in ("train", "val")}
    summary = {"samples": counts, "validation": figures, "best_epoch": {"number": 1}, "num_epochs": 1}
    summary |= {"recipe": {"jitter": {"num_copies": 0}, "calibration": "platt"}, "without_light": []}
    assert "calibrated: P –, R 0.000, F – at a score" in "\n".join(_training_lines(summary, Path()))
    summary["recipe"] = {"jitter": {"num_copies": 0}, "calibration": "none"}  # as that of the paper
    lines = "\n".join(_training_lines(summary, Path()))
    assert "not calibrated, by its recipe: calibration error 0.250\non the validation boxes: P –, R 0.000" in lines
    assert "temperature" not in lines


@pytest.mark.parametrize(("way", "is_said"), [(1.0, False), (0.35, True), (0.0, False)])
def test_weights_that_moved_a_part_of_the_way_are_told(way: float, is_said: bool) -> None:
    (line,) = _kept_lines({"phone": {"light": [0.9, 0.8]}}, way)
    assert ("the weights moved 35% of the way to what it learnt" in line) == is_said


def test_a_data_set_without_validation(tmp_path: Path, options: list[object]) -> None:
    data = make_drives(tmp_path / "own", num_images=1)
    (data / "day" / "val").rename(data / "day" / "else")
    line = complaint("train", data, *options[2:], "--out", tmp_path / "run")
    assert "expected the split val in it" in line


def test_data_without_a_light_are_named(tmp_path: Path, options: list[object]) -> None:
    data = make_drives(tmp_path / "own", num_images=1)
    for path in (data / "day/train/labels/keypoints").iterdir():
        path.write_text(json.dumps(json.loads(path.read_text()) | {"annotations": []}))
    line = complaint("train", data, *options[2:], "--out", tmp_path / "run")
    assert re.search(rf"{data}/day/train: expected light artifacts among \d+ boxes, found none", line)
    more = make_drives(tmp_path / "more", num_images=2)
    done = foreglow_command("train", data, more, *options[2:], "--out", tmp_path / "run", "--epochs", 1)
    assert done.exit_code == 0, done.output
    assert f"{data}/day/train: no box with light: it says that nothing in it is light of a vehicle" in done.stdout
    assert f"{data}/day/val" not in done.stdout
    assert f"{more}/day" not in done.stdout


@pytest.mark.parametrize("missing", ["torch", "onnx"])
def test_the_train_extra_is_named(
    tmp_path: Path, options: list[object], monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    real = builtins.__import__

    def without(name: str, *rest: Any, **named: Any) -> Any:
        if name.split(".")[0] == missing:
            raise ModuleNotFoundError(f"No module named {missing!r}", name=missing)
        return real(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", without)
    line = complaint(*options, "--out", tmp_path / "run")
    assert f"{missing} is not installed; this command needs: pip install 'foreglow[train]'" in line
    assert not (tmp_path / "run").exists()


def test_the_paper_recipe_exports_its_network(data: Path, tmp_path: Path) -> None:
    """One step of the paper's network: exported in its own layout, calibrated, and checked against torch."""
    recipe = RECIPES["paper"].model_copy(update={"epochs": 1, "max_negatives_per_positive": 1.0})
    proposals = preset("paper").proposals.model_copy(update={"reference_width_px": 160})
    summary = train_model([data], recipe, PipelineConfig(proposals=proposals), tmp_path / "run", device="cpu")
    assert summary["num_parameters"] == 942_209
    assert summary["largest_difference_of_export"] < 1e-4
    other, before = RECIPES["compact"], sorted((tmp_path / "run").rglob("*"))
    with pytest.raises(ValueError, match=r"checkpoint\.pt: .*: expected that of the training begun here"):
        train_model([data], other, PipelineConfig(proposals=proposals), tmp_path / "run", device="cpu")
    assert sorted((tmp_path / "run").rglob("*")) == before  # no samples of the refused recipe


def held_out(*after: float) -> Judged:
    """A box with light, found before at .9, and one without at .5; now they have the scores `after`."""
    samples = make_samples(2, 0, labels=np.array([POSITIVE, NEGATIVE], np.int8), groups=np.full(2, -1, np.int8))
    return Judged("mine/val", None, samples, np.array([0.9, 0.5]), np.array(after), 0.5)


@pytest.mark.parametrize(
    ("after", "is_worse"),
    [((0.8, 0.7), False), ((0.4, 0.7), True)],
)
def test_a_model_that_got_worse_on_the_drives_of_the_user(after: tuple[float, float], is_worse: bool) -> None:
    lines = _worse_lines([held_out(*after), held_out(0.1, 0.9)])  # the last is what is held out of the old samples
    assert [line.partition(",")[0] for line in lines] == (["worse on mine/val"] if is_worse else [])
    assert all("keep the model that you had" in line for line in lines)


def test_a_loss_below_the_threshold_is_not_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("foreglow.cli.learning.MAX_WORSE", 0.5)  # of an average precision of 1 before and 0.5 after
    assert not _worse_lines([held_out(0.4, 0.7)] * 2)
    monkeypatch.setattr("foreglow.cli.learning.MAX_WORSE", 0.49)
    assert len(_worse_lines([held_out(0.4, 0.7)] * 2)) == 1
