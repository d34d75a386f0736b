"""One scene of the experiment on glare: both closed loops, what other policies would have shone, and what was lit."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.beam.policy import ForeglowPolicy
from foreglow.config import PipelineConfig
from foreglow.geometry import Floats
from foreglow.lab.simulation import DriveFrame, Scene
from foreglow.lab.studies.glare.drive import DriverEye, GlareDrive, PolicyRun, RoadLight
from foreglow.lab.studies.glare.light import EyeLight, OurLight
from foreglow.lab.studies.glare.loop import Delays, OracleCar, OurCar, PaperCar, ProductionCar, Shone, both, closed_loop
from foreglow.lab.studies.occurrence.metrics import Sighting
from foreglow.lab.studies.occurrence.run import Expectations, Moment, is_coming
from foreglow.photometry import NUM_LEDS, read_headlamps
from foreglow.tracking import make_tracker
from foreglow.types import Detections, Frame, Ranges

RUN_IN_S = 1.5
"""So long a drive goes on before it counts: systems start in low beam, from which light returns slowly."""


@dataclass(frozen=True, slots=True)
class Setting:
    """Another setting of ours, of which the light is computed on the detections of the closed loop.

    Attributes:
        parameter: What is changed.
        unit: Of its value; empty without.
        value: The value.
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


@dataclass(frozen=True, slots=True, eq=False)
class DrivenScene:
    """What comes of one scene.

    Attributes:
        drive: What was lit, and what every policy and setting shone.
        sightings: Of hidden vehicles.
    """

    drive: GlareDrive
    sightings: tuple[Sighting, ...]


@dataclass(slots=True)
class _Look:
    """What is kept of a frame of our loop: all but its image."""

    frame: Frame
    detections: Detections
    ranges: Ranges | None


class Drives:
    """Drives scenes."""

    def __init__(self, config: PipelineConfig, delays: Delays, quality: str = "training") -> None:
        """Takes the configuration, with a beam policy, and the delays from camera to beam."""
        self._config, self._delays, self._quality = config, delays, quality
        self._headlamps = read_headlamps(config.beam.headlamps)

    def pairs(self, scene: Scene) -> Iterator[tuple[Shone, Shone]]:
        """Both closed loops side by side, frame by frame: the paper's and ours."""
        loops = (
            closed_loop(scene, car, self._delays, self._quality)
            for car in (PaperCar(self._config), OurCar(self._config))
        )
        return zip(*loops, strict=True)

    def driven(self, scene: Scene, name: str, pairs: Iterator[tuple[Shone, Shone]]) -> DrivenScene:
        """All that is kept of a scene, from its closed loops."""
        light = OurLight(scene)
        production = ProductionCar(self._config.beam, self._headlamps)
        oracle = OracleCar(self._config.beam, self._headlamps)
        log = _Log()
        looks: list[_Look] = []
        for paper, ours in pairs:
            known = ours.known
            seen = [light.at_eye(known, one, ours.levels) for one in known.vehicles]
            log.note(known, seen, light.on_road(known))
            in_sight = [one for one, eye in zip(known.vehicles, seen, strict=True) if eye.is_in_sight]
            by_production, is_reporting = production.levels(known)
            log.shone("low", np.zeros((2, NUM_LEDS)))
            log.shone("high", np.ones((2, NUM_LEDS)))
            log.shone("production", by_production, production.gaps_rad)
            log.shone(
                "paper",
                both(by_production, is_reporting, paper.levels),
                production.gaps_rad if is_reporting else paper.gaps_rad,
            )
            log.shone("foreglow", ours.levels, ours.gaps_rad)
            log.shone("oracle", oracle.levels(known, in_sight), oracle.gaps_rad)
            assert ours.result.detections is not None
            blank = dataclasses.replace(known.frame, image=_blank(known.frame))
            looks.append(_Look(blank, ours.result.detections, ours.result.ranges))
        expected = Expectations(self._config.beam.coverage)
        for setting in settings_of(self._delays):
            log.shone_all(setting.name, self._replayed(looks, setting, None))
        self._replayed(looks, None, expected)
        return DrivenScene(
            log.drive(scene, name), expected.sightings([Moment.of(one) for one in log.known], scene.rate_hz)
        )

    def _replayed(self, looks: Sequence[_Look], setting: Setting | None, expected: Expectations | None) -> list[Floats]:
        """What another setting would have shone, on the same detections."""
        changed_beam: Mapping[str, Any] = {} if setting is None else setting.beam
        changed_tracker: Mapping[str, Any] = {} if setting is None else setting.tracker
        beam = self._config.beam.model_copy(update=dict(changed_beam))
        tracker = make_tracker(self._config.tracker.model_copy(update=dict(changed_tracker)))
        policy = ForeglowPolicy(beam, self._headlamps)
        commanded = []
        for look in looks:
            tracks = tracker.update(look.frame, look.detections, look.ranges)
            commanded.append(policy.command(look.frame, tracks).levels)
            if expected is not None:
                expected.note(policy.expected)
        latency_ns = 0 if setting is None else round(setting.latency_s * 1e9)
        times_ns = np.array([look.frame.timestamp_ns for look in looks])
        latest = np.searchsorted(times_ns, times_ns - latency_ns, side="right") - 1
        return [commanded[max(place, 0)] for place in latest.tolist()]


class _Log:
    """What is gathered of a drive."""

    def __init__(self) -> None:
        self.known: list[DriveFrame] = []
        self._eyes: dict[int, dict[int, EyeLight]] = {}
        self._road: list[tuple[Floats, NDArray[np.float32]]] = []
        self._levels: dict[str, list[Floats]] = {}
        self._gaps: dict[str, list[Floats]] = {}

    def note(self, known: DriveFrame, eyes: Sequence[EyeLight], road: tuple[Floats, NDArray[np.float32]]) -> None:
        """The light in a frame; its image and depth are let go."""
        place = len(self.known)
        blank = dataclasses.replace(known.frame, image=_blank(known.frame))
        self.known.append(dataclasses.replace(known, frame=blank, depth_m=np.zeros((0, 0), np.float32)))
        self._road.append(road)
        for vehicle, eye in zip(known.vehicles, eyes, strict=True):
            self._eyes.setdefault(vehicle.vehicle_id, {})[place] = eye

    def shone(self, name: str, levels: Floats, gaps_rad: Floats | None = None) -> None:
        """What a policy shone in the latest frame."""
        self._levels.setdefault(name, []).append(levels)
        self._gaps.setdefault(name, []).append(np.zeros((0, 2)) if gaps_rad is None else gaps_rad)

    def shone_all(self, name: str, levels: Sequence[Floats]) -> None:
        """What a setting shone in all frames."""
        self._levels[name] = list(levels)
        self._gaps[name] = [np.zeros((0, 2))] * len(levels)

    def drive(self, scene: Scene, name: str) -> GlareDrive:
        """The drive from the end of its run-in on."""
        times_s = np.array([one.frame.timestamp_ns / 1e9 for one in self.known])
        kept = np.flatnonzero(times_s >= RUN_IN_S)
        if not len(kept):
            raise ValueError(f"{name}: expected a drive of more than {RUN_IN_S:g} s, got {scene.duration_s:g} s")
        return GlareDrive(
            name=name,
            scenario=scene.name,
            rate_hz=scene.rate_hz,
            times_s=times_s[kept],
            speeds_mps=np.array([self.known[place].ego_speed_mps for place in kept]),
            eyes=tuple(self._eye(vehicle_id, kept) for vehicle_id in sorted(self._eyes) if self._is_driven(vehicle_id)),
            road=RoadLight(
                np.stack([self._road[place][0] for place in kept]), np.stack([self._road[place][1] for place in kept])
            ),
            runs=MappingProxyType(
                {
                    policy: PolicyRun.of(
                        policy,
                        np.stack([levels[place] for place in kept]),
                        [self._gaps[policy][place] for place in kept],
                    )
                    for policy, levels in self._levels.items()
                }
            ),
            light_s=self._first_lights(times_s),
        )

    def _is_driven(self, vehicle_id: int) -> bool:
        """Whether somebody drives it: it has lamps that are lit."""
        return any(
            one.vehicle_id == vehicle_id and any(lamp.intensity_cd > 0 for lamp in one.lamps)
            for frame in self.known
            for one in frame.vehicles
        )

    def _eye(self, vehicle_id: int, kept: NDArray[np.intp]) -> DriverEye:
        lights, no_light = self._eyes[vehicle_id], np.zeros((2, NUM_LEDS), np.float32)
        absent = EyeLight(math.nan, math.nan, False, 0.0, no_light)
        eyes = [lights.get(place, absent) for place in kept.tolist()]
        frame, vehicle = next(
            (frame, one) for frame in self.known for one in frame.vehicles if one.vehicle_id == vehicle_id
        )
        return DriverEye(
            vehicle_id=vehicle_id,
            kind=vehicle.kind,
            is_oncoming=is_coming(frame.ego_pose, vehicle),
            ranges_m=np.array([one.range_m for one in eyes]),
            azimuths_rad=np.array([one.azimuth_rad for one in eyes]),
            is_in_sight=np.array([one.is_in_sight for one in eyes]),
            base_lx=np.array([one.base_lx for one in eyes]),
            leds_lx=np.stack([one.leds_lx for one in eyes]),
        )

    def _first_lights(self, times_s: Floats) -> dict[int, float]:
        """By vehicle, when its first light is labelled."""
        first: dict[int, float] = {}
        for frame, time_s in zip(self.known, times_s.tolist(), strict=True):
            for vehicle in frame.vehicles:
                if vehicle.artifacts and not all(one.is_doubtful for one in vehicle.artifacts):
                    first.setdefault(vehicle.vehicle_id, time_s)
        return first


def _blank(frame: Frame) -> NDArray[np.uint8]:
    """A black image of the same size that takes no memory."""
    return np.broadcast_to(np.uint8(0), frame.image.shape)
