"""Tracks survive the way through `frames.jsonl`."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from foreglow.runs.frame_records import FrameRecords
from foreglow.runs.tracks_file import read_gaps, read_results, read_tracks, source_of_run
from foreglow.types import BeamCommand, BeamMode, FrameResult, Ranges, Tracks, TrackState
from tests.stand_ins import night_frames, result_of, tracks_of

BOXES = [[3.0, 4.0, 9.5, 8.25], [20.0, 21.0, 40.0, 33.0]]
STATES = [TrackState.TENTATIVE, TrackState.COASTING]


def write_run(path: Path, *followed: Tracks | None) -> Path:
    records = FrameRecords(path)
    for frame, tracks in zip(night_frames(len(followed)), followed, strict=True):
        result: FrameResult = result_of(frame, [[3, 4, 9, 8]], [0.5])
        records.write(frame, dataclasses.replace(result, tracks=tracks))
    records.close()
    return path


def test_tracks_come_back_as_they_were(tmp_path: Path) -> None:
    written = tracks_of(BOXES, STATES, ids=[3, 8], ranges_m=[np.nan, 81.5], detections=[0, -1])
    written = dataclasses.replace(written, direct_probabilities=np.array([0.123456789, np.nan]))
    tracks = read_tracks(write_run(tmp_path / "frames.jsonl", written, tracks_of([])))
    assert list(tracks) == [0, 2]
    assert len(tracks[2]) == 0
    for field in dataclasses.fields(Tracks):
        np.testing.assert_array_equal(getattr(tracks[0], field.name), getattr(written, field.name))


def test_a_run_without_a_tracker(tmp_path: Path) -> None:
    path = write_run(tmp_path / "frames.jsonl", None)
    with pytest.raises(ValueError, match=r"frames\.jsonl: line 1: tracks: expected a list, got nothing"):
        read_tracks(path)


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('"confidence":0.75', '"confidence":1.5', r"line 1: tracks\.0\.confidence"),
        ('"state":"confirmed"', '"state":"lost"', r"line 1: tracks\.0\.state: expected 'tentative'"),
        ("[3.0,4.0,9.5,8.25]", "[3.0,4.0,2.0,8.25]", r"line 1: Tracks\.boxes_xyxy_px: expected finite boxes"),
        ('"id":0', '"was":0', r"line 1: tracks\.0\.id: field is missing"),
    ],
)
def test_a_broken_line_names_itself(tmp_path: Path, old: str, new: str, complaint: str) -> None:
    path = write_run(tmp_path / "frames.jsonl", tracks_of(BOXES))
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ValueError, match=complaint):
        read_tracks(path)


def test_each_frame_once(tmp_path: Path) -> None:
    path = write_run(tmp_path / "frames.jsonl", tracks_of([]))
    path.write_text(path.read_text() * 2)
    with pytest.raises(ValueError, match="line 2: frame: expected each frame once, 0 is there twice"):
        read_tracks(path)


def test_no_such_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"frames\.jsonl: no such file"):
        read_tracks(tmp_path / "frames.jsonl")


def test_whole_results_come_back(tmp_path: Path) -> None:
    frame = night_frames(1)[0]
    written = result_of(frame, [[3, 4, 9, 8], [20, 21, 40, 33]], [0.5, 0.1], threshold=0.3)
    detections = written.detections
    assert detections is not None
    ranges = Ranges(detections, np.array([33.25, np.nan]), np.array([np.inf, np.inf]))
    written = dataclasses.replace(written, ranges=ranges, tracks=tracks_of(BOXES, STATES))
    records = FrameRecords(tmp_path / "frames.jsonl")
    records.write(frame, written)
    records.close()
    found = read_results(tmp_path / "frames.jsonl", 0.3)[0]
    assert (found.frame, found.timestamp_ns) == (0, 0)
    assert found.proposals.boxes_xyxy_px.tolist() == written.proposals.boxes_xyxy_px.tolist()
    assert found.detections is not None
    assert found.detections.scores.tolist() == detections.scores.tolist()
    assert found.detections.is_accepted.tolist() == [True, False]
    assert found.ranges is not None
    np.testing.assert_array_equal(found.ranges.ranges_m, ranges.ranges_m)
    np.testing.assert_array_equal(found.ranges.sigmas_m, ranges.sigmas_m)
    assert found.tracks is not None
    assert found.tracks.states.tolist() == STATES


def test_results_with_a_broken_line(tmp_path: Path) -> None:
    path = write_run(tmp_path / "frames.jsonl", tracks_of([]))
    path.write_text(path.read_text().replace("[[3,4,9,8]]", "[[3,4,9,4]]", 1))
    with pytest.raises(ValueError, match=r"line 1: Proposals\.boxes_xyxy_px: box 0 is \[3, 4, 9, 4\]"):
        read_results(path, 0.5)


def test_where_a_run_had_its_frames(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"summary\.json: no such file"):
        source_of_run(tmp_path)
    (tmp_path / "summary.json").write_text(f'{{"source": "{tmp_path}"}}')
    assert source_of_run(tmp_path) == tmp_path
    (tmp_path / "summary.json").write_text('{"source": "/nowhere/at/all"}')
    with pytest.raises(FileNotFoundError, match=r"source: expected the run's frames, there is nothing at /nowhere"):
        source_of_run(tmp_path)
    (tmp_path / "summary.json").write_text('{"source": 3}')
    with pytest.raises(ValueError, match=r"summary\.json: source: expected a valid string"):
        source_of_run(tmp_path)


def test_gaps_come_back(tmp_path: Path) -> None:
    path, frames = tmp_path / "frames.jsonl", night_frames(3)
    gaps_rad = np.radians([[-3.0, -1.25], [0.5, 2.0]])
    commands = [
        BeamCommand(0, BeamMode.GLARE_FREE, np.ones((2, 3)), gaps_rad, np.array([np.nan, 80.0])),
        BeamCommand(0, BeamMode.FULL, np.ones((2, 3))),
        None,
    ]
    records = FrameRecords(path)
    for frame, command in zip(frames, commands, strict=True):
        records.write(frame, dataclasses.replace(result_of(frame, []), beam=command))
    records.close()
    found = read_gaps(path)
    assert list(found) == [0, 2]
    np.testing.assert_allclose(found[0], gaps_rad)
    assert found[2].shape == (0, 2)
    path.write_text(path.read_text().replace('"left_deg":2.0', '"left_deg":"far"', 1))
    with pytest.raises(ValueError, match=r"line 1: beam\.gaps\.1\.left_deg: expected a valid number"):
        read_gaps(path)
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_gaps(tmp_path / "absent.jsonl")
