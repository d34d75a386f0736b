"""Bad input to `run` is one line with exit code 2, and leaves nothing half-written."""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from foreglow.runs.folder import OutputFolder
from foreglow.runs.json_lines import LineSink
from tests.cli.commands import PNG, complaint, foreglow_command, names
from tests.linux import needs_full_disk
from tests.stand_ins import night_image


def truncated(data: bytes) -> bytes:
    return data[: len(data) // 2]


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


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (["run", "drive", "--out", ""], "--out"),
        (["run", "drive", "--out="], "--out"),
        (["live", "drive", "--record", ""], "--record"),
        (["beam", "drive", "--out", "out", "--save", ""], "--save"),
        (["evaluate", "split", "--json", ""], "--json"),
        (["ros2", "distance", "--config", ""], "--config"),
        (["yolo", "train", "", "--out", "out"], "the command line"),
        (["run", "", "--out", "out"], "the command line"),
    ],
)
def test_an_empty_value_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert f"{name}: expected a value, got an empty one" in complaint(*arguments)
    assert names(tmp_path) == set()


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
        (["--config", "absent.toml"], "absent.toml: no such file"),
        (["--on-error", "ignore"], "on_error: expected one of stop, skip, mark, got 'ignore'"),
        (["--model", "absent.onnx"], "absent.onnx"),
    ],
)
def test_bad_option_is_one_line(
    tmp_path: Path, folder: Path, config: Path, options: Sequence[str], expected: str
) -> None:
    usual = [] if "--config" in options else ["--config", config]
    assert expected in complaint("run", folder, "--out", tmp_path / "out", *usual, *options)
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


@needs_full_disk
def test_full_disk_is_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, folder: Path, config: Path) -> None:
    whole = OutputFolder.line_sinks

    def on_a_full_disk(results: OutputFolder) -> list[LineSink]:
        path = results.partial("frames.jsonl")
        path.unlink()
        path.symlink_to("/dev/full")
        return whole(results)

    monkeypatch.setattr(OutputFolder, "line_sinks", on_a_full_disk)
    out = tmp_path / "out"
    out.mkdir()
    older = {"frames.jsonl": '{"frame":0,"sequence":"","timestamp_ns":0}\n', "config.toml": "older"}
    for name, text in older.items():
        (out / name).write_text(text)
    assert "frames.jsonl: No space left on device" in complaint(
        "run", folder, "--out", out, "--config", config
    ).replace(".partial", "")
    assert {path.name: path.read_text() for path in out.iterdir()} == older


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


def test_unreadable_image_is_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, folder: Path, config: Path
) -> None:
    image = folder / "000000.png"
    image.chmod(0)
    if os.geteuid() == 0:  # file modes do not stop this user
        opened = Path.open

        def as_another_user(path: Path, *arguments: Any, **options: Any) -> Any:
            if path == image:
                raise PermissionError(errno.EACCES, "Permission denied", str(path))
            return opened(path, *arguments, **options)

        monkeypatch.setattr(Path, "open", as_another_user)
    line = complaint("run", image, "--out", tmp_path / "out", "--config", config)
    assert "000000.png: cannot be read: Permission denied" in line


def test_pvdn_as_a_whole_names_a_split(tmp_path: Path) -> None:
    for split in ("train", "val"):
        (tmp_path / "PVDN" / "day" / split / "labels").mkdir(parents=True)
        (tmp_path / "PVDN" / "day" / split / "labels" / "sequences.json").write_text("{}")
    for path in (tmp_path / "PVDN", tmp_path / "PVDN" / "day"):
        assert "one split of PVDN, such as " in complaint("run", path, "--out", tmp_path / "out")


def test_unknown_data_set() -> None:
    assert "expected pvdn, got 'kitti'" in complaint("download", "kitti")


@pytest.mark.parametrize(
    ("line", "name", "command"),
    [
        ("run x --config a.toml --config b.toml", "--config", "run"),
        ("run x --limit=3 --out y --limit 3", "--limit", "run"),
        ("labels export x --format cvat --out y.xml --format coco", "--format", "labels export"),
        ("ros2 beam --can can0 --can can1 --ros-args -r __ns:=/car -r beam:=light", "--can", "ros2 beam"),
    ],
)
def test_an_option_that_is_given_twice(line: str, name: str, command: str) -> None:
    """The last one counted, and the others had no effect: of two configurations, a user may expect both."""
    told = complaint(*line.split())
    assert told.startswith(f"foreglow: {name}: expected once, got it 2 times (see ")
    assert told.endswith(f" {command} --help)\n")


def test_what_may_be_given_twice() -> None:
    """Flags, what a command takes several of, and what is meant for ROS 2."""
    for line in ("run nothing --video --video", "simulate --scene a.toml --scene b.toml --out x"):
        assert "expected once" not in complaint(*line.split())


def test_a_limit_on_the_frames_before_one(folder: Path, tmp_path: Path) -> None:
    """It had no effect: `--frame` alone says how many are read."""
    line = complaint("stages", folder, "--frame", 2, "--limit", 1, "--out", tmp_path / "stages.png")
    assert "--limit: expected none: the frames until --frame 2 are read" in line
