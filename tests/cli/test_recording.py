"""`record`, `run --record`, and runs on recordings."""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from foreglow.cli.shared_run import open_frames
from foreglow.config import preset
from foreglow.datasets import ImageFolder, Recording, open_source, shipped_drive
from foreglow.options import SourceOptions, VehicleOptions
from foreglow.parallel import Local
from foreglow.runs.recorded_run import open_run, read_frames, read_run
from foreglow.runs.summary_file import read_summary
from foreglow.runtime import Opening, OutputFolder, run_apart
from foreglow.types import Frame
from tests.cli.commands import RESULTS, complaint, foreglow_command, names, num_lines
from tests.datasets.bags.bags import TOPIC, images, make_bag, make_mcap, raw

pytest.importorskip("foxglove")


def records(out: Path) -> list[dict[str, Any]]:
    """What a run says of its frames."""
    return [json.loads(line) for line in (out / "frames.jsonl").read_text().splitlines()]


def test_a_name_that_is_no_unicode(tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"night\xff")
    folder.mkdir()
    for index, width_px in enumerate((96, 128)):  # the second begins a sequence, which has its name
        cv2.imwrite(str(tmp_path / "image.png"), np.full((64, width_px), 20, np.uint8))
        (tmp_path / "image.png").rename(folder / os.fsdecode(b"%d\xff.png" % index))
    result = foreglow_command("run", folder, "--out", tmp_path / "out", "--record", tmp_path / "drive.mcap")
    assert result.exit_code == 0, result.stderr
    assert read_summary(tmp_path / "out" / "summary.json").source == str(folder)
    assert foreglow_command("run", tmp_path / "drive.mcap", "--out", tmp_path / "again").exit_code == 0
    assert [record["sequence"] for record in records(tmp_path / "again")] == ["", "1?.png"]


@pytest.mark.slow
def test_a_recorded_drive_runs_again_with_the_same_results(tmp_path: Path) -> None:
    recording, first, second = tmp_path / "drive.mcap", tmp_path / "first", tmp_path / "second"
    result = foreglow_command("run", shipped_drive(), "--out", first, "--record", recording, "--limit", 8)
    assert result.exit_code == 0, result.output
    assert names(first) == RESULTS
    result = foreglow_command("run", recording, "--out", second)
    assert result.exit_code == 0, result.output
    assert records(second) == records(first)
    assert records(first)[0]["sequence"] == "S00001"
    again = tmp_path / "again.mcap"
    result = foreglow_command("record", recording, "--out", again)
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith("8 frames, ")
    assert f"look at {again}, such as in Foxglove" in result.stdout
    assert names(tmp_path) == {"drive.mcap", "again.mcap", "first", "second"}


def test_a_run_knows_its_topic(tmp_path: Path) -> None:
    """Two cameras take their images at the same times: later commands took those of the first one for the run's."""
    first = [np.full((96, 128), 3, np.uint8) for _ in range(3)]
    second = [np.full((96, 128), 40, np.uint8) for _ in range(3)]
    path, run = make_mcap(tmp_path / "rig.mcap", second, others={"/another": first}), tmp_path / "run"
    assert next(iter(open_source(path))).image.max() == 3
    result = foreglow_command("run", path, "--out", run, "--topic", TOPIC)
    assert result.exit_code == 0, result.output
    assert read_summary(run / "summary.json").topic == TOPIC
    recorded = read_run(run)
    frames = read_frames(recorded, recorded.sequences[""])
    assert {int(frame.image.max()) for frame in frames.values()} == {40}
    assert {int(frame.image.max()) for frame in open_run(run)} == {40}
    options = ("--calibration", shipped_drive() / "simulation/S00001/camera.toml", "--out", tmp_path / "beam")
    said = complaint("beam", run, *options, "--topic", "/another")
    assert f"--topic: expected none, or {TOPIC} as in {run}, got /another" in said
    with OutputFolder(tmp_path / "apart") as folder:
        opening = Opening(open_frames, (path, SourceOptions(topic="/another", on_error="mark"), VehicleOptions()))
        run_apart(opening, preset("paper"), folder, Local())
    summary = read_summary(tmp_path / "apart" / "summary.json")
    assert (summary.topic, summary.on_error) == ("/another", "mark")


def test_a_bag_by_topic(tmp_path: Path, config: Path) -> None:
    bag, out = make_bag(tmp_path, "bag", [raw(image) for image in images(3)]), tmp_path / "out"
    result = foreglow_command("run", bag, "--out", out, "--config", config, "--topic", TOPIC, "--limit", 2)
    assert result.exit_code == 0, result.output
    assert num_lines(out) == 2
    line = complaint("run", bag, "--out", out, "--topic", "/other")
    assert "expected the topic /other with images" in line
    assert f"found /chatter (std_msgs/String), {TOPIC} (sensor_msgs/Image)" in line
    assert "expected a recording, as a topic was named" in complaint(
        "run", shipped_drive(), "--out", out, "--topic", "/a"
    )


def test_a_damaged_recording(tmp_path: Path, config: Path) -> None:
    source, recording = make_mcap(tmp_path / "cut.mcap", images(6)), tmp_path / "drive.mcap"
    source.write_bytes(source.read_bytes()[: int(0.6 * source.stat().st_size)])
    line = complaint("record", source, "--out", recording, "--config", config)
    assert f"{source}: truncated recording, its end is missing; --on-error skip reads what is there" in line
    result = foreglow_command("record", source, "--out", recording, "--config", config, "--on-error", "skip")
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith("3 frames, ")
    assert "skipped as unreadable, the first: " in result.stdout
    assert foreglow_command("run", source.rename(f"{source}.partial"), "--out", tmp_path / "out").exit_code == 0
    assert num_lines(tmp_path / "out") == 3


@pytest.mark.slow
def test_a_recording_is_not_its_own_source(tmp_path: Path) -> None:
    recording = tmp_path / "drive.mcap"
    assert foreglow_command("record", shipped_drive(), "--out", recording, "--limit", 2).exit_code == 0
    for arguments in (
        ("record", recording, "--out", recording),
        ("run", recording, "--out", tmp_path, "--record", recording),
    ):
        assert f"{recording}: expected a file that does not overwrite SOURCE {recording}" in complaint(*arguments)
    assert names(tmp_path) == {"drive.mcap"}


def test_paths_that_cannot_be(tmp_path: Path, folder: Path) -> None:
    out = tmp_path / "out"
    for line in (
        complaint("record", folder, "--out", tmp_path / "drive.bag"),
        complaint("run", folder, "--out", out, "--record", tmp_path / "drive.bag"),
    ):
        assert "drive.bag: expected a file whose name ends with .mcap" in line
    assert "No such file or directory" in complaint("record", folder, "--out", tmp_path / "absent" / "drive.mcap")
    assert names(tmp_path) == {"images"}


def test_a_run_that_fails_leaves_no_recording(tmp_path: Path, folder: Path, config: Path) -> None:
    (folder / "000001.png").write_bytes(b"")
    line = complaint("record", folder, "--out", tmp_path / "drive.mcap", "--config", config)
    assert "000001.png: expected an image, the file is empty" in line
    assert names(tmp_path) == {"images", "reference.toml"}
    result = foreglow_command(
        "record", folder, "--out", tmp_path / "drive.mcap", "--config", config, "--on-error", "skip"
    )
    assert result.exit_code == 0
    assert "1 skipped as unreadable, the first: " in result.stdout


def test_without_the_packages(tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = tmp_path / "drive.mcap"
    assert foreglow_command("record", shipped_drive(), "--out", recording, "--limit", 1).exit_code == 0
    for name in [name for name in sys.modules if name.startswith("foreglow.runtime.mcap")]:
        monkeypatch.delitem(sys.modules, name)
    for name in ("foxglove", "zstandard"):
        monkeypatch.setitem(sys.modules, name, None)
    needs = "is not installed; this command needs: pip install 'foreglow[recordings]'"
    assert f"foxglove {needs}" in complaint("record", folder, "--out", tmp_path / "other.mcap")
    assert f"zstandard {needs}" in complaint("run", recording, "--out", tmp_path / "out")


@pytest.mark.slow
def test_a_recording_cut_while_it_is_played_keeps_the_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording, out = tmp_path / "drive.mcap", tmp_path / "out"
    assert foreglow_command("record", shipped_drive(), "--out", recording, "--limit", 8).exit_code == 0
    read, num_read = Recording._frame, 0

    def cut(*arguments: Any) -> Frame:
        nonlocal num_read
        num_read += 1
        if num_read == 3:
            os.truncate(recording, recording.stat().st_size // 2)
        return read(*arguments)

    monkeypatch.setattr(Recording, "_frame", cut)
    result = foreglow_command("live", recording, "--speed", 0, "--out", out)
    assert result.exit_code == 2
    assert f"{recording}: byte " in result.stderr
    summary = read_summary(out / "summary.json")
    assert 3 <= summary.num_frames < 8
    assert not summary.is_complete


@pytest.mark.slow
def test_what_a_source_raises_unforeseen_keeps_the_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    images, out = tmp_path / "images", tmp_path / "out"
    shutil.copytree(shipped_drive() / "images" / "S00001", images)
    read, num_read = ImageFolder._frame, 0

    def broken(*arguments: Any) -> Frame:
        nonlocal num_read
        num_read += 1
        if num_read == 4:
            raise IndexError("out of range")
        return read(*arguments)

    monkeypatch.setattr(ImageFolder, "_frame", broken)
    result = foreglow_command("live", images, "--speed", 0, "--out", out)
    assert "IndexError: out of range" in result.stderr
    assert read_summary(out / "summary.json").num_frames == 3
