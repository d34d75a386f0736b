"""Tracks survive the way through `frames.jsonl`."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from foreglow.evaluation.track_file import read_tracks
from foreglow.runtime.records import FrameRecords
from foreglow.types import FrameResult, Tracks, TrackState
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
