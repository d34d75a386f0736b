"""Headlamps in closed loop: what the camera sees is lit by what was commanded a moment ago."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from pydantic import Field

from foreglow.beam import Gap, GapWriter, PaperPolicy
from foreglow.beam.messages import CommandEncoder
from foreglow.beam.receiver import LampReceiver, ReceiverConfig
from foreglow.config import BeamConfig, DistanceConfig, FrozenModel, PipelineConfig, TrackerConfig
from foreglow.datasets.simulated import VehicleTruth
from foreglow.datasets.simulated.production import ProductionSystem
from foreglow.geometry import Floats
from foreglow.lab.evaluation.occurrence import is_coming
from foreglow.lab.simulation import DriveFrame, Scene, side_by_side, with_beam
from foreglow.lab.simulation.camera.profile import CameraProfile
from foreglow.photometry import NUM_LEDS, Headlamps, read_headlamps
from foreglow.pipeline import Pipeline
from foreglow.types import BeamCommand, FrameResult

EXACT_MARGIN_DEG = 0.5
"""Margin of the gap around a vehicle whose position is known exactly; other policies have `BeamConfig.margin_deg`."""

BODY_MARGIN_M = 0.3
"""Further margin on either side of such a vehicle's body."""

REAR_REACH_M = 150.0
"""The modelled production system knows of a vehicle ahead up to this range, while its rear lamps are in sight."""


class Delays(FrozenModel):
    """What passes until the lamps shine what an image asks for.

    Attributes:
        camera_s: From the exposure until the command is on the bus: read-out, transfer and computing.
        lamp_s: From there until the LEDs follow. Together 150 ms, of published 200 to 290 ms from camera to beam for
            whole systems, whose plausibility is in that; ours is in the tracker.
    """

    camera_s: float = Field(default=0.05, ge=0, le=1)
    lamp_s: float = Field(default=0.1, ge=0, le=1)

    def known_to(self, config: PipelineConfig) -> PipelineConfig:
        """`config` with a beam policy, ours where it has none, that knows of the delays.

        Raises:
            ValueError: If it has another latency, which would have no effect.
        """
        sum_s, given_s = self.camera_s + self.lamp_s, config.beam.latency_s
        if given_s != BeamConfig().latency_s and not math.isclose(given_s, sum_s):
            raise ValueError(
                f"beam.latency_s: expected {sum_s:g}, the sum of camera delay and lamp delay, or its default, "
                f"got {given_s:g}"
            )
        return config.commanding(latency_s=sum_s)


class Shone(NamedTuple):
    """One frame of a closed loop.

    Attributes:
        known: The frame, and all that is known of it.
        levels: Shape (2, L), what was shone in it.
        gaps_rad: Shape (G, 2), the gaps of the command that is in force.
        command: What followed from it.
    """

    known: DriveFrame
    levels: Floats
    gaps_rad: Floats
    command: BeamCommand
    result: FrameResult


class Car(Protocol):
    """Makes commands of frames: a pipeline, with what else a car has."""

    def step(self, known: DriveFrame) -> tuple[FrameResult, BeamCommand]:
        """What follows from a frame."""
        ...

    def lit(self, known: DriveFrame, levels: Floats) -> Floats:
        """What the next image is lit with when the bus says `levels`, shape (2, L); `known` is the frame before it."""
        ...


class OurCar:
    """Our pipeline with its beam stage and guard, and nothing else."""

    def __init__(self, config: PipelineConfig) -> None:
        self._pipeline = Pipeline(config)

    def step(self, known: DriveFrame) -> tuple[FrameResult, BeamCommand]:
        """As `Car.step`."""
        result = self._pipeline.step(known.frame)
        assert result.beam is not None
        return result, result.beam

    def lit(self, known: DriveFrame, levels: Floats) -> Floats:  # noqa: ARG002
        """As `Car.lit`."""
        return levels


class PaperCar:
    """The paper's: its whole chain, or our detector with its tracker and policy where its network is not given.

    A production system has the beam while it sees someone.

    Source: Ewecker et al., arXiv 2107.11302, section on the use case.
    """

    def __init__(self, config: PipelineConfig, chain: PipelineConfig | None = None) -> None:
        headlamps = read_headlamps(config.beam.headlamps)
        self._pipeline = Pipeline(paper_config(chain or config))
        self._policy = PaperPolicy(config.beam, headlamps)
        self._production = ProductionCar(config.beam, headlamps)

    def step(self, known: DriveFrame) -> tuple[FrameResult, BeamCommand]:
        """As `Car.step`; the production system's share is not in it."""
        result = self._pipeline.step(known.frame)
        assert result.tracks is not None
        return result, self._policy.command(known.frame, result.tracks)

    def lit(self, known: DriveFrame, levels: Floats) -> Floats:
        """As `Car.lit`."""
        return both(*self._production.reported_levels(known), levels)


def both(production: Floats, is_reporting: bool, provident: Floats) -> Floats:
    """What the paper's lamps shine, shape (2, L): the provident part is mute while the production system reports."""
    return production if is_reporting else np.minimum(production, provident)


class ExactCar:
    """Exact gaps, in this very frame, around vehicles whose positions are known: what no car can do.

    They are no bound on what the lamps can do: gaps are as wide as `exact_gaps` says, each LED is dimmed to
    `BeamConfig.led_limit_lx`, and there is no guard. Narrower gaps keep more light, and a guard dims further.
    """

    def __init__(self, config: BeamConfig, headlamps: Headlamps) -> None:
        self._writer = GapWriter(config, headlamps)
        self.gaps_rad = np.zeros((0, 2))

    def levels(self, known: DriveFrame, vehicles: Sequence[VehicleTruth]) -> Floats:
        """Shape (2, L), in this frame, with gaps for `vehicles`."""
        command = self._writer.command(known.frame.timestamp_ns, exact_gaps(known, vehicles))
        self.gaps_rad = command.gaps_rad
        return command.levels


class ProductionCar(ExactCar):
    """The modelled production system's beam: exact gaps for the vehicles that it reports, and they count at once.

    Its latency is in its reports (`ProductionConfig.latency_s`, from camera to beam). It also knows of vehicles ahead
    of us while their rear lamps are in sight.
    """

    def __init__(self, config: BeamConfig, headlamps: Headlamps) -> None:
        super().__init__(config, headlamps)
        self._system = ProductionSystem()

    def reported_levels(self, known: DriveFrame) -> tuple[Floats, bool]:
        """Shape (2, L), in this frame, and whether a vehicle is reported."""
        reported = self._system.update(known.frame.timestamp_ns, known.vehicles)
        seen = [met for met in known.vehicles if met.vehicle_id in reported or _is_followed(known, met)]
        return self.levels(known, seen), bool(seen)


def paper_config(config: PipelineConfig) -> PipelineConfig:
    """`config` with the paper's tracker and ground plane and without a beam stage; the detector stays."""
    return config.model_copy(
        update={
            "distance": DistanceConfig(),
            "tracker": TrackerConfig(),
            "beam": config.beam.model_copy(update={"policy": "none"}),
        }
    )


def exact_gaps(known: DriveFrame, vehicles: Sequence[VehicleTruth]) -> list[Gap]:
    """A gap around the whole body of each of `vehicles`, in front of us, with both margins on either side."""
    gaps = []
    for vehicle in vehicles:
        length_m, width_m, _ = vehicle.size_m
        ends = vehicle.box_centre_m + np.array(
            [[x * length_m / 2, y * width_m / 2, 0] for x in (-1, 1) for y in (-1, 1)]
        )
        corners = known.ego_pose.to_body(vehicle.pose.to_outer(ends))
        ranges_m = np.hypot(corners[:, 0], corners[:, 1])
        if corners[:, 0].min() > 0.0:
            azimuths = np.arctan2(corners[:, 1], corners[:, 0])
            margins = np.arctan2(BODY_MARGIN_M, ranges_m) + math.radians(EXACT_MARGIN_DEG)
            right, left = (azimuths - margins).min(), (azimuths + margins).max()
            gaps.append(Gap(float(right), float(left), float(ranges_m.min()), float(ranges_m.max())))
    return gaps


def closed_loops(
    scene: Scene,
    cars: Sequence[Car],
    delays: Delays,
    quality: str,
    headlamps: Headlamps | None = None,
    profile: CameraProfile | None = None,
) -> Iterator[tuple[Shone, ...]]:
    """Drives `scene` with each of `cars` in turn at the lamps, all of them frame by frame: rendered once for all.

    What is known of a frame is the same for all cars, but for the image; labels are those of the first car's.
    """
    lamps = [_Lamps(delays) for _ in cars]
    levels = [lamp.levels for lamp in lamps]

    def shining() -> Sequence[Floats]:
        return levels

    drives = side_by_side(with_beam(scene, "matrix"), shining, quality, headlamps, profile)
    for number, seen in enumerate(drives, start=1):
        steps = [car.step(known) for car, known in zip(cars, seen, strict=True)]
        yield tuple(
            Shone(known, shone, lamp.in_force.gaps_rad, command, result)
            for known, shone, lamp, (result, command) in zip(seen, levels, lamps, steps, strict=True)
        )
        next_ns = round(scene.time_s(number) * 1e9)
        for lamp, (_, command) in zip(lamps, steps, strict=True):
            lamp.receive(command, next_ns)
        levels = [car.lit(known, lamp.levels) for car, known, lamp in zip(cars, seen, lamps, strict=True)]


class _Lamps:
    """A car's lamps behind its bus: commands arrive as CAN frames, at a receiver that starts in low beam as in a car.

    Attributes:
        in_force: The latest command that the lamps follow.
        levels: Shape (2, L), what is shone in the next frame.
    """

    def __init__(self, delays: Delays) -> None:
        self._camera_ns, self._lamp_ns = round(delays.camera_s * 1e9), round(delays.lamp_s * 1e9)
        self._encoder, self._receiver = CommandEncoder(), LampReceiver(ReceiverConfig(latency_s=delays.lamp_s))
        self._on_the_way: deque[tuple[int, BeamCommand]] = deque()
        self._sent: deque[tuple[int, BeamCommand]] = deque()
        self.in_force = BeamCommand.low(0, NUM_LEDS)
        self.levels = self.in_force.levels

    def receive(self, command: BeamCommand, next_ns: int) -> None:
        """Takes the command for a frame, and goes on to the next frame, at `next_ns`."""
        self._on_the_way.append((command.timestamp_ns + self._camera_ns, command))
        while self._on_the_way and self._on_the_way[0][0] <= next_ns:
            arrival_ns, arrived = self._on_the_way.popleft()
            for frame in self._encoder.frames(arrived):
                self._receiver.receive(arrival_ns, frame.frame_id, frame.data)
            self._sent.append((arrival_ns + self._lamp_ns, arrived))
        while self._sent and self._sent[0][0] <= next_ns:
            self.in_force = self._sent.popleft()[1]
        self.levels, _ = self._receiver.shining(next_ns)


def _is_followed(known: DriveFrame, vehicle: VehicleTruth) -> bool:
    """Whether it drives ahead of us, near, with its rear lamps in sight."""
    is_lit = any(lamp.is_rear and lamp.visible_share >= 0.5 for lamp in vehicle.lamps)
    return is_lit and not is_coming(known.ego_pose, vehicle) and vehicle.range_m < REAR_REACH_M
