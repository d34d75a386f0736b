"""The experiment on run-times: what is counted, and that all ways to run are measured."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks.faulty import live_config
from foreglow.config import PipelineConfig
from foreglow.datasets import PVDN, shipped_drive
from foreglow.lab.studies.runtime import run as runtime
from foreglow.lab.studies.runtime.page import summary_lines, write_report
from foreglow.lab.studies.runtime.run import COMPLETE, KINDS, PARTS, NetworkTimes, frames_by_proposals, run_experiment
from tests.cli.commands import complaint, foreglow_command, names
from tests.lab.studies.detector_data import make_data, make_model

pytestmark = pytest.mark.slow


def no_progress(step: str, num_done: int, num_all: int) -> None:
    assert step
    assert 0 <= num_done <= num_all


def times(complete_ms: list[float], num_proposals: list[int], num_dropped: int = 0) -> NetworkTimes:
    return NetworkTimes("one", {COMPLETE: np.array(complete_ms)}, np.array(num_proposals), num_dropped)


def test_dropped_frames_are_not_in_time() -> None:
    measured = times([1.0, 60.0, math.nan, 2.0], [1, 1, 1, 1], num_dropped=1)
    assert measured.share_within(0.0555) == 0.5
    assert math.isnan(times([], []).share_within(1.0))


def test_frames_by_proposals() -> None:
    measured = times([1.0, 2.0, 3.0, 4.0, math.nan], [0, 9, 10, 70, 70])
    groups = {words: complete.tolist() for words, complete in frames_by_proposals(measured, (0, 10, 60))}
    assert groups == {"0 to 9": [1.0, 2.0], "10 to 59": [3.0], "60 and more": [4.0]}


def test_every_frame_counts_once_in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = list(itertools.islice(PVDN(shipped_drive()), 12))
    again = frames[:7]

    class Two:
        num_frames = 19

        def __iter__(self):  # type: ignore[no-untyped-def]
            yield from frames
            yield from (dataclasses.replace(frame, sequence="S2") for frame in again)

    monkeypatch.setattr(runtime, "NUM_WARM_UP", 5)
    found = runtime.in_process(Two(), live_config(), no_progress)  # type: ignore[arg-type]
    assert found.parts_ms.keys() == PARTS.keys()
    assert all(len(values) == 19 and np.isfinite(values).all() for values in found.parts_ms.values())
    assert found.num_proposals[:7].tolist() == found.num_proposals[12:].tolist()
    stages_ms = sum(values for part, values in found.parts_ms.items() if part != COMPLETE)
    assert (found.parts_ms[COMPLETE] >= stages_ms).all()


def test_live(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtime, "NUM_WARM_UP", 2)
    found = runtime.live(PVDN(shipped_drive()), live_config(), 10)
    assert len(found.num_proposals) == 10
    assert {*PARTS, "capture", "queue", "send"} == found.parts_ms.keys()
    assert (found.parts_ms[COMPLETE] > 0).all()


def test_too_few_images_for_the_live_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtime, "live", lambda *_: times([], []))  # all of them were run before the first that counts
    results = run_experiment(shipped_drive(), live_config(), ["live"], 10, no_progress)
    assert not results.networks
    (line,) = summary_lines(results)
    assert line == "live: expected more than 20 images, which are run before the first that counts, got 90"


def test_report_of_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(runtime, "in_process", lambda *_: times([1.0, 2.0], [3, 30]))
    slow = dataclasses.replace(times([math.nan, 90.0], [3, 30], 1), name="live")
    monkeypatch.setattr(runtime, "live", lambda *_: slow)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == "rclpy" else name)
    results = run_experiment(shipped_drive(), live_config(), list(KINDS), 10, no_progress)
    report = write_report(results, tmp_path)
    assert names(tmp_path) == {
        "results.json", "config.toml", "frames.csv", "stages.png", "proposals.png", "report.md"
    }  # fmt: skip
    written = json.loads((tmp_path / "results.json").read_text())
    assert [network["num_frames"] for network in written["networks"]] == [2, 1]
    assert written["networks"][1]["share_within_frame"] == 0.0
    assert written["missing"].keys() == {"ROS 2, one node", "ROS 2, six processes"}
    text = report.read_text()
    assert "rclpy is not installed" in text
    assert "mean of CP" in text
    assert "Live, the first 20 frames are run before the first that counts." in text
    few = "live: 1 frame counted, those after the first 20: fewer than 100, so that p99 says little"
    assert f"- {few}\n" in text
    assert few in summary_lines(results)
    assert written["networks"][0]["parts_ms"]["CP"]["mean"] == 1.5
    assert written["networks"][1]["parts_ms"]["CP"]["mean"] == 90.0  # of the frames that were not lost
    assert "| paper, with a GPU, on PVDN | 7 030 |" in text
    assert "| 0 to 9 | 1 | 1.00 | 1.00 |" in text
    assert (tmp_path / "frames.csv").read_text().splitlines()[1] == "one,0,3,1.0000"
    assert "100.00% within 55.6 ms, 0 dropped" in summary_lines(results)[0]


def test_the_papers_whole_chain_has_a_row(tmp_path: Path) -> None:
    pytest.importorskip("onnx")
    pytest.importorskip("matplotlib")
    data, model = make_data(tmp_path / "data"), make_model(tmp_path / "all.onnx")
    out = tmp_path / "out"
    arguments = ("experiment", "runtime", data, "--out", out, "--on", "process", "--paper-model", model)
    done = foreglow_command(*arguments)
    assert done.exit_code == 0, done.output
    ours, paper = json.loads((out / "results.json").read_text())["networks"]
    assert (ours["name"], paper["name"]) == ("in process", "in process, paper's whole chain")
    assert paper["num_frames"] == ours["num_frames"]
    assert paper["parts_ms"].keys() == ours["parts_ms"].keys() == {"CP", "PG", "PC", "OT", "BC"}  # not calibrated


def test_a_network_that_does_not_answer_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def silent(*_: object) -> None:
        raise TimeoutError("proposals, beam: expected a beam command within 60 s")

    monkeypatch.setattr(runtime, "in_process", lambda *_: times([1.0, 2.0], [3, 30]))
    monkeypatch.setattr(runtime, "in_fresh_process", silent)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: name)
    results = run_experiment(shipped_drive(), live_config(), ["process", "ros2"], 10, no_progress)
    assert [network.num_frames for network in results.networks] == [2]
    assert results.missing == {"ROS 2, six processes": "proposals, beam: expected a beam command within 60 s"}


@pytest.mark.ros
def test_over_ros2(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    done = foreglow_command(
        "experiment", "runtime", shipped_drive(), "--out", tmp_path, "--on", "ros2", "--on", "node", "--frames", 6
    )
    assert done.exit_code == 0, done.output
    written = json.loads((tmp_path / "results.json").read_text())
    assert [network["name"] for network in written["networks"]] == ["ROS 2, six processes", "ROS 2, one node"]
    for network in written["networks"]:
        assert network["num_frames"] + network["num_dropped"] == 6
        assert {*PARTS, "sent"} == network["parts_ms"].keys()


def test_bad_input(tmp_path: Path) -> None:
    assert "--on: expected some of process, live, node, ros2, got 'gpu'" in complaint(
        "experiment", "runtime", shipped_drive(), "--out", tmp_path, "--on", "gpu"
    )
    with pytest.raises(ValueError, match="without them there are no tracks"):
        run_experiment(shipped_drive(), PipelineConfig(), ["process"], 1, no_progress)
