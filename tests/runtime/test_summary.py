"""Run-times and provenance."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from foreglow import provenance
from foreglow.runtime import summary
from foreglow.runtime.records import frame_record
from tests.stand_ins import night_frames, result_of


def test_run_time_of_a_hundred_values() -> None:
    assert summary.run_time([float(k) for k in range(101)]) == {"median": 50.0, "p95": 95.0, "p99": 99.0}


def test_scored_boxes_are_counted() -> None:
    frame = night_frames(1)[0]
    tally = summary.Tally()
    tally.add(frame, result_of(frame, [[0, 0, 4, 4], [8, 8, 12, 12]], [0.9, 0.1]))
    tally.add(frame, result_of(frame, [], []))
    counted = tally.summary("here", [], is_complete=True, is_classified=True, dispatch="avx2")
    assert (counted.num_frames, counted.num_proposals, counted.num_scored, counted.num_accepted) == (2, 2, 2, 1)
    assert counted.run_time_ms["total"] == {"median": 0.25, "p95": 0.25, "p99": 0.25}


def test_record_keeps_scores_exactly_and_lists_accepted_boxes() -> None:
    frame = night_frames(1)[0]
    score = float(np.nextafter(np.float32(0.5), np.float32(1)))
    record = frame_record(frame, result_of(frame, [[0, 0, 4, 4], [8, 8, 12, 12]], [score, 0.5]))
    assert record["scores"] == [score, 0.5]
    assert record["detections_xyxy_px"] == [[0, 0, 4, 4]]


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
