"""All of a run, read back from the folder that it wrote: summary, configuration, and every frame's result."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from foreglow.config import PipelineConfig, read_config
from foreglow.datasets import PVDN, open_source
from foreglow.datasets.json_files import Record, read_json
from foreglow.runs.predictions import FrameLine, Number, frame_lines
from foreglow.runs.tracks_file import ResultLine, recorded_result, source_of_run
from foreglow.types import BeamCommand, BeamMode, Frame, FrameResult


class FaultRecord(Record):
    """A fault of a live run, from its beginning to its end by the frames' clock; None while it lasted."""

    fault: str
    from_ns: int
    until_ns: int | None = None
    detail: str = ""


class LiveRecord(Record):
    """What a live run lost, and what went wrong in it."""

    num_dropped: int
    num_late: int
    fault_counts: dict[str, int]
    faults: tuple[FaultRecord, ...]


class SummaryRecord(Record):
    """The fields of `summary.json` that a report tells; see `runtime.summary.RunSummary`."""

    source: str
    is_complete: bool
    num_frames: int
    num_proposals: int
    num_accepted: int | None
    num_tracks: int | None
    num_skipped: int
    beam: dict[str, Any] | None
    run_time_ms: dict[str, dict[str, Number | None]]
    version: str
    commit: str | None
    has_local_changes: bool | None
    processor: str
    live: LiveRecord | None = None


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class RecordedRun:
    """A run as its folder tells it.

    Attributes:
        folder: Where it lies.
        summary: What it did.
        config: What it was done with.
        sequences: By name, in the order of the run, the results of its frames; `stage_ms` as far as it was kept.
    """

    folder: Path
    summary: SummaryRecord
    config: PipelineConfig
    sequences: Mapping[str, tuple[FrameResult, ...]]


class _GapRecord(Record):
    right_deg: Number
    left_deg: Number
    range_m: Number | None


class _BeamRecord(Record):
    mode: Literal["low", "glare_free", "full"]
    gaps: tuple[_GapRecord, ...]
    faults: tuple[str, ...]
    levels: tuple[tuple[Annotated[int, Field(ge=0, le=1000)], ...], tuple[Annotated[int, Field(ge=0, le=1000)], ...]]


class _RunLine(ResultLine):
    sequence: str = ""
    beam: _BeamRecord | None = None


def read_run(folder: Path) -> RecordedRun:
    """The run that was written to `folder`.

    Raises:
        FileNotFoundError: If one of its files is missing.
        ValueError: If one is broken; the message names path, line and field.
    """
    path = folder / "frames.jsonl"
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file, expected the folder of a run")
    summary = read_json(folder / "summary.json", SummaryRecord)
    config = read_config(folder / "config.toml")
    times = read_stage_times(folder)
    sequences: dict[str, list[FrameResult]] = {}
    for origin, line in frame_lines(path.read_bytes(), _RunLine, path):
        try:
            result = recorded_result(line, config.classifier.score_threshold)
            beam = None if line.beam is None else _command(line.beam, line.timestamp_ns)
        except ValueError as error:
            raise ValueError(f"{origin}: {error}") from error
        result = dataclasses.replace(result, beam=beam, stage_ms=times.get(line.frame, {}))
        sequences.setdefault(line.sequence, []).append(result)
    return RecordedRun(folder, summary, config, {name: tuple(results) for name, results in sequences.items()})


def read_frames(run: RecordedRun, results: Iterable[FrameResult]) -> Mapping[int, Frame]:
    """By number, the frames that these results of the run were made of.

    Raises:
        FileNotFoundError: If the run's frames are no longer where they were.
        ValueError: If they cannot be read, or there are others now.
    """
    wanted = {one.frame: one.timestamp_ns for one in results}
    source = open_source(source_of_run(run.folder), on_error="skip")
    frames: dict[int, Frame] = {}
    if isinstance(source, PVDN):
        frames = {number: source.read(number) for number in sorted(wanted)}
    else:
        for frame in source:
            if frame.frame in wanted:
                frames[frame.frame] = frame
            if len(frames) == len(wanted):
                break
    if {number: frame.timestamp_ns for number, frame in frames.items()} != wanted:
        raise ValueError(f"{run.summary.source}: expected the frames of the run, there are others now")
    return frames


class _TimesLine(FrameLine):
    stage_ms: dict[str, Number]


def read_stage_times(folder: Path) -> Mapping[int, Mapping[str, float]]:
    """By frame, how long each stage of the run in `folder` took, milliseconds.

    Raises:
        FileNotFoundError: If its file is missing.
        ValueError: If it is broken; the message names the line and the field.
    """
    path = folder / "times.jsonl"
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file, expected the folder of a run")
    return {line.frame: line.stage_ms for _, line in frame_lines(path.read_bytes(), _TimesLine, path)}


def _command(record: _BeamRecord, timestamp_ns: int) -> BeamCommand:
    gaps_deg = np.array([(gap.right_deg, gap.left_deg) for gap in record.gaps], np.float64).reshape(-1, 2)
    return BeamCommand(
        timestamp_ns=timestamp_ns,
        mode=BeamMode[record.mode.upper()],
        levels=np.array(record.levels, np.float64) / 1000.0,
        gaps_rad=np.radians(gaps_deg),
        gap_ranges_m=np.array([math.nan if gap.range_m is None else gap.range_m for gap in record.gaps], np.float64),
        faults=record.faults,
    )
