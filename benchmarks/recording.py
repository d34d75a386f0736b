"""Run-time and size of recordings: `python -m benchmarks.recording [--out FILE.json] [--quick]`.

One thread, frames of 1280x960 px with the results of the preset `foreglow`. Recording a frame is compared with encoding
its image as PNG, quickest level, and reading one back with decoding that: of these two, the mean of 12 frames counts.
"""

from __future__ import annotations

import dataclasses
import itertools
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
from rich.table import Table

from benchmarks.synthetic_frames import night_frame
from benchmarks.timing import CONSOLE, Contender, Row, RunTimes, in_ms, interleaved, options, table, write_results
from foreglow.datasets import Recording
from foreglow.pipeline import Pipeline
from foreglow.runtime.mcap import McapRecorder
from foreglow.types import Frame, FrameResult

RATE_HZ = 18
NUM_IMAGES, NUM_QUICK = 12, 3
LEVEL = (cv2.IMWRITE_PNG_COMPRESSION, 1)


def results_of(count: int) -> list[tuple[Frame, FrameResult]]:
    """Frames of an oncoming car, and what the pipeline makes of them."""
    pipeline = Pipeline()
    frames = [Frame(night_frame(index, 90.0 - 2.0 * index), index * 10**9 // RATE_HZ) for index in range(count)]
    return [(frame, pipeline.step(frame)) for frame in frames]


def next_write(recorder: McapRecorder, results: Sequence[tuple[Frame, FrameResult]]) -> Callable[[], object]:
    """A call that records the next frame at the next time, and begins anew after the last one."""
    coming, numbers = itertools.cycle(results), itertools.count()

    def write() -> None:
        frame, result = next(coming)
        time_ns = next(numbers) * 10**9 // RATE_HZ
        recorder.write(dataclasses.replace(frame, timestamp_ns=time_ns), result)

    return write


def record_all(path: Path, results: Sequence[tuple[Frame, FrameResult]]) -> None:
    recorder = McapRecorder(path)
    for frame, result in results:
        recorder.write(frame, result)
    recorder.close()


def measure(rounds: int, num_images: int, folder: Path) -> list[Row]:
    """Median and p99 of one frame, megabytes a minute, and how many times quicker than PNG."""
    results = results_of(num_images)
    images = itertools.cycle([frame.image for frame, _ in results])
    encoded = [cv2.imencode(".png", frame.image, LEVEL)[1] for frame, _ in results]
    record_all(folder / "small.mcap", results)
    sizes = {"record": (folder / "small.mcap").stat().st_size, "encode PNG": sum(map(len, encoded))}
    source, recorder = Recording(folder / "small.mcap"), McapRecorder(folder / "timed.mcap")
    calls = {
        "record": next_write(recorder, results),
        "encode PNG": lambda: cv2.imencode(".png", next(images), LEVEL),
        "read": lambda: list(source),
        "decode PNG": lambda: [cv2.imdecode(data, cv2.IMREAD_UNCHANGED) for data in encoded],
    }
    num_calls = {"record": num_images, "encode PNG": num_images, "read": 1, "decode PNG": 1}
    contenders = {name: Contender(call, calls=num_calls[name]) for name, call in calls.items()}
    times = interleaved(contenders, rounds)
    for name in ("read", "decode PNG"):
        times[name] = RunTimes(times[name].samples_ms / num_images)
    recorder.discard()
    opponents = {"record": "encode PNG", "read": "decode PNG"}
    return [
        {
            "what": name,
            "speed_up": its.speed_up_over(times[opponents[name]]) if name in opponents else None,
            "megabytes_a_minute": sizes[name] / num_images * RATE_HZ * 60 / 1e6 if name in sizes else None,
            **its.figures(),
        }
        for name, its in times.items()
    ]


def recording_table(rows: Sequence[Row]) -> Table:
    shown = table(
        "A frame of 1280x960 px, one thread", ("",), ("median ms", "p99 ms", "times PNG", "MB a minute, 18 Hz")
    )
    for row in rows:
        ratio = "" if row["speed_up"] is None else f"{row['speed_up']:.1f}"
        size = "" if row["megabytes_a_minute"] is None else f"{row['megabytes_a_minute']:.0f}"
        shown.add_row(row["what"], *in_ms(row, "median_ms", "p99_ms"), ratio, size)
    return shown


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, "recording", arguments)
    with tempfile.TemporaryDirectory() as folder:
        rows = measure(*((1, NUM_QUICK) if given.quick else (20, NUM_IMAGES)), Path(folder))
    CONSOLE.print(recording_table(rows))
    write_results(given.out, {"recording": rows})
    CONSOLE.print(f"look in {given.out}")


if __name__ == "__main__":
    main()
