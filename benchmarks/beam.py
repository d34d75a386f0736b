"""Run-time of policy, guard and messages: `python -m benchmarks.beam [--out FILE.json] [--quick]`.

One thread. Messages are compared with cantools by the same DBC. Policy and guard are given the lamps of vehicles, two
each, that come nearer, or light on the road far ahead whose vehicle is hidden. With tracking, they are given what our
tracker makes of the lamps of eight vehicles; that alone is compared with the published code's tracker.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.timing import CONSOLE, Contender, Row, in_ms, interleaved, options, table, write_results
from foreglow.beam import make_policy
from foreglow.beam.guard import Guard
from foreglow.beam.known_images import NUM_KNOWN
from foreglow.beam.messages import GAPS_ID, LEVELS_IDS, OWN_DBC, CommandEncoder, decode_gaps, decode_levels
from foreglow.beam.receiver import LampReceiver
from foreglow.beam.stage import BeamStage
from foreglow.config import OUR_TRACKER, PUBLISHED_TRACKER, BeamConfig, GuardConfig, TrackerConfig
from foreglow.datasets.vehicle_logs.dbc import read_dbc
from foreglow.geometry import Camera, Pose
from foreglow.photometry import read_headlamps
from foreglow.tracking import make_tracker
from foreglow.types import (
    BeamCommand,
    BeamMode,
    Detections,
    EgoMotion,
    Frame,
    Proposals,
    Ranges,
    RoadAhead,
    Tracks,
    TrackState,
)
from foreglow.types.kinds import kinds_of_direct

FRAME_NS = 55_555_556
NUM_FRAMES = 400
NUM_LAMPS = (0, 2, 4, 8)
NUM_VEHICLES = 8
WHOLE, PUBLISHED = (f"{what}: {NUM_VEHICLES} vehicles" for what in ("tracking, policy, guard", "published tracker"))
MOUNT = Pose(np.array([1.8, 0.0, 1.35]), np.eye(3))
CAMERA = Camera(1280, 960, (1350.0, 1350.0), (640.0, 490.0), (-0.07, 0.015, 1e-4, -2e-5, 0.0), MOUNT)


ROAD = RoadAhead(np.stack([np.arange(0.0, 400.0, 5.0), np.arange(0.0, 400.0, 5.0) ** 2 / 800.0, np.zeros(80)], -1), 3.5)


def drive(num_lights: int, direct: float) -> list[tuple[Tracks, Frame]]:
    """Lights that come nearer: lamps, two a vehicle, by their probability `direct`, or light on things."""
    random = np.random.default_rng(0)
    images = [random.integers(10, 35, (960, 1280), np.uint8) for _ in range(NUM_KNOWN + 1)]
    drawn = []
    for number in range(NUM_FRAMES):
        ranges_m = 250.0 - 0.4 * number + 10.0 * np.arange(num_lights, dtype=np.float64)
        lefts = (
            640.0 - 1350.0 * (3.0 + 1.3 * (np.arange(num_lights) % 2)) / ranges_m - 60 * (np.arange(num_lights) // 2)
        )
        half_px = 1350.0 * 0.4 / ranges_m
        boxes = np.stack([lefts - half_px, 500 - half_px, lefts + half_px, 500 + half_px], -1)
        frame = Frame(
            images[number % len(images)], number * FRAME_NS, camera=CAMERA, motion=EgoMotion(20.0, 0.0), road=ROAD
        )
        tracks = Tracks(
            ids=np.arange(num_lights),
            states=np.full(num_lights, TrackState.CONFIRMED, np.int64),
            boxes_xyxy_px=boxes,
            confidences=np.full(num_lights, 0.9),
            num_hits=np.full(num_lights, 9),
            num_misses=np.zeros(num_lights, np.int64),
            ages_s=np.full(num_lights, 1.0 + number / 18),
            ranges_m=ranges_m,
            sigmas_m=ranges_m / 10,
            detections=np.arange(num_lights),
            light_kinds=kinds_of_direct(np.full(num_lights, direct)),
        )
        drawn.append((tracks, frame))
    return drawn


def next_command(num_lights: int, direct: float) -> Callable[[], object]:
    """A call that makes, checks and encodes the next command, and begins anew after the last one."""
    headlamps = read_headlamps()
    policy, guard = make_policy(BeamConfig(policy="foreglow"), headlamps), Guard(GuardConfig(), headlamps)
    encoder, coming = CommandEncoder(1.0), itertools.cycle(drive(num_lights, direct))

    def step() -> object:
        tracks, frame = next(coming)
        if frame.timestamp_ns == 0:
            policy.reset()
            guard.reset()
        is_vehicle = tracks.direct_probabilities > 0.5
        return encoder.frames(guard.check(policy.command(frame, tracks), tracks, frame, is_vehicle=is_vehicle))

    return step


def next_stage(config: TrackerConfig, *, with_beam: bool) -> Callable[[], object]:
    """A call that tracks the lamps of eight vehicles and, `with_beam`, makes and checks the command."""
    tracker, stage = make_tracker(config), BeamStage(BeamConfig(policy="foreglow"), GuardConfig())
    coming = itertools.cycle([(frame, *measured(tracks)) for tracks, frame in drive(2 * NUM_VEHICLES, 0.97)])

    def step() -> object:
        frame, detections, ranges = next(coming)
        if frame.timestamp_ns == 0:
            tracker.reset()
            stage.reset()
        tracks = tracker.update(frame, detections, ranges)
        return stage.command(frame, tracks) if with_beam else tracks

    return step


def measured(tracks: Tracks) -> tuple[Detections, Ranges]:
    """What a detector and a distance estimator say of these tracks."""
    boxes = np.rint(tracks.boxes_xyxy_px).astype(np.int32)
    boxes[:, 2:] = np.maximum(boxes[:, 2:], boxes[:, :2] + 5)
    scores = np.full(len(tracks), 0.97, np.float32)
    detections = Detections(Proposals(boxes), scores, 0.5, tracks.light_kinds.astype(np.float32))
    return detections, Ranges(detections, tracks.ranges_m, tracks.sigmas_m)


def codecs() -> dict[str, Callable[[], object]]:
    """Calls that encode a command, decode its frames, and receive them; ours and those of cantools."""
    random = np.random.default_rng(0)
    gaps = np.array([[-0.1, 0.0], [0.02, 0.1]])
    command = BeamCommand(10**9, BeamMode.GLARE_FREE, random.random((2, 84)), gaps, np.array([70.0, 90.0]))
    encoder = CommandEncoder(1.0)
    frames = encoder.frames(command)
    messages: dict[int, Any] = {message.frame_id: message for message in read_dbc(OWN_DBC).values()}
    values = [(messages[frame.frame_id], messages[frame.frame_id].decode(frame.data)) for frame in frames]
    receiver, times_ns = LampReceiver(), itertools.count(10**9, FRAME_NS)

    def receive() -> None:
        time_ns = next(times_ns)
        for frame in frames[: len(LEVELS_IDS)]:
            receiver.receive(time_ns, *frame)

    return {
        "encode": lambda: encoder.frames(command),
        "encode, cantools": lambda: [message.encode(signals) for message, signals in values],
        "decode": lambda: (decode_levels(frames[: len(LEVELS_IDS)]), decode_gaps(GAPS_ID, frames[-1].data)),
        "decode, cantools": lambda: [messages[frame_id].decode(data) for frame_id, data in frames],
        "receive": receive,
    }


def measure(rounds: int) -> list[Row]:
    """Median and p99 of one command, and how many times quicker than cantools or the published tracker."""
    calls = {f"policy, guard, encode: {count} lamps": next_command(count, 0.9) for count in NUM_LAMPS}
    calls |= {
        "policy, guard, encode: hidden vehicle": next_command(2, 0.1),
        WHOLE: next_stage(OUR_TRACKER, with_beam=True),
        "… tracking alone": next_stage(OUR_TRACKER, with_beam=False),
        PUBLISHED: next_stage(PUBLISHED_TRACKER, with_beam=False),
    }
    calls |= codecs()
    times = interleaved({name: Contender(call, calls=20) for name, call in calls.items()}, rounds)
    rows = []
    for name, its in times.items():
        reference = times[PUBLISHED] if name == WHOLE else times.get(f"{name}, cantools")
        row: Row = {"what": name, "speed_up": None if reference is None else its.speed_up_over(reference)}
        rows.append(row | its.figures())
    return rows


def beam_table(rows: Sequence[Row]) -> Table:
    shown = table("One beam command, one thread", ("",), ("median ms", "p99 ms", "times reference"))
    for row in rows:
        ratio = "" if row["speed_up"] is None else f"{row['speed_up']:.1f}"
        shown.add_row(row["what"], *in_ms(row, "median_ms", "p99_ms"), ratio)
    return shown


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, "beam", arguments)
    rows = measure(1 if given.quick else 60)
    CONSOLE.print(beam_table(rows))
    write_results(given.out, {"beam": rows})
    CONSOLE.print(f"look in {given.out}")


if __name__ == "__main__":
    main()
