"""Run-time of the guard and of the messages: `python -m benchmarks.beam [--out FILE.json] [--quick]`.

One thread. Messages are compared with cantools by the same DBC; the guard is given full beam and the lamps of vehicles.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.timing import CONSOLE, Contender, Row, in_ms, interleaved, options, table, write_results
from foreglow.beam.guard import Guard
from foreglow.beam.messages import GAPS_ID, LEVELS_IDS, OWN_DBC, CommandEncoder, decode_gaps, decode_levels
from foreglow.beam.receiver import LampReceiver
from foreglow.config import GuardConfig
from foreglow.datasets.vehicle_logs.can_log import read_dbc
from foreglow.geometry import Camera, Pose
from foreglow.photometry import read_headlamps
from foreglow.types import BeamCommand, BeamMode, EgoMotion, Frame, Tracks, TrackState

FRAME_NS = 55_555_556
NUM_FRAMES = 400
NUM_LAMPS = (0, 2, 4, 8)
MOUNT = Pose(np.array([1.8, 0.0, 1.35]), np.eye(3))
CAMERA = Camera(1280, 960, (1350.0, 1350.0), (640.0, 490.0), (-0.07, 0.015, 1e-4, -2e-5, 0.0), MOUNT)


def drive(num_lamps: int) -> list[tuple[BeamCommand, Tracks, Frame]]:
    """Full beam, and so many lamps that come nearer, two a vehicle."""
    random = np.random.default_rng(0)
    images = [random.integers(5, 60, (960, 1280), np.uint8) for _ in range(3)]
    drawn = []
    for number in range(NUM_FRAMES):
        ranges_m = 250.0 - 0.4 * number + 10.0 * np.arange(num_lamps, dtype=np.float64)
        lefts = 640.0 - 1350.0 * (3.0 + 1.3 * (np.arange(num_lamps) % 2)) / ranges_m - 60 * (np.arange(num_lamps) // 2)
        half_px = 1350.0 * 0.4 / ranges_m
        boxes = np.stack([lefts - half_px, 500 - half_px, lefts + half_px, 500 + half_px], -1)
        frame = Frame(images[number % 3], number * FRAME_NS, camera=CAMERA, motion=EgoMotion(20.0, 0.0))
        tracks = Tracks(
            ids=np.arange(num_lamps),
            states=np.full(num_lamps, TrackState.CONFIRMED, np.int64),
            boxes_xyxy_px=boxes,
            confidences=np.full(num_lamps, 0.9),
            num_hits=np.full(num_lamps, 9),
            num_misses=np.zeros(num_lamps, np.int64),
            ages_s=np.full(num_lamps, 1.0 + number / 18),
            ranges_m=ranges_m,
            sigmas_m=ranges_m / 10,
            detections=np.arange(num_lamps),
        )
        drawn.append((BeamCommand(frame.timestamp_ns, BeamMode.FULL, np.ones((2, 84))), tracks, frame))
    return drawn


def next_check(num_lamps: int) -> Callable[[], object]:
    """A call that checks and encodes the next command, and begins anew after the last one."""
    guard, encoder = Guard(GuardConfig(), read_headlamps()), CommandEncoder(1.0)
    coming = itertools.cycle(drive(num_lamps))

    def step() -> object:
        wanted, tracks, frame = next(coming)
        if frame.timestamp_ns == 0:
            guard.reset()
        return encoder.frames(guard.check(wanted, tracks, frame))

    return step


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
    """Median and p99 of one command, and how many times quicker than cantools."""
    calls = {f"guard and encode, {count} lamps": next_check(count) for count in NUM_LAMPS} | codecs()
    times = interleaved({name: Contender(call, calls=20) for name, call in calls.items()}, rounds)
    rows = []
    for name, its in times.items():
        reference = times.get(f"{name}, cantools")
        row: Row = {"what": name, "speed_up": None if reference is None else its.speed_up_over(reference)}
        rows.append(row | its.figures())
    return rows


def beam_table(rows: Sequence[Row]) -> Table:
    shown = table("One beam command, one thread", ("",), ("median ms", "p99 ms", "times cantools"))
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
