"""What `frames.jsonl` says about a beam."""

from __future__ import annotations

import dataclasses
import json

import numpy as np

from foreglow.runs.frame_records import beam_record, frame_record
from foreglow.types import BeamCommand, BeamMode
from tests.stand_ins import night_frames, result_of


def test_gaps_in_degrees_and_levels_in_thousandths() -> None:
    levels = np.array([[0.0, 0.0004, 0.12345], [0.9996, 1.0, 0.5]])
    gaps_rad = np.radians([[-3.0, -1.25], [0.5, 2.0]])
    command = BeamCommand(5, BeamMode.GLARE_FREE, levels, gaps_rad, np.array([np.nan, 81.23456]))
    assert beam_record(command) == {
        "mode": "glare_free",
        "gaps": [
            {"right_deg": -3.0, "left_deg": -1.25, "range_m": None},
            {"right_deg": 0.5, "left_deg": 2.0, "range_m": 81.235},
        ],
        "faults": [],
        "levels": [[0, 0, 123], [1000, 1000, 500]],
    }


def test_faults_are_named_and_a_frame_without_a_beam_has_none() -> None:
    frame = night_frames(1)[0]
    result = result_of(frame, [])
    assert frame_record(frame, result)["beam"] is None
    low = dataclasses.replace(result, beam=BeamCommand.low(0, 2, "too_slow", "no_camera"))
    record = json.loads(json.dumps(frame_record(frame, low)))["beam"]
    assert (record["mode"], record["faults"]) == ("low", ["too_slow", "no_camera"])
    assert record["levels"] == [[0, 0], [0, 0]]
