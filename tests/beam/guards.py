"""Guards under way, and what is asked of their commands."""

from __future__ import annotations

from typing import Any

import numpy as np

from foreglow.beam.guard import Guard
from foreglow.config import GuardConfig
from foreglow.types import BeamCommand, BeamMode, Frame, Tracks
from tests.beam.made_up import CAMERA, FakeLamps, box_around, frame_at, full, guard_config, tracks_of

LAMPS = FakeLamps()

NUM_LEDS = LAMPS.num_leds
NOBODY = tracks_of([], [])
AHEAD = box_around(0.02, -0.005, 0.01)


def running(config: GuardConfig | None = None, *, num_frames: int = 25) -> Guard:
    """A guard that has let full beam through, up to frame `num_frames - 1`."""
    guard = Guard(config or guard_config(), LAMPS)
    for number in range(num_frames):
        frame = frame_at(number)
        guard.check(full(frame, NUM_LEDS), NOBODY, frame)
    return guard


def next_check(guard: Guard, frame: Frame, tracks: Tracks | None = NOBODY, **more: Any) -> BeamCommand:
    return guard.check(full(frame, NUM_LEDS), tracks, frame, **more)


def assert_low(command: BeamCommand, *faults: str) -> None:
    assert command.mode == BeamMode.LOW
    assert not command.levels.any()
    assert command.faults == faults


def with_arrays(thing: Any, **arrays: Any) -> Any:
    """`thing` with other values that its own check would not take, as after a bit flip."""
    for name, value in arrays.items():
        object.__setattr__(thing, name, value)
    return thing


def towards_cd(command: BeamCommand, azimuth_rad: float, elevation_rad: float, range_m: float) -> Any:
    """What the LEDs of each lamp shine at a point seen from the camera in a direction of the vehicle's frame."""
    ray = np.array([np.cos(azimuth_rad) * np.cos(elevation_rad), np.sin(azimuth_rad) * np.cos(elevation_rad), 0.0])
    ray[2] = np.sin(elevation_rad)
    point = CAMERA.vehicle_from_camera.position_m + range_m * ray
    shone = []
    for index, lamp in enumerate((LAMPS.left, LAMPS.right)):
        seen = point - lamp.vehicle_from_lamp.position_m
        shone.append(float(LAMPS.intensities_cd(seen[np.newaxis])[1][0, index] @ command.levels[index]))
    return np.array(shone)
