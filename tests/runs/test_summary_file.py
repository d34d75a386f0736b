"""What is written to `summary.json`, and that it is read back as it was."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from foreglow.config import preset
from foreglow.files import json_text
from foreglow.runs.summary_file import FaultEvent, LiveSummary, RunSummary, lack_of_run, read_summary
from foreglow.runs.tally import Tally
from foreglow.types import BeamCommand, BeamMode
from tests.stand_ins import night_frames, result_of


def a_summary() -> RunSummary:
    tally = Tally()
    commands = [BeamCommand(0, BeamMode.FULL, np.ones((2, 4))), BeamCommand.low(0, 4, "too_slow")]
    for frame, command in zip(night_frames(2), commands, strict=True):
        tally.add(frame, dataclasses.replace(result_of(frame, [[0, 0, 4, 4]], [0.9]), beam=command))
    return tally.summary("here", ["a.png: broken"], preset("foreglow"), is_complete=False, dispatch="avx2")


def test_a_run_comes_back(tmp_path: Path) -> None:
    path, summary = tmp_path / "summary.json", a_summary()
    path.write_text(json_text(summary))
    assert "live" not in json.loads(path.read_text())
    found = read_summary(path)
    assert found.live is None
    assert json_text(found) == json_text({**json.loads(path.read_text()), "live": None})


def test_a_live_run_comes_back(tmp_path: Path) -> None:
    path, run = tmp_path / "summary.json", a_summary()
    events = (FaultEvent("camera_gone", 5, 9, "cable"), FaultEvent("bus_failed", 7))
    summary = LiveSummary(
        run=run, num_dropped=1, num_late=2, num_unrecorded=3, sink_errors=["full"], fault_counts={"x": 2}, faults=events
    )
    path.write_text(json_text(summary))
    found = read_summary(path)
    assert json_text(found) == path.read_text()
    assert found.live is not None
    assert tuple(found.live.faults) == events
    assert (found.source, found.live.num_late, found.live.fault_counts) == ("here", 2, {"x": 2})


@pytest.mark.parametrize(
    ("field", "value", "complaint"),
    [
        ("num_frames", "2", r"num_frames: expected a valid integer, got '2'"),
        ("num_with_road", -1, r"num_with_road: expected .* 0, got -1"),
        ("beam", {"num_low": 1}, r"beam\.num_glare_free: field is missing"),
        ("run_time_ms", {"total": {"median": "fast"}}, r"run_time_ms\.total\.median: expected a valid number"),
        ("live", {}, r"live\.num_dropped: field is missing"),
    ],
)
def test_a_broken_summary_names_the_field(tmp_path: Path, field: str, value: object, complaint: str) -> None:
    path = tmp_path / "summary.json"
    path.write_text(json.dumps(json.loads(json_text(a_summary())) | {field: value}))
    with pytest.raises(ValueError, match=complaint) as caught:
        read_summary(path)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(("num", "words"), [(1, "1 frame,"), (2, "2 frames,")])
def test_frames_are_counted_in_words(tmp_path: Path, num: int, words: str) -> None:
    (tmp_path / "summary.json").write_text(json_text(dataclasses.replace(a_summary(), num_frames=num)))
    assert f"interrupted after {words} what is made" in str(lack_of_run(tmp_path))
