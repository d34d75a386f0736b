"""The campaign of hard knocks runs, and knows a disorderly end from an orderly one."""

from __future__ import annotations

import dataclasses
import json
import signal
from pathlib import Path

import pytest

from benchmarks.knocks.probe import Outcome, Probe, orderly, refused, try_out

REFUSED = Outcome(2, "", "foreglow: a.png: expected an image\n", 0.5, 100.0, False, (), ())


def test_an_orderly_end(tmp_path: Path) -> None:
    assert orderly(tmp_path, REFUSED) == []
    assert refused(tmp_path, REFUSED) == []
    assert orderly(tmp_path, dataclasses.replace(REFUSED, code=0, stderr="")) == []


@pytest.mark.parametrize(
    "change",
    [
        {"code": None},
        {"code": 1},
        {"code": 70},
        {"code": -11},
        {"code": -signal.SIGXCPU},
        {"stderr": ""},
        {"stderr": "foreglow: a\nforeglow: b\n"},
        {"stderr": "Traceback (most recent call last)\n"},
        {"stderr": f"foreglow: {'x' * 5000}\n"},
        {"resident_mib": 9000.0},
        {"is_input_changed": True},
        {"left": ("out/frames.jsonl.partial",)},
    ],
)
def test_a_disorderly_end(tmp_path: Path, change: dict[str, object]) -> None:
    assert orderly(tmp_path, dataclasses.replace(REFUSED, **change))  # type: ignore[arg-type]


def test_done_is_no_refusal(tmp_path: Path) -> None:
    assert refused(tmp_path, dataclasses.replace(REFUSED, code=0, stderr=""))


def test_results_that_lie(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text(json.dumps({"is_complete": True, "num_frames": 2}))
    (tmp_path / "frames.jsonl").write_text("{}\n")
    assert orderly(tmp_path, dataclasses.replace(REFUSED, code=0, stderr=""))


@pytest.mark.process
def test_what_a_probe_sees(tmp_path: Path) -> None:
    def prepare(folder: Path) -> list[str]:
        (folder / "inputs" / "a.png").write_text("no image")
        return ["run", "inputs/a.png", "--out", "out"]

    verdict = try_out(Probe("tests", "no image", prepare, refused), tmp_path / "sound")
    assert verdict.wrong == ()
    assert verdict.code == 2

    def spoil(folder: Path) -> object:
        (folder / "inputs" / "a.png").write_text("no image")

        def change() -> int:
            Path("inputs/a.png").write_text("another")
            Path("out.tmp").touch()
            return 0

        return change

    wrong = try_out(Probe("tests", "spoils", spoil), tmp_path / "spoiled").wrong  # type: ignore[arg-type]
    assert wrong == ("an input was changed", "left behind: out.tmp")


@pytest.mark.process
@pytest.mark.slow
def test_some_probes_of_the_campaign(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    pytest.importorskip("foxglove")
    pytest.importorskip("cantools")
    from benchmarks.knocks.__main__ import main

    out = tmp_path / "knocks.json"
    assert main(["--only", "misuse: run", "--jobs", "1", "--out", str(out)]) == 0
    assert len(json.loads(out.read_text())["knocks"]) > 5
