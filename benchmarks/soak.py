"""The live loop over many frames, a drive again and again: memory, open files, threads, and the same results.

With `--faults-every N` something goes wrong every N frames for a while, each time another thing: how soon is low beam?
"""

from __future__ import annotations

import argparse
import dataclasses
import faulthandler
import functools
import hashlib
import json
import math
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2

from benchmarks.faulty import STAGES, WRONG_FRAMES, Lamps, live_config, spoil
from benchmarks.image_faults import FAULTS
from benchmarks.memory import resident_mib
from benchmarks.timing import CONSOLE, RESULTS, write_results
from foreglow.datasets import FrameSource, open_source, shipped_drive
from foreglow.geometry import Camera
from foreglow.pipeline import Pipeline
from foreglow.runs.frames_file import frame_to_line
from foreglow.runtime.health import Health
from foreglow.runtime.live import LiveFault, LiveLoop, Paced
from foreglow.types import BeamCommand, BeamMode, Frame, FrameResult, Image

NUM_FRAMES, NUM_QUICK = 200_000, 900
NUM_LOOKS = 100
"""How often memory, threads and files are looked at during a run, and the figures so far are written."""

SETTLED_SHARE = 0.1
"""Memory is compared from here on: run-times of so many frames are kept, and scratch memory finds its size."""

NUM_WRONG = 12
"""Frames in a row with something wrong."""

IMAGE_FAULTS = ("white", "half stuck", "rows repeated", "cut JPEG")
"""Those of `image_faults` that `WRONG_FRAMES` does not have."""

CAMERA_FAULTS = (*WRONG_FRAMES, *IMAGE_FAULTS)
MAX_FRAMES_TO_LOW = 2
"""Frames within which every fault has to be answered."""

MAX_GROWTH = 0.02
"""Share by which memory may grow in the second half of a run."""

PULSE_S, PAUSE_S, HANGING_S = 0.2, 5.0, 60.0
"""A thread that sleeps for so long; how late it is when the process was stopped; and how long no frame takes."""

NEVER_PROVOKED = (LiveFault.CAMERA_GONE, LiveFault.STAGE_HANGS, LiveFault.NO_PIPELINE)
"""Faults of the clock, which this run at any speed does not provoke."""

ALL_FAULTS = (*map(str, CAMERA_FAULTS), *(f"{stage} fails" for stage in STAGES))


class Again:
    """A drive in memory, as one sequence after another, with times that go on, and now and then something wrong.

    Attributes:
        wrong: By the time of a frame in which something is wrong, what it is, and the how many-th such frame in a row
            it is, from 0.
    """

    rate_hz: float | None = 18.0
    skipped: Sequence[str] = ()

    def __init__(
        self,
        drive: FrameSource,
        num_frames: int,
        faults_every: int | None = None,
        faults: Sequence[str] = ALL_FAULTS,
        first: int = 20,
        width_px: int | None = None,
    ) -> None:
        """Repeats `drive`; every `faults_every` frames the next of `faults` comes, from frame `first` or so of it."""
        self.name = drive.name
        self._frames = [frame if width_px is None else reduced(frame, width_px) for frame in drive]
        self.num_loops = math.ceil(num_frames / len(self._frames))
        self.num_frames: int | None = self.num_loops * len(self._frames)
        self._faults_every, self._faults, self._first = faults_every, faults, first
        self.wrong: dict[int, tuple[str, int]] = {}
        step_ns = self._frames[1].timestamp_ns - self._frames[0].timestamp_ns
        self.loop_ns = self._frames[-1].timestamp_ns - self._frames[0].timestamp_ns + step_ns

    def __len__(self) -> int:
        return len(self._frames)

    def __iter__(self) -> Iterator[Frame]:
        next_fault, num_faults = self._faults_every or math.inf, 0
        for loop in range(self.num_loops):
            begin = loop * len(self._frames)
            frames = [
                dataclasses.replace(
                    frame, sequence=f"loop {loop}", timestamp_ns=frame.timestamp_ns + loop * self.loop_ns
                )
                for frame in self._frames
            ]
            if begin >= next_fault and loop < self.num_loops - 1:
                next_fault += self._faults_every or 0
                fault = self._faults[num_faults % len(self._faults)]
                first = self._first + num_faults % (len(frames) - 2 * NUM_WRONG - self._first)
                frames[first : first + NUM_WRONG] = self._spoiled(
                    fault, frames[first : first + NUM_WRONG], frames[first - 1]
                )
                num_faults += 1
            yield from frames

    def _spoiled(self, fault: str, frames: Sequence[Frame], latest: Frame) -> list[Frame]:
        self.wrong |= {frame.timestamp_ns: (fault, number) for number, frame in enumerate(frames)}
        if fault in IMAGE_FAULTS:
            images = FAULTS[fault]([frame.image for frame in frames], latest.image)
            return [dataclasses.replace(frame, image=image) for frame, image in zip(frames, images, strict=True)]
        for known, wrong in WRONG_FRAMES.items():
            if fault == str(known):
                return wrong([latest, *frames])[1:]  # so that a frozen image is the latest one from the first on
        return list(frames)  # a stage fails

    def fail(self, now_ns: int, stage: str) -> None:
        """Raises if this is the stage that fails at this time."""
        if self.wrong.get(now_ns, ("", 0))[0] == f"{stage} fails":
            raise ArithmeticError("told to fail")


def reduced(frame: Frame, width_px: int) -> Frame:
    """The frame as a smaller imager behind the same lens would give it."""
    height_px = round(frame.image.shape[0] * width_px / frame.image.shape[1])
    image: Image = cv2.resize(frame.image, (width_px, height_px), interpolation=cv2.INTER_AREA)  # type: ignore[assignment]
    camera = None if frame.camera is None else _scaled(frame.camera, width_px, height_px)
    return dataclasses.replace(frame, image=image, camera=camera)


@functools.cache  # the same camera for all frames, as every reader has it: stages keep what they make of it
def _scaled(camera: Camera, width_px: int, height_px: int) -> Camera:
    return camera.scaled(width_px, height_px)


class Digests:
    """A live sink that keeps what came of the first and the last loop, and looks at the process now and then."""

    def __init__(self, source: Again, report: Callable[[list[dict[str, Any]]], None]) -> None:
        """A sink that gives `report` all that it has seen of the process so far, each time it has looked."""
        self._report = report
        self._starts_ns = {f"loop {loop}": loop * source.loop_ns for loop in (0, source.num_loops - 1)}
        self._ends = {sequence: hashlib.sha256() for sequence in self._starts_ns}
        self._every = max(1, source.num_loops // NUM_LOOKS) * len(source)
        self.count = 0
        self.rows: list[dict[str, Any]] = []

    def write(self, frame: Frame, result: FrameResult) -> None:
        digest = self._ends.get(frame.sequence)
        if digest is not None:
            start_ns = self._starts_ns[frame.sequence]
            of_first = dataclasses.replace(frame, sequence="", timestamp_ns=frame.timestamp_ns - start_ns)
            result = dataclasses.replace(result, timestamp_ns=result.timestamp_ns - start_ns)
            record = frame_to_line(of_first, result)
            digest.update(json.dumps(record).encode())
        self.count += 1
        if self.count % self._every == 0:
            self._look()

    def _look(self) -> None:
        files = len(list(Path("/proc/self/fd").iterdir()))
        threads = threading.active_count()
        row = {"frames": self.count, "resident_mib": resident_mib(), "open_files": files, "threads": threads}
        self.rows.append(row)
        self._report(self.rows)
        CONSOLE.print(" ".join(f"{name} {value:.0f}" for name, value in row.items()))

    def write_health(self, health: Health) -> None: ...

    def close(self) -> None:
        if not self.rows:  # ended soon
            self._look()

    def discard(self) -> None: ...

    @property
    def is_same(self) -> bool:
        """Whether the last loop gave what the first one gave."""
        return len({digest.hexdigest() for digest in self._ends.values()}) == 1


class Pulse:
    """Tells a process that was stopped from a thread that hangs: a thread of its own does nothing but sleep.

    If that thread, too, was late, the machine or whoever sent SIGSTOP is to blame, and not the loop. If it was in time
    and no frame was done for `HANGING_S`, the stacks of all threads are printed.

    Attributes:
        pauses: For how many seconds the process was stopped, each time, and after how many frames.
    """

    def __init__(self, sink: Digests) -> None:
        self.pauses: list[dict[str, float]] = []
        self._sink = sink
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Pulse:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self._thread.join()

    def _run(self) -> None:
        latest_s = moved_s = time.monotonic()
        count = 0
        while not self._is_over.wait(PULSE_S):
            before_s, latest_s = latest_s, time.monotonic()
            late_s = latest_s - before_s - PULSE_S
            if late_s > PAUSE_S:
                self.pauses.append({"frames": self._sink.count, "seconds": late_s})
            if count != self._sink.count or late_s > PAUSE_S:
                count, moved_s = self._sink.count, latest_s
            elif latest_s - moved_s > HANGING_S:
                moved_s = latest_s
                faulthandler.dump_traceback(all_threads=True)


class Checking(Lamps):
    """Lamps that keep only the latest command, and in the how many-th wrong frame of a row low beam came for good.

    Attributes:
        first_low: By fault, for how many rows low beam came in this frame; None if it never came, or light came back.
    """

    def __init__(self, source: Again) -> None:
        super().__init__()
        self._source = source
        self._low_since: int | None = None
        self.first_low: defaultdict[str, Counter[int | None]] = defaultdict(Counter)

    @property
    def counts(self) -> dict[str, dict[str, int]]:
        """`first_low` as JSON has it."""
        return {
            fault: {str(key): num for key, num in dict(counts).items()}
            for fault, counts in dict(self.first_low).items()
        }

    def send(self, command: BeamCommand) -> None:
        self.commands, self.times_s = [], []
        super().send(command)
        fault, number = self._source.wrong.get(command.timestamp_ns, (None, 0))
        if fault is None:
            return
        if number == 0:
            self._low_since = None
        if command.mode != BeamMode.LOW:
            self._low_since = None
        elif self._low_since is None:
            self._low_since = number
        if number == NUM_WRONG - 1:
            self.first_low[fault][self._low_since] += 1


def measure(
    num_frames: int,
    faults_every: int | None = None,
    report: Callable[[dict[str, Any]], None] = lambda _: None,
    **faults: Any,
) -> dict[str, Any]:
    """What happened to the process, whether the last loop's results are the first one's, and what came of faults.

    Now and then `report` gets the figures so far.
    """
    source = Again(open_source(shipped_drive()), num_frames, faults_every, **faults)
    configuration = live_config()
    lamps = Checking(source)
    sink = Digests(source, lambda rows: report({"samples": rows, "first_low": lamps.counts}))

    def pipeline() -> Pipeline:
        made = Pipeline(configuration)
        for stage in STAGES if faults_every else ():
            spoil(made, stage, functools.partial(source.fail, stage=stage))
        return made

    loop = LiveLoop(Paced(source, math.inf), pipeline, configuration, outputs=[lamps], sinks=[sink])
    with Pulse(sink) as pulse:
        summary = loop.run()
    settled = [row for row in sink.rows if row["frames"] >= SETTLED_SHARE * num_frames] or sink.rows
    sizes = [row["resident_mib"] for row in settled]
    later = sizes[len(sizes) // 2 :]
    figures = {
        "num_frames": summary.run.num_frames,
        "is_complete": summary.run.is_complete,
        "is_same": sink.is_same,
        "faults": dict(summary.fault_counts),
        "not_provoked": [
            f"{event.fault} at {event.from_ns / 1e9:.2f} s: {event.detail or 'no reason given'}"
            for event in summary.faults
            if event.fault in NEVER_PROVOKED
        ],
        "pauses": pulse.pauses,
        "first_low": lamps.counts,
        "resident_mib": [sizes[0], min(sizes), max(sizes), sizes[-1]],
        "largest_change": max(abs(size - sizes[0]) for size in sizes) / sizes[0],
        "late_growth": later[-1] / later[0] - 1.0,
        "open_files": sorted({row["open_files"] for row in settled}),
        "threads": sorted({row["threads"] for row in settled}),
        "samples": sink.rows,
    }
    return figures | {"wrong": wrong(figures)}


def wrong(figures: dict[str, Any]) -> list[str]:
    """What should not be; a silence or a stage that hangs only while the process was stopped is none of the loop's."""
    found = []
    if not figures["is_complete"]:
        found.append(f"ended after {figures['num_frames']} frames")
    elif not figures["is_same"]:
        found.append("the last loop's results differ from the first one's")
    for fault, counts in figures["first_low"].items():
        late = {key: num for key, num in counts.items() if key == "None" or int(key) >= MAX_FRAMES_TO_LOW}
        found += [f"{fault}: low beam in the n-th wrong frame, from 0: {late}"] if late else []
    found += [] if figures["pauses"] else figures["not_provoked"]
    for key in ("open_files", "threads"):  # there may be fewer at the end
        numbers = [row[key] for row in figures["samples"]]
        found += [f"{key} grew: {numbers}"] if max(numbers) > numbers[0] else []
    if figures["late_growth"] > MAX_GROWTH:
        found.append(f"memory grew by {figures['late_growth']:.1%} in the second half")
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--out", type=Path, default=RESULTS / "soak.json", help="the figures as JSON, also those so far"
    )
    parser.add_argument("--frames", type=int, default=NUM_FRAMES, help="at least so many frames, in whole drives")
    parser.add_argument("--faults-every", type=int, help="something goes wrong every so many frames")
    parser.add_argument("--width", type=int, help="reduce the images to so many columns: quicker")
    parser.add_argument("--quick", action="store_true", help="few frames: shows that it runs")
    given = parser.parse_args(arguments)
    figures = measure(
        NUM_QUICK if given.quick else given.frames,
        given.faults_every,
        lambda so_far: write_results(given.out, {"soak_so_far": so_far}),
        width_px=given.width,
    )
    first, least, most, last = figures["resident_mib"]
    CONSOLE.print(
        f"{figures['num_frames']} frames; resident memory {first:.1f} MiB after a tenth, then {least:.1f} to "
        f"{most:.1f}, {last:.1f} at the end ({figures['largest_change']:.2%}); open files {figures['open_files']}, "
        f"threads {figures['threads']}; faults {figures['faults']}; the process was stopped {len(figures['pauses'])} "
        f"times; as it should not be: {'; '.join(figures['wrong']) or 'nothing'}"
    )
    if figures["first_low"]:
        CONSOLE.print("low beam for good in the n-th wrong frame (from 0), by fault: how often")
        for fault, counts in figures["first_low"].items():
            CONSOLE.print(f"  {fault}: {counts}")
    write_results(given.out, {"soak": figures})
    CONSOLE.print(f"look in {given.out}")
    return 1 if figures["wrong"] else 0


if __name__ == "__main__":
    raise SystemExit(main())
