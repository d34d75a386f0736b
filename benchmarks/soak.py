"""The live loop over many frames, a drive again and again: memory, open files, threads, and the same results."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from benchmarks.faulty import Lamps, live_config
from benchmarks.memory import resident_mib
from benchmarks.timing import CONSOLE, options, write_results
from foreglow.datasets import open_source, shipped_drive
from foreglow.pipeline import Pipeline
from foreglow.runs.frames_file import frame_to_line
from foreglow.runtime.health import Health
from foreglow.runtime.live import LiveLoop, Paced
from foreglow.types import BeamCommand, Frame, FrameResult

NUM_FRAMES, NUM_QUICK = 200_000, 900
SETTLED_SHARE = 0.1
"""Memory is compared from here on: run-times of so many frames are kept, and scratch memory finds its size."""


class Again:
    """A drive in memory, as one sequence after another."""

    rate_hz: float | None = 18.0
    skipped: Sequence[str] = ()

    def __init__(self, name: str, frames: Sequence[Frame], num_loops: int) -> None:
        self.name = name
        self._frames = frames
        self._num_loops = num_loops
        self.num_frames: int | None = num_loops * len(frames)

    def __iter__(self) -> Iterator[Frame]:
        for loop in range(self._num_loops):
            for frame in self._frames:
                yield dataclasses.replace(frame, sequence=f"loop {loop}")


class Digests:
    """A live sink that keeps what came of the first and the last loop, and looks at the process now and then."""

    def __init__(self, num_loops: int, num_frames_a_loop: int) -> None:
        self._ends = {"loop 0": hashlib.sha256(), f"loop {num_loops - 1}": hashlib.sha256()}
        self._every = max(1, num_loops // 40) * num_frames_a_loop
        self._count = 0
        self.rows: list[dict[str, Any]] = []

    def write(self, frame: Frame, result: FrameResult) -> None:
        digest = self._ends.get(frame.sequence)
        if digest is not None:
            record = frame_to_line(dataclasses.replace(frame, sequence=""), result)
            digest.update(json.dumps(record).encode())
        self._count += 1
        if self._count % self._every == 0:
            files = len(list(Path("/proc/self/fd").iterdir()))
            threads = threading.active_count()
            self.rows.append(
                {"frames": self._count, "resident_mib": resident_mib(), "open_files": files, "threads": threads}
            )

    def write_health(self, health: Health) -> None: ...

    def close(self) -> None: ...

    def discard(self) -> None: ...

    @property
    def is_same(self) -> bool:
        return len({digest.hexdigest() for digest in self._ends.values()}) == 1


class Forgetful(Lamps):
    """Lamps that keep only the latest command."""

    def send(self, command: BeamCommand) -> None:
        self.commands, self.times_s = [], []
        super().send(command)


def measure(num_frames: int) -> dict[str, Any]:
    """What happened to the process, and whether the last loop's results are the first one's."""
    drive = open_source(shipped_drive())
    frames = list(drive)
    num_loops = math.ceil(num_frames / len(frames))
    configuration = live_config()
    sink = Digests(num_loops, len(frames))
    source = Paced(Again(drive.name, frames, num_loops), math.inf)
    loop = LiveLoop(source, lambda: Pipeline(configuration), configuration, outputs=[Forgetful()], sinks=[sink])
    summary = loop.run()
    settled = [row for row in sink.rows if row["frames"] >= SETTLED_SHARE * num_frames]
    sizes = [row["resident_mib"] for row in settled]
    return {
        "num_frames": summary.run.num_frames,
        "is_same": sink.is_same,
        "faults": dict(summary.fault_counts),
        "resident_mib": [sizes[0], min(sizes), max(sizes), sizes[-1]],
        "largest_change": max(abs(size - sizes[0]) for size in sizes) / sizes[0],
        "open_files": sorted({row["open_files"] for row in settled}),
        "threads": sorted({row["threads"] for row in settled}),
        "samples": sink.rows,
    }


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, "soak", arguments)
    figures = measure(NUM_QUICK if given.quick else NUM_FRAMES)
    first, least, most, last = figures["resident_mib"]
    CONSOLE.print(
        f"{figures['num_frames']} frames; resident memory {first:.1f} MiB after a tenth, then {least:.1f} to "
        f"{most:.1f}, {last:.1f} at the end ({figures['largest_change']:.2%}); open files {figures['open_files']}, "
        f"threads {figures['threads']}; last loop's results {'equal' if figures['is_same'] else 'DIFFER FROM'} the "
        f"first one's; faults {figures['faults']}"
    )
    write_results(given.out, {"soak": figures})
    CONSOLE.print(f"look in {given.out}")


if __name__ == "__main__":
    main()
