"""Run-time and memory of the detector: `python -m benchmarks.detector [--out FILE.json] [--quick]`.

Everything in one thread, everything in one run. Uses the published frame and weights where they are at hand, else a
generated frame and random weights, and says so.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.material import benchmark_frame, imported_models
from benchmarks.memory import memory_growth
from benchmarks.opencv_chain import OpenCvProposer, one_opencv_thread
from benchmarks.timing import CONSOLE, Contender, Row, in_ms, interleaved, options, table, write_results
from foreglow import _native
from foreglow.config import PRESETS, ClassifierConfig, PipelineConfig, ProposalConfig
from foreglow.pipeline import Pipeline
from foreglow.proposals import NativeProposer, Proposer, ReferenceProposer
from foreglow.types import Frame, FrameResult, Image

FRAME_NS = 55_555_556
"""Time between frames at 18 Hz."""


@dataclass(frozen=True, slots=True)
class Effort:
    """How often things are repeated."""

    rounds: int = 100
    proposal_frames: int = 10_000
    pipeline_frames: int = 2_000


QUICK = Effort(rounds=1, proposal_frames=50, pipeline_frames=10)


def measure_proposals(image: Image, rounds: int) -> list[Row]:
    """Every dispatch level, the OpenCV chain where it can do the same, and the reference, for every preset."""
    rows: list[Row] = []
    for preset, pipeline_config in PRESETS.items():
        config = pipeline_config.proposals
        proposers: dict[str, Proposer] = {
            f"native, {level}": NativeProposer(_with_dispatch(config, level)) for level in _native.available_dispatch()
        }
        if config.split_saddle == 0:  # which the chain knows nothing of
            proposers["OpenCV chain"] = OpenCvProposer(config)
        proposers["reference.py"] = ReferenceProposer(config)
        boxes = {name: proposer.propose(image).boxes_xyxy_px for name, proposer in proposers.items()}
        contenders = {
            name: Contender(partial(proposer.propose, image), 1 if name == "reference.py" else 10)
            for name, proposer in proposers.items()
        }
        with one_opencv_thread():
            times = interleaved(contenders, rounds)
        for name, taken in times.items():
            row = {"preset": preset, "back_end": name, "num_boxes": len(boxes[name])}
            row["equals_reference"] = np.array_equal(boxes[name], boxes["reference.py"])
            row |= taken.figures()
            row["times_reference"] = taken.speed_up_over(times["reference.py"])
            if "OpenCV chain" in times:
                row["times_opencv"] = taken.speed_up_over(times["OpenCV chain"])
            rows.append(row)
    return rows


def _with_dispatch(config: ProposalConfig, level: str) -> ProposalConfig:
    return ProposalConfig.model_validate(config.model_dump() | {"dispatch": level})


def measure_pipelines(image: Image, pipelines: dict[str, Pipeline], rounds: int) -> list[Row]:
    """`Pipeline.step` from an array in memory to scored boxes, and the medians of its stages."""
    results: dict[str, list[FrameResult]] = {name: [] for name in pipelines}

    def step(name: str) -> None:  # as a camera's next frame, so that what looks back in time does
        frame = Frame(image, timestamp_ns=len(results[name]) * FRAME_NS)
        results[name].append(pipelines[name].step(frame))

    contenders = {name: Contender(partial(step, name)) for name in pipelines}
    rows: list[Row] = []
    for name, taken in interleaved(contenders, rounds).items():
        detections = results[name][-1].detections
        assert detections is not None
        row: Row = {"variant": name, "num_boxes": len(detections), "num_accepted": int(detections.is_accepted.sum())}
        row |= taken.figures()
        for stage in results[name][-1].stage_ms:
            row[f"{stage}_ms"] = float(np.median([result.stage_ms[stage] for result in results[name]]))
        rows.append(row)
    return rows


def measure_memory(image: Image, pipeline: Pipeline, effort: Effort) -> list[Row]:
    """Growth of the resident memory over many frames."""
    proposer = NativeProposer(ProposalConfig())
    return [
        {"part": "native proposals"} | memory_growth(proposer.propose, image, effort.proposal_frames),
        {"part": "whole detector"} | memory_growth(pipeline.step, image, effort.pipeline_frames),
    ]


def proposals_table(rows: Sequence[Row]) -> Table:
    figures = ("boxes", "median ms", "p99 ms", "times reference.py", "times OpenCV")
    shown = table("Proposals, 1280x960, one thread", ("preset", "back end"), figures)
    for row in rows:
        boxes = f"{row['num_boxes']}{'' if row['equals_reference'] else ' (differ)'}"
        ratios = (f"{row['times_reference']:.0f}", f"{row['times_opencv']:.2f}" if "times_opencv" in row else "-")
        shown.add_row(row["preset"], row["back_end"], boxes, *in_ms(row, "median_ms", "p99_ms"), *ratios)
    return shown


def pipelines_table(rows: Sequence[Row], weights: str) -> Table:
    figures = ("boxes", "accepted", "median ms", "p99 ms", "of it proposals", "of it classifier")
    shown = table(f"Whole detector, 1280x960, one thread, {weights}", ("classifier",), figures)
    for row in rows:
        times = in_ms(row, "median_ms", "p99_ms", "proposals_ms", "classifier_ms")
        shown.add_row(row["variant"], str(row["num_boxes"]), str(row["num_accepted"]), *times)
    return shown


def memory_table(rows: Sequence[Row]) -> Table:
    shown = table("Resident memory", ("",), ("frames", "before MiB", "after MiB", "growth MiB"))
    for row in rows:
        sizes = (row[key] for key in ("before_mib", "after_mib", "growth_mib"))
        shown.add_row(row["part"], str(row["num_frames"]), *("-" if size is None else f"{size:.2f}" for size in sizes))
    return shown


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, "detector", arguments)
    effort = QUICK if given.quick else Effort()
    frame, image = benchmark_frame()
    CONSOLE.print(f"Frame: {frame}")
    results: dict[str, Any] = {"frame": frame, "proposals": measure_proposals(image, effort.rounds)}
    CONSOLE.print(proposals_table(results["proposals"]))
    with tempfile.TemporaryDirectory() as folder:
        results["weights"], models = imported_models(Path(folder))
        pipelines = {
            variant: Pipeline(PipelineConfig(classifier=ClassifierConfig(model=path)))
            for variant, (path, _) in models.items()
        }
    pipelines["preset foreglow"] = Pipeline()
    results["detector"] = measure_pipelines(image, pipelines, effort.rounds)
    CONSOLE.print(pipelines_table(results["detector"], results["weights"]))
    results["memory"] = measure_memory(image, pipelines["preset foreglow"], effort)
    CONSOLE.print(memory_table(results["memory"]))
    write_results(given.out, results)
    CONSOLE.print(f"look in {given.out}")


if __name__ == "__main__":
    main()
