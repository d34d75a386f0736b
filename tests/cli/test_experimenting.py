"""The commands `export-yolo`, `yolo`, `export-mot` and `experiment`: what they say, and one line for bad input."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import pytest

from foreglow.config import preset
from foreglow.datasets import open_labelled, shipped_drive
from foreglow.lab.studies.time_benefit.page import write_report
from foreglow.lab.studies.time_benefit.run import run_experiment
from tests.cli.commands import complaint, foreglow_command
from tests.datasets.tiny_pvdn import make_pvdn
from tests.lab.learning.yolo.fakes import Calls, fake_libreyolo
from tests.lab.studies.detector_data import make_data, make_model
from tests.lab.studies.ranged_drives import make_split

pytestmark = pytest.mark.torch


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return make_data(tmp_path / "data")


def test_export(data: Path, tmp_path: Path) -> None:
    result = foreglow_command("export-yolo", data, "--out", tmp_path / "out", "--size", 64, "--preset", "paper")
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith(f"wrote {tmp_path / 'out' / 'data.yaml'}: images of train 6 (")
    assert result.stdout.endswith("boxes: preset paper\n")
    assert "expected one of paper, baseline" in complaint(
        "export-yolo", data, "--out", tmp_path / "x", "--preset", "none"
    )
    assert "no such folder" in complaint("export-yolo", tmp_path / "absent", "--out", tmp_path / "x")


def test_train_predict_and_evaluate(monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path) -> None:
    calls = Calls("libreyolo")
    monkeypatch.setitem(sys.modules, "libreyolo", fake_libreyolo(calls))
    run, found = tmp_path / "run", tmp_path / "found.json"
    arguments = ("--image-size", 64, "--epochs", 2, "--batch", 4, "--seed", 7, "--device", "cpu", "--size", "n")
    result = foreglow_command("yolo", "train", data, "--out", run, *arguments)
    assert result.exit_code == 0, result.output
    assert "0.00 million parameters" in result.stdout
    assert (calls.trained[0]["batch"], calls.trained[0]["seed"], calls.made[0][1]["size"]) == (4, 7, "n")
    result = foreglow_command("yolo", "predict", run, data / "test", "--out", found)
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith(f"wrote {found}: 6 images, ")
    result = foreglow_command("evaluate", data / "test", "--predictions", found)
    assert result.exit_code == 0, result.output


def test_bad_input_of_yolo(monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    assert "yolo train: backend: " in complaint("yolo", "train", data, "--out", out, "--backend", "darknet")
    assert "yolo train: image_size_px: " in complaint("yolo", "train", data, "--out", out, "--image-size", 100)
    assert "expected a finished run" in complaint("yolo", "predict", out, data / "test", "--out", tmp_path / "x.json")
    for name, extra in (("libreyolo", "yolo"), ("ultralytics", "ultralytics")):
        monkeypatch.setitem(sys.modules, name, None)
        line = complaint("yolo", "train", data, "--out", out, "--backend", name)
        assert f"{name} is not installed; this command needs: pip install 'foreglow[{extra}]'" in line
    assert not out.exists()


def test_experiment(data: Path, tmp_path: Path) -> None:
    pytest.importorskip("onnx")
    model, out = make_model(tmp_path / "model.onnx"), tmp_path / "out"
    arguments = (data, "--out", out, "--paper-model", model, "--no-training", "--no-yolo")
    result = foreglow_command("experiment", "detector", *arguments, "--rows", "paper,compact,yolo-large")
    assert result.exit_code == 0, result.output
    assert result.stdout.endswith(f"look in {out / 'report.html'}\n")
    assert "Optimised, 640 x 480: F: 0.82; here 0." in result.stdout
    assert {path.name for path in out.iterdir()} == {"predictions", "rows", "results.json", "table.md", "report.html"}
    rows = json.loads((out / "results.json").read_text())["rows"]
    assert [row["reason"] is None for row in rows] == [True, False, False]


def test_bad_input_of_the_experiment(data: Path, tmp_path: Path) -> None:
    experiment = ("experiment", "detector", data, "--out", tmp_path / "out")
    assert "rows: expected some of baseline" in complaint(*experiment, "--rows", "best")
    assert "no such model, given with --our-model" in complaint(*experiment, "--our-model", tmp_path / "absent")
    line = complaint(*experiment, "--no-yolo", "--no-training")  # it made a report of nothing
    assert "rows: expected one whose model is given or trained, got none: baseline-small: not given" in line
    assert not (tmp_path / "out").exists()
    assert "split: expected one of train, val, test, got 'all'" in complaint(*experiment, "--split", "all")
    ours = ("--our-model", "foreglow", "--rows", "ours,yolo-small")
    for name, *unused in (
        ("--yolo-epochs", 9, "--no-yolo"),
        ("--yolo-image-size", 960, "--no-training"),
        ("--epochs-ours", 9),
        ("--epochs-paper", 9),
        ("--patience", 9),
    ):
        assert f"{name}: expected with a row that is trained by it" in complaint(*experiment, *ours, name, *unused)


@pytest.mark.usefixtures("undrawn", "few_rules")
def test_time_benefit(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    out = tmp_path / "out"
    result = foreglow_command("experiment", "time-benefit", shipped_drive(), "--out", out)
    assert result.exit_code == 0, result.output
    assert result.stdout.endswith(f"look in {out / 'report.md'}\n")
    assert " false groups of close tracks, " in result.stdout
    assert "Single frame before a human, mean: 0.5 s; here" in result.stdout
    assert "vehicle at 18 Hz, " in result.stdout


@pytest.mark.usefixtures("undrawn", "few_rules")
def test_time_benefit_of_two_splits(tmp_path: Path) -> None:
    """The second split is a copy of the first; a folder that is a split has no others."""
    pytest.importorskip("matplotlib")
    root = make_pvdn(tmp_path / "data")
    shutil.copytree(root, root.parent / "test")
    out = tmp_path / "out"
    time_benefit = ("experiment", "time-benefit", "--split", "val,test", "--out", out)
    result = foreglow_command(*time_benefit, tmp_path / "data")
    assert result.exit_code == 0, result.output
    results = json.loads((out / "results.json").read_text())
    assert (results["num_sequences"], results["rates_hz"]) == (4, [18.0, 18.0])
    expected = f"foreglow: --split: expected a whole data set with it, {root} is a single split\n"
    assert complaint(*time_benefit, root) == expected


@pytest.mark.usefixtures("undrawn", "few_rules")
def test_time_benefit_at_a_low_rate(tmp_path: Path) -> None:
    """The command refuses it; the report of what `reproduce` measures says so."""
    pytest.importorskip("matplotlib")
    root = make_pvdn(tmp_path / "data")
    path = root / "labels" / "image_annotations.json"
    content = json.loads(path.read_text())
    numbers = {11: 0, 12: 1, 13: 2, 5: 0, 7: 1}
    images = [image | {"timestamp": round(1e3 * numbers[image["id"]] / 1.5)} for image in content["images"]]
    path.write_text(json.dumps(content | {"info": {"rate_hz": 1.5}, "images": images}))
    said = complaint("experiment", "time-benefit", root, "--out", tmp_path / "out")
    assert f"{root}: rate_hz: expected at least 5, as below it five frames take longer than a human, got 1.5" in said
    results = run_experiment([open_labelled(root)], preset("foreglow"))
    report = write_report(results, tmp_path / "out").read_text()
    assert "2 sequences at 1.5 Hz; " in report
    path.write_text(json.dumps(content | {"info": {"rate_hz": 30}, "images": images}))  # as of some frames of a video
    few = run_experiment([open_labelled(root)], preset("foreglow"))
    assert few.rates_hz == pytest.approx((1.5,), rel=0.01)
    false, wanted = few.methods[1].false, results.methods[1].false
    assert false is not None
    assert wanted is not None
    assert false.minutes == pytest.approx(wanted.minutes, rel=0.01)
    assert "Below 5 Hz five frames take longer than a human" in report


def test_what_is_named_twice_would_count_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    root = make_pvdn(tmp_path / "data")
    data, split = tmp_path / "data", root.name
    other = data / root.relative_to(data).parent / "test"
    learnt = other.with_name("train")
    for link in (other, learnt):
        link.symlink_to(root)
    monkeypatch.chdir(root.parent)
    out = ("--out", tmp_path / "out")
    time_benefit = ("experiment", "time-benefit", data, *out, "--split")
    once = "expected each once"
    assert complaint(*time_benefit, f"{split}, {split}") == f"foreglow: --split: {once}, {split} comes twice\n"
    assert f"--split: {once}, {other} comes twice" in complaint(*time_benefit, f"{split},test")
    wrong = f"--split: expected names with commas between them, got '{split},'"
    assert complaint(*time_benefit, f"{split},") == f"foreglow: {wrong}\n"
    ranges = ("experiment", "detection-range", *out)
    assert f"DATA: {once}, {split} comes twice" in complaint(*ranges, root, split)
    assert f"--rows: {once}, paper comes twice" in complaint(
        "experiment", "detector", data, *out, "--rows", "paper,paper"
    )
    distance = ("experiment", "distance", data, *out)
    assert f"--estimators: {once}, gp comes twice" in complaint(*distance, "--estimators", "gp,psd_3d,gp")
    runtime = ("experiment", "runtime", root, *out)
    assert f"--on: {once}, process comes twice" in complaint(*runtime, "--on", "process", "--on", "process")
    assert f"--straight: {once}, {split} comes twice" in complaint(
        "reproduce", data, *out, "--straight", root, "--straight", split
    )
    assert f"--split: {once}, {split} comes twice" in complaint("annotate", data, "--split", split, "--split", split)
    model = ("--out", tmp_path / "model")
    assert f"DATA: {once}, {learnt} comes twice" in complaint("train", data, learnt, *model)
    mixed = ("--from", "foreglow", "--mix", root, "--mix", split)
    assert f"--mix: {once}, {split} comes twice" in complaint("train", data, *model, *mixed)
    assert not (tmp_path / "out").exists()


def test_bad_input_of_time_benefit(tmp_path: Path) -> None:
    experiment = ("experiment", "time-benefit", shipped_drive(), "--out", tmp_path / "out")
    assert "classifier.model: expected one" in complaint(*experiment, "--preset", "paper")
    assert "--production-category: expected with labels as PVDN's" in complaint(*experiment, "--production-category", 5)
    assert not (tmp_path / "out").exists()


def test_export_mot(tmp_path: Path) -> None:
    run, out = tmp_path / "run", tmp_path / "mot"
    assert foreglow_command("run", shipped_drive(), "--out", run).exit_code == 0
    result = foreglow_command("export-mot", run, shipped_drive(), "--out", out, "--name", "ours")
    assert result.exit_code == 0, result.output
    assert result.stdout == f"look in {out}\n"
    rows = (out / "trackers/ours/data/S00001.txt").read_text().splitlines()
    assert len(rows) > 20
    assert len({row.split(",")[1] for row in rows}) >= 2
    assert (out / "gt/S00001/gt/gt.txt").exists()
    assert "frames.jsonl: no such file, expected predictions" in complaint(
        "export-mot", out, shipped_drive(), "--out", tmp_path / "other"
    )
    assert foreglow_command("run", shipped_drive(), "--out", run, "--limit", 27).exit_code == 0
    error = complaint("export-mot", run, shipped_drive(), "--out", tmp_path / "other")
    assert error.startswith(f"foreglow: {run / 'frames.jsonl'}: expected all images of {shipped_drive()}, got a run")
    assert not (tmp_path / "other").exists()


@pytest.mark.usefixtures("undrawn")
def test_distance(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    make_split(tmp_path / "drives", "val")
    out = tmp_path / "out"
    arguments = ("experiment", "distance", tmp_path / "drives", "--out", out, "--split", "val")
    result = foreglow_command(*arguments, "--estimators", "gp,psd_3d", "--seed", 4)
    assert result.exit_code == 0, result.output
    assert result.stdout.endswith(f"look in {out / 'report.html'}\n")
    assert "Mean range of direct light: 83 m; here" in result.stdout
    record = json.loads((out / "results.json").read_text())
    assert {finding["estimator"] for finding in record["findings"]} == {"gp", "psd_3d"}
    assert (record["split"], record["made_with"]["seed"]) == ("night/val", 4)


@pytest.mark.usefixtures("undrawn")
def test_the_split_that_was_found_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    make_split(tmp_path / "drives", "val")
    monkeypatch.chdir(tmp_path / "drives")
    result = foreglow_command("experiment", "simulator", ".", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith("measured on night/val\n")
    assert json.loads((tmp_path / "out" / "results.json").read_text())["name"] == "night/val"
    (tmp_path / "none.json").write_text("{}")
    result = foreglow_command("evaluate", ".", "--predictions", tmp_path / "none.json")
    assert result.exit_code == 0, result.output
    assert "\nnight/val" in result.stdout


def test_bad_input_of_the_distance_experiment(data: Path, tmp_path: Path) -> None:
    experiment = ("experiment", "distance", data, "--out", tmp_path / "out")
    assert "estimators: expected some of gp, psd_3d" in complaint(*experiment, "--estimators", "radar")
    assert "expected the range of each light, a calibration and the road ahead" in complaint(*experiment)
    assert "split: expected one of train, val, test, got 'all'" in complaint(*experiment, "--split", "all")
    assert not (tmp_path / "out").exists()
