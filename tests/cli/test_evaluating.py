"""`foreglow evaluate`: a model or a file of predictions, and the folder with the report."""

from __future__ import annotations

import codecs
import dataclasses
import json
import os
import re
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from foreglow.cli.shared_run import run_in_parallel
from foreglow.datasets.simulated import BoxShares, shares_path
from foreglow.datasets.simulated.shares import write_shares
from foreglow.lab.reports.evaluation_page import REPORT
from foreglow.lab.reports.page import Page
from foreglow.runs.frames_file import frame_to_line
from foreglow.runs.json_lines import LineSink
from foreglow.runs.summary_file import RunSummary
from foreglow.types import Frame
from foreglow.types.kinds import kinds_of_direct
from tests.cli.commands import RESULTS, complaint, foreglow_command, names
from tests.stand_ins import night_image, result_of, tracks_of


def write_split(root: Path) -> Path:
    """The labels of a split of two images with one key point each, as PVDN has them."""
    labels = root / "labels"
    (labels / "keypoints").mkdir(parents=True)
    sequence = {
        "id": 1, "dir": "S00001", "start_time": 0, "end_time": 200, "num_images": 2, "image_ids": [2, 4],
        "proband_id": 1, "sector": 1, "direction": 0, "street_style": 0, "dome": False, "proband_behaviour": 0,
        "road_type": 0, "view": 0, "weather": 0, "environment_lighting": 2,
    }  # fmt: skip
    images = [
        {
            "id": k, "file_name": f"{k:06d}.png", "height": 96, "width": 128, "date_captured": "", "timestamp": 0.0,
            "licence": 0, "camera_configuration": 0,
        }
        for k in (2, 4)
    ]  # fmt: skip
    annotations = {
        "info": {}, "licences": [], "camera_configurations": [{"camera": "Cam01", "cycle": "day"}], "categories": [],
        "images": images, "annotations": [],
    }  # fmt: skip
    (labels / "sequences.json").write_text(json.dumps({"sequences": [sequence]}))
    (labels / "image_annotations.json").write_text(json.dumps(annotations))
    instance = {"pos": [10, 10], "iid": 1, "direct": True, "rear": False}
    vehicle = {"pos": [10, 10], "oid": 1, "direct": True, "instances": [instance]}
    for k in (2, 4):
        entry = {"image_id": k, "annotations": [vehicle]}
        (labels / "keypoints" / f"{k:06d}.json").write_text(json.dumps(entry))
    return root


PLOTS = {"curve.png", "hidden.png", "kinds.png", "reliability.png"}


@pytest.fixture(name="split")
def fixture_split(tmp_path: Path) -> Path:
    """Two images with a lamp each; the labels are beside it."""
    split = write_split(tmp_path / "PVDN" / "day" / "val")
    (split / "images" / "S00001").mkdir(parents=True)
    for image_id in (2, 4):
        cv2.imwrite(str(split / "images" / "S00001" / f"{image_id:06d}.png"), night_image(image_id))
    return split


@pytest.fixture(name="predictions")
def fixture_predictions(tmp_path: Path) -> Path:
    path = tmp_path / "predictions.json"
    boxes = {"boxes": [[5, 5, 15, 15], [30, 30, 40, 40]], "scores": [0.9, 0.3]}
    path.write_text(json.dumps({"2": boxes}))
    return path


def test_points_outside_the_image_are_told(split: Path, predictions: Path) -> None:
    """As labels for larger images have them; the recall alone would look like a weak detector."""
    words = ("evaluate", split, "--predictions", predictions)
    assert "outside the image" not in foreglow_command(*words).stdout
    keypoints = split / "labels" / "keypoints" / "000004.json"
    keypoints.write_text(keypoints.read_text().replace("[10, 10]", "[160, 10]"))
    assert "outside the image, so that no box finds them: 1 key point;" in foreglow_command(*words).stdout


def test_a_split_that_nobody_has_labelled_is_told(split: Path, predictions: Path, tmp_path: Path) -> None:
    for path in (split / "labels/keypoints").iterdir():
        path.write_text(json.dumps(json.loads(path.read_text()) | {"annotations": []}))
    done = foreglow_command("evaluate", split, "--predictions", predictions, "--json", tmp_path / "found.json")
    assert done.exit_code == 0, done.output
    assert "no key point in 2 images, so that only false boxes are judged: is the split labelled?" in done.stdout
    assert "best F – at threshold –; average precision –" in done.stdout, "no threshold is better than another"


def test_points_that_are_there_several_times_are_told(split: Path, predictions: Path) -> None:
    words = ("evaluate", split, "--predictions", predictions)
    assert "counted again" not in foreglow_command(*words).stdout
    keypoints = split / "labels" / "keypoints" / "000004.json"
    content = json.loads(keypoints.read_text())
    keypoints.write_text(json.dumps(content | {"annotations": content["annotations"] * 3}))
    again = "in the labels again, same vehicle, instance and place, and counted again: 2 key points\n"
    assert again in foreglow_command(*words).stdout


def test_a_split_whose_name_is_no_utf_8(split: Path, predictions: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    moved = split.parents[1].rename(tmp_path / os.fsdecode(b"PVDN\xff")) / "day" / "val"
    out = tmp_path / "out"
    result = foreglow_command("evaluate", moved, "--predictions", predictions, "--out", out)
    assert result.exit_code == 0, result.output
    assert "PVDN?" in json.loads((out / "results.json").read_text())["made_with"]["split"]


@pytest.mark.parametrize("name", ["report.md", "report.html"])
def test_a_page_is_utf_8_whatever_is_called_so(name: str, tmp_path: Path) -> None:
    page = Page("night\udcff")
    page.text("of night\udcff")
    assert page.write(tmp_path / name).read_text().count("night?") == (2 if name == "report.md" else 3)


@pytest.fixture(name="model")
def fixture_model(tmp_path: Path) -> Path:
    pytest.importorskip("onnx")
    from tests.classifier.test_onnx import write_model

    return write_model(tmp_path / "model.onnx")


@pytest.fixture(name="config")
def fixture_config(tmp_path: Path) -> Path:
    path = tmp_path / "reference.toml"
    path.write_text('[proposals]\nbackend = "reference"\nreference_width_px = 128\n')
    return path


@pytest.mark.slow
def test_report_on_predictions(tmp_path: Path, split: Path, predictions: Path) -> None:
    pytest.importorskip("matplotlib")
    out = tmp_path / "out"
    result = foreglow_command("evaluate", split, "--predictions", predictions, "--out", out)
    assert result.exit_code == 0, result.output
    assert f"look in {out / 'report.md'}" in result.stdout
    assert names(out) == {"report.md", "results.json", *PLOTS}
    results = json.loads((out / "results.json").read_text())
    assert results["quality"]["recall"] == results["breakdown"]["whole"]["recall"] == 0.5
    assert results["ranking"]["average_precision"] == 0.5
    assert results["made_with"]["predictions"] == str(predictions)
    report = (out / "report.md").read_text()
    assert "By whose light" not in report
    assert all(f"]({name})" in report for name in PLOTS)
    assert "| lamp | 2 | 0.500 | 0.500 | 0.667 |" in report
    again = tmp_path / "again"
    assert foreglow_command("evaluate", split, "--predictions", predictions, "--out", again).exit_code == 0
    for name in names(out):
        assert (out / name).read_bytes() == (again / name).read_bytes(), name


def test_direct_light_is_rated_where_a_run_says_it(tmp_path: Path, split: Path) -> None:
    records = LineSink(tmp_path / "frames.jsonl", frame_to_line)
    for image_id in (2, 4):
        frame = Frame(night_image(image_id), image_id, frame=image_id)
        result = result_of(frame, [[5, 5, 15, 15]], [0.9])
        assert result.detections is not None
        said = dataclasses.replace(result.detections, light_kinds=kinds_of_direct(np.array([0.8], np.float32)))
        tracks = dataclasses.replace(tracks_of([[5, 5, 15, 15]]), light_kinds=kinds_of_direct(np.array([0.4])))
        records.write(frame, dataclasses.replace(result, detections=said, tracks=tracks))
    records.close()
    done = foreglow_command("evaluate", split, "--predictions", tmp_path / "frames.jsonl")
    assert done.exit_code == 0, done.output
    assert "direct or indirect, accepted boxes: balanced accuracy – (1.000 of 2 direct, – of 0" in done.stdout
    assert "direct or indirect, plausible tracks: balanced accuracy – (0.000 of 2 direct, – of 0" in done.stdout
    assert "pairs of tracks" not in done.stdout


def test_whose_light_is_in_the_boxes(tmp_path: Path, split: Path, predictions: Path) -> None:
    pytest.importorskip("pyarrow")
    path = shares_path(split, 1)
    path.parent.mkdir(parents=True)
    boxes = np.array([[5, 5, 15, 15], [30, 30, 40, 40]], np.int32)
    shares = np.array([[0.5, 0, 0, 0, 0.5, 0], [0, 0, 0, 0, 1, 0]], np.float32)
    write_shares(path, [(2, BoxShares("foreglow", boxes, shares))])
    results = tmp_path / "results.json"
    command = ("evaluate", split, "--predictions", predictions, "--threshold", 0.2, "--json", results)
    done = foreglow_command(*command)
    assert done.exit_code == 0, done.output
    assert "by whose light, false below 0.1 of vehicle light: precision 0.500, average precision 1.000" in done.stdout
    assert "by whose light, false boxes a frame: 0.500 in all 2 images, – in the 0 without vehicles" in done.stdout
    found = json.loads(results.read_text())
    assert (found["tp"], found["whose_light"]["precision"]) == (1, 0.5)
    write_shares(path, [(2, BoxShares("foreglow", boxes + 1, shares))])
    done = foreglow_command(*command)
    assert done.exit_code == 0, done.output
    assert "by whose light: no figures, 2 of 2 boxes are not among the proposals stored" in done.stdout
    assert "average precision 1.000" not in done.stdout


def test_kinds_are_compared_with_the_stored_shares(tmp_path: Path, split: Path) -> None:
    pytest.importorskip("pyarrow")
    shares = BoxShares("foreglow", np.array([[5, 5, 15, 15]], np.int32), np.eye(6, dtype=np.float32)[1:2])
    path = shares_path(split, 1)
    path.parent.mkdir(parents=True)
    write_shares(path, [(2, shares), (4, shares)])
    records = LineSink(tmp_path / "frames.jsonl", frame_to_line)
    for image_id, kinds in ((2, [0.1, 0.7, 0.1, 0.1]), (4, [0.7, 0.1, 0.1, 0.1])):
        frame = Frame(night_image(image_id), image_id, frame=image_id)
        result = result_of(frame, [[5, 5, 15, 15]], [0.9])
        assert result.detections is not None
        told = dataclasses.replace(result.detections, light_kinds=np.array([kinds], np.float32))
        records.write(frame, dataclasses.replace(result, detections=told))
    records.close()
    json_file = tmp_path / "figures.json"
    done = foreglow_command("evaluate", split, "--predictions", tmp_path / "frames.jsonl", "--json", json_file)
    assert done.exit_code == 0, done.output
    assert json.loads(json_file.read_text())["kinds"]["counts"][1] == [1, 1, 0, 0, 0]
    assert "0.500 are of the kind that they are called" in " ".join(done.stdout.split())


@pytest.mark.usefixtures("undrawn")
def test_boxes_without_scores_have_no_curves(tmp_path: Path, split: Path) -> None:
    pytest.importorskip("matplotlib")
    plain = tmp_path / "plain.json"
    plain.write_text(json.dumps({"2": [[5, 5, 15, 15]], "4": []}))
    out = tmp_path / "out"
    result = foreglow_command("evaluate", split, "--predictions", plain, "--out", out)
    assert result.exit_code == 0, result.output
    assert names(out) == {"report.md", "results.json", "kinds.png"}
    assert json.loads((out / "results.json").read_text())["ranking"] is None


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_model_is_run_on_the_split(tmp_path: Path, split: Path, model: Path, config: Path) -> None:
    pytest.importorskip("matplotlib")
    out = tmp_path / "out"
    options = ("--model", model, "--config", config, "--threshold", 0.01)
    result = foreglow_command("evaluate", split, *options, "--out", out, "--robustness")
    assert result.exit_code == 0, result.output
    assert names(out) >= {"report.md", "results.json", "kinds.png", *RESULTS}
    assert "score_threshold = 0.01" in (out / "config.toml").read_text()
    results = json.loads((out / "results.json").read_text())
    assert set(results["run_time_ms"]) == {"proposals", "classifier", "total"}
    rows = results["robustness"]
    assert rows[0]["name"] == "as it is"
    assert rows[0]["f1"] == results["quality"]["f1"]
    assert "## Robustness" in (out / "report.md").read_text()
    # The same figures from the file that it wrote.
    file = tmp_path / "quality.json"
    again = ("--predictions", out / "frames.jsonl", "--threshold", 0.01, "--json", file)
    assert foreglow_command("evaluate", split, *again).exit_code == 0
    assert json.loads(file.read_text()) == results["quality"] | {"is_complete": True}
    # Its threshold is that of the run, where nobody names another.
    assert foreglow_command("evaluate", split, "--predictions", out / "frames.jsonl", "--json", file).exit_code == 0
    assert json.loads(file.read_text()) == results["quality"] | {"is_complete": True}


def test_a_report_never_lies_beside_another_run(
    tmp_path: Path, split: Path, model: Path, config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second evaluation that is interrupted while it is reported left the first one's report beside its own run."""
    out = tmp_path / "out"
    evaluate = ("evaluate", split, "--model", model, "--config", config, "--out", out)
    assert foreglow_command(*evaluate).exit_code == 0
    assert {"report.md", "results.json", "curve.png"} <= names(out)

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("foreglow.lab.evaluation.examine", interrupted)
    assert foreglow_command(*evaluate).exit_code == 130
    assert names(out).isdisjoint(REPORT)
    assert names(out) == set(RESULTS)


def test_an_interrupted_evaluation_says_what_is_there(
    tmp_path: Path, split: Path, model: Path, config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"

    def interrupted(*given: Any) -> RunSummary:
        return dataclasses.replace(run_in_parallel(*given), is_interrupted=True)

    monkeypatch.setattr("foreglow.cli.evaluate.run_in_parallel", interrupted)
    result = foreglow_command("evaluate", split, "--model", model, "--config", config, "--out", out)
    assert result.exit_code == 130
    assert re.search(rf"^interrupted after \d+ images: {out} has these, and no report$", result.stdout, re.MULTILINE)


def test_without_a_folder_nothing_is_written(tmp_path: Path, split: Path, model: Path, config: Path) -> None:
    before = names(tmp_path)
    result = foreglow_command("evaluate", split, "--model", model, "--config", config)
    assert result.exit_code == 0, result.output
    assert "ms a frame (median)" in result.stdout
    assert "compared with the key points that were labelled" in result.stdout
    heading = next(line for line in result.stdout.splitlines() if "std" in line)
    assert [cell.strip() for cell in heading.strip("┃│").replace("┃", "│").split("│")] == ["figure", "value", "std"]
    assert names(tmp_path) == before


def test_exactly_one_detector_is_needed(split: Path, predictions: Path, tmp_path: Path) -> None:
    assert "expected --predictions FILE or --model FILE, got neither" in complaint(
        "evaluate", split, "--preset", "paper"
    )
    both = complaint("evaluate", split, "--predictions", predictions, "--model", tmp_path / "model.onnx")
    assert "expected --predictions or --model, got both" in both
    line = complaint("evaluate", split, "--predictions", predictions, "--preset", "paper")
    assert "expected --predictions or --preset" in line
    line = complaint("evaluate", split, "--predictions", predictions, "--robustness")
    assert "expected --model with --robustness" in line
    line = complaint("evaluate", split, "--predictions", predictions, "--jobs", 2)
    assert "expected --jobs and --cluster with a model" in line
    assert "expected --robustness with --seed" in complaint("evaluate", split, "--seed", 3)
    line = complaint("evaluate", split, "--robustness", "--json", tmp_path / "all.json")
    assert "expected --out with --robustness, whose figures are in the report alone" in line


def test_a_missing_model_is_one_line(tmp_path: Path, split: Path) -> None:
    pytest.importorskip("matplotlib")
    out = tmp_path / "out"
    assert "none.onnx" in complaint("evaluate", split, "--model", tmp_path / "none.onnx", "--out", out)
    assert not out.exists()


@pytest.mark.parametrize("threshold", [-1, "nan"])
def test_thresholds_of_a_model_lie_within_its_scores(split: Path, tmp_path: Path, threshold: object) -> None:
    line = complaint("evaluate", split, "--model", tmp_path / "model.onnx", "--threshold", threshold)
    assert "--threshold" in line


def test_missing_matplotlib_is_named(
    tmp_path: Path, split: Path, predictions: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def require_matplotlib() -> None:
        raise ModuleNotFoundError("No module named 'matplotlib'", name="matplotlib")

    monkeypatch.setattr("foreglow.lab.reports.figures.require_matplotlib", require_matplotlib)
    line = complaint("evaluate", split, "--predictions", predictions, "--out", tmp_path / "out")
    assert "pip install 'foreglow[plots]'" in line


def test_evaluate(tmp_path: Path) -> None:
    split = write_split(tmp_path / "PVDN" / "day" / "val")
    predictions = tmp_path / "predictions.json"
    predictions.write_text(json.dumps({"2": {"boxes": [[5, 5, 15, 15], [30, 30, 40, 40]], "scores": [0.9, 0.8]}}))
    result = foreglow_command("evaluate", split, "--predictions", predictions, "--json", tmp_path / "quality.json")
    assert result.exit_code == 0, result.output
    assert "precision" in result.stdout
    assert "± 0.0000" in result.stdout
    quality = json.loads((tmp_path / "quality.json").read_text())
    assert (quality["tp"], quality["fp"], quality["fn"]) == (1, 1, 1)
    assert (quality["precision"], quality["recall"], quality["q"]) == (0.5, 0.5, 1.0)


def test_undefined_metrics_are_a_dash_and_null(tmp_path: Path) -> None:
    split = write_split(tmp_path / "PVDN" / "day" / "val")
    (tmp_path / "none.json").write_text("{}")
    options = ["--predictions", tmp_path / "none.json", "--json", tmp_path / "quality.json"]
    result = foreglow_command("evaluate", split, *options)
    assert result.exit_code == 0, result.output
    assert "± –" in result.stdout
    assert json.loads((tmp_path / "quality.json").read_text())["q"] is None


@pytest.mark.parametrize("text", ["", "{", "[1]", '{"x": 3}'])
def test_broken_predictions_are_one_line(tmp_path: Path, text: str) -> None:
    split = write_split(tmp_path / "PVDN" / "day" / "val")
    (tmp_path / "predictions.json").write_text(text)
    assert "predictions.json" in complaint("evaluate", split, "--predictions", tmp_path / "predictions.json")


def test_missing_key_point_file_is_one_line(tmp_path: Path) -> None:
    split = write_split(tmp_path / "PVDN" / "day" / "val")
    (split / "labels" / "keypoints" / "000004.json").unlink()
    (tmp_path / "none.json").write_text("{}")
    assert "000004.json" in complaint("evaluate", split, "--predictions", tmp_path / "none.json")


def test_predictions_for_another_split(tmp_path: Path, split: Path) -> None:
    predictions = tmp_path / "predictions.json"
    predictions.write_text('{"77": {"boxes": [[1, 1, 5, 5]], "scores": [0.9]}}')
    assert "expected boxes in images of" in complaint("evaluate", split, "--predictions", predictions)


def test_a_run_on_another_split_that_has_the_same_names(tmp_path: Path, split: Path, config: Path) -> None:
    run, other = tmp_path / "run", tmp_path / "PVDN" / "day" / "test"
    assert foreglow_command("run", split, "--out", run, "--config", config).exit_code == 0
    shutil.copytree(split, other)
    cv2.imwrite(str(other / "images" / "S00001" / "000002.png"), night_image(7))
    commands = (
        ("evaluate", other, "--predictions", run / "frames.jsonl"),
        ("export-mot", run, other, "--out", run / "mot"),
    )
    for command in commands:
        assert complaint(*command).startswith(
            f"foreglow: {other}: expected the labels of what {run} was made from, {split}"
        )
    for same in (split, shutil.copytree(split, tmp_path / "moved"), split / "images" / "S00001"):
        result = foreglow_command("evaluate", same, "--predictions", run / "frames.jsonl")
        assert result.exit_code == 0, result.output


def test_a_byte_order_mark_is_no_content(split: Path, predictions: Path) -> None:
    labels = split / "labels" / "sequences.json"
    labels.write_bytes(codecs.BOM_UTF8 + labels.read_bytes())
    assert foreglow_command("evaluate", split, "--predictions", predictions).exit_code == 0
