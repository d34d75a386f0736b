"""`foreglow beam`, as a user types it: on frames, and on an earlier run."""

from __future__ import annotations

import json
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from foreglow import preset, read_config
from foreglow.cli.beam import lamp_bus
from foreglow.config import BeamConfig, config_to_toml
from foreglow.datasets import shipped_drive
from foreglow.photometry.headlamps_file import SHIPPED
from foreglow.runs.recorded_run import read_frames, read_run
from foreglow.types import BeamCommand, BeamMode
from tests.cli.commands import RESULTS, complaint, foreglow_command, names, without_digest

NUM_FRAMES = 24
LIMIT = ("--limit", NUM_FRAMES)


def beam(*arguments: object) -> str:
    result = foreglow_command("beam", *arguments)
    assert result.exit_code == 0, result.output
    return result.stdout


def lines(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "frames.jsonl").read_text().splitlines()]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first second of the drive that ships, as `run` leaves it."""
    out = tmp_path_factory.mktemp("run") / "run"
    assert foreglow_command("run", shipped_drive(), "--out", out, *LIMIT).exit_code == 0
    return out


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Images alone, in which a car is in sight."""
    folder = tmp_path_factory.mktemp("own") / "images"
    folder.mkdir()
    for image in sorted((shipped_drive() / "images/S00001").iterdir())[64:76]:
        shutil.copy(image, folder)
    return folder


@pytest.fixture
def equipment(tmp_path: Path) -> tuple[object, ...]:
    """Options for images alone: calibration, and that no speed is needed."""
    (tmp_path / "own.toml").write_text("[guard]\nneeds_speed = false\n")
    return "--calibration", CALIBRATION, "--config", tmp_path / "own.toml"


CALIBRATION = shipped_drive() / "simulation/S00001/camera.toml"


@pytest.mark.slow
def test_from_frames(tmp_path: Path, images: Path, equipment: tuple[object, ...]) -> None:
    said = beam(images, "--out", tmp_path / "out", *equipment)
    assert names(tmp_path / "out") == RESULTS
    assert read_config(tmp_path / "out" / "config.toml").beam.policy == "foreglow"
    records = lines(tmp_path / "out")
    assert len(records) == 12
    modes = [record["beam"]["mode"] for record in records]
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["beam"]["num_full"] == modes.count("full")
    assert set(summary["run_time_ms"]) == {"proposals", "classifier", "distance", "tracking", "beam", "total"}
    gaps = [gap for record in records for gap in record["beam"]["gaps"]]
    assert gaps
    assert all(gap["right_deg"] < gap["left_deg"] for gap in gaps)
    mean_deg = sum(gap["left_deg"] - gap["right_deg"] for gap in gaps) / len(gaps)
    assert summary["beam"]["mean_gap_deg"] == pytest.approx(mean_deg, abs=0.002)
    assert f"beam, of the frames: full {modes.count('full') / 12:.1%}" in said
    assert f"gaps {mean_deg:.1f} degrees wide in the mean" in said
    for record in records:
        left, right = record["beam"]["levels"]
        assert (len(left), len(right)) == (84, 84)
        assert all(isinstance(level, int) and 0 <= level <= 1000 for level in left + right)


@pytest.mark.slow
def test_from_an_earlier_run_it_is_the_same(tmp_path: Path, images: Path, equipment: tuple[object, ...]) -> None:
    beam(images, "--out", tmp_path / "frames", *equipment)
    assert foreglow_command("run", images, "--out", tmp_path / "earlier", *equipment[:2]).exit_code == 0
    assert {record["beam"] for record in lines(tmp_path / "earlier")} == {None}
    beam(tmp_path / "earlier", "--out", tmp_path / "run", *equipment)
    for expected, found in zip(lines(tmp_path / "frames"), lines(tmp_path / "run"), strict=True):
        (wanted, its) = expected.pop("beam"), found.pop("beam")  # files have boxes to a thousandth of a pixel
        np.testing.assert_allclose(its.pop("levels"), wanted.pop("levels"), atol=1)
        for gap, same in zip(its.pop("gaps"), wanted.pop("gaps"), strict=True):
            assert gap == pytest.approx(same, abs=0.01)
        assert (its, found) == (wanted, expected)
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["source"] == str(images)
    times = [json.loads(line) for line in (tmp_path / "run" / "times.jsonl").read_text().splitlines()]
    assert [(time["frame"], set(time["stage_ms"])) for time in times] == [
        (line["frame"], {"beam"}) for line in lines(tmp_path / "run")
    ]


def test_limit_of_an_earlier_run(tmp_path: Path, run: Path) -> None:
    beam(run, "--out", tmp_path / "out", "--limit", 3)
    assert len(lines(tmp_path / "out")) == 3


def test_the_model_is_that_of_the_run(tmp_path: Path, run: Path) -> None:
    """Another one may lie at its path by now, which has scored nothing here."""
    shutil.copytree(run, tmp_path / "run")
    path = tmp_path / "run" / "summary.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"model_sha256": "5" * 64}))
    beam(tmp_path / "run", "--out", tmp_path / "out", "--limit", 3)
    assert json.loads((tmp_path / "out/summary.json").read_text())["model_sha256"] == "5" * 64


def as_interrupted(run: Path, copy: Path) -> Path:
    """A copy of a run, as if Ctrl-C had ended it."""
    shutil.copytree(run, copy)
    summary = json.loads((copy / "summary.json").read_text())
    (copy / "summary.json").write_text(json.dumps(summary | {"is_complete": False}))
    return copy


@pytest.mark.slow
def test_what_an_interrupted_run_lacks_its_beam_lacks_too(tmp_path: Path, run: Path) -> None:
    cut = as_interrupted(run, tmp_path / "cut")
    said = beam(cut, "--out", tmp_path / "out")
    assert f"{cut}: the run was interrupted after {NUM_FRAMES} frames, what is made from it is incomplete\n" in said
    assert json.loads((tmp_path / "out/summary.json").read_text())["is_complete"] is False
    said = beam(run, "--out", tmp_path / "whole", "--limit", 3)
    assert "incomplete" not in said
    assert json.loads((tmp_path / "whole/summary.json").read_text())["is_complete"] is True


@pytest.mark.slow
def test_frames_that_an_interrupted_run_of_several_jobs_left_out_are_left_out(tmp_path: Path, run: Path) -> None:
    cut, left_out = as_interrupted(run, tmp_path / "cut"), 2
    kept = [line for line in lines(run) if line != lines(run)[left_out]]
    (cut / "frames.jsonl").write_text("".join(json.dumps(line) + "\n" for line in kept))
    summary = json.loads((cut / "summary.json").read_text())
    del summary["frames_sha256"]
    threshold = read_config(run / "config.toml").classifier.score_threshold
    counts = {
        "num_frames": len(kept),
        "num_proposals": sum(len(line["proposals_xyxy_px"]) for line in kept),
        "num_accepted": sum(score >= threshold for line in kept for score in line["scores"]),
    }
    (cut / "summary.json").write_text(json.dumps(summary | counts))
    for number, earlier in enumerate((cut, tmp_path / "out0")):
        beam(earlier, "--out", tmp_path / f"out{number}")
        assert [line["frame"] for line in lines(tmp_path / f"out{number}")] == [line["frame"] for line in kept]


@pytest.mark.slow
def test_another_calibration_than_that_of_the_run_is_told(
    tmp_path: Path, images: Path, equipment: tuple[object, ...]
) -> None:
    run, other = tmp_path / "run", tmp_path / "other.toml"
    assert foreglow_command("run", images, "--out", run, *equipment[:2]).exit_code == 0
    same = foreglow_command("beam", run, "--out", tmp_path / "same", *equipment)
    assert (same.exit_code, same.stderr) == (0, "")
    text = CALIBRATION.read_text()
    pitch = re.search(r"pitch_deg = (\S+)", text)
    assert pitch is not None
    other.write_text("\n".join(line for line in text.splitlines() if "digest" not in line and not line.startswith("#")))
    other.write_text(other.read_text().replace(pitch[0], "pitch_deg = 2.5"))
    for earlier, out in ((run, tmp_path / "out"), (tmp_path / "out", tmp_path / "again")):
        found = foreglow_command("beam", earlier, "--out", out, "--calibration", other, *equipment[2:])
        assert found.exit_code == 0, found.output
        words = "its ranges were made with another calibration, and stay as they are"
        assert found.stderr == f"foreglow: {earlier}: {words}: mount.pitch_deg was {float(pitch[1])}, is 2.5 now\n"
        summary = json.loads((out / "summary.json").read_text())
        assert summary["calibration"]["mount"]["pitch_deg"] == float(pitch[1])
        assert summary["beam_calibration"]["mount"]["pitch_deg"] == 2.5
    summary = json.loads((tmp_path / "same" / "summary.json").read_text())
    assert (summary["calibration"]["mount"]["pitch_deg"], summary["beam_calibration"]) == (float(pitch[1]), None)


@pytest.mark.slow
def test_a_run_without_calibration_is_told(tmp_path: Path, images: Path, equipment: tuple[object, ...]) -> None:
    run = tmp_path / "run"
    assert foreglow_command("run", images, "--out", run).exit_code == 0
    found = foreglow_command("beam", run, "--out", tmp_path / "out", *equipment)
    assert found.exit_code == 0, found.output
    assert found.stderr == f"foreglow: {run}: made without a calibration, so that its tracks have no ranges\n"
    assert "nothing has a range" not in found.stdout  # no estimator was asked
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["calibration"] is None
    assert summary["beam_calibration"] is not None


def test_an_image_that_was_damaged_since_the_run_is_named(
    tmp_path: Path, images: Path, equipment: tuple[object, ...]
) -> None:
    """In place, so that nothing else tells; it said only that one was missing."""
    there, run = tmp_path / "images", tmp_path / "run"
    shutil.copytree(images, there)
    assert foreglow_command("run", there, "--out", run, *equipment).exit_code == 0
    damaged = sorted(there.iterdir())[5]
    damaged.write_bytes(bytes(damaged.stat().st_size))
    said = complaint("beam", run, "--out", tmp_path / "out", *equipment)
    assert "images: expected the 12 frames of the run, there are 11 now; " in said
    assert str(damaged) in said
    said = complaint("labels", "export", there, "--run", run, "--out", tmp_path / "guess.xml")
    assert "images: expected the frames of the run, has no frame" in said
    assert str(damaged) in said
    recorded = read_run(run)
    with pytest.raises(ValueError, match=rf"images: expected .*, there are others now; {re.escape(str(damaged))}"):
        read_frames(recorded, [result for results in recorded.sequences.values() for result in results])


def test_a_run_whose_frames_are_no_longer_all_there(
    tmp_path: Path, images: Path, equipment: tuple[object, ...]
) -> None:
    there = tmp_path / "images"
    shutil.copytree(images, there)
    command = ("run", there, "--out", tmp_path / "run", *equipment)
    assert foreglow_command(*command).exit_code == 0
    max(there.iterdir()).unlink()
    said = complaint("beam", tmp_path / "run", "--out", tmp_path / "out", *equipment)
    assert "images, what is there is not what the run was made from" in said
    without_digest(tmp_path / "run")
    said = complaint("beam", tmp_path / "run", "--out", tmp_path / "out", *equipment)
    assert "images: expected the 12 frames of the run, there are 11 now" in said
    assert not (tmp_path / "out").exists()
    lines = (tmp_path / "run/frames.jsonl").read_text().splitlines(keepends=True)
    (tmp_path / "run/frames.jsonl").write_text("".join(lines[:5]))
    said = complaint("beam", tmp_path / "run", "--out", tmp_path / "out", *equipment)
    assert "frames.jsonl: expected the 12 frames of summary.json, got 5" in said


def test_what_the_tracks_of_a_run_were_made_with_cannot_be_changed(tmp_path: Path, run: Path) -> None:
    (tmp_path / "own.toml").write_text("[classifier]\nscore_threshold = 0.2\n")
    said = complaint("beam", run, "--out", tmp_path / "out", "--config", tmp_path / "own.toml")
    assert "own.toml: classifier: expected that of" in said
    (tmp_path / "own.toml").write_text("[guard]\nwhite_level = 200\n")
    said = complaint("beam", run, "--out", tmp_path / "out", "--config", tmp_path / "own.toml")
    assert "own.toml: guard.white_level: expected that of" in said
    assert not (tmp_path / "out").exists()
    beam(run, "--out", tmp_path / "out", "--config", run / "config.toml")


@pytest.mark.parametrize(("policy", "level"), [("low", 0), ("high", 1000)])
def test_plain_beams(tmp_path: Path, run: Path, policy: str, level: int) -> None:
    (tmp_path / "own.toml").write_text("[beam]\npolicy = 'paper'\n[guard]\nled_limits_cd = [[0.0, 1e9]]\n")
    beam(run, "--out", tmp_path / "out", "--policy", policy, "--config", tmp_path / "own.toml")
    last = lines(tmp_path / "out")[-1]["beam"]
    assert {code for lamp in last["levels"] for code in lamp} == {level}
    assert read_config(tmp_path / "out" / "config.toml").beam.policy == policy


def test_the_files_policy_counts_where_none_is_given(tmp_path: Path, run: Path) -> None:
    (tmp_path / "own.toml").write_text("[beam]\npolicy = 'paper'\n")
    beam(run, "--out", tmp_path / "out", "--config", tmp_path / "own.toml", "--limit", 2)
    assert read_config(tmp_path / "out" / "config.toml").beam.policy == "paper"


def test_a_run_does_not_choose_which_code_runs(tmp_path: Path, run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Results come from others, too: what their configuration names is not imported."""
    theirs = shutil.copytree(run, tmp_path / "theirs")
    config = read_config(theirs / "config.toml").commanding(policy="their_module:Policy")
    (theirs / "config.toml").write_text(config_to_toml(config))
    (tmp_path / "their_module.py").write_text("open('imported', 'w').close()\n")
    monkeypatch.chdir(tmp_path)
    said = complaint("beam", theirs, "--out", tmp_path / "out")
    assert "theirs/config.toml: beam.policy: expected one of Foreglow's" in said
    assert not (tmp_path / "imported").exists()
    assert "their_module" in complaint("beam", theirs, "--out", tmp_path / "out", "--policy", "their_module:Policy")


@pytest.mark.slow
def test_pictures_and_a_can_log(tmp_path: Path, run: Path) -> None:
    cantools, can = pytest.importorskip("cantools"), pytest.importorskip("can")
    from foreglow.beam.messages import OWN_DBC

    said = beam(run, "--out", tmp_path / "out", "--video", "--can", "asc", "--limit", 12)
    assert names(tmp_path / "out") == {*RESULTS, "beam.mp4", "beam.asc"}
    assert "beam.asc, beam.mp4, config.toml" in said
    with av.open(str(tmp_path / "out" / "beam.mp4")) as container:
        pictures = [picture.to_ndarray(format="bgr24") for picture in container.decode(video=0)]
    assert len(pictures) == 12
    database = cantools.database.load_file(OWN_DBC)
    with can.ASCReader(tmp_path / "out" / "beam.asc") as log:
        messages = [(each.arbitration_id, database.decode_message(each.arbitration_id, each.data)) for each in log]
    assert len(messages) == 5 * 12
    for index, record in enumerate(lines(tmp_path / "out")):
        of_frame = dict(messages[5 * index : 5 * index + 5])
        gaps = of_frame[0x3B4]
        assert gaps["Time"] == record["timestamp_ns"] // 1_000_000
        assert gaps["Mode"] == {"full": "Full", "glare_free": "GlareFree", "low": "Low"}[record["beam"]["mode"]]
        assert BeamConfig().restore_s <= float(gaps["Ramp"]) < BeamConfig().restore_s + 0.2
        assert float(of_frame[0x3B0]["Left00"]) == pytest.approx(record["beam"]["levels"][0][0] / 1000, abs=0.006)
    beam(run, "--out", tmp_path / "out", "--limit", 2)
    assert names(tmp_path / "out") == RESULTS


@pytest.mark.slow
def test_one_image_with_its_picture(tmp_path: Path, images: Path, equipment: tuple[object, ...]) -> None:
    beam(sorted(images.iterdir())[0], "--out", tmp_path / "out", *equipment, "--video")
    assert names(tmp_path / "out") == {*RESULTS, "beam.png"}
    assert cv2.imread(str(tmp_path / "out" / "beam.png")) is not None


def test_faults_are_counted(tmp_path: Path, images: Path) -> None:
    (tmp_path / "same").mkdir()
    for index in range(3):
        shutil.copy(sorted(images.iterdir())[0], tmp_path / "same" / f"{index}.jpg")
    (tmp_path / "own.toml").write_text("[guard]\nneeds_speed = false\nmax_same_images = 1\n")
    options = ("--calibration", CALIBRATION, "--config", tmp_path / "own.toml")
    said = beam(tmp_path / "same", "--out", tmp_path / "out", *options)
    assert "low beam for camera_frozen in 2 frames" in said
    assert lines(tmp_path / "out")[-1]["beam"]["faults"] == ["camera_frozen"]


def test_other_lamps(tmp_path: Path, run: Path) -> None:
    lamps = tmp_path / "lamps.toml"
    lamps.write_text(
        SHIPPED.read_text()
        .replace("num_columns = 28", "num_columns = 14")
        .replace("pitch_deg = 1.2", "pitch_deg = 2.4")
    )
    beam(run, "--out", tmp_path / "out", "--lamps", lamps, "--limit", 2)
    assert len(lines(tmp_path / "out")[0]["beam"]["levels"][0]) == 42
    assert read_config(tmp_path / "out" / "config.toml").beam.headlamps == lamps
    pytest.importorskip("can")
    line = complaint("beam", run, "--out", tmp_path / "x", "--lamps", lamps, "--can", "asc")
    assert "--can: expected lamps of 84 LEDs" in line
    assert "have 42 each; --compact writes their gaps alone" in line


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--policy", "best"], "--policy: expected one of low, high, paper, foreglow, or module:Name, got 'best'"),
        (["--lamps", "absent.toml"], "absent.toml: no such"),
        (["--can", "csv"], "--can: expected one of asc, blf, log, got 'csv'"),
        (["--compact"], "--compact: expected --can beside it"),
        (["--preset", "paper"], "expected neither --preset nor --model with a run"),
        (["--model", "foreglow"], "expected neither --preset nor --model with a run"),
        (["--config", "absent.toml"], "absent.toml: no such file"),
        (["--on-error", "mark"], "--on-error: expected without a run"),
    ],
)
def test_bad_option_is_one_line(tmp_path: Path, run: Path, options: list[str], expected: str) -> None:
    pytest.importorskip("can")
    assert expected in complaint("beam", run, "--out", tmp_path / "out", *options)
    assert not (tmp_path / "out").exists()


def test_broken_lamps_name_file_and_field(tmp_path: Path, run: Path) -> None:
    lamps = tmp_path / "lamps.toml"
    lamps.write_text(SHIPPED.read_text().replace("num_columns = 28", "num_columns = 'many'"))
    line = complaint("beam", run, "--out", tmp_path / "out", "--lamps", lamps)
    assert "lamps.toml: grid.num_columns: " in line
    assert not (tmp_path / "out").exists()


def test_nothing_to_make_tracks_with(tmp_path: Path) -> None:
    line = complaint("beam", shipped_drive(), "--out", tmp_path / "out", "--preset", "paper")
    assert "expected a model (--model FILE) and a tracker" in line


def test_frames_without_calibration_or_speed(tmp_path: Path, images: Path) -> None:
    line = complaint("beam", images, "--out", tmp_path / "out")
    assert "images: the beam needs the camera's calibration: expected --calibration FILE" in line
    line = complaint("beam", images, "--out", tmp_path / "out", "--calibration", CALIBRATION)
    assert "images: the beam needs our speed: expected --can-log FILE, or needs_speed = false under [guard]" in line
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_runs_that_cannot_be_used(tmp_path: Path, run: Path) -> None:
    def broken(name: str, file: str, old: str, new: str) -> Path:
        copy = Path(shutil.copytree(run, tmp_path / name))
        text = (copy / file).read_text()
        assert old in text
        (copy / file).write_text(text.replace(old, new, 1))
        return copy

    out = tmp_path / "out"
    moved = broken("moved", "summary.json", str(shipped_drive()), "nowhere")
    line = complaint("beam", moved, "--out", out)
    assert "summary.json: source: expected the run's frames, there is nothing at nowhere" in line
    assert f"give them in place of {moved}, with --config {moved / 'config.toml'}" in line
    later = broken("later", "frames.jsonl", '"timestamp_ns":0', '"timestamp_ns":1')
    line = complaint("beam", later, "--out", out)
    assert "later/frames.jsonl: expected the frames that the run wrote, by frames_sha256 in summary.json" in line
    without_digest(later)
    line = complaint("beam", later, "--out", out)
    assert "later: expected the frames of its source, has no frame 10000 at 0.000 s" in line
    trackless = tmp_path / "trackless"
    assert (
        foreglow_command("run", shipped_drive(), "--out", trackless, "--preset", "paper", "--limit", 1).exit_code == 0
    )
    line = complaint("beam", trackless, "--out", out)
    assert "trackless: expected the folder of a run with tracks: it had no model or no tracker" in line
    (moved / "summary.json").unlink()
    assert "summary.json: no such file" in complaint("beam", moved, "--out", out)
    assert not out.exists()


def test_output_that_is_a_file_or_the_run(tmp_path: Path, run: Path) -> None:
    (tmp_path / "out").write_text("mine")
    assert "expected a folder to write into, got a file" in complaint("beam", run, "--out", tmp_path / "out")
    before = (run / "frames.jsonl").read_bytes()
    assert "expected another folder for the results than" in complaint("beam", run, "--out", run)
    assert (run / "frames.jsonl").read_bytes() == before


def test_the_missing_extra_is_named(tmp_path: Path, run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "can", None)
    line = complaint("beam", run, "--out", tmp_path / "out", "--can", "asc")
    assert "pip install 'foreglow[can]'" in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("restore_s", "brightening_s", "ramp_s"), [(0.2, 0.5, 0.6), (10.0, 0.5, 3.0), (1.0, 60.0, 3.0)]
)
def test_lamps_that_take_gaps_brighten_no_faster_than_the_guard_lets_leds(
    restore_s: float, brightening_s: float, ramp_s: float
) -> None:
    can = pytest.importorskip("can")
    from foreglow.beam.messages import GAPS_ID, decode_gaps

    config = preset("foreglow").changed("beam", restore_s=restore_s).changed("guard", brightening_s=brightening_s)
    with can.Bus(interface="virtual", channel="ramps", fd=True) as listener:
        bus = lamp_bus("virtual:ramps", config)
        bus.send(BeamCommand(0, BeamMode.FULL, np.ones((2, 84))))
        bus.close()
        sent = {message.arbitration_id: bytes(message.data) for message in iter(lambda: listener.recv(0), None)}
    assert decode_gaps(GAPS_ID, sent[GAPS_ID]).ramp_s == pytest.approx(ramp_s)
