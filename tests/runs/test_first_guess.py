"""What a run found becomes points to correct: kinds of light, tracks as numbers."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from foreglow.datasets.exchange import Kind, Mark
from foreglow.runs.first_guess import read_guess
from foreglow.types import Detections, Frame
from tests.runs.test_recorded_run import write_run
from tests.stand_ins import night_image, result_of, tracks_of

BOXES = [[10, 10, 20, 21], [40, 10, 50, 20], [70, 10, 80, 20]]
KINDS = [[0.1, 0.7, 0.1, 0.1], [0.1, 0.1, 0.7, 0.1], [np.nan] * 4]


def test_accepted_boxes_are_lights_of_their_tracks(tmp_path: Path) -> None:
    frame = Frame(night_image(), 0, 5, "S1")
    result = result_of(frame, BOXES, [0.9, 0.8, 0.7])
    found = Detections(result.proposals, np.array([0.9, 0.8, 0.7], np.float32), 0.5, np.array(KINDS, np.float32))
    followed = dataclasses.replace(result, detections=found, tracks=tracks_of([BOXES[0]], ids=[12], detections=[0]))
    below = result_of(Frame(night_image(), 1, 6, "S1"), BOXES[:1], [0.01])
    run = write_run(tmp_path / "run", [(frame, followed), (Frame(night_image(), 1, 6, "S1"), below)])
    guess = read_guess(run)
    lights = [mark for mark in guess[5].marks if mark.kind == Kind.LIGHT]
    assert lights == [
        Mark(Kind.LIGHT, (15, 15), 12, 12, is_direct=True, is_rear=True),
        Mark(Kind.LIGHT, (45, 15), -1, -1),
        Mark(Kind.LIGHT, (75, 15), -2, -2),
    ]
    assert [mark.oid for mark in guess[5].marks if mark.kind == Kind.VEHICLE] == [12, -1, -2]
    assert guess[6].marks == (), "a frame in which nothing was found is a guess, too"


def test_tracks_of_two_parts_of_a_video_are_two_vehicles(tmp_path: Path) -> None:
    """The tracker counts anew in each; labels of the video are one drive."""
    results = []
    for number, (sequence, track) in enumerate([("", 0), ("", 2), ("frame 2", 0), ("frame 2", 1)]):
        frame = Frame(night_image(), number, number, sequence)
        result = result_of(frame, BOXES[:1], [0.9])
        tracks = tracks_of([BOXES[0]], ids=[track], detections=[0])
        results.append((frame, dataclasses.replace(result, tracks=tracks)))
    guess = read_guess(write_run(tmp_path / "run", results))
    assert [[mark.oid for mark in guess[number].marks] for number in range(4)] == [[0, 0], [2, 2], [3, 3], [4, 4]]
