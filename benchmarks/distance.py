"""Run-time of the range estimators with 20 boxes a frame: `python -m benchmarks.distance [--out FILE.json] [--quick]`.

One thread. Frames and road are those of the drive that ships, boxes the detector's and, up to 20, some that stay where
they are. The road-surface estimator is compared with its own specification in NumPy.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from rich.table import Table

from benchmarks.timing import CONSOLE, Contender, Row, in_ms, interleaved, options, table, write_results
from foreglow.config import OUR_TRACKER, DistanceConfig, preset
from foreglow.datasets import PVDN, shipped_drive
from foreglow.distance import RoadSurface, make_estimator
from foreglow.distance.hypotheses import cells_along, parameters_of
from foreglow.distance.weighing import weighed_ranges
from foreglow.pipeline import Pipeline
from foreglow.tracking import make_tracker
from foreglow.types import Detections, Frame, Proposals

NUM_BOXES = 20
NUM_FRAMES = 60
ESTIMATORS = ("gp", "psd_3d", "road_surface")
SPECIFICATION = "road_surface in NumPy"
WITH_TRACKER = "road_surface + our tracker"

Boxed: TypeAlias = tuple[Frame, Detections]


def boxed_frames(num_frames: int) -> list[Boxed]:
    """The latest frames of the drive, each with `NUM_BOXES` boxes."""
    drive = PVDN(shipped_drive())
    pipeline = Pipeline(preset("foreglow").detector_only)
    random = np.random.default_rng(0)
    corners = random.integers((100, 300), (1100, 700), (NUM_BOXES, 2))
    staying = np.concatenate([corners, corners + random.integers(8, 30, corners.shape)], axis=1).astype(np.int32)
    staying_scores = random.uniform(0.0, 0.5, NUM_BOXES).astype(np.float32)
    boxed = []
    for number in drive.frame_ids[-num_frames:]:
        frame = drive.read(number)
        found = pipeline.step(frame).detections
        assert found is not None, "the preset has a model"
        boxes = np.concatenate([found.boxes_xyxy_px, staying])[:NUM_BOXES]
        scores = np.concatenate([found.scores, staying_scores])[:NUM_BOXES]
        order = np.lexsort((boxes[:, 3], boxes[:, 2], boxes[:, 0], boxes[:, 1]))
        boxed.append((frame, Detections(Proposals(boxes[order]), scores[order], found.score_threshold)))
    return boxed


def estimating(name: str) -> Callable[[Boxed], object]:
    """Ranges by the estimator `name`."""
    estimator = make_estimator(DistanceConfig.model_validate({"estimator": name}))
    return lambda boxed: estimator.estimate(*boxed)


def as_specified() -> Callable[[Boxed], object]:
    """Ranges by the road-surface estimator, all hypotheses laid out and weighed in NumPy."""
    estimator = RoadSurface(DistanceConfig())
    parameters = parameters_of(estimator.model)

    def ranges(boxed: Boxed) -> object:
        view = estimator.view(*boxed)
        cells = cells_along(parameters, view.road, view.camera_m, view.pitch_sigma_rad)
        return weighed_ranges(parameters, cells, view.boxes)

    return ranges


def estimating_and_tracking() -> Callable[[Boxed], object]:
    """Ranges by the road-surface estimator, and the tracks that they go to."""
    estimator, tracker = RoadSurface(DistanceConfig()), make_tracker(OUR_TRACKER)
    return lambda boxed: tracker.update(*boxed, estimator.estimate(*boxed))


def on_next(call: Callable[[Boxed], object], boxed: Sequence[Boxed]) -> Callable[[], object]:
    """`call` on one frame after another, and anew after the last one."""
    coming = itertools.cycle(boxed)
    return lambda: call(next(coming))


def measure(rounds: int) -> list[Row]:
    """Median and p99 of one frame, and how many times quicker than the specification."""
    boxed = boxed_frames(NUM_FRAMES)
    calls = {name: estimating(name) for name in ESTIMATORS}
    calls |= {WITH_TRACKER: estimating_and_tracking(), SPECIFICATION: as_specified()}
    times = interleaved({name: Contender(on_next(call, boxed), calls=20) for name, call in calls.items()}, rounds)
    return [
        {"estimator": name, "speed_up": its.speed_up_over(times[SPECIFICATION])} | its.figures()
        for name, its in times.items()
    ]


def distance_table(rows: Sequence[Row]) -> Table:
    shown = table(f"Estimators, one thread, {NUM_BOXES} boxes", ("estimator",), ("median ms", "p99 ms", "times NumPy"))
    for row in rows:
        shown.add_row(row["estimator"], *in_ms(row, "median_ms", "p99_ms"), f"{row['speed_up']:.2f}")
    return shown


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, "distance", arguments)
    rows = measure(1 if given.quick else 60)
    CONSOLE.print(distance_table(rows))
    write_results(given.out, {"distance": rows})


if __name__ == "__main__":
    main()
