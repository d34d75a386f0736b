"""Two processes or two dask workers against one: `python -m benchmarks.scale [--out FILE.json] [--quick]`.

A run over a generated split of four sequences, and the cost of handing out a task that does nothing. In seconds these
say little about another machine; the ratios are of the same rounds.
"""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.synthetic_frames import night_frame
from benchmarks.timing import CONSOLE, Contender, Row, interleaved, options, table, write_results
from foreglow.config import preset
from foreglow.datasets import PVDN
from foreglow.datasets.pvdn.schema import Sequence as PVDNSequence
from foreglow.datasets.pvdn.writer import LabelledImage, PVDNWriter
from foreglow.parallel import Cluster, Local, Parent, Workers
from foreglow.runtime import Opening, OutputFolder, run_apart
from foreglow.types import Frame

NUM_SEQUENCES = 4


def main(arguments: Sequence[str] | None = None) -> None:
    asked = options(__doc__, "scale", arguments)
    num_frames, num_tasks, rounds = (2, 10, 1) if asked.quick else (100, 300, 5)
    from distributed import LocalCluster

    with (
        tempfile.TemporaryDirectory() as folder,
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0") as dask,
    ):
        split = write_split(Path(folder) / "day" / "val", num_frames)
        workers: dict[str, Workers] = {
            "this process": Local(1),
            "--jobs 2": Local(2),
            "--cluster, 2 workers": Cluster(dask.scheduler_address),
        }
        runs = measured(workers, Path(folder) / "out", split, rounds)
        tasks = handed_out(workers, num_tasks, rounds, frame_ms=runs[0]["median_ms"] / (NUM_SEQUENCES * num_frames))
    CONSOLE.print(run_table(runs, num_frames), task_table(tasks))
    write_results(asked.out, {"run": runs, "tasks": tasks, "num_frames": NUM_SEQUENCES * num_frames})


def write_split(root: Path, num_frames: int) -> Path:
    """Sequences of the same few pictures, since drawing one takes longer than finding what is in it."""
    images = [night_frame(seed, range_m=60.0 + 10.0 * seed) for seed in range(2)]
    with PVDNWriter(root) as writer:
        for number in range(1, NUM_SEQUENCES + 1):
            frames = (Frame(images[index % 2], 0, 1000 * number + index) for index in range(num_frames))
            writer.add_sequence(PVDNSequence.plain(number), [LabelledImage(frame) for frame in frames])
    return root


def measured(workers: dict[str, Workers], out: Path, split: Path, rounds: int) -> list[Row]:
    """Whole runs, with the start of the processes and all files."""

    def run(by: Workers) -> None:
        run_apart(Opening(PVDN, (split,)), preset("foreglow"), OutputFolder(out), by)

    times = interleaved({name: Contender(functools.partial(run, by), 1) for name, by in workers.items()}, rounds, 0)
    alone = times["this process"]
    return [
        {"workers": name, "median_ms": timing.median_ms, "speed_up": timing.speed_up_over(alone)}
        for name, timing in times.items()
    ]


def nothing(item: int, parent: Parent) -> int:  # noqa: ARG001
    return item


def handed_out(workers: dict[str, Workers], num_tasks: int, rounds: int, frame_ms: float) -> list[Row]:
    """The cost of a task: what many take longer than two, which have the processes started as well."""

    def run_tasks(by: Workers, num: int) -> None:
        list(by.each(nothing, {str(number): number for number in range(num)}, lambda *_: None))

    calls = {
        (name, num): functools.partial(run_tasks, by, num) for name, by in workers.items() for num in (2, num_tasks)
    }
    times = interleaved({f"{name} {num}": Contender(call, 1) for (name, num), call in calls.items()}, rounds, 0)
    rows: list[Row] = []
    for name in workers:
        few_ms, many_ms = (times[f"{name} {num}"].median_ms for num in (2, num_tasks))
        task_ms = max(many_ms - few_ms, 0.0) / (num_tasks - 2)
        rows.append({"workers": name, "start_ms": few_ms, "task_ms": task_ms, "frames": task_ms / frame_ms})
    return rows


def run_table(rows: Sequence[Row], num_frames: int) -> object:
    filled = table(f"A run over {NUM_SEQUENCES} sequences of {num_frames} frames", ["workers"], ["seconds", "speed-up"])
    for row in rows:
        filled.add_row(row["workers"], f"{row['median_ms'] / 1e3:.2f}", f"{row['speed_up']:.2f}")
    return filled


def task_table(rows: Sequence[Row]) -> object:
    title = "A task that does nothing; frames: of the run in this process that take as long"
    filled = table(title, ["workers"], ["start, ms", "a task, ms", "frames"])
    for row in rows:
        filled.add_row(row["workers"], f"{row['start_ms']:.1f}", f"{row['task_ms']:.3f}", f"{row['frames']:.3f}")
    return filled


if __name__ == "__main__":
    main()
