"""Counts, run-times and provenance of a run."""

from __future__ import annotations

import dataclasses
import hashlib
import subprocess
from pathlib import Path

import numpy as np
import pytest

from foreglow import provenance
from foreglow.config import PipelineConfig, preset
from foreglow.display.summary_lines import run_lines
from foreglow.files import json_text
from foreglow.geometry import Camera, Pose
from foreglow.models import SHA256
from foreglow.runs import tally as tallies
from foreglow.runs.summary_file import RunSummary
from foreglow.runs.tally import Tally, run_time
from foreglow.types import BeamCommand, BeamMode, Ranges, TrackState
from tests.stand_ins import night_frames, result_of, tracks_of

STATES = [TrackState.CONFIRMED, TrackState.TENTATIVE]


def summary_of(tally: Tally, config: PipelineConfig | None = None) -> RunSummary:
    return tally.summary("here", [], config or preset("foreglow"), is_complete=True, dispatch=None)


def test_run_time_of_a_hundred_values() -> None:
    assert run_time([float(k) for k in range(101)]) == {"median": 50.0, "p95": 95.0, "p99": 99.0}


def test_scored_boxes_are_counted() -> None:
    frame = night_frames(1)[0]
    tally = Tally()
    tally.add(frame, result_of(frame, [[0, 0, 4, 4], [8, 8, 12, 12]], [0.9, 0.1]))
    tally.add(frame, result_of(frame, [], []))
    counted = summary_of(tally)
    assert (counted.num_ranged, counted.num_tracks) == (0, None)
    assert (counted.num_frames, counted.num_proposals, counted.num_scored, counted.num_accepted) == (2, 2, 2, 1)
    assert counted.run_time_ms["total"] == {"median": 0.25, "p95": 0.25, "p99": 0.25}


def test_models_at_the_same_path_are_told_apart(tmp_path: Path) -> None:
    model, digests = tmp_path / "model.onnx", []
    config = preset("paper").changed("classifier", model=model)
    for content in (b"one", b"another", None):
        model.unlink(missing_ok=True)
        if content is not None:
            model.write_bytes(content)
        digests.append(summary_of(Tally(), config).model_sha256)
    assert digests == [hashlib.sha256(b"one").hexdigest(), hashlib.sha256(b"another").hexdigest(), None]
    assert summary_of(Tally()).model_sha256 == SHA256
    assert summary_of(Tally(), config.changed("classifier", model=None)).model_sha256 is None


def test_ranges_and_tracks_are_counted() -> None:
    frames = night_frames(2)
    tally = Tally()
    for frame, followed in zip(frames, (tracks_of([[0, 0, 4, 4], [8, 8, 9, 9]], STATES), tracks_of([])), strict=True):
        result = result_of(frame, [[0, 0, 4, 4], [8, 8, 12, 12]], [0.9, 0.1])
        assert result.detections is not None
        ranges = Ranges(result.detections, np.array([30.0, np.nan]), np.array([3.0, np.inf]))
        tally.add(frame, dataclasses.replace(result, ranges=ranges, tracks=followed))
    tally.add(night_frames(1, "S00002")[0], dataclasses.replace(result, tracks=tracks_of([[0, 0, 4, 4]])))
    counted = summary_of(tally)
    assert (counted.num_ranged, counted.num_tracks) == (2, 2)  # the tentative track does not count
    without = summary_of(tally, preset("foreglow").detector_only)
    assert without.num_ranged is None


@pytest.mark.parametrize(
    ("has_camera", "num_boxes", "words"),
    [(False, 0, "calibration is not known"), (True, 1, "need the road ahead"), (True, 0, None)],
)
def test_why_nothing_has_a_range(tmp_path: Path, has_camera: bool, num_boxes: int, words: str | None) -> None:
    """A camera whose calibration was given is not told to be unknown, such as where there are no boxes."""
    frame, tally = night_frames(1)[0], Tally()
    if has_camera:
        mount = Pose(np.array([1.9, 0.0, 1.3]), np.eye(3))
        size_px, centre_px = (frame.width_px, frame.height_px), (frame.width_px / 2, frame.height_px / 2)
        camera = Camera(*size_px, (100.0, 100.0), centre_px, (0.0,) * 5, mount)
        frame = dataclasses.replace(frame, camera=camera)
    tally.add(frame, result_of(frame, [[0, 0, 4, 4]] * num_boxes, [0.9] * num_boxes))
    lines = run_lines(summary_of(tally), tmp_path)
    told = [line for line in lines if line.startswith("nothing has a range: ")]
    assert len(told) == (words is not None)
    assert all(words is not None and words in line for line in told)


def test_beam_commands_are_counted() -> None:
    frame = night_frames(1)[0]
    bright, gaps_rad = np.ones((2, 4)), np.radians([[-3.0, -1.0], [0.0, 4.0]])
    commands = [
        BeamCommand(0, BeamMode.FULL, bright),
        BeamCommand(0, BeamMode.GLARE_FREE, bright, gaps_rad, np.array([50.0, np.nan])),
        BeamCommand.low(0, 4, "too_slow"),
        BeamCommand.low(0, 4, "image_black", "too_slow"),
    ]
    tally = Tally()
    assert summary_of(tally).beam is None
    for command in commands:
        tally.add(frame, dataclasses.replace(result_of(frame, []), beam=command))
    counted = summary_of(tally).beam
    assert counted is not None
    assert (counted.num_low, counted.num_glare_free, counted.num_full) == (2, 1, 1)
    assert counted.mean_gap_deg == 3.0
    assert list(counted.faults.items()) == [("too_slow", 2), ("image_black", 1)]


def test_commit_of_this_checkout() -> None:
    commit, has_local_changes = provenance.checkout_state()
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        assert (commit, has_local_changes) == (None, None)
        return
    command = ["git", "-C", str(root), "rev-parse", "HEAD"]
    assert commit == subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def test_no_commit_without_git(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    assert provenance.checkout_state() == (None, None)


def test_tallies_of_parts_are_that_of_the_whole() -> None:
    rng = np.random.default_rng(3)
    whole, first, second = Tally(), Tally(), Tally()
    for index, frame in enumerate([*night_frames(3, "S00001"), *night_frames(3, "S00002")]):
        result = result_of(frame, [[0, 0, 4, 4], [8, 8, 12, 12]], rng.random(2).tolist())
        gaps_rad = np.radians([[-3.0, -1.0], [0.0, 4.0 + index]])
        levels = np.ones((2, 4))
        beam = (
            BeamCommand.low(0, 4, f"fault_{index % 2}")
            if index % 3
            else BeamCommand(0, BeamMode.GLARE_FREE, levels, gaps_rad, np.array([50.0, np.nan]))
        )
        assert result.detections is not None
        ranges = Ranges(result.detections, np.array([30.0, np.nan]), np.array([3.0, np.inf]))
        result = dataclasses.replace(
            result, ranges=ranges, tracks=tracks_of([[0, 0, 4, 4]], ids=[index // 2]), beam=beam
        )
        result = dataclasses.replace(result, stage_ms={"proposals": float(rng.random())})
        for tally in (whole, second if index >= 3 else first):
            tally.add(frame, result)
    joined = Tally()
    for part in (first, second):
        joined.extend(part)
    expected, found = (summary_of(tally) for tally in (whole, joined))
    assert found == expected
    assert json_text(found) == json_text(expected)  # also the order of faults
    assert expected.num_tracks == 4


def test_a_tally_of_days_stays_small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tallies, "NUM_TIMES", 10)
    tally = Tally()
    frame = night_frames(1)[0]
    for number in range(200):
        result = result_of(frame, [[0, 0, 4, 4]], [0.9])
        tally.add(frame, dataclasses.replace(result, tracks=tracks_of([[0, 0, 4, 4]], ids=[number // 4])))
    assert len(tally._counted) == 1
    assert {len(times.values) for times in tally._stage_ms.values()} == {10}
    assert summary_of(tally).num_tracks == 50


def test_the_latest_times_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tallies, "NUM_TIMES", 4)
    first, later = tallies.LatestTimes(), tallies.LatestTimes()
    for value in range(7):
        first.add(value)
    assert sorted(first.values) == [3, 4, 5, 6]
    for value in range(10, 16):
        later.add(value)
    later.extend(first)
    assert sorted(later.values) == [3, 4, 5, 6]
    assert sorted(first.values) == [3, 4, 5, 6]
    first.add(7)
    later.extend(first)
    assert list(later.values[later._oldest :] + later.values[: later._oldest]) == [4, 5, 6, 7]


def test_the_source_is_found_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "drive").mkdir()
    monkeypatch.chdir(tmp_path)

    def source_of(name: str) -> str:
        return Tally().summary(name, [], preset("paper"), is_complete=True, dispatch=None).source

    assert source_of("drive") == str(tmp_path / "drive")
    assert source_of("camera:0") == "camera:0"
