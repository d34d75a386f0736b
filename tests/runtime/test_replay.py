"""A run once more from its tracks on."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from foreglow.beam import BeamStage
from foreglow.config import BeamConfig, PipelineConfig
from foreglow.runtime.run import Replay
from foreglow.types import FrameResult, Tracks
from tests.beam.made_up import box_around, frame_at, tracks_of
from tests.stand_ins import result_of

CONFIG = PipelineConfig(beam=BeamConfig(policy="foreglow"))
FRAMES = [frame_at(number) for number in range(4)]


def followed(number: int) -> Tracks:
    return tracks_of([box_around(0.02, 0.0, 0.005)], [80.0], ages_s=1.0 + number / 18)


def results() -> dict[int, FrameResult]:
    return {
        frame.frame: dataclasses.replace(result_of(frame, [[0, 0, 9, 9]], [0.5]), tracks=followed(frame.frame))
        for frame in FRAMES
    }


def test_commands_are_those_of_the_stage_and_the_rest_stays() -> None:
    stage, replay = BeamStage(CONFIG.beam, CONFIG.guard), Replay(CONFIG, results(), "earlier")
    for _ in range(2):
        for frame in FRAMES:
            result, expected = replay.step(frame), stage.command(frame, followed(frame.frame))
            assert result.beam is not None
            np.testing.assert_array_equal(result.beam.levels, expected.levels)
            np.testing.assert_array_equal(result.beam.gaps_rad, expected.gaps_rad)
            assert result.beam.faults == expected.faults == ()
            assert list(result.stage_ms) == ["beam"]
            assert result.detections is not None
        stage.reset()
        replay.reset()


def test_another_sequence_begins_anew() -> None:
    stage, replay = BeamStage(CONFIG.beam, CONFIG.guard), Replay(CONFIG, results(), "earlier")
    for frame in FRAMES:
        if frame.frame == 2:
            stage.reset()
        stepped = replay.step(dataclasses.replace(frame, sequence="second" if frame.frame >= 2 else "first")).beam
        assert stepped is not None
        np.testing.assert_array_equal(stepped.levels, stage.command(frame, followed(frame.frame)).levels)
        assert stepped.levels.any() == (frame.frame % 2 == 1)


@pytest.mark.parametrize("what", ["missing", "at another time", "without tracks"])
def test_other_frames_are_refused(what: str) -> None:
    known = results()
    first = FRAMES[0]
    if what == "missing":
        del known[0]
    elif what == "at another time":
        known[0] = dataclasses.replace(known[0], timestamp_ns=first.timestamp_ns + 1)
    else:
        known[0] = dataclasses.replace(known[0], tracks=None)
    with pytest.raises(ValueError, match=r"earlier: expected the frames of its source, has no frame 0 at 0\.000 s"):
        Replay(CONFIG, known, "earlier").step(first)


def test_lamps_that_are_not_there() -> None:
    config = PipelineConfig(beam=BeamConfig(policy="foreglow", headlamps="absent.toml"))  # type: ignore[arg-type]
    with pytest.raises(FileNotFoundError, match=r"absent\.toml"):
        Replay(config, {}, "earlier")
