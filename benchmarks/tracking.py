"""Run-time of the trackers with 20 boxes a frame: `python -m benchmarks.tracking [--out FILE.json] [--quick]`.

One thread. The published code's tracker, objects in a list, is what the others are compared with.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np
from rich.table import Table

from benchmarks.timing import CONSOLE, Contender, Row, in_ms, interleaved, options, table, write_results
from foreglow.config import OUR_TRACKER, PUBLISHED_TRACKER, TrackerConfig
from foreglow.geometry import Camera, Pose
from foreglow.tracking import make_tracker
from foreglow.types import Detections, EgoMotion, Frame, Proposals, Ranges

NUM_BOXES = 20
NUM_FRAMES = 2000
RATE_HZ = 18.0
TRACKERS = {
    "published": PUBLISHED_TRACKER,
    "paper": TrackerConfig(),
    "ours": OUR_TRACKER,
    "ours, ranges gated and averaged": OUR_TRACKER.model_copy(update={"range_gate": 3.0, "range_filter": "median"}),
    "ours, tracks alone": OUR_TRACKER.model_copy(update={"vehicle_gate": 0.0, "range_evidence": 0.0}),
}


def wandering(num_frames: int) -> list[tuple[Frame, Detections, Ranges]]:
    """Lights that go round in circles, each seen in nine frames of ten, all with ranges."""
    random = np.random.default_rng(0)
    camera = Camera(1280, 960, (1400.0, 1400.0), (640.0, 480.0), (0.0,) * 5, Pose(np.array([1, 0, 1.2]), np.eye(3)))
    image = np.broadcast_to(np.uint8(0), (960, 1280))
    columns, rows = np.meshgrid(np.linspace(100, 1150, 5), np.linspace(120, 800, 4))
    centres = np.stack([columns.ravel(), rows.ravel()], -1)
    frames = []
    for number in range(num_frames):
        angle = number / RATE_HZ
        low = np.rint(centres + 60 * np.array([np.cos(angle), np.sin(angle)]) + random.normal(0, 1, centres.shape))
        boxes = np.concatenate([low, low + 24], axis=1).astype(np.int32)[random.random(NUM_BOXES) < 0.9]
        scores = random.uniform(0.15, 0.95, len(boxes)).astype(np.float32)
        detections = Detections(Proposals(boxes), scores, 0.5)
        ranges = Ranges(detections, random.uniform(70, 80, len(boxes)), np.full(len(boxes), 8.0))
        frame = Frame(image, round(angle * 1e9), camera=camera, motion=EgoMotion(20.0, 0.02))
        frames.append((frame, detections, ranges))
    return frames


def next_update(config: TrackerConfig, frames: Sequence[tuple[Frame, Detections, Ranges]]) -> Callable[[], object]:
    """A call that takes the next frame, and begins anew after the last one."""
    tracker, coming = make_tracker(config), itertools.cycle(frames)
    return lambda: tracker.update(*next(coming))


def measure(rounds: int) -> list[Row]:
    """Median and p99 of one frame, and how many times quicker than the published code's tracker."""
    frames = wandering(NUM_FRAMES)
    contenders = {name: Contender(next_update(config, frames), calls=50) for name, config in TRACKERS.items()}
    times = interleaved(contenders, rounds)
    return [
        {"tracker": name, "speed_up": its.speed_up_over(times["published"])} | its.figures()
        for name, its in times.items()
    ]


def tracking_table(rows: Sequence[Row]) -> Table:
    shown = table(f"Trackers, one thread, {NUM_BOXES} lights", ("tracker",), ("median ms", "p99 ms", "times published"))
    for row in rows:
        shown.add_row(row["tracker"], *in_ms(row, "median_ms", "p99_ms"), f"{row['speed_up']:.2f}")
    return shown


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, "tracking", arguments)
    rows = measure(1 if given.quick else 60)
    CONSOLE.print(tracking_table(rows))
    write_results(given.out, {"tracking": rows})
    CONSOLE.print(f"look in {given.out}")


if __name__ == "__main__":
    main()
