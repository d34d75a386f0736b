"""Simulates a scene of the experiment on glare: closed loops, and what other settings would shine."""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.beam import make_policy
from foreglow.beam.policy import ForeglowPolicy
from foreglow.config import PipelineConfig
from foreglow.datasets.simulated import VehicleTruth
from foreglow.geometry import Floats
from foreglow.lab.evaluation.occurrence import Expectations, Moment, Sighting, is_coming
from foreglow.lab.simulation import DriveFrame, Scene
from foreglow.lab.simulation.camera.profile import CameraProfile
from foreglow.lab.studies.glare.drive import DriverEye, GlareDrive, PolicyRun, RoadLight
from foreglow.lab.studies.glare.light import EyeLight, OurLight, StreetLight
from foreglow.lab.studies.glare.loop import (
    Car,
    Delays,
    ExactCar,
    OurCar,
    PaperCar,
    ProductionCar,
    Shone,
    both,
    closed_loops,
)
from foreglow.lab.studies.glare.scores import POLICY_ROWS
from foreglow.photometry import NUM_LEDS, Headlamps, read_headlamps
from foreglow.tracking import Tracker, make_tracker
from foreglow.types import BeamCommand, Frame, FrameResult, Tracks

RUN_IN_S = 1.5
"""Time before a drive counts: systems start in low beam, from which light returns slowly."""


@dataclass(frozen=True, slots=True)
class Setting:
    """Another setting of ours, of which the light is computed on the detections of the closed loop.

    Attributes:
        parameter: What is changed.
        latency_s: From exposure to light.
        beam: Changed fields of the beam stage.
        tracker: Changed fields of the tracker.
    """

    parameter: str
    unit: str
    value: float
    latency_s: float
    beam: Mapping[str, Any] = field(default_factory=dict)
    tracker: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Of its run."""
        return f"{self.parameter} {self.value:g}"


def settings_of(delays: Delays) -> tuple[Setting, ...]:
    """All settings that the report shows curves of."""
    usual_s = delays.camera_s + delays.lamp_s
    return (
        *(
            Setting("latency", "ms", ms, ms / 1e3, {"latency_s": ms / 1e3})
            for ms in (0.0, 50.0, 100.0, 150.0, 200.0, 300.0)
        ),
        *(Setting("margin", "deg", deg, usual_s, {"margin_deg": deg}) for deg in (0.0, 0.15, 0.3, 0.6, 1.2, 2.0)),
        *(
            Setting("evidence", "", level, usual_s, tracker={"confirm_evidence": level})
            for level in (0.0, 0.5, 1.0, 2.0, 4.0, 8.0)
        ),
        *(
            Setting("neutral score", "", score, usual_s, tracker={"neutral_score": score})
            for score in (0.15, 0.25, 0.34, 0.5, 0.7, 0.85)
        ),
        *(Setting("coverage", "", share, usual_s, {"coverage": share}) for share in (0.0, 0.3, 0.6, 0.8, 0.95)),
    )


def own_name(config: PipelineConfig) -> str:
    """What the row of our pipeline is called: by its policy, and never like a row that is there anyway."""
    policy = config.beam.policy
    return f"our pipeline, {policy}" if policy in POLICY_ROWS and policy != "foreglow" else policy


class Drives:
    """Drives scenes."""

    def __init__(
        self,
        config: PipelineConfig,
        delays: Delays,
        quality: str = "training",
        paper: PipelineConfig | None = None,
        also: Mapping[str, PipelineConfig] | None = None,
        profile: CameraProfile | None = None,
    ) -> None:
        """Takes the configurations of the cars, with a beam policy, and what they have in common.

        Args:
            config: Of our car.
            delays: From camera to beam.
            quality: Of the renderer.
            paper: The paper's whole chain; without it the paper's car has our detector.
            also: Further cars, by the names of their rows.
            profile: The camera; None for the scenes' own.

        Raises:
            ValueError: If the headlamps do not fit.
        """
        self._config, self._delays, self._quality, self._paper = config, delays, quality, paper
        self._also, self._profile = dict(also or {}), profile
        self._headlamps = read_headlamps(config.beam.headlamps)
        if self._headlamps.num_leds != NUM_LEDS:
            raise ValueError(
                f"{config.beam.headlamps}: expected lamps of {NUM_LEDS} LEDs, as the CAN messages of the closed loop "
                f"have them, got {self._headlamps.num_leds}"
            )

    def cars(self) -> list[Car]:
        """Ours, the paper's, and further ones.

        Raises:
            FileNotFoundError: If a model or table of one does not exist.
            ValueError: If a stage of one cannot be made, such as a plug-in.
        """
        others = [OurCar(config) for config in self._also.values()]
        return [OurCar(self._config), PaperCar(self._config, self._paper), *others]

    def frames(self, scene: Scene) -> Iterator[tuple[Shone, ...]]:
        """All closed loops side by side, frame by frame, as `cars` has them."""
        return closed_loops(scene, self.cars(), self._delays, self._quality, self._headlamps, self._profile)

    def driven(
        self, scene: Scene, name: str, frames: Iterator[tuple[Shone, ...]]
    ) -> tuple[GlareDrive, tuple[Sighting, ...]]:
        """All that is kept of a scene, from its closed loops: what was lit and shone, and when hidden vehicles came."""
        light = OurLight(scene, self._headlamps)
        production = ProductionCar(self._config.beam, self._headlamps)
        oracle = ExactCar(self._config.beam, self._headlamps)
        settings = settings_of(self._delays)
        replays = [_Replay(self._config, self._headlamps, setting) for setting in settings]
        policy = ForeglowPolicy(self._config.beam, self._headlamps)
        tracker, expected = make_tracker(self._config.tracker), Expectations(self._config.beam.coverage)
        record = _Record()
        for ours, paper, *others in frames:
            known = ours.known
            eyes = [light.at_eye(known, vehicle, ours.levels) for vehicle in known.vehicles]
            record.add_frame(known, eyes, light.on_road(known))
            in_sight = [vehicle for vehicle, eye in zip(known.vehicles, eyes, strict=True) if eye.is_in_sight]
            by_production, is_reporting = production.reported_levels(known)
            papers_gaps_rad = production.gaps_rad if is_reporting else paper.gaps_rad
            record.add_run("low", np.zeros((2, NUM_LEDS)))
            record.add_run("high", np.ones((2, NUM_LEDS)))
            record.add_run("production", by_production, production.gaps_rad)
            record.add_run("paper", both(by_production, is_reporting, paper.levels), papers_gaps_rad)
            record.add_run(own_name(self._config), ours.levels, ours.gaps_rad)
            for row, other in zip(self._also, others, strict=True):
                record.add_run(row, other.levels, other.gaps_rad)
            record.add_run("oracle", oracle.levels(known, in_sight), oracle.gaps_rad)
            for setting, replay in zip(settings, replays, strict=True):
                record.add_run(setting.name, replay.shining(known.frame, ours.result))
            policy.command(known.frame, _tracked(tracker, known.frame, ours.result))
            expected.add(policy.expected)
        moments = [Moment(known.frame.timestamp_ns / 1e9, known.ego_pose, known.vehicles) for known in record.known]
        return record.drive(scene, name), expected.sightings(moments, scene.rate_hz)


class _Replay:
    """What another setting of ours would shine, by the images and detections of the closed loop."""

    def __init__(self, config: PipelineConfig, headlamps: Headlamps, setting: Setting) -> None:
        self._tracker = make_tracker(config.tracker.model_copy(update=dict(setting.tracker)))
        self._policy = make_policy(config.beam.model_copy(update=dict(setting.beam)), headlamps)
        self._latency_ns = round(setting.latency_s * 1e9)
        self._commands: deque[BeamCommand] = deque()

    def shining(self, frame: Frame, result: FrameResult) -> Floats:
        """Shape (2, L), in `frame`, whose `result` is what our pipeline made of it; the first command at once."""
        self._commands.append(self._policy.command(frame, _tracked(self._tracker, frame, result)))
        while len(self._commands) > 1 and self._commands[1].timestamp_ns <= frame.timestamp_ns - self._latency_ns:
            self._commands.popleft()
        return self._commands[0].levels


def _tracked(tracker: Tracker, frame: Frame, result: FrameResult) -> Tracks:
    """What `tracker` makes of the detections in `frame`."""
    assert result.detections is not None
    return tracker.update(frame, result.detections, result.ranges)


class _Record:
    """What is gathered of a drive, frame by frame."""

    def __init__(self) -> None:
        self.known: list[DriveFrame] = []
        self._eyes: dict[int, dict[int, EyeLight]] = {}
        self._road: list[tuple[Floats, NDArray[np.float32]]] = []
        self._levels: dict[str, list[Floats]] = defaultdict(list)
        self._gaps: dict[str, list[Floats]] = defaultdict(list)

    def add_frame(self, known: DriveFrame, eyes: Sequence[EyeLight], road: tuple[Floats, NDArray[np.float32]]) -> None:
        """Adds the light in a frame; the image and the depth are let go."""
        image = np.broadcast_to(np.uint8(0), known.frame.image.shape)  # without memory
        frame = dataclasses.replace(known.frame, image=image)
        for vehicle, eye in zip(known.vehicles, eyes, strict=True):
            self._eyes.setdefault(vehicle.vehicle_id, {})[len(self.known)] = eye
        self.known.append(dataclasses.replace(known, frame=frame, depth_m=np.zeros((0, 0), np.float32)))
        self._road.append(road)

    def add_run(self, name: str, levels: Floats, gaps_rad: Floats | None = None) -> None:
        """Adds what a policy or a setting shone in the next frame."""
        self._levels[name].append(levels)
        self._gaps[name].append(np.zeros((0, 2)) if gaps_rad is None else gaps_rad)

    def drive(self, scene: Scene, name: str) -> GlareDrive:
        """The drive from the end of its run-in on."""
        times_s = np.array([known.frame.timestamp_ns / 1e9 for known in self.known])
        start = int(np.searchsorted(times_s, RUN_IN_S))
        if start == len(times_s):
            raise ValueError(f"{name}: expected a drive of more than {RUN_IN_S:g} s, got {scene.duration_s:g} s")
        base_lx, leds_lx = zip(*self._road[start:], strict=True)
        street = StreetLight(scene)
        driven = [vehicle_id for vehicle_id in sorted(self._eyes) if self._is_driven(vehicle_id)]
        last_frames = {vehicle_id: self._last_frame(vehicle_id) for vehicle_id in driven}
        gone_s = {vehicle_id: float(times_s[last]) for vehicle_id, last in last_frames.items() if 0 <= last < start}
        return GlareDrive(
            name=name,
            scenario=scene.name,
            rate_hz=scene.rate_hz,
            times_s=times_s[start:],
            speeds_mps=np.array([known.ego_speed_mps for known in self.known[start:]]),
            eyes=tuple(self._eye(vehicle_id, start) for vehicle_id in driven if vehicle_id not in gone_s),
            road=RoadLight(np.stack(base_lx), np.stack(leds_lx)),
            runs={
                policy: PolicyRun.of(policy, np.stack(levels[start:]), self._gaps[policy][start:])
                for policy, levels in self._levels.items()
            },
            light_s=self._first_lights(times_s),
            gone_s=gone_s,
            is_lit=np.array([street.is_lit(known.ego_s_m) for known in self.known[start:]]),
        )

    def _sightings_of(self, vehicle_id: int) -> list[tuple[DriveFrame, VehicleTruth]]:
        return [
            (known, vehicle) for known in self.known for vehicle in known.vehicles if vehicle.vehicle_id == vehicle_id
        ]

    def _is_driven(self, vehicle_id: int) -> bool:
        """Whether somebody drives it: it has lamps that are lit."""
        return any(lamp.intensity_cd > 0 for _, vehicle in self._sightings_of(vehicle_id) for lamp in vehicle.lamps)

    def _last_frame(self, vehicle_id: int) -> int:
        """The last one in which a vehicle has a range; -1 if it never has."""
        lights = self._eyes[vehicle_id].items()
        return max((frame for frame, light in lights if not math.isnan(light.range_m)), default=-1)

    def _eye(self, vehicle_id: int, start: int) -> DriverEye:
        absent = EyeLight(math.nan, math.nan, False, 0.0, np.zeros((2, NUM_LEDS), np.float32))
        lights = [self._eyes[vehicle_id].get(frame, absent) for frame in range(start, len(self.known))]
        known, vehicle = self._sightings_of(vehicle_id)[0]
        return DriverEye(
            vehicle_id=vehicle_id,
            kind=vehicle.kind,
            is_oncoming=is_coming(known.ego_pose, vehicle),
            ranges_m=np.array([light.range_m for light in lights]),
            azimuths_rad=np.array([light.azimuth_rad for light in lights]),
            is_in_sight=np.array([light.is_in_sight for light in lights]),
            base_lx=np.array([light.base_lx for light in lights]),
            leds_lx=np.stack([light.leds_lx for light in lights]),
        )

    def _first_lights(self, times_s: Floats) -> dict[int, float]:
        first: dict[int, float] = {}
        for known, time_s in zip(self.known, times_s.tolist(), strict=True):
            for vehicle in known.vehicles:
                if not all(artifact.is_doubtful for artifact in vehicle.artifacts):
                    first.setdefault(vehicle.vehicle_id, time_s)
        return first
