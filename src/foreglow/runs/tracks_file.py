"""The tracks or the gaps of a run, or all of its results, read back from its `frames.jsonl`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from foreglow.datasets.json_files import Record, read_json
from foreglow.geometry import Floats
from foreglow.runs.predictions import FrameLine, Number, frame_lines
from foreglow.types import Detections, FrameResult, Proposals, Ranges, Tracks, TrackState


class _TrackRecord(Record):
    id: int
    state: Literal["tentative", "confirmed", "coasting"]
    box_xyxy_px: tuple[Number, Number, Number, Number]
    confidence: Annotated[Number, Field(ge=0, le=1)]
    num_hits: Annotated[int, Field(ge=1)]
    num_misses: Annotated[int, Field(ge=0)]
    age_s: Annotated[Number, Field(ge=0)]
    range_m: Number | None
    range_sigma_m: Annotated[Number, Field(gt=0)] | None
    detection: Annotated[int, Field(ge=-1)]
    direct: Annotated[Number, Field(ge=0, le=1)] | None = None


class _FrameLine(FrameLine):
    tracks: tuple[_TrackRecord, ...] | None = None


def has_tracks(path: Path | str) -> bool:
    """Whether the file at `path` is the `frames.jsonl` of a run with a tracker, by its first line."""
    path = Path(path)
    if path.suffix.lower() != ".jsonl" or not path.is_file():
        return False
    with path.open("rb") as file:
        lines = frame_lines(file.readline(), _FrameLine, path)
        return any(parsed.tracks is not None for _, parsed in lines)


def read_tracks(path: Path | str) -> Mapping[int, Tracks]:
    """By image id, the tracks in the `frames.jsonl` at `path`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not of that form, or the run had no tracker; the message names the line and the field.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file, expected the frames.jsonl of a run")
    tracks: dict[int, Tracks] = {}
    for origin, parsed in frame_lines(path.read_bytes(), _FrameLine, path):
        if parsed.tracks is None:
            raise ValueError(f"{origin}: tracks: expected a list, got nothing: the run had no model or no tracker")
        try:
            tracks[parsed.frame] = _tracks(parsed.tracks)
        except ValueError as error:
            raise ValueError(f"{origin}: {error}") from error
    return tracks


class ResultLine(_FrameLine):
    """A line with the results up to the tracks."""

    timestamp_ns: int
    proposals_xyxy_px: tuple[tuple[int, int, int, int], ...]
    scores: tuple[Number, ...] | None = None
    direct: tuple[Number | None, ...] | None = None
    ranges_m: tuple[Number | None, ...] | None = None
    range_sigmas_m: tuple[Number | None, ...] | None = None


def read_results(path: Path | str, score_threshold: float) -> Mapping[int, FrameResult]:
    """By image id, the results in the `frames.jsonl` at `path` up to the tracks, without run-times.

    Args:
        path: The file.
        score_threshold: That of the run: boxes with a score above it were accepted.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not of that form, or the run had no tracker; the message names the line and the field.
    """
    path = Path(path)
    read_tracks(path)  # which says so where there are none
    results: dict[int, FrameResult] = {}
    for origin, line in frame_lines(path.read_bytes(), ResultLine, path):
        try:
            results[line.frame] = recorded_result(line, score_threshold)
        except ValueError as error:
            raise ValueError(f"{origin}: {error}") from error
    return results


class _GapRecord(Record):
    right_deg: Number
    left_deg: Number


class _BeamRecord(Record):
    gaps: tuple[_GapRecord, ...]


class _BeamLine(FrameLine):
    beam: _BeamRecord | None = None


def read_gaps(path: Path | str) -> Mapping[int, Floats]:
    """By image id, the dark gaps in the `frames.jsonl` at `path`: shape (G, 2), as `BeamCommand.gaps_rad`.

    Frames without a beam are left out.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not of that form; the message names the line and the field.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file, expected the frames.jsonl of a run")
    return {
        line.frame: np.radians([(one.right_deg, one.left_deg) for one in line.beam.gaps]).reshape(-1, 2)
        for _, line in frame_lines(path.read_bytes(), _BeamLine, path)
        if line.beam is not None
    }


class _Summary(Record):
    source: str


def source_of_run(run: Path) -> Path:
    """Where the frames of the run in the folder `run` are, by its `summary.json`.

    Raises:
        FileNotFoundError: If it has no summary, or the frames are no longer where they were.
        ValueError: If the summary is broken.
    """
    path = run / "summary.json"
    source = Path(read_json(path, _Summary).source)
    if not source.exists():
        raise FileNotFoundError(
            f"{path}: source: expected the run's frames, there is nothing at {source}; where they are elsewhere now, "
            f"give them in place of {run}, with --config {run / 'config.toml'}"
        )
    return source


def recorded_result(line: ResultLine, score_threshold: float) -> FrameResult:
    """The result in a line, up to the tracks, which may be missing.

    Raises:
        ValueError: If its parts do not belong together.
    """
    proposals = Proposals(np.array(line.proposals_xyxy_px, np.int32).reshape(-1, 4))
    detections: Detections | None = None
    ranges: Ranges | None = None
    if line.scores is not None:
        direct = np.array(line.direct or (), np.float32)
        detections = Detections(proposals, np.array(line.scores, np.float32), score_threshold, direct)
        if line.ranges_m is not None and line.range_sigmas_m is not None:
            ranges_m, sigmas_m = np.array(line.ranges_m, np.float64), np.array(line.range_sigmas_m, np.float64)
            ranges = Ranges(detections, ranges_m, np.where(np.isnan(sigmas_m), np.inf, sigmas_m))
    tracks = None if line.tracks is None else _tracks(line.tracks)
    return FrameResult(line.frame, line.timestamp_ns, proposals, detections, {}, ranges, tracks)


def _tracks(records: tuple[_TrackRecord, ...]) -> Tracks:
    return Tracks(
        ids=np.array([one.id for one in records], np.int64),
        states=np.array([TrackState[one.state.upper()] for one in records], np.int64),
        boxes_xyxy_px=np.array([one.box_xyxy_px for one in records], np.float64).reshape(-1, 4),
        confidences=np.array([one.confidence for one in records], np.float64),
        num_hits=np.array([one.num_hits for one in records], np.int64),
        num_misses=np.array([one.num_misses for one in records], np.int64),
        ages_s=np.array([one.age_s for one in records], np.float64),
        ranges_m=np.array([math.nan if one.range_m is None else one.range_m for one in records], np.float64),
        sigmas_m=np.array(
            [math.inf if one.range_sigma_m is None else one.range_sigma_m for one in records], np.float64
        ),
        detections=np.array([one.detection for one in records], np.int64),
        direct_probabilities=np.array([math.nan if one.direct is None else one.direct for one in records], np.float64),
    )
