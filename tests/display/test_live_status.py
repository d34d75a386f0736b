"""What the terminal says of a live run."""

from __future__ import annotations

import dataclasses

import pytest

from foreglow.display.live_status import LiveStatus
from foreglow.runtime.health import Health
from foreglow.types import BeamCommand


def health(time_ns: int, *faults: str, commanded: tuple[str, ...] = ()) -> Health:
    return Health(time_ns, faults, 1, 0, 0, BeamCommand.low(time_ns, 4, *commanded))


def test_all_is_well_only_where_the_command_says_so_too(capsys: pytest.CaptureFixture[str]) -> None:
    """Between the end of a fault and the next frame's command nobody knows yet whether another goes on."""
    status = LiveStatus()
    status.write_health(health(1, "stage_failed", commanded=("stage_failed",)))
    status.write_health(health(2, commanded=("stage_failed",)))
    status.write_health(health(3, "speed_unknown", commanded=("speed_unknown",)))
    status.write_health(health(4, commanded=("speed_unknown",)))
    status.write_health(health(5))
    status.close()
    said = [line.split("s  ", 1)[1] for line in capsys.readouterr().err.splitlines()]
    assert said == ["stage_failed", "speed_unknown", "all is well again"]


def test_control_characters_are_shown_and_not_carried_out(capsys: pytest.CaptureFixture[str]) -> None:
    """Details may have the name of a device, or the words of a driver."""
    status = LiveStatus()
    status.write_health(dataclasses.replace(health(1, "no_frame"), details="camera \x1b[2J\x07\u202e is gone"))
    status.close()
    assert "no_frame (camera \\x1b[2J\\x07\\u202e is gone)" in capsys.readouterr().err


def test_a_screen_that_takes_no_more_is_no_lack_of_the_results(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a log on a full disk, all results counted as not recorded although they were."""
    status = LiveStatus()

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(status._console, "print", fail)
    status.write_health(health(1, "stage_failed"))
    status.close()
