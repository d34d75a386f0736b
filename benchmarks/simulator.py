"""Run-time of the simulator: `python -m benchmarks.simulator [--out FILE.json] [--quick]`.

Whole frames of drives, as `foreglow simulate` makes them, and what the renderer takes of them, its haze apart. The
frames are spread over each drive; the first one, which may have to compile kernels, is shown apart.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any
from unittest.mock import patch

import numpy as np
from rich.table import Table

from benchmarks.timing import CONSOLE, Row, RunTimes, options, table, write_results
from foreglow.lab.simulation import drive_frames
from foreglow.lab.simulation.light.llvm import dr, prepare
from foreglow.lab.simulation.light.render import Renderer
from foreglow.lab.simulation.light.shading import Haze
from foreglow.lab.simulation.scenes.scenarios import MIXTURES, adapted, scenario
from foreglow.lab.simulation.scenes.scene import Scene

SIZES_PX = ((1280, 960), (640, 480))
SEED = 7


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is simulated."""

    scenarios: tuple[str, ...] = tuple(MIXTURES["pvdn"])
    num_frames: int = 12


QUICK = Effort(scenarios=("curve",), num_frames=3)


@dataclass(slots=True)
class Watch:
    """Run-times of each call of some methods, while it is on.

    Attributes:
        taken_ms: By name, milliseconds of each call.
    """

    taken_ms: dict[str, list[float]] = field(default_factory=dict)

    def on(self, name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        """`method`, watched."""
        samples = self.taken_ms.setdefault(name, [])

        def timed(*arguments: Any, **named: Any) -> Any:
            started = time.perf_counter_ns()
            result = method(*arguments, **named)
            samples.append((time.perf_counter_ns() - started) / 1e6)
            return result

        return timed


def measure_drive(scene: Scene) -> Row:
    """Run-times of the frames of a drive, the first one apart."""
    watch = Watch()
    with (
        patch.object(Renderer, "render", watch.on("render", Renderer.render)),
        patch.object(Haze, "render", watch.on("haze", Haze.render)),
    ):
        frames = drive_frames(scene)
        take = watch.on("frame", lambda: next(frames))
        num_vehicles = max(len(take().vehicles) for _ in range(scene.num_frames))
    row: Row = {"scenario": scene.name, "width_px": scene.camera.width_px, "num_vehicles": num_vehicles}
    row["first_ms"] = watch.taken_ms["frame"][0]
    for name, samples in watch.taken_ms.items():
        times = RunTimes(np.array(samples[1:])[None])
        row |= {f"{name}_{key}": value for key, value in times.figures().items()}
    return row


def measure(effort: Effort) -> list[Row]:
    """One row for each size and scenario, and after those of a size the medians over them."""
    rows: list[Row] = []
    for size_px in SIZES_PX:
        drives = []
        for name in effort.scenarios:
            drawn = scenario(name, SEED)
            rate_hz = (effort.num_frames + 1) / drawn.duration_s
            drives.append(measure_drive(adapted(drawn, size_px, rate_hz, "night")))
        medians = {key: float(np.median([row[key] for row in drives])) for key in drives[0] if key.endswith("_ms")}
        rows += [*drives, {"scenario": "median", "width_px": size_px[0], "num_vehicles": None, **medians}]
    return rows


def frames_table(rows: Sequence[Row]) -> Table:
    figures = ("vehicles", "first ms", "frame ms", "p99 ms", "of it render", "of it haze")
    shown = table("Labelled frames, training quality", ("size", "scenario"), figures)
    sizes = dict(SIZES_PX)
    for row in rows:
        vehicles = "" if row["num_vehicles"] is None else str(row["num_vehicles"])
        keys = ("first_ms", "frame_median_ms", "frame_p99_ms", "render_median_ms", "haze_median_ms")
        times = [f"{row[key]:.0f}" for key in keys]
        shown.add_row(f"{row['width_px']}x{sizes[row['width_px']]}", row["scenario"], vehicles, *times)
    return shown


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, "simulator", arguments)
    results: dict[str, Any] = {"variant": prepare(), "num_threads": dr.thread_count()}
    results["frames"] = measure(QUICK if given.quick else Effort())
    CONSOLE.print(frames_table(results["frames"]))
    write_results(given.out, results)
    CONSOLE.print(f"look in {given.out}")


if __name__ == "__main__":
    main()
