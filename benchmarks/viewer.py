"""What it costs to keep a run for the viewer: `python -m benchmarks.viewer`. Needs `foreglow[view]`.

Both are timed on the frames of the drive that ships, in turn: the pipeline's step with the beam, and the sink that
records its results, images as JPEG and without loss.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from rich.table import Table

from benchmarks.timing import CONSOLE, Row, RunTimes, in_ms, options, table, write_results
from foreglow.config import preset
from foreglow.datasets import PVDN, shipped_drive
from foreglow.display.viewer import RerunSink, RrdFile
from foreglow.display.viewer.blueprint import blueprint
from foreglow.display.viewer.sink import JPEG_QUALITY
from foreglow.pipeline import Pipeline
from foreglow.types import Frame

QUALITIES = {f"recorded, JPEG {JPEG_QUALITY}": JPEG_QUALITY, "recorded, without loss": None}

STEP = "pipeline's step"

Value = TypeVar("Value")


def measure(frames: Sequence[Frame], rate_hz: float, rounds: int) -> list[Row]:
    """A row for the step, and one for each way to record."""
    config = preset("foreglow")
    config = config.model_copy(update={"beam": config.beam.model_copy(update={"policy": "foreglow"})})
    pipeline = Pipeline(config)
    samples: dict[str, list[list[float]]] = {name: [] for name in (STEP, *QUALITIES)}
    megabytes: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(rounds + 1):
            pipeline.reset()
            results, step_ms = zip(*(_timed(partial(pipeline.step, frame)) for frame in frames), strict=True)
            samples[STEP].append(list(step_ms))
            for name, quality in QUALITIES.items():
                path = Path(folder) / "run.rrd"
                sink = RerunSink([RrdFile(path, blueprint(has_lux=False))], jpeg_quality=quality)
                pairs = list(zip(frames, results, strict=True))
                samples[name].append([_timed(partial(sink.write, *pair))[1] for pair in pairs])
                sink.close()
                megabytes[name] = path.stat().st_size / 1e6
    times = {name: RunTimes(np.array(its[1:])) for name, its in samples.items()}  # the first round warms up
    return [
        {
            "what": name,
            "times_step": 1.0 / its.speed_up_over(times[STEP]),
            "megabytes_a_minute": megabytes[name] * 60.0 * rate_hz / len(frames) if name in megabytes else 0.0,
            **its.figures(),
        }
        for name, its in times.items()
    ]


def _timed(call: Callable[[], Value]) -> tuple[Value, float]:
    """What a call returns, and how long it took, milliseconds."""
    started = time.perf_counter_ns()
    value = call()
    return value, (time.perf_counter_ns() - started) / 1e6


def viewer_table(rows: Sequence[Row]) -> Table:
    columns = ("median ms", "p99 ms", "times the step", "MB a minute")
    shown = table("One frame of 1280x960, one thread", ("",), columns)
    for row in rows:
        figures = in_ms(row, "median_ms", "p99_ms")
        shown.add_row(row["what"], *figures, f"{row['times_step']:.1f}", f"{row['megabytes_a_minute']:.0f}")
    return shown


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, "viewer", arguments)
    drive = PVDN(shipped_drive())
    frames = list(drive)[:8] if given.quick else list(drive)
    rows = measure(frames, drive.rate_hz, 1 if given.quick else 5)
    CONSOLE.print(viewer_table(rows))
    write_results(given.out, {"viewer": rows})
    CONSOLE.print(f"look in {given.out}")


if __name__ == "__main__":
    main()
