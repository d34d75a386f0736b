"""How soon the live loop commands low beam after each fault, and how soon there is light again, on a replayed drive.

Faults of the image are counted in frames, from raw and from coded sources, without a clock: a busy machine gives the
same. The others, and the time until there is light again, are measured in real time.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import av
import numpy as np

from benchmarks.faulty import PERIOD_S, STAGES, WRONG_FRAMES, Lamps, ScriptedCamera, Step, live_config, spoil
from benchmarks.image_faults import CODINGS, FAULTS, NUM_GOOD, NUM_WRONG, Coding, as_coded, encoded
from benchmarks.soak import reduced
from benchmarks.timing import CONSOLE, RESULTS, Row, table, write_results
from foreglow.config import PipelineConfig
from foreglow.datasets import Video, open_source, shipped_drive
from foreglow.pipeline import Pipeline
from foreglow.runtime.live import LiveLoop
from foreglow.types import BeamMode, Frame, Image

BEGIN, END, NUM = 20, 30, 60
"""In these frames of the drive something is wrong."""

SMALL_PX = 320
"""Width of a small camera's images."""

EARLY = 4
"""A decoder of several threads knows of a lost packet so many frames before the one that shows it."""

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


def count(frames: Sequence[Frame]) -> list[Row]:
    """By fault of the image and source, in which wrong frame there is low beam for good, from 1; None if in none."""
    used = frames[: NUM_GOOD + NUM_WRONG]
    small = [reduced(frame, SMALL_PX) for frame in used]
    rows = []
    for name, coding in CODINGS.items():
        rows += [{"fault": fault, "source": name, "low_in": counted(_faulty(used, fault, coding))} for fault in FAULTS]
        low_in = counted(_faulty(small, "cut JPEG", coding))
        rows.append({"fault": f"cut JPEG, {SMALL_PX} px wide", "source": name, "low_in": low_in})
        if coding is not None and coding.codec == "libx264":
            rows.append({"fault": "a lost packet", "source": name, "low_in": counted(*_without_a_packet(used, coding))})
    return rows


def counted(frames: Sequence[Frame], first: int = NUM_GOOD) -> int | None:
    """In which frame from `first` on there is low beam for good, from 1, as the loop commands it."""
    configuration, lamps = live_config(), Lamps()
    camera = ScriptedCamera(frames)
    LiveLoop(camera, functools.partial(Pipeline, configuration), configuration, outputs=[lamps]).run()
    commands = lamps.of_frames()
    is_low = [frame.timestamp_ns in commands and commands[frame.timestamp_ns].mode == BeamMode.LOW for frame in frames]
    if any(is_low[1 : first - EARLY]):
        raise RuntimeError(f"low beam before anything is wrong: {is_low[:first]}")
    num_low = next((number for number, low in enumerate(reversed(is_low[first:])) if not low), len(frames) - first)
    return len(frames) - first - num_low + 1 if num_low else None


def _faulty(frames: Sequence[Frame], fault: str, coding: Coding | None) -> list[Frame]:
    images = [frame.image for frame in frames]
    wrong = FAULTS[fault](images[NUM_GOOD:], images[NUM_GOOD - 1])
    return _with_images(frames, as_coded([*images[:NUM_GOOD], *wrong], coding))


def _with_images(frames: Sequence[Frame], images: Sequence[Image], flags: Sequence[bool] = ()) -> list[Frame]:
    flags = flags or [False] * len(images)
    triples = zip(frames, images, flags, strict=True)
    return [dataclasses.replace(frame, image=image, is_damaged=flag) for frame, image, flag in triples]


def _without_a_packet(frames: Sequence[Frame], coding: Coding) -> tuple[list[Frame], int]:
    """The frames from a transport stream that lost a packet after `NUM_GOOD` frames, up to the key frame after that.

    Also which of them is the first that is wrong.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "stream.ts"
        stream = encoded([frame.image for frame in frames], coding, "mpegts")
        path.write_bytes(stream)
        clean = [frame.image for frame in Video(path)]
        container: Any = av.open(str(path))
        with container:
            packets = [packet for packet in container.demux(container.streams.video[0]) if packet.size]
        end = next(
            (number for number in range(NUM_GOOD + 1, len(packets)) if packets[number].is_keyframe), len(packets)
        )
        start = (packets[NUM_GOOD].pos + packets[NUM_GOOD].size // 2) // 188 * 188
        path.write_bytes(stream[:start] + stream[start + 188 :])
        lossy = list(Video(path, on_error="mark"))
    images, flags = [frame.image for frame in lossy], [frame.is_damaged for frame in lossy]
    first = next(k for k in range(end) if (lossy[k].image != clean[k]).any())
    return _with_images(frames[:end], images[:end], flags[:end]), first


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=RESULTS / "live_faults.json", help="the figures as JSON")
    parser.add_argument("--quick", action="store_true", help="each fault once: shows that it runs")
    parser.add_argument("--counted", action="store_true", help="only what is counted in frames, which needs no clock")
    given = parser.parse_args(arguments)
    counts = count(list(open_source(shipped_drive())))
    sources = list(CODINGS)
    shown = table("Wrong frame with which low beam begins", ("fault",), sources)
    for fault in dict.fromkeys(row["fault"] for row in counts):
        low_in = {row["source"]: row["low_in"] or "none" for row in counts if row["fault"] == fault}
        shown.add_row(fault, *(str(low_in.get(source, "")) for source in sources))
    CONSOLE.print(shown)
    rows = [] if given.counted else measure(1 if given.quick else 5)
    shown = table(
        "Low beam after a fault, 18 Hz", ("fault",), ("frames", "slowest", "ms", "light again, ms", "full, ms")
    )
    for row in rows:
        frames = [f"{row[key]:.2f}" for key in ("low_frames", "slowest_low_frames")]
        shown.add_row(row["fault"], *frames, *(f"{1e3 * row[key]:.0f}" for key in ("low_s", "light_s", "full_s")))
    CONSOLE.print(shown)
    write_results(given.out, {"counted": counts, "live_faults": rows})
    CONSOLE.print(f"look in {given.out}")


if __name__ == "__main__":
    main()
