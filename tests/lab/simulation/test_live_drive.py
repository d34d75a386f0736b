"""A simulated drive as a live source, in closed loop."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from foreglow.lab.simulation import Scene, resized, scenario, scene_to_toml
from foreglow.lab.simulation.live_drive import LiveDrive, open_drive
from foreglow.photometry import NUM_LEDS
from foreglow.runtime.live.cameras import CameraOptions
from foreglow.types import BeamCommand, BeamMode
from foreglow.wording import UnusedWarning


def test_a_scene_in_a_file(tmp_path: Path) -> None:
    path = tmp_path / "night.toml"
    path.write_text(scene_to_toml(Scene(name="night", seed=5)))
    assert open_drive(str(path), CameraOptions()).name == "night/5"
    with pytest.raises(ValueError, match="quality: expected one of"):
        open_drive(str(path), CameraOptions(quality="best"))
    with pytest.raises(ValueError, match="expected no --seed beside it"):
        open_drive(str(path), CameraOptions(seed=3))


def test_a_low_beam_that_the_matrix_lamps_replace_is_named(tmp_path: Path) -> None:
    path = tmp_path / "night.toml"
    path.write_text("[ego]\ncarpet = 0.4\nstray = 2.0\n")
    with pytest.warns(
        UnusedWarning, match=r"night\.toml: ego\.carpet, ego\.stray: left out, .* the beam is matrix here"
    ):
        open_drive(str(path), CameraOptions())


@pytest.mark.renderer
def test_our_own_light_in_closed_loop() -> None:
    scene = resized(scenario("curve", 1), 160, 120)
    drive = LiveDrive(scene, "fast")
    means = []
    for frame in itertools.islice(drive, 8):
        means.append(frame.image.mean())
        level = 1.0 if frame.frame < 5 else 0.0
        mode = BeamMode.FULL if level else BeamMode.LOW
        drive.send(BeamCommand(frame.timestamp_ns, mode, np.full((2, NUM_LEDS), level)))
        assert drive.lux(frame).keys() == {f"vehicle {vehicle.vehicle_id}" for vehicle in drive._drive.latest.vehicles}  # type: ignore[union-attr]
        assert frame.timestamp_ns <= drive.now_ns() <= frame.timestamp_ns + 1e9 / scene.rate_hz
    dark, lit = np.mean(means[:2]), np.mean(means[4:6])  # the lamps want some good commands before they shine
    assert lit > dark + 0.3
    assert means[7] < (dark + lit) / 2
