"""A run that is read back from its folder is what was written."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from foreglow.config import config_to_toml
from foreglow.runs.frame_records import frame_record, time_record
from foreglow.runs.recorded_run import read_run
from foreglow.types import BeamCommand, BeamMode, Frame, FrameResult, TrackState
from tests.stand_ins import REFERENCE, night_image, result_of, tracks_of

SUMMARY = {
    "source": "images",
    "is_complete": True,
    "num_frames": 2,
    "num_proposals": 4,
    "num_accepted": 2,
    "num_tracks": 1,
    "num_skipped": 0,
    "beam": None,
    "run_time_ms": {"total": {"median": 0.25}},
    "version": "1.0",
    "commit": None,
    "has_local_changes": None,
    "processor": "one",
}


def write_run(folder: Path, made: list[tuple[Frame, FrameResult]], **changes: object) -> Path:
    """As a run leaves it."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "frames.jsonl").write_text("".join(json.dumps(frame_record(*one)) + "\n" for one in made))
    (folder / "times.jsonl").write_text("".join(json.dumps(time_record(*one)) + "\n" for one in made))
    (folder / "summary.json").write_text(json.dumps(SUMMARY | changes))
    (folder / "config.toml").write_text(config_to_toml(REFERENCE))
    return folder


def made_up(number: int, sequence: str = "S00001", faults: tuple[str, ...] = ()) -> tuple[Frame, FrameResult]:
    frame = Frame(night_image(), 50_000_000 * number, number, sequence)
    tracks = tracks_of([(10, 10, 20, 20)], [TrackState.CONFIRMED], ranges_m=[50.0 - number])
    gaps = np.zeros((0, 2)) if faults else np.radians([[-2.0, 3.0]])
    levels = np.full((2, 84), 0.0 if faults else 0.5)
    mode = BeamMode.LOW if faults else BeamMode.GLARE_FREE
    beam = BeamCommand(frame.timestamp_ns, mode, levels, gaps, np.full(len(gaps), 40.0), faults)
    plain = result_of(frame, [(10, 10, 20, 20), (30, 10, 40, 20)], [0.75, 0.25])
    return frame, dataclasses.replace(plain, tracks=tracks, beam=beam)


def test_everything_comes_back(tmp_path: Path) -> None:
    made = [made_up(1, "A"), made_up(2, "A", ("camera_dark",)), made_up(3, "B")]
    run = read_run(write_run(tmp_path / "run", made))
    assert {name: [one.frame for one in results] for name, results in run.sequences.items()} == {"A": [1, 2], "B": [3]}
    found = [one for its in run.sequences.values() for one in its]
    for (frame, _), result in zip(made, found, strict=True):
        expected = frame_record(*made[frame.frame - 1])
        assert frame_record(frame, result) == expected


def test_a_run_without_tracks_and_beam(tmp_path: Path) -> None:
    frame = Frame(night_image(), 0, 5)
    run = read_run(write_run(tmp_path, [(frame, result_of(frame, [(1, 2, 3, 4)]))]))
    ((result,),) = run.sequences.values()
    assert (result.detections, result.tracks, result.beam) == (None, None, None)
    assert result.stage_ms == {"proposals": 0.25}


def test_what_is_no_run(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"frames\.jsonl: no such file, expected the folder of a run"):
        read_run(tmp_path)
    write_run(tmp_path, [made_up(1)])
    text = (tmp_path / "frames.jsonl").read_text()
    (tmp_path / "frames.jsonl").write_text(text.replace('"glare_free"', '"bright"'))
    with pytest.raises(ValueError, match=r"frames\.jsonl: line 1: beam\.mode"):
        read_run(tmp_path)
    (tmp_path / "frames.jsonl").write_text(text.replace("[500, ", "[", 1))
    with pytest.raises(ValueError, match=r"frames\.jsonl: line 1"):
        read_run(tmp_path)
    (tmp_path / "summary.json").unlink()
    with pytest.raises(FileNotFoundError, match=r"summary\.json"):
        read_run(tmp_path)
