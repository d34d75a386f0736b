"""Simulates a scene of the experiment on glare: closed loops, what other policies would shine, and what is lit."""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from foreglow.beam import make_policy
from foreglow.beam.policy import ForeglowPolicy
from foreglow.config import PipelineConfig
from foreglow.datasets.simulated import VehicleTruth
from foreglow.geometry import Floats, Pose, rotation
from foreglow.lab.evaluation.occurrence import Expectations, Moment, Sighting, is_coming
from foreglow.lab.simulation import DriveFrame, Scene
from foreglow.lab.simulation.camera.profile import CameraProfile
from foreglow.lab.simulation.scenes.scene import EgoSpec
from foreglow.lab.simulation.traffic.actors import matrix_of
from foreglow.lab.simulation.world.road import Road
from foreglow.lab.studies.glare.drive import DriverEye, GlareDrive, PolicyRun, RoadLight
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
from foreglow.photometry import NUM_LEDS, Headlamp, Headlamps, read_headlamps, street_lamp
from foreglow.tracking import make_tracker
from foreglow.types import Frame, FrameResult, Tracks

FARTHEST_M = 400.0
"""In the simulator no light of ours reaches an eye that is further away."""

ROAD_DISTANCES_M = np.arange(40.0, 121.0, 10.0)
"""Where the light on the road is measured, arc lengths ahead of our rear axle."""

VERGE_M = 0.75
"""Distance of the point on the verge from the edge of the carriageway on our side."""


LIT_M = np.arange(0.0, 101.0, 5.0)
"""Where it is asked whether the road is lit, arc lengths ahead of our rear axle."""

MIN_LIT_LX, MIN_LIT_SHARE = 0.5, 0.75
"""A road is lit where lamps on posts give at least so much, on at least this share of `LIT_M`; one lamp alone lights
some 40 m of it."""


class EyeLight(NamedTuple):
    """The light at one eye in one frame.

    Attributes:
        range_m: From our vehicle's origin; NaN where it is beside or behind our lamps, or too far away.
        azimuth_rad: Of the eye in our vehicle's frame, to the left; NaN as the range.
        base_lx: By both low beams.
        leds_lx: Shape (2, L), by each LED at level 1.
    """

    range_m: float
    azimuth_rad: float
    is_in_sight: bool
    base_lx: float
    leds_lx: NDArray[np.float32]


class OurLight:
    """The light of our headlamps in one drive, as they are mounted, aimed and as bright as the scene has them."""

    def __init__(self, scene: Scene, headlamps: Headlamps | None = None) -> None:
        """Takes the scene, and our headlamps; None for the built-in ones."""
        self._lamps = _aimed(headlamps or read_headlamps(), scene.ego)
        self._positions_m = np.stack(
            [lamp.vehicle_from_lamp.position_m for lamp in (self._lamps.left, self._lamps.right)]
        )
        self._brightness = scene.ego.brightness
        self._scattering_per_m = scene.weather.scattering_per_m
        self._road = Road(scene.road)
        verge_m = -scene.road.mirror * (self._road.half_width_m + VERGE_M)
        self._offsets_m = (_lane_m(scene), verge_m)

    def at_eye(self, known: DriveFrame, vehicle: VehicleTruth, levels: Floats) -> EyeLight:
        """The light at the driver's eye of `vehicle`, or at its mirrors where we follow it.

        What stands in between follows from the sum of both lamps' light in the simulator: one, both or none of them is
        seen, whichever comes nearest to that sum. A vehicle that we follow is in sight when its rear lamps are.

        Args:
            known: The frame.
            vehicle: One of its vehicles.
            levels: Shape (2, L), what was shone in this frame.
        """
        eye = known.ego_pose.to_body(vehicle.eye_world_m)
        forward = known.ego_pose.rotation.T @ vehicle.pose.rotation[:, 0]
        is_oncoming = is_coming(known.ego_pose, vehicle)
        no_light = np.zeros((2, self._lamps.num_leds), np.float32)
        range_m = float(np.hypot(eye[0], eye[1]))
        if eye[0] <= self._lamps.left.vehicle_from_lamp.position_m[0] + 0.5 or range_m > FARTHEST_M:
            return EyeLight(np.nan, np.nan, is_oncoming and vehicle.eye_lx.get("ego", 0.0) > 0, 0.0, no_light)
        sight = forward if is_oncoming else -forward
        base_lx, leds_lx = (self._facing(eye, sight, light_lx) for light_lx in self._by_lamp(eye))
        if is_oncoming:
            expected_lx = base_lx + (levels * leds_lx).sum(axis=1)
            is_seen = seen_lamps(expected_lx, vehicle.eye_lx.get("ego", 0.0))
        else:
            is_seen = np.full(2, any(lamp.is_rear and lamp.visible_share > 0 for lamp in vehicle.lamps))
        return EyeLight(
            range_m=range_m,
            azimuth_rad=float(np.arctan2(eye[1], eye[0])),
            is_in_sight=bool(is_seen.any()),
            base_lx=float(base_lx @ is_seen),
            leds_lx=(leds_lx * is_seen[:, None]).astype(np.float32),
        )

    def on_road(self, known: DriveFrame) -> tuple[Floats, NDArray[np.float32]]:
        """Mean illuminance of own lane and verge, facing the lamps, with nothing in between.

        Returns:
            By both low beams, shape (2,); by each LED at level 1, shape (2, 2, L): area, lamp, LED.
        """
        arcs_m = known.ego_s_m + ROAD_DISTANCES_M
        areas = [self._road.points(arcs_m, offset_m) for offset_m in self._offsets_m]
        points = known.ego_pose.to_body(np.concatenate(areas))
        base_lx, leds_lx = self._lamps.illuminance_lx(points)
        num = len(ROAD_DISTANCES_M)
        base = base_lx.reshape(2, num).mean(axis=1) * self._brightness
        leds = leds_lx.reshape(2, num, 2, -1).mean(axis=1) * self._brightness
        return base, leds.astype(np.float32)

    def _by_lamp(self, point: Floats) -> tuple[Floats, Floats]:
        """Illuminance by each low beam, shape (2,), and by each LED, shape (2, L), facing them."""
        offsets = point - self._positions_m
        squares = np.sum(offsets * offsets, axis=1)
        base_cd = [self._lamps.intensities_cd(offset[None])[0][0, lamp] for lamp, offset in enumerate(offsets)]
        leds_lx = self._lamps.illuminance_lx(point[None])[1][0]
        return np.array(base_cd) / squares, leds_lx

    def _facing(self, eye: Floats, forward: Floats, light_lx: Floats) -> Floats:
        """The light on a plane across `forward`, in place of one that faces the lamps, through the air; by lamp."""
        away = self._positions_m - eye
        ranges_m = np.linalg.norm(away, axis=1)
        kept = np.clip(away @ forward / ranges_m, 0.0, None) * np.exp(-self._scattering_per_m * ranges_m)
        return np.asarray(light_lx * (self._brightness * kept).reshape(2, *([1] * (light_lx.ndim - 1))))


def seen_lamps(expected_lx: Floats, found_lx: float) -> NDArray[np.bool_]:
    """Which of two lamps are seen, when they would give `expected_lx`, shape (2,), and give `found_lx` together.

    >>> seen_lamps(np.array([2.0, 3.0]), 3.0).tolist()
    [False, True]
    """
    choices = np.array([[False, False], [True, False], [False, True], [True, True]])
    return np.asarray(choices[np.argmin(np.abs(choices @ expected_lx - found_lx))])


def _aimed(headlamps: Headlamps, ego: EgoSpec) -> Headlamps:
    aim = Pose(np.zeros(3), rotation(float(np.radians(ego.yaw_aim_deg)), float(np.radians(ego.pitch_aim_deg))))
    left, right = (
        Headlamp(lamp.vehicle_from_lamp @ aim, matrix_of(ego, lamp.matrix))
        for lamp in (headlamps.left, headlamps.right)
    )
    return dataclasses.replace(headlamps, left=left, right=right)


def _lane_m(scene: Scene) -> float:
    """Offset of the middle of our lane to the left of the road's centre line."""
    return -scene.road.mirror * scene.road.lane_m(scene.ego.lane_number)


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
        record = _Record()
        results: list[FrameResult] = []
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
            results.append(ours.result)
        recorded = [known.frame for known in record.known]
        for setting in settings_of(self._delays):
            for levels in self._replayed(recorded, results, setting):
                record.add_run(setting.name, levels)
        moments = [Moment(known.frame.timestamp_ns / 1e9, known.ego_pose, known.vehicles) for known in record.known]
        sightings = self._expectations(recorded, results).sightings(moments, scene.rate_hz)
        return record.drive(scene, name), sightings

    def _replayed(self, frames: Sequence[Frame], results: Sequence[FrameResult], setting: Setting) -> list[Floats]:
        """What another setting would have shone in each frame, on the same detections."""
        beam = self._config.beam.model_copy(update=dict(setting.beam))
        policy = make_policy(beam, self._headlamps)
        followed = zip(frames, self._tracked(frames, results, setting.tracker), strict=True)
        commanded = [policy.command(frame, tracks).levels for frame, tracks in followed]
        times_ns = np.array([frame.timestamp_ns for frame in frames])
        latest = np.searchsorted(times_ns, times_ns - round(setting.latency_s * 1e9), side="right") - 1
        return [commanded[max(index, 0)] for index in latest.tolist()]

    def _expectations(self, frames: Sequence[Frame], results: Sequence[FrameResult]) -> Expectations:
        policy = ForeglowPolicy(self._config.beam, self._headlamps)
        expected = Expectations(self._config.beam.coverage)
        for frame, tracks in zip(frames, self._tracked(frames, results, {}), strict=True):
            policy.command(frame, tracks)
            expected.add(policy.expected)
        return expected

    def _tracked(
        self, frames: Sequence[Frame], results: Sequence[FrameResult], changes: Mapping[str, Any]
    ) -> Iterator[Tracks]:
        """What our tracker, with some fields of its configuration changed, makes of the detections."""
        tracker = make_tracker(self._config.tracker.model_copy(update=dict(changes)))
        for frame, result in zip(frames, results, strict=True):
            assert result.detections is not None
            yield tracker.update(frame, result.detections, result.ranges)


class StreetLight:
    """The light of a drive's lamps on posts on our lane, as on a flat road without anything in between."""

    def __init__(self, scene: Scene) -> None:
        edge_m = scene.road.half_width_m
        self._lane_m = _lane_m(scene)
        lamps = [lamp for lamp in scene.surroundings.street_lamps if lamp.intensity_cd > 0]
        sides = [1.0 if lamp.side == "left" else -1.0 for lamp in lamps]
        self._positions_m = np.array(
            [
                (lamp.s_m, side * (edge_m + lamp.offset_m), lamp.height_m)
                for lamp, side in zip(lamps, sides, strict=True)
            ]
        ).reshape(-1, 3)
        self._intensities_cd = np.array([lamp.intensity_cd for lamp in lamps])

    def is_lit(self, s_m: float) -> bool:
        """Whether the road ahead of the arc length `s_m` is lit."""
        points_m = np.stack([s_m + LIT_M, np.full(len(LIT_M), self._lane_m), np.zeros(len(LIT_M))], axis=1)
        offsets_m = points_m[:, np.newaxis] - self._positions_m
        distances_m = np.linalg.norm(offsets_m, axis=2)
        downwards = np.stack([-offsets_m[..., 2], offsets_m[..., 0], offsets_m[..., 1]], axis=-1)
        intensities_cd = self._intensities_cd * street_lamp().towards(downwards)
        lux = (intensities_cd * downwards[..., 0] / distances_m**3).sum(axis=1)
        return bool((lux >= MIN_LIT_LX).mean() >= MIN_LIT_SHARE)


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
        image = np.broadcast_to(np.uint8(0), known.frame.image.shape)  # black, of the same size, without memory
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
        return GlareDrive(
            name=name,
            scenario=scene.name,
            rate_hz=scene.rate_hz,
            times_s=times_s[start:],
            speeds_mps=np.array([known.ego_speed_mps for known in self.known[start:]]),
            eyes=tuple(
                self._eye(vehicle_id, start) for vehicle_id in sorted(self._eyes) if self._is_driven(vehicle_id)
            ),
            road=RoadLight(np.stack(base_lx), np.stack(leds_lx)),
            runs={
                policy: PolicyRun.of(policy, np.stack(levels[start:]), self._gaps[policy][start:])
                for policy, levels in self._levels.items()
            },
            light_s=self._first_lights(times_s),
            is_lit=np.array([street.is_lit(known.ego_s_m) for known in self.known[start:]]),
        )

    def _sightings_of(self, vehicle_id: int) -> list[tuple[DriveFrame, VehicleTruth]]:
        return [
            (known, vehicle) for known in self.known for vehicle in known.vehicles if vehicle.vehicle_id == vehicle_id
        ]

    def _is_driven(self, vehicle_id: int) -> bool:
        """Whether somebody drives it: it has lamps that are lit."""
        return any(lamp.intensity_cd > 0 for _, vehicle in self._sightings_of(vehicle_id) for lamp in vehicle.lamps)

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
