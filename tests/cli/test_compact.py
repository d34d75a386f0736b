"""`foreglow beam --compact`: CAN logs of gaps alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from foreglow.beam.messages import decode_gaps
from foreglow.datasets import shipped_drive
from foreglow.types import BeamMode
from tests.cli.commands import complaint, foreglow_command

can = pytest.importorskip("can")

THIRD = """
import numpy as np

from foreglow import BeamCommand, BeamMode, BeamPolicy


class Third(BeamPolicy):
    def __init__(self, config, headlamps):
        self.num_leds = headlamps.num_leds

    def command(self, frame, tracks):
        return BeamCommand(frame.timestamp_ns, BeamMode.GLARE_FREE, np.full((2, self.num_leds), 1 / 3))
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first frames of the drive that ships, as `run` leaves them."""
    out = tmp_path_factory.mktemp("run") / "run"
    assert foreglow_command("run", shipped_drive(), "--out", out, "--limit", 14).exit_code == 0
    return out


def modes_of(run: Path, out: Path, *options: object) -> tuple[list[BeamMode], str]:
    """The mode of each message in the log, and what the command said."""
    result = foreglow_command("beam", run, "--out", out, "--can", "log", "--compact", *options)
    assert result.exit_code == 0, result.output
    with can.CanutilsLogReader(out / "beam.log") as log:
        return [decode_gaps(each.arbitration_id, bytes(each.data)).header.mode for each in log], result.stdout


def test_the_log_has_gaps_alone(tmp_path: Path, run: Path) -> None:
    modes, said = modes_of(run, tmp_path / "out")
    assert modes[0] == BeamMode.LOW  # from which light rises
    assert BeamMode.LOW not in modes[1:]
    assert len(modes) == 14
    assert "--compact" not in said


def test_a_policy_that_dims_all_leds_is_low_beam_and_a_line_says_so(
    tmp_path: Path, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "third_beam.py").write_text(THIRD)
    monkeypatch.syspath_prepend(tmp_path)
    modes, said = modes_of(run, tmp_path / "out", "--policy", "third_beam:Third")
    assert set(modes[5:]) == {BeamMode.LOW}
    assert f"--compact: low beam in the place of {modes[1:].count(BeamMode.LOW)} commands that dim LEDs" in said


def test_questions_are_refused(tmp_path: Path, run: Path) -> None:
    (tmp_path / "ask.toml").write_text("[beam]\nask = true\n")
    line = complaint(
        "beam", run, "--out", tmp_path / "out", "--can", "log", "--compact", "--config", tmp_path / "ask.toml"
    )
    assert "--compact: expected ask = false under [beam]: gaps alone cannot carry its questions" in line
    assert not (tmp_path / "out").exists()
