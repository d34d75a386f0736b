"""From each fault, through guard, bus and receiver, to low beam at the lamps within the deadline."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from foreglow.beam.guard import Guard
from foreglow.beam.messages import CanFrame, CommandEncoder
from foreglow.beam.questions import DIP
from foreglow.beam.receiver import LampReceiver
from foreglow.types import BeamCommand, BeamMode, Frame, Tracks
from tests.beam.made_up import FRAME_NS, IMAGES, FakeLamps, box_around, frame_at, full, guard_config, tracks_of

LAMPS = FakeLamps(num_rows=3, num_columns=28)
MS = 1_000_000
DEADLINE_NS = 200 * MS
DELAY_NS = 30 * MS
"""From the exposure to the arrival of a command."""

FIRST_BAD = 40
CAR = box_around(0.02, -0.005, 0.005)


@dataclass(frozen=True)
class Moment:
    """One frame's way to the lamps, to be disturbed."""

    frame: Frame
    tracks: Tracks | None
    wanted: BeamCommand
    pipeline_faults: tuple[str, ...] = ()
    delay_ns: int = DELAY_NS
    is_running: bool = True
    on_the_bus: Callable[[tuple[CanFrame, ...]], tuple[CanFrame, ...]] = lambda frames: frames


dipped_frames = range(0)
"""Those in which the policy asks; tests replace it."""


def moment_at(number: int, frame: Frame | None = None) -> Moment:
    frame = frame_at(number) if frame is None else frame
    tracks = tracks_of([CAR], [120.0], sigmas_m=[5.0], ages_s=number / 18)
    wanted = full(frame, LAMPS.num_leds)
    if number in dipped_frames:
        levels = wanted.levels.copy()
        levels[:, 10:40] = 1 - DIP
        wanted = replace(wanted, mode=BeamMode.GLARE_FREE, levels=levels)
    return Moment(frame, tracks, wanted)


def with_arrays(tracks: Tracks, **arrays: Any) -> Tracks:
    for name, value in arrays.items():
        object.__setattr__(tracks, name, value)
    return tracks


def changed(frames: tuple[CanFrame, ...]) -> tuple[CanFrame, ...]:
    return tuple(CanFrame(frame_id, data[:9] + bytes([data[9] ^ 0x10]) + data[10:]) for frame_id, data in frames)


DISTURBANCES: dict[str, Callable[[int], Moment]] = {
    "process killed": lambda n: replace(moment_at(n), is_running=False),
    "dropped frames": lambda n: replace(moment_at(n), is_running=(n - FIRST_BAD) % 6 == 5),
    "camera gives the same frame": lambda n: moment_at(n, frame_at(FIRST_BAD - 1)),
    "camera gives the same image": lambda n: moment_at(n, frame_at(n, image=IMAGES[0])),
    "saturated image": lambda n: moment_at(n, frame_at(n, image=np.full((960, 1280), 255, np.uint8))),
    "black image": lambda n: moment_at(n, frame_at(n, image=np.zeros((960, 1280), np.uint8))),
    "calibration lost": lambda n: moment_at(n, frame_at(n, with_camera=False)),
    "speed lost": lambda n: moment_at(n, frame_at(n, speed_mps=None)),
    "slow": lambda n: moment_at(n, frame_at(n, speed_mps=8.0)),
    "NaN box": lambda n: replace(
        moment_at(n),
        tracks=with_arrays(tracks_of([CAR], [50.0], ages_s=float(n)), boxes_xyxy_px=np.full((1, 4), np.nan)),
    ),
    "stale track": lambda n: replace(moment_at(n), tracks=tracks_of([CAR], [120.0], ages_s=1.0)),
    "tracker gone": lambda n: replace(moment_at(n), tracks=None),
    "stale command": lambda n: replace(moment_at(n), wanted=full(frame_at(FIRST_BAD - 1), LAMPS.num_leds)),
    "pipeline fault": lambda n: replace(moment_at(n), pipeline_faults=("classifier",)),
    "pipeline hangs behind": lambda n: replace(moment_at(n), delay_ns=DELAY_NS + (n - FIRST_BAD + 1) * 150 * MS),
    "CAN loss": lambda n: replace(moment_at(n), on_the_bus=lambda _: ()),
    "loss of one CAN frame of each command": lambda n: replace(moment_at(n), on_the_bus=lambda frames: frames[1:]),
    "CRC errors": lambda n: replace(moment_at(n), on_the_bus=changed),
    "cut CAN frames": lambda n: replace(
        moment_at(n), on_the_bus=lambda frames: tuple(CanFrame(frame_id, data[:40]) for frame_id, data in frames)
    ),
}


class Car:
    """Guard, bus and lamps."""

    def __init__(self) -> None:
        self.guard = Guard(guard_config(), LAMPS)
        self.encoder = CommandEncoder()
        self.lamps = LampReceiver()
        self.now_ns = 0

    def take(self, moment: Moment) -> None:
        if moment.is_running:
            arrival_ns = max(self.now_ns, moment.frame.timestamp_ns + moment.delay_ns)
            command = self.guard.check(
                moment.wanted,
                moment.tracks,
                moment.frame,
                time_ns=arrival_ns,
                pipeline_faults=moment.pipeline_faults,
            )
            for frame_id, data in moment.on_the_bus(self.encoder.frames(command)):
                self.lamps.receive(arrival_ns, frame_id, data)
            self.now_ns = arrival_ns

    def light(self, time_ns: int) -> float:
        self.now_ns = max(self.now_ns, time_ns)
        return float(self.lamps.shining(self.now_ns)[0].max())


@pytest.mark.slow
@pytest.mark.parametrize("name", DISTURBANCES)
@pytest.mark.parametrize(
    "dipped",
    [range(0), range(FIRST_BAD - 1, FIRST_BAD + 2), range(FIRST_BAD - 4, FIRST_BAD - 1)],
    ids=["steady", "dipped", "returning"],
)
def test_fault_ends_in_low_beam(monkeypatch: pytest.MonkeyPatch, name: str, dipped: range) -> None:
    """Also while a question is put, and while light returns from one."""
    monkeypatch.setattr(sys.modules[__name__], "dipped_frames", dipped)
    car = Car()
    for number in range(FIRST_BAD):
        car.take(moment_at(number))
    latest_good_ns = (FIRST_BAD - 1) * FRAME_NS + DELAY_NS
    assert car.light(latest_good_ns) == 1.0
    is_low_since_ns = None
    for number in range(FIRST_BAD, FIRST_BAD + 24):
        # Looked at every few milliseconds up to the next command.
        for time_ns in range((number - 1) * FRAME_NS + DELAY_NS + MS, number * FRAME_NS + DELAY_NS, 9 * MS):
            lit = car.light(time_ns) > 0
            if time_ns > latest_good_ns + DEADLINE_NS:
                assert not lit
            elif not lit and is_low_since_ns is None:
                is_low_since_ns = time_ns
        car.take(DISTURBANCES[name](number))
    assert car.light(car.now_ns) == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(DISTURBANCES) - {"pipeline hangs behind"}))
def test_light_returns_once_all_is_well(name: str) -> None:
    """Slowly after a fault that the guard sees; after one of the bus alone as soon as four commands came."""
    car = Car()
    for number in range(FIRST_BAD):
        car.take(moment_at(number))
    for number in range(FIRST_BAD, FIRST_BAD + 8):
        car.take(DISTURBANCES[name](number))
    light = []
    for number in range(FIRST_BAD + 8, FIRST_BAD + 40):
        car.take(moment_at(number))
        light.append(car.light(number * FRAME_NS + DELAY_NS))
    assert light[0] < 0.06
    assert light[-1] == 1.0
    if "CAN" in name or "CRC" in name:
        assert light[2:4] == [0.0, 1.0]
    else:
        num_dropped = 2 if name == "dropped frames" else 0  # by which the guard's light has begun to return
        assert all(lit <= (index + num_dropped + 1) * FRAME_NS / 1e9 + 1e-9 for index, lit in enumerate(light))


def test_unknown_range_is_taken_as_the_worst() -> None:
    """No reason for low beam: towards that vehicle alone the strictest limit holds, from that frame on."""
    car = Car()
    shone = {}
    for number in range(FIRST_BAD + 1):
        moment = moment_at(number)
        if number == FIRST_BAD:
            moment = replace(moment, tracks=tracks_of([CAR], [np.nan], ages_s=number / 18))
        car.take(moment)
        levels, _ = car.lamps.shining(car.now_ns)
        ahead = np.array([[np.cos(0.02), np.sin(0.02), -0.005]])
        shone[number] = float((LAMPS.intensities_cd(ahead)[1][0] * levels).sum(axis=-1).max())
    assert shone[FIRST_BAD] <= 150.0 < shone[FIRST_BAD - 1] <= 1400.0
    assert car.light(car.now_ns) == 1.0
