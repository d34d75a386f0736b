"""How soon the live loop commands low beam after each fault, and how soon there is light again, on a replayed drive."""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from benchmarks.faulty import PERIOD_S, STAGES, WRONG_FRAMES, Lamps, ScriptedCamera, Step, live_config, spoil
from benchmarks.timing import CONSOLE, Row, options, table, write_results
from foreglow.config import PipelineConfig
from foreglow.datasets import open_source, shipped_drive
from foreglow.pipeline import Pipeline
from foreglow.runtime.live import LiveLoop
from foreglow.types import BeamMode, Frame

BEGIN, END, NUM = 20, 30, 60
"""In these frames of the drive something is wrong."""

SHOCK_S = 1.0
"""A silent camera, or a stage that hangs."""


class Marked(ScriptedCamera):
    """A camera that keeps when each frame arrived."""

    def __init__(self, script: Sequence[Step]) -> None:
        super().__init__(script, is_live=True)
        self.times_s: list[float] = []

    def __iter__(self) -> Iterator[Frame]:
        for frame in super().__iter__():
            self.times_s.append(time.monotonic())
            yield frame


def reaction(camera: Marked, lamps: Lamps, begin: int, end: int) -> tuple[float, float, float]:
    """From the first wrong frame to low beam, from the first right one to any light, and to full levels; seconds."""
    begin_s, end_s = camera.times_s[begin], camera.times_s[end]
    pairs = list(zip(lamps.times_s, lamps.commands, strict=True))[:-1]
    low_s = next(time_s for time_s, command in pairs if time_s >= begin_s and command.mode == BeamMode.LOW)
    light_s = next(time_s for time_s, command in pairs if time_s > end_s and command.mode != BeamMode.LOW)
    bright = np.max([command.levels.max() for _, command in pairs])
    full_s = next(time_s for time_s, command in pairs if time_s > end_s and command.levels.max() >= bright - 1e-9)
    return low_s - begin_s, light_s - end_s, full_s - end_s


def one_run(script: Sequence[Step], begin: int, end: int, what: Callable[[Pipeline], None] | None = None) -> Any:
    configuration: PipelineConfig = live_config(abandon_s=10.0)
    camera, lamps = Marked(script), Lamps()

    def make() -> Pipeline:
        pipeline = Pipeline(configuration)
        if what is not None:
            what(pipeline)
        return pipeline

    LiveLoop(camera, make, configuration, outputs=[lamps]).run()
    return reaction(camera, lamps, begin, end)


def scenarios(frames: list[Frame]) -> dict[str, Callable[[], Any]]:
    """By fault, a run with it."""
    wrong_ns = {frame.timestamp_ns for frame in frames[BEGIN:END]}

    def failing(stage: str) -> Callable[[Pipeline], None]:
        return lambda pipeline: spoil(pipeline, stage, lambda now_ns: 1 // (now_ns not in wrong_ns))

    def hanging(pipeline: Pipeline) -> None:
        first_ns = frames[BEGIN].timestamp_ns
        spoil(pipeline, "classifier", lambda now_ns: threading.Event().wait(SHOCK_S) if now_ns == first_ns else None)

    runs: dict[str, Callable[[], Any]] = {}
    for fault, wrong in WRONG_FRAMES.items():
        first = BEGIN + (fault == "camera_frozen")  # the first of them is still right
        script = [*frames[:BEGIN], *wrong(frames[BEGIN:END]), *frames[END:NUM]]
        runs[str(fault)] = functools.partial(one_run, script, first, END)
    old = [*frames[:BEGIN], *frames[BEGIN - 10 : BEGIN], *frames[END:NUM]]
    runs["frame_out_of_order"] = lambda: one_run(old, BEGIN, END)
    slow = [*frames[:BEGIN], *frames[BEGIN + 1 : END + 10 : 2], *frames[END + 10 : NUM + 10]]
    runs["camera_slow"] = lambda: one_run(paced(slow), BEGIN, BEGIN + 10)
    gone: list[Step] = [*frames[:BEGIN], SHOCK_S, *frames[END:NUM]]
    runs["camera_gone"] = lambda: since_due(gone)
    for stage in STAGES:
        runs[f"stage_failed ({stage})"] = functools.partial(one_run, frames[:NUM], BEGIN, END, failing(stage))
    runs["stage_hangs"] = lambda: one_run(frames, BEGIN, BEGIN + 1, hanging)
    return runs


def paced(frames: Sequence[Frame]) -> list[Step]:
    """The frames with waits between them where their times are further apart than a frame's time."""
    script: list[Step] = []
    for before, frame in zip([frames[0], *frames], frames, strict=False):
        extra_s = (frame.timestamp_ns - before.timestamp_ns) / 1e9 - PERIOD_S
        script += [extra_s, frame] if extra_s > PERIOD_S / 10 else [frame]
    return script


def since_due(script: Sequence[Step]) -> tuple[float, float, float]:
    """Of a silent camera: from when the first frame that does not come should have."""
    low_s, light_s, full_s = one_run(script, BEGIN - 1, BEGIN)
    return low_s - PERIOD_S, light_s, full_s


def measure(rounds: int) -> list[Row]:
    """Medians, and the slowest low beam, of each fault."""
    frames = list(open_source(shipped_drive()))
    rows = []
    for fault, run in scenarios(frames).items():
        times_s = np.array([run() for _ in range(rounds)])
        low_s, light_s, full_s = np.median(times_s, axis=0).tolist()
        rows.append(
            {
                "fault": fault,
                "low_frames": low_s / PERIOD_S,
                "slowest_low_frames": float(times_s[:, 0].max()) / PERIOD_S,
                "low_s": low_s,
                "light_s": light_s,
                "full_s": full_s,
            }
        )
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, "live_faults", arguments)
    rows = measure(1 if given.quick else 5)
    shown = table(
        "Low beam after a fault, 18 Hz", ("fault",), ("frames", "slowest", "ms", "light again, ms", "full, ms")
    )
    for row in rows:
        frames = [f"{row[key]:.2f}" for key in ("low_frames", "slowest_low_frames")]
        shown.add_row(row["fault"], *frames, *(f"{1e3 * row[key]:.0f}" for key in ("low_s", "light_s", "full_s")))
    CONSOLE.print(shown)
    write_results(given.out, {"live_faults": rows})
    CONSOLE.print(f"look in {given.out}")


if __name__ == "__main__":
    main()
