"""`foreglow live` as its user calls it."""

from __future__ import annotations

import contextlib
import errno
import importlib
import json
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

import pytest

from foreglow.cli.beam import lamp_bus
from foreglow.config import preset
from foreglow.datasets import shipped_drive
from foreglow.photometry import NUM_LEDS
from foreglow.runs.folder import ROOM_BYTES
from foreglow.runs.recorded_run import read_run
from foreglow.runs.summary_file import read_summary
from foreglow.runtime.live import LiveFault, Paced
from foreglow.types import BeamCommand, Frame
from foreglow.whole_files import is_temporary
from tests.cli.commands import PNG, RESULTS, complaint, foreglow_command, names, num_lines
from tests.cli.forked import Loaded
from tests.datasets.bags.bags import images, make_mcap
from tests.datasets.video.test_video_file import make_video

pytestmark = pytest.mark.slow


def test_replay_into_a_folder_and_onto_a_bus(tmp_path: Path) -> None:
    pytest.importorskip("can")
    out = tmp_path / "out"
    result = foreglow_command("live", shipped_drive(), "--speed", 0, "--limit", 30, "--can", "virtual:x", "--out", out)
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert lines[0].startswith("30 frames, 0 dropped for a newer one, 0 late; ")
    assert lines[-1] == f"look in {out}"
    assert names(out) == RESULTS
    assert num_lines(out) == 30
    summary = json.loads((out / "summary.json").read_text())
    assert summary["beam"]["num_low"] == 1  # of the first frame, as light begins to return there
    counts = dict.fromkeys(("num_dropped", "num_late", "num_out_of_order", "num_unrecorded"), 0)
    assert summary["live"] == counts | {"sink_errors": [], "fault_counts": {}, "faults": []}
    assert {"capture", "queue", "beam", "send", "total"} <= summary["run_time_ms"].keys()


@pytest.mark.parametrize("part", ["", "images/S00001"])
def test_its_source_is_the_same_as_that_of_a_run(part: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    split, out = shipped_drive(), tmp_path / "out"
    monkeypatch.chdir(split.parents[1])
    source = split.relative_to(Path.cwd()) / part
    record = tmp_path / "drive.mcap"
    live = ("live", source, "--speed", 0, "--limit", 2, "--out", out / "live", "--record", record)
    assert foreglow_command(*live).exit_code == 0
    assert foreglow_command("run", source, "--limit", 2, "--out", out / "run").exit_code == 0
    first, second = (read_summary(out / name / "summary.json") for name in ("live", "run"))
    assert first.source == second.source == str(split / part)
    assert first.source_digest == second.source_digest is not None
    assert str(split / part).encode() in record.read_bytes()
    monkeypatch.chdir(tmp_path)
    assert foreglow_command("beam", out / "live", "--out", out / "beam").exit_code == 0


def test_results_are_those_of_beam(tmp_path: Path) -> None:
    live, beam = tmp_path / "live", tmp_path / "beam"
    assert foreglow_command("live", shipped_drive(), "--speed", 0, "--out", live).exit_code == 0
    assert foreglow_command("beam", shipped_drive(), "--out", beam).exit_code == 0

    assert (live / "frames.jsonl").read_bytes() == (beam / "frames.jsonl").read_bytes()


@pytest.mark.parametrize("interrupt", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_interrupted(tmp_path: Path, program: Loaded, interrupt: signal.Signals) -> None:
    out = tmp_path / "out"
    process = program.start("live", shipped_drive(), "--speed", "0.5", "--out", out)
    partial = out / "frames.jsonl.partial"
    deadline_s = time.monotonic() + 60
    while not (partial.exists() and partial.stat().st_size):
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    process.send_signal(interrupt)
    code, stdout, stderr = process.ended()
    assert code == 130, stderr
    assert "interrupted" in stdout
    assert "Traceback" not in stderr
    assert names(out) == RESULTS
    assert json.loads((out / "summary.json").read_text())["is_complete"] is False


def test_model_that_loops_for_ever_ends_in_order(tmp_path: Path) -> None:
    out, code = (
        tmp_path / "out",
        (
            "import foreglow.pipeline, time\n"
            "from foreglow.cli import main\n"
            "step, made = foreglow.pipeline.Pipeline.step, []\n"
            "def looping(self, frame, **others):\n"
            "    while made.append(1) or len(made) > 5:\n"
            "        time.sleep(0.001)\n"
            "    return step(self, frame, **others)\n"
            "foreglow.pipeline.Pipeline.step = looping\n"
            "main()\n"
        ),
    )
    command = [sys.executable, "-c", code, "live", str(shipped_drive()), "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 2, done.stderr
    assert "hung 3 times; start again" in done.stderr.splitlines()[-1]
    assert names(out) == RESULTS
    assert json.loads((out / "summary.json").read_text())["is_complete"] is False


def test_without_a_camera_it_says_why_and_gives_up(tmp_path: Path) -> None:
    result = foreglow_command("live", "camera:/dev/no_camera", "--give-up", 1, "--out", tmp_path / "out")
    assert result.exit_code == 2
    *status, last = result.stderr.splitlines()
    assert any("camera_gone (OSError: camera:/dev/no_camera: cannot be opened)" in line for line in status)
    assert last.startswith("foreglow: camera:/dev/no_camera: no frame for 1 s: ")
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["num_frames"] == 0


def test_killed_process_leaves_no_half_written_result(tmp_path: Path, program: Loaded) -> None:
    out = tmp_path / "out"
    process = program.start("live", shipped_drive(), "--speed", "0.5", "--out", out)
    partial = out / "frames.jsonl.partial"
    deadline_s = time.monotonic() + 60
    while not (partial.exists() and partial.stat().st_size):
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    assert process.ended()[0] == -signal.SIGKILL
    assert not RESULTS & names(out)


def test_bad_input(tmp_path: Path) -> None:
    assert "no such file or folder" in complaint("live", tmp_path / "absent")
    assert "scenario: expected one of" in complaint("live", "simulate:nowhere")
    other = tmp_path / "scene.json"
    other.touch()
    for path in (other, tmp_path / "absent"):
        assert f"{path}: expected a scene, a file whose name ends with .toml" in complaint("live", f"simulate:{path}")
    assert "--can nonsense:1: expected an interface of python-can" in complaint(
        "live", shipped_drive(), "--can", "nonsense:1"
    )
    assert "--speed" in complaint("live", shipped_drive(), "--speed", -1)
    assert "expected a model" in complaint("live", shipped_drive(), "--preset", "paper")
    assert "--can-in: expected neither" in complaint(
        "live", "camera:0", "--can-in", "virtual:x", "--map", "a", "--poses", "b"
    )


@pytest.mark.parametrize(
    ("source", "option", "value"),
    [
        ("a drive", "--size", "640x480"),
        ("a drive", "--rate", 5),
        ("a drive", "--seed", 5),
        ("a drive", "--quality", "fast"),
        ("a drive", "--can-in", "virtual:x"),
        ("a drive", "--camera-delay", 0.1),
        ("camera:0", "--topic", "/image"),
        ("camera:0", "--speed", 2),
        ("camera:0", "--seed", 5),
        ("rtsp://127.0.0.1:1/night", "--size", "640x480"),
        ("simulate:curve", "--speed", 2),
        ("simulate:curve", "--calibration", "camera.toml"),
        ("simulate:curve", "--rate", 5),
        ("simulate:curve", "--lamps", files("foreglow.photometry") / "headlamps.toml"),
    ],
)
def test_an_option_without_effect_is_an_error(source: str, option: str, value: object) -> None:
    named = str(shipped_drive()) if source == "a drive" else source
    line = complaint("live", named, option, value)
    assert line == f"foreglow: {option}: expected with another kind of SOURCE: no effect on {named}\n"


@pytest.mark.parametrize("command", ["source", "all"])
def test_an_option_without_effect_on_a_source_of_ros_2(command: str) -> None:
    assert "--loop: expected with another kind" in complaint("ros2", command, "camera:0", "--loop")
    assert "--rate: expected with another kind" in complaint("ros2", command, shipped_drive(), "--rate", 5)


@pytest.mark.parametrize("option", ["--can-log", "--dbc", "--mapping", "--map", "--poses"])
def test_a_file_without_effect_on_a_camera_of_ros_2(option: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    assert f"{option}: expected with another kind" in complaint("ros2", "source", "camera:0", option, tmp_path / "file")


@pytest.mark.parametrize("option", ["--time-offset", "--pose-error"])
def test_a_number_without_effect_on_a_camera_of_ros_2(option: str) -> None:
    assert f"{option}: expected with another kind" in complaint("ros2", "source", "camera:0", option, 1)


def test_lamps_that_take_gaps_brighten_as_slowly_as_they_can() -> None:
    """A message has 3 s at most: with a slower policy, each command was an error of the bus."""
    config = preset("foreglow").commanding(restore_s=10.0)
    bus = lamp_bus("virtual:slow", config)
    try:
        bus.send(BeamCommand.low(0, NUM_LEDS))
    finally:
        bus.close()


def test_numbers_without_effect_are_errors() -> None:
    for option, value in (("--time-offset", 1), ("--pose-error", 2)):
        assert f"{option}: expected with" in complaint("live", shipped_drive(), option, value)


def test_a_region_outside_the_frames_ends_it(tmp_path: Path) -> None:
    """No later frame is another chance, as after an error in a stage."""
    config, out = tmp_path / "region.toml", tmp_path / "out"
    config.write_text("[proposals]\nregion_xyxy_px = [5000, 0, 5100, 100]\n")
    result = foreglow_command("live", shipped_drive(), "--config", config, "--out", out)
    assert result.exit_code == 2, result.output
    line = result.stderr.splitlines()[-1]
    assert line.startswith(f"foreglow: {config}: proposals.region_xyxy_px: expected a part of the frame, ")
    assert not (out / "summary.json").exists()


@pytest.mark.parametrize("damage", ["cut", "hole"])
def test_what_a_recording_lacks_ends_it(damage: str, tmp_path: Path) -> None:
    """All that is there is played; what is lost may have been any number of frames."""
    path, out = make_mcap(tmp_path / "drive.mcap", images(5)), tmp_path / "out"
    data = bytearray(path.read_bytes())
    starts = [position for position in range(len(data)) if data.startswith(b"zstd", position)]
    if damage == "cut":
        data = data[: starts[4] + 100]
    else:
        data[starts[2] + 100 : starts[2] + 120] = bytes(20)
    path.write_bytes(data)
    result = foreglow_command("live", path, "--speed", 0, "--out", out)
    assert result.exit_code == 2, result.output
    line = result.stderr.splitlines()[-1]
    assert line.startswith(f"foreglow: expected a whole recording, frames may be lost: {path}: ")
    assert "1 left out as unreadable, the first: " in result.stdout
    assert num_lines(out) == 4
    summary = read_summary(out / "summary.json")
    assert (summary.is_complete, summary.num_lost_parts) == (False, 1)


def test_a_video_that_is_cut_ends_it(tmp_path: Path) -> None:
    data = make_video(tmp_path / "whole.mkv").read_bytes()
    path, out = tmp_path / "cut.mkv", tmp_path / "out"
    path.write_bytes(data[: len(data) * 2 // 3])
    result = foreglow_command("live", path, "--speed", 0, "--out", out)
    assert result.exit_code == 2, result.output
    assert f"frames may be lost: {path}: truncated video, " in result.stderr.splitlines()[-1]
    assert num_lines(out) > 4
    summary = read_summary(out / "summary.json")
    assert (summary.is_complete, summary.num_lost_parts) == (False, 1)


def test_images_that_cannot_be_read_up_to_the_end(tmp_path: Path) -> None:
    """As of a folder that was removed meanwhile: it ended before its last image."""
    images, out = tmp_path / "images", tmp_path / "out"
    images.mkdir()
    for name, content in (("000", PNG), ("001", PNG[:50]), ("002", PNG), ("003", PNG[:50]), ("004", b"no image")):
        (images / f"{name}.png").write_bytes(content)
    result = foreglow_command("live", images, "--speed", 0, "--out", out)
    assert result.exit_code == 2, result.output
    start = f"foreglow: expected images up to the end, the last 2 cannot be read: {images / '003.png'}: "
    assert result.stderr.splitlines()[-1].startswith(start)
    assert num_lines(out) == 2
    summary = read_summary(out / "summary.json")
    assert (summary.is_complete, summary.num_skipped, summary.num_lost_parts) == (False, 3, 0)
    assert f"fault at 0.11 s until the end: {LiveFault.CAMERA_GONE} (ValueError: expected images up" in result.stdout


def test_unreadable_images_are_left_out(tmp_path: Path) -> None:
    images, out = tmp_path / "images", tmp_path / "out"
    images.mkdir()
    for name, content in (("000", PNG), ("001", PNG[:50]), ("002", b"no image"), ("003", PNG)):
        (images / f"{name}.png").write_bytes(content)
    result = foreglow_command("live", images, "--speed", 0, "--out", out)
    assert result.exit_code == 0, result.output
    assert "2 left out as unreadable, the first: " in result.stdout
    assert result.stdout.count("as unreadable") == 1
    assert num_lines(out) == 2
    assert json.loads((out / "summary.json").read_text())["num_skipped"] == 2
    for path in images.iterdir():
        path.write_bytes(PNG[:50])
    for source in (images, images / "000.png"):
        line = complaint("live", source, "--speed", 0, "--out", tmp_path / "nothing")
        assert "expected a readable frame; " in line
        assert line.count("000.png") == 1


def test_a_source_that_ends_with_an_error_leaves_its_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def frames(source: Paced) -> Iterator[Frame]:
        for frame in source._source:
            if frame.frame == 10_005:
                raise OSError(errno.EIO, "Input/output error", "night")
            yield frame

    monkeypatch.setattr(Paced, "__iter__", frames)
    out = tmp_path / "out"
    result = foreglow_command("live", shipped_drive(), "--speed", 0, "--out", out)
    assert result.exit_code == 2
    assert "Input/output error" in result.stderr
    assert names(out) == RESULTS
    assert num_lines(out) == 5
    assert json.loads((out / "summary.json").read_text())["is_complete"] is False


@contextlib.contextmanager
def files_of_at_most(num_bytes: int) -> Iterator[None]:
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (num_bytes, usual[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)


def test_results_until_the_disk_is_full_can_be_read(tmp_path: Path) -> None:
    out, beam = tmp_path / "out", tmp_path / "beam"
    with files_of_at_most(2 * ROOM_BYTES):
        result = foreglow_command("live", shipped_drive(), "--speed", 0, "--out", out)
    assert result.exit_code == 2, result.output
    assert result.stderr.splitlines()[-1] == f"foreglow: not recorded: {out / 'frames.jsonl'}: File too large"
    assert "could not keep up" not in result.stdout
    assert names(out) == RESULTS
    assert 2 * ROOM_BYTES - 10_000 < (out / "frames.jsonl").stat().st_size < 2 * ROOM_BYTES
    num_frames = num_lines(out)
    assert len((out / "times.jsonl").read_text().splitlines()) == num_frames
    with pytest.warns(UserWarning, match=f"interrupted after {num_frames} frames"):
        run = read_run(out)
    assert not run.summary.is_complete
    assert run.summary.num_frames == num_frames == sum(map(len, run.sequences.values()))
    assert run.summary.beam is not None
    assert run.summary.beam.num_low + run.summary.beam.num_glare_free + run.summary.beam.num_full == num_frames
    assert foreglow_command("beam", out, "--out", beam).exit_code == 0
    assert num_lines(beam) == num_frames
    assert not read_summary(beam / "summary.json").is_complete


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.process)])
def test_a_full_disk_of_a_run_names_the_output(jobs: int, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with files_of_at_most(50_000):
        result = foreglow_command("run", shipped_drive(), "--out", out, "--jobs", jobs)
    assert result.exit_code == 2, result.output
    assert result.stderr.splitlines()[-1] in (
        f"foreglow: {out / 'frames.jsonl'}: File too large",
        f"foreglow: {out}: File too large",
    )
    assert not out.exists()


@pytest.mark.parametrize("command", ["live", "run"])
def test_a_recording_without_a_frame_is_not_kept(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("foxglove")

    def interrupted(*_: object) -> None:
        assert (tmp_path / "x.mcap.partial").exists()
        raise KeyboardInterrupt

    monkeypatch.setattr("foreglow.cli.live.viewer_sinks", interrupted)
    monkeypatch.setattr("foreglow.cli.run.viewer_sinks", interrupted)
    line = (command, shipped_drive(), "--out", tmp_path / "out", "--record", tmp_path / "x.mcap")
    assert foreglow_command(*line).exit_code == 130
    assert not names(tmp_path)


def test_recording_named_after_its_time(tmp_path: Path) -> None:
    pytest.importorskip("foxglove")
    named = tmp_path / "drive_%Y.mcap"
    assert foreglow_command("live", shipped_drive(), "--speed", 0, "--limit", 3, "--record", named).exit_code == 0
    (recording,) = tmp_path.iterdir()
    assert recording.name == f"drive_{time.strftime('%Y')}.mcap"
    before = recording.read_bytes()
    assert foreglow_command("live", recording, "--speed", 0, "--record", named).exit_code == 0
    assert names(tmp_path) == {recording.name, f"{recording.stem}_2.mcap"}  # by a clock that begins anew
    assert recording.read_bytes() == before
    again = foreglow_command("live", recording, "--speed", 0, "--out", tmp_path / "out")
    assert again.exit_code == 0, again.output
    assert num_lines(tmp_path / "out") == 3


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_recording_of_a_process_that_is_ended(tmp_path: Path, program: Loaded, how: signal.Signals) -> None:
    pytest.importorskip("foxglove")
    recording = tmp_path / "drive.mcap"
    partial = tmp_path / "drive.mcap.partial"
    process = program.start("live", shipped_drive(), "--speed", "0.5", "--record", recording)
    deadline_s = time.monotonic() + 60
    while not (partial.exists() and partial.stat().st_size > 6_000_000):  # more than the first chunk, of 4 MB
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    process.send_signal(how)
    assert process.ended()[0] == (130 if how == signal.SIGINT else -how)
    left = recording if how == signal.SIGINT else partial
    hidden = {path.name for path in tmp_path.iterdir() if is_temporary(path)}
    assert names(tmp_path) == {left.name} | hidden
    assert not hidden or how == signal.SIGKILL
    assert foreglow_command("live", left, "--speed", 0, "--out", tmp_path / "out").exit_code == 0
    assert num_lines(tmp_path / "out") >= 2


RAISING = """
class Raising:
    def __init__(self, config):
        pass

    def update(self, *_):
        raise ValueError("first line\\n  second line")

    def reset(self):
        pass
"""


def test_what_a_plug_in_raises_is_told_on_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    importlib.invalidate_caches()
    Path("talkative_tracker.py").write_text(RAISING)
    Path("own.toml").write_text('[tracker]\nmethod = "talkative_tracker:Raising"\n')
    result = foreglow_command(
        "live", shipped_drive(), "--speed", 0, "--limit", 2, "--config", "own.toml", "--out", "out"
    )
    assert result.exit_code == 0, result.output
    assert "ValueError: first line second line" in result.stdout
    assert "ValueError: first line second line" in result.stderr
    assert all("second line" not in line or "first line" in line for line in result.output.splitlines())


@pytest.mark.process
@pytest.mark.parametrize("begins", ["threading.Thread", "multiprocessing.Process"])
def test_what_a_plugin_has_begun_does_not_keep_the_process(begins: str, tmp_path: Path) -> None:
    (tmp_path / "begins.py").write_text(f"""
import multiprocessing, threading, time
from foreglow.beam.policy import ForeglowPolicy

def policy(config, headlamps):
    {begins}(target=time.sleep, args=(120,)).start()
    return ForeglowPolicy(config, headlamps)
""")
    (tmp_path / "begins.toml").write_text('[beam]\npolicy = "begins:policy"\n')
    line = ["live", shipped_drive(), "--speed", "0", "--limit", "2", "--config", "begins.toml"]
    command = [sys.executable, "-c", "from foreglow.cli import main; main()", *map(str, line)]
    assert subprocess.run(command, cwd=tmp_path, capture_output=True, timeout=60, check=False).returncode == 0
