"""The command line: what it prints, where it writes, and one line with exit code 2 for bad input."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from typer.testing import CliRunner, Result

import foreglow
from foreglow.cli import app
from tests.shared_data import shared_file
from tests.stand_ins import REFERENCE, night_image

RESULTS = {"frames.jsonl", "summary.json", "config.toml"}


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """A configuration that needs no native core."""
    path = tmp_path / "reference.toml"
    width_px = REFERENCE.proposals.reference_width_px
    path.write_text(f'[proposals]\nbackend = "reference"\nreference_width_px = {width_px}\n')
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of three images."""
    path = tmp_path / "images"
    path.mkdir()
    for k in range(3):
        cv2.imwrite(str(path / f"{k:06d}.png"), night_image(k))
    return path


def foreglow_command(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def complaint(*arguments: object) -> str:
    """The one line on stderr of a command that must fail with exit code 2."""
    result = foreglow_command(*arguments)
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1, result.stderr
    assert result.stderr.startswith("foreglow: ")
    return result.stderr


def names(path: Path) -> set[str]:
    return {entry.name for entry in path.iterdir()}


def num_lines(path: Path) -> int:
    return len((path / "frames.jsonl").read_text().splitlines())


def test_run_on_a_folder(tmp_path: Path, folder: Path, config: Path) -> None:
    out = tmp_path / "out"
    result = foreglow_command("run", folder, "--out", out, "--preset", "paper", "--config", config)
    assert result.exit_code == 0, result.output
    assert names(out) == RESULTS
    assert num_lines(out) == 3
    assert "3 frames, 3 proposals; " in result.stdout
    assert "the proposals are not classified: no model was given" in result.stdout
    assert f"look in {out}: config.toml, frames.jsonl, summary.json" in result.stdout
    summary = json.loads((out / "summary.json").read_text())
    assert summary["source"] == str(folder)
    assert summary["is_complete"] is True


def test_our_model_runs_where_nothing_else_is_asked_for(tmp_path: Path, folder: Path) -> None:
    result = foreglow_command("run", folder, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "not classified" not in result.stdout
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["is_classified"] is True
    used = foreglow.read_config(tmp_path / "out" / "config.toml")
    assert used == foreglow.preset("foreglow")


def test_run_on_one_image_with_picture(tmp_path: Path, folder: Path, config: Path) -> None:
    out = tmp_path / "out"
    result = foreglow_command("run", folder / "000000.png", "--out", out, "--config", config, "--video")
    assert result.exit_code == 0, result.output
    assert names(out) == {*RESULTS, "overlay.png"}


def test_run_on_a_folder_with_video_and_on_that_video(tmp_path: Path, folder: Path, config: Path) -> None:
    out = tmp_path / "out"
    assert foreglow_command("run", folder, "--out", out, "--config", config, "--video").exit_code == 0
    assert names(out) == {*RESULTS, "overlay.mp4"}
    with av.open(str(out / "overlay.mp4")) as container:
        assert len(list(container.decode(video=0))) == 3
    again = foreglow_command("run", out / "overlay.mp4", "--out", tmp_path / "again", "--config", config, "--limit", 2)
    assert again.exit_code == 0, again.output
    assert num_lines(tmp_path / "again") == 2


def test_run_again_without_video_removes_the_old_one(tmp_path: Path, folder: Path, config: Path) -> None:
    for options in (["--video"], []):
        assert foreglow_command("run", folder, "--out", tmp_path / "out", "--config", config, *options).exit_code == 0
    assert names(tmp_path / "out") == RESULTS


def test_preset_is_overridden_by_the_file(tmp_path: Path, folder: Path, config: Path) -> None:
    out = tmp_path / "out"
    with config.open("a") as file:
        file.write("gap_px = 7\n")
    assert foreglow_command("run", folder, "--out", out, "--preset", "baseline", "--config", config).exit_code == 0
    used = foreglow.read_config(out / "config.toml").proposals
    assert (used.gap_px, used.kappa, used.backend) == (7, 0.5, "reference")


def test_bad_image_among_many(tmp_path: Path, folder: Path, config: Path) -> None:
    (folder / "000001.png").write_text("no image")
    out = tmp_path / "out"
    line = complaint("run", folder, "--out", out, "--config", config)
    assert "000001.png" in line
    assert not out.exists()
    result = foreglow_command("run", folder, "--out", out, "--config", config, "--on-error", "skip", "--video")
    assert result.exit_code == 0, result.output
    assert "1 unreadable frame skipped" in result.stdout
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["num_frames"], summary["num_skipped"]) == (2, 1)
    assert "000001.png" in summary["skipped"][0]


def test_nothing_but_bad_images(tmp_path: Path, folder: Path, config: Path) -> None:
    for path in folder.iterdir():
        path.write_text("no image")
    line = complaint("run", folder, "--out", tmp_path / "out", "--config", config, "--on-error", "skip")
    assert "expected a readable frame" in line
    assert "000000.png" in line
    assert not (tmp_path / "out").exists()


def truncated(data: bytes) -> bytes:
    return data[: len(data) // 2]


PNG = cv2.imencode(".png", night_image())[1].tobytes()


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.png", truncated(PNG)),
        ("a.png", b""),
        ("a.png", b"this is no picture"),
        ("a.png", cv2.imencode(".png", night_image(0, 9, 9))[1].tobytes()),
        ("a.mp4", b""),
        ("a.mp4", b"this is no video"),
        ("a.txt", b"this is nothing of the kind"),
    ],
)
def test_bad_source_is_one_line(tmp_path: Path, config: Path, name: str, data: bytes) -> None:
    (tmp_path / name).write_bytes(data)
    assert name in complaint("run", tmp_path / name, "--out", tmp_path / "out", "--config", config, "--video")
    assert names(tmp_path) == {name, config.name}


def test_truncated_video_is_one_line(tmp_path: Path, folder: Path, config: Path) -> None:
    assert foreglow_command("run", folder, "--out", tmp_path / "a", "--config", config, "--video").exit_code == 0
    path = tmp_path / "cut.mp4"
    path.write_bytes(truncated((tmp_path / "a" / "overlay.mp4").read_bytes()))
    assert "cut.mp4" in complaint("run", path, "--out", tmp_path / "out", "--config", config)
    assert not (tmp_path / "out").exists()


def test_nan_in_a_float_image_is_one_line(tmp_path: Path, config: Path) -> None:
    image = np.full((96, 128), 0.5)
    image[3, 4] = np.nan
    np.save(tmp_path / "a.npy", image)
    assert "NaN" in complaint("run", tmp_path / "a.npy", "--out", tmp_path / "out", "--config", config)


def test_missing_and_empty_sources(tmp_path: Path, config: Path) -> None:
    assert "absent" in complaint("run", tmp_path / "absent", "--out", tmp_path / "out", "--config", config)
    (tmp_path / "empty").mkdir()
    assert "empty" in complaint("run", tmp_path / "empty", "--out", tmp_path / "out", "--config", config)
    assert not (tmp_path / "out").exists()


def test_broken_split_is_one_line(tmp_path: Path, config: Path) -> None:
    split = tmp_path / "day" / "val"
    (split / "labels").mkdir(parents=True)
    (split / "images" / "S00001").mkdir(parents=True)
    (split / "labels" / "sequences.json").write_text("{")
    assert "sequences.json" in complaint("run", split, "--out", tmp_path / "out", "--config", config)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--preset", "best"], "preset: expected one of paper, baseline, foreglow, got 'best'"),
        (["--config", "absent.toml"], "absent.toml: no such configuration file"),
        (["--on-error", "ignore"], "on_error: expected stop or skip, got 'ignore'"),
        (["--model", "absent.onnx"], "absent.onnx"),
    ],
)
def test_bad_option_is_one_line(
    tmp_path: Path, folder: Path, config: Path, options: Sequence[str], expected: str
) -> None:
    arguments = ["run", folder, "--out", tmp_path / "out", "--config", config, *options]
    assert expected in complaint(*arguments)
    assert not (tmp_path / "out").exists()


def test_model_that_is_none_is_one_line(tmp_path: Path, folder: Path, config: Path) -> None:
    (tmp_path / "model.onnx").write_bytes(b"no model")
    arguments = ["run", folder, "--out", tmp_path / "out", "--config", config, "--model", tmp_path / "model.onnx"]
    assert "model.onnx" in complaint(*arguments)


def test_broken_config_names_file_and_field(tmp_path: Path, folder: Path) -> None:
    (tmp_path / "bad.toml").write_text("[proposals]\nkappa = 99\n")
    line = complaint("run", folder, "--out", tmp_path / "out", "--config", tmp_path / "bad.toml")
    assert "bad.toml: proposals.kappa: " in line


def test_output_that_is_a_file(tmp_path: Path, folder: Path, config: Path) -> None:
    (tmp_path / "out").write_text("mine")
    assert "out" in complaint("run", folder, "--out", tmp_path / "out", "--config", config)
    assert (tmp_path / "out").read_text() == "mine"


def test_full_disk_is_one_line(tmp_path: Path, folder: Path, config: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("this system has no /dev/full")
    out = tmp_path / "out"
    out.mkdir()
    (out / "frames.jsonl").write_text("older")
    (out / "frames.jsonl.partial").symlink_to("/dev/full")
    assert "frames.jsonl: No space left on device" in complaint(
        "run", folder, "--out", out, "--config", config
    ).replace(".partial", "")
    assert names(out) == {"frames.jsonl"}
    assert (out / "frames.jsonl").read_text() == "older"


def test_source_that_would_be_overwritten(tmp_path: Path, config: Path) -> None:
    (tmp_path / "overlay.png").write_bytes(PNG)
    assert "overwrite" in complaint("run", tmp_path / "overlay.png", "--out", tmp_path, "--config", config)
    assert (tmp_path / "overlay.png").read_bytes() == PNG


def test_results_do_not_join_the_images(folder: Path, config: Path) -> None:
    before = names(folder)
    assert "expected another folder" in complaint("run", folder, "--out", folder, "--config", config, "--video")
    assert names(folder) == before


def test_region_outside_the_frame(tmp_path: Path, folder: Path, config: Path) -> None:
    with config.open("a") as file:
        file.write("region_xyxy_px = [128, 0, 200, 50]\n")
    line = complaint("run", folder, "--out", tmp_path / "out", "--config", config)
    assert (
        "proposals.region_xyxy_px: expected a part of the frame, [128, 0, 200, 50] lies outside its 128x96 px" in line
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="needs a user whom file modes stop")
def test_unreadable_image_is_one_line(tmp_path: Path, folder: Path, config: Path) -> None:
    (folder / "000000.png").chmod(0)
    line = complaint("run", folder / "000000.png", "--out", tmp_path / "out", "--config", config)
    assert "000000.png: cannot be read: Permission denied" in line


def test_pvdn_as_a_whole_names_a_split(tmp_path: Path) -> None:
    for split in ("train", "val"):
        (tmp_path / "PVDN" / "day" / split / "labels").mkdir(parents=True)
        (tmp_path / "PVDN" / "day" / split / "labels" / "sequences.json").write_text("{}")
    for path in (tmp_path / "PVDN", tmp_path / "PVDN" / "day"):
        assert "one split of PVDN, such as " in complaint("run", path, "--out", tmp_path / "out")


def test_unknown_data_set() -> None:
    assert "expected pvdn, got 'kitti'" in complaint("download", "kitti")


@pytest.mark.parametrize("arguments", [["run"], ["walk"], ["run", "a", "--out", "b", "--limit", "0"]])
def test_usage_errors_have_exit_code_2(arguments: Sequence[str]) -> None:
    assert foreglow_command(*arguments).exit_code == 2


def test_debug_shows_the_error_itself(tmp_path: Path) -> None:
    result = foreglow_command("--debug", "run", tmp_path / "absent", "--out", tmp_path / "out")
    assert isinstance(result.exception, FileNotFoundError)


def test_version() -> None:
    assert foreglow_command("--version").stdout == f"foreglow {foreglow.__version__}\n"


def subprocess_command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "foreglow.cli", *map(str, arguments)]


def test_as_a_process(tmp_path: Path, folder: Path, config: Path) -> None:
    command = subprocess_command("run", folder, "--out", tmp_path / "out", "--config", config)
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert names(tmp_path / "out") == RESULTS


def test_error_of_a_process_has_no_traceback(tmp_path: Path) -> None:
    command = subprocess_command("run", tmp_path / "absent", "--out", tmp_path / "out")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "Traceback" in subprocess.run([*command[:3], "--debug", *command[3:]], capture_output=True, text=True).stderr


@pytest.mark.skipif(os.name == "nt", reason="pipes of POSIX")
def test_reader_that_goes_away_is_no_error_of_ours(tmp_path: Path, folder: Path, config: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    command = subprocess_command("run", folder, "--out", tmp_path / "out", "--config", config)
    try:
        done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True, check=False)
    finally:
        os.close(writing)
    assert (done.returncode, done.stderr) == (1, "")
    assert names(tmp_path / "out") == RESULTS


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("interrupt", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_process_keeps_what_was_done(tmp_path: Path, config: Path, interrupt: signal.Signals) -> None:
    images = tmp_path / "many"
    images.mkdir()
    for k in range(3000):
        (images / f"{k:06d}.png").write_bytes(PNG)
    out = tmp_path / "out"
    process = subprocess.Popen(subprocess_command("run", images, "--out", out, "--config", config))
    deadline = time.monotonic() + 20
    partial = out / "frames.jsonl.partial"
    while not (partial.exists() and partial.stat().st_size) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(interrupt)
    assert process.wait(20) == 130
    summary = json.loads((out / "summary.json").read_text())
    assert summary["is_complete"] is False
    assert 0 < summary["num_frames"] == num_lines(out) < 3000
    assert names(out) == RESULTS


def test_run_on_the_real_frame_finds_the_published_boxes(tmp_path: Path) -> None:
    frame = shared_file("data/pvdn_frame_047433.png")
    config = tmp_path / "reference.toml"
    config.write_text('[proposals]\nbackend = "reference"\n')
    assert (
        foreglow_command("run", frame, "--out", tmp_path / "out", "--preset", "paper", "--config", config).exit_code
        == 0
    )
    record = json.loads((tmp_path / "out" / "frames.jsonl").read_text())
    assert len(record["proposals_xyxy_px"]) == 7
    assert [706, 482, 738, 508] in record["proposals_xyxy_px"]


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
    assert "± -" in result.stdout
    assert json.loads((tmp_path / "quality.json").read_text())["q"] is None


@pytest.mark.parametrize("text", ["", "{", "[]", '{"x": 3}'])
def test_broken_predictions_are_one_line(tmp_path: Path, text: str) -> None:
    split = write_split(tmp_path / "PVDN" / "day" / "val")
    (tmp_path / "predictions.json").write_text(text)
    assert "predictions.json" in complaint("evaluate", split, "--predictions", tmp_path / "predictions.json")


def test_missing_key_point_file_is_one_line(tmp_path: Path) -> None:
    split = write_split(tmp_path / "PVDN" / "day" / "val")
    (split / "labels" / "keypoints" / "000004.json").unlink()
    (tmp_path / "none.json").write_text("{}")
    assert "000004.json" in complaint("evaluate", split, "--predictions", tmp_path / "none.json")


def test_import_of_weights_that_are_none(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    (tmp_path / "weights.pt").write_bytes(b"no weights")
    line = complaint("import-weights", tmp_path / "weights.pt", "--out", tmp_path / "model.onnx")
    assert "weights.pt" in line
    assert names(tmp_path) == {"weights.pt"}


def test_missing_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def import_weights(*_: object) -> None:
        raise ModuleNotFoundError("No module named 'torch'", name="torch")

    monkeypatch.setattr("foreglow.learning.import_weights", import_weights)
    line = complaint("import-weights", tmp_path / "weights.pt", "--out", tmp_path / "model.onnx")
    assert "pip install 'foreglow[train]'" in line
