"""A simulated drive as a live source, `simulate:NAME` of `foreglow live`: our own beam commands light its frames."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from foreglow.beam.messages import CommandEncoder
from foreglow.beam.receiver import LampReceiver
from foreglow.lab.simulation.drivable import read_drivable, with_beam_of
from foreglow.lab.simulation.drive import Drive
from foreglow.lab.simulation.scenes.scenarios import scenario, with_beam
from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.outputs import exists
from foreglow.runtime.live.cameras import CameraOptions
from foreglow.runtime.live.sources import START_S, ClosedLoop
from foreglow.types import BeamCommand, Frame

ANSWER_S = 1.0
"""Longest wait for a frame's command, by the wall clock."""


def open_drive(name: str, options: CameraOptions) -> LiveDrive:
    """A drive through the scenario called `name`, or through the scene of a TOML file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is broken or cannot be driven, or there is no such scenario or quality.
    """
    if name.endswith(".toml"):
        if options.seed:
            raise ValueError(f"{name}: expected no --seed beside it: a scene has one itself")
        scene = with_beam_of(read_drivable(Path(name)), "matrix", Path(name))
        return LiveDrive(scene, options.quality)
    if "/" in name or exists(Path(name)):
        raise ValueError(f"{name}: expected a scene, a file whose name ends with .toml, or the name of a scenario")
    return LiveDrive(scenario(name, options.seed), options.quality)


class LiveDrive(ClosedLoop):
    """A simulated drive in closed loop: our own commands light the coming frames, through CAN frames and lamp models.

    Time stands still while a frame is rendered: each frame comes one frame period after the previous one, and shows
    the light of the previous frame's command.
    """

    max_silence_s: float | None = START_S
    speed = 1.0
    is_lossless = False
    is_endless = False

    def __init__(self, scene: Scene, quality: str = "training") -> None:
        """A drive through `scene`, with our matrix beam.

        Raises:
            ValueError: If there is no such quality.
        """
        self._drive = Drive(with_beam(scene, "matrix"), quality)
        self._answered = threading.Event()
        self._frame_ns, self._begun_ns = 0, time.monotonic_ns()
        self._period_ns = round(1e9 / scene.rate_hz)
        self._encoder = CommandEncoder()
        self._lamps = LampReceiver()
        self._lock = threading.Lock()

    @property
    def name(self) -> str:
        """The name of the scene, with its seed."""
        return self._drive.name

    @property
    def rate_hz(self) -> float | None:
        """The frame rate of the scene."""
        return self._drive.rate_hz

    @property
    def num_frames(self) -> int | None:
        """The number of frames of the drive."""
        return self._drive.num_frames

    @property
    def skipped(self) -> Sequence[str]:
        """Always empty."""
        return ()

    def now_ns(self) -> int:
        """The time of the frame at hand, plus the time since it was rendered; never later than the next frame."""
        return self._frame_ns + min(time.monotonic_ns() - self._begun_ns, self._period_ns)

    def __iter__(self) -> Iterator[Frame]:
        self._lamps = LampReceiver()
        self._drive.set_led_levels(self._lamps.shining(0)[0])
        for known in self._drive.frames():
            self._answered.clear()
            self._frame_ns, self._begun_ns = known.frame.timestamp_ns, time.monotonic_ns()
            yield known.frame
            self._answered.wait(ANSWER_S)
            with self._lock:
                levels, _ = self._lamps.shining(max(self.now_ns(), known.frame.timestamp_ns + self._period_ns))
            self._drive.set_led_levels(levels)

    def send(self, command: BeamCommand) -> None:
        """As `ClosedLoop.send`."""
        with self._lock:
            now_ns = self.now_ns()
            for frame in self._encoder.frames(command):
                self._lamps.receive(now_ns, frame.frame_id, frame.data)
        self._answered.set()

    def close(self) -> None:
        """As `ClosedLoop.close`: nothing is open."""

    def lux(self, frame: Frame) -> Mapping[str, float]:
        """As `ClosedLoop.lux`."""
        known = self._drive.latest
        if known is None or known.frame.timestamp_ns != frame.timestamp_ns:
            return {}
        return {f"vehicle {vehicle.vehicle_id}": vehicle.eye_lx.get("ego", 0.0) for vehicle in known.vehicles}
