"""`frames.jsonl`: the results of each frame of a run, one JSON object a line.

`FrameLine` is the type of a line: `frame_to_line` makes it, `line_to_result` takes it, and pydantic checks it when a
file is read. A line is a plain dict and is written by `json`, not by pydantic, which would write some numbers in
another way (`2e-5` instead of `2e-05`): the same run has to give the same bytes in every version.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from foreglow.config import read_config
from foreglow.datasets.json_files import MAX_LINE_BYTES, parse_json
from foreglow.files import bounded_lines, checked_path, file_digest
from foreglow.geometry import Floats
from foreglow.runs.frame_line import (
    BeamEntry,
    Box,
    FrameLine,
    FrameLineModel,
    ModeName,
    StateName,
    TrackEntry,
    VehicleEntry,
    check_boxes,
)
from foreglow.runs.json_lines import read_lines
from foreglow.runs.summary_file import read_summary
from foreglow.types import (
    BeamCommand,
    BeamMode,
    Detections,
    Frame,
    FrameResult,
    Proposals,
    Ranges,
    Tracks,
    TrackState,
    Vehicles,
)
from foreglow.types.kinds import kinds_of_direct, tells_rear

T = TypeVar("T")

_STATE_NAMES = {state: cast(StateName, state.name.lower()) for state in TrackState}
_MODE_NAMES = {mode: cast(ModeName, mode.name.lower()) for mode in BeamMode}


def frame_to_line(frame: Frame, result: FrameResult) -> FrameLine:
    """The line about one frame."""
    detections, ranges, tracks = result.detections, result.ranges, result.tracks
    line: FrameLine = {
        "frame": result.frame,
        "sequence": frame.sequence,
        "timestamp_ns": result.timestamp_ns,
        "proposals_xyxy_px": result.proposals.boxes_xyxy_px.tolist(),
        "scores": None if detections is None else detections.scores.tolist(),
        "direct": None if detections is None else _without_nan(detections.direct_probabilities),
        "detections_xyxy_px": None if detections is None else detections.accepted_boxes_xyxy_px.tolist(),
        "ranges_m": None if ranges is None else _to_millimetres(ranges.ranges_m),
        "range_sigmas_m": None if ranges is None else _to_millimetres(ranges.sigmas_m),
        "tracks": None if tracks is None else _track_entries(tracks),
        "beam": None if result.beam is None else beam_entry(result.beam),
    }
    if frame.is_damaged:
        line["is_damaged"] = True
    if detections is not None and tells_rear(detections.light_kinds):
        line["light_kinds"] = _rows_without_nan(detections.light_kinds)
    if tracks is not None and tracks.vehicles is not None:
        line["vehicles"] = _vehicle_entries(tracks.vehicles, tracks.ids)
    return line


def line_to_result(line: FrameLine, score_threshold: float) -> FrameResult:
    """The result that a line is about, without run-times.

    Args:
        line: The line.
        score_threshold: That of the run, which accepted boxes with a higher score.

    Raises:
        ValueError: If the line has no time, or parts of it contradict each other.
    """
    if "timestamp_ns" not in line:
        raise ValueError("timestamp_ns: field is missing")
    proposals = Proposals(_whole_pixels(line["proposals_xyxy_px"]))
    scores, ranges_m, sigmas_m = line.get("scores"), line.get("ranges_m"), line.get("range_sigmas_m")
    tracks, beam = line.get("tracks"), line.get("beam")
    detections: Detections | None = None
    ranges: Ranges | None = None
    if scores is not None:
        light_kinds = _light_kinds(line.get("light_kinds"), line.get("direct"), np.float32)
        detections = Detections(proposals, np.array(scores, np.float32), score_threshold, light_kinds)
        if ranges_m is not None and sigmas_m is not None:
            ranges = Ranges(detections, _numbers(ranges_m), _numbers(sigmas_m, unknown=math.inf))
    return FrameResult(
        line["frame"],
        line["timestamp_ns"],
        proposals,
        detections,
        ranges=ranges,
        tracks=None if tracks is None else _tracks(tracks, line.get("vehicles")),
        beam=None if beam is None else _beam_command(beam, line["timestamp_ns"]),
    )


def _track_entries(tracks: Tracks) -> list[TrackEntry]:
    columns = (
        tracks.ids.tolist(),
        tracks.states.tolist(),
        tracks.boxes_xyxy_px.tolist(),
        tracks.confidences.tolist(),
        tracks.num_hits.tolist(),
        tracks.num_misses.tolist(),
        tracks.ages_s.tolist(),
        _to_millimetres(tracks.ranges_m),
        _to_millimetres(tracks.sigmas_m),
        tracks.detections.tolist(),
        _without_nan(tracks.direct_probabilities),
    )
    entries: list[TrackEntry] = [
        {
            "id": number,
            "state": _STATE_NAMES[state],
            "box_xyxy_px": _to_thousandths(box),
            "confidence": confidence,
            "num_hits": num_hits,
            "num_misses": num_misses,
            "age_s": round(age_s, 6),
            "range_m": range_m,
            "range_sigma_m": sigma_m,
            "detection": detection,
            "direct": direct,
        }
        for (
            number, state, box, confidence, num_hits, num_misses, age_s, range_m, sigma_m, detection, direct,
        ) in zip(*columns, strict=True)
    ]  # fmt: skip
    if tells_rear(tracks.light_kinds):
        for entry, light_kinds in zip(entries, _rows_without_nan(tracks.light_kinds), strict=True):
            entry["light_kinds"] = light_kinds
    return entries


def _vehicle_entries(vehicles: Vehicles, track_ids: NDArray[np.int64]) -> list[VehicleEntry]:
    leading_ids = track_ids[vehicles.leading]
    columns = (vehicles.ids, vehicles.states, vehicles.confidences, vehicles.is_in_sight, leading_ids)
    return [
        {
            "id": number,
            "state": _STATE_NAMES[TrackState(state)],
            "confidence": confidence,
            "is_in_sight": is_in_sight,
            "tracks": track_ids[vehicles.of_tracks == number].tolist(),
            "leading": leading,
        }
        for number, state, confidence, is_in_sight, leading in zip(
            *(column.tolist() for column in columns), strict=True
        )
    ]


def _vehicles(entries: list[VehicleEntry], track_ids: NDArray[np.int64]) -> Vehicles:
    """The vehicles of tracks with these ids.

    Raises:
        ValueError: If a track belongs to none of them, or there is no leading one.
    """
    of_tracks = {track_id: entry["id"] for entry in entries for track_id in entry["tracks"]}
    indices = {track_id: index for index, track_id in enumerate(track_ids.tolist())}
    missing = next(iter(indices.keys() - of_tracks.keys()), None)
    if missing is not None:
        raise ValueError(f"vehicles: expected one that has track {missing}, found none")
    return Vehicles(
        ids=np.array([entry["id"] for entry in entries], np.int64),
        states=np.array([TrackState[entry["state"].upper()] for entry in entries], np.int64),
        confidences=np.array([entry["confidence"] for entry in entries], np.float64),
        is_in_sight=np.array([entry["is_in_sight"] for entry in entries], np.bool_),
        of_tracks=np.array([of_tracks[track_id] for track_id in indices], np.int64),
        leading=np.array([indices.get(entry["leading"], -1) for entry in entries], np.int64),
    )


def _tracks(entries: list[TrackEntry], vehicles: list[VehicleEntry] | None) -> Tracks:
    def column(name: str, dtype: type) -> NDArray[Any]:
        return np.array([entry.get(name) for entry in entries], dtype)

    direct = [entry.get("direct") for entry in entries]
    rows = [entry.get("light_kinds") for entry in entries] if any("light_kinds" in entry for entry in entries) else None
    ids = column("id", np.int64)
    return Tracks(
        ids=ids,
        states=np.array([TrackState[entry["state"].upper()] for entry in entries], np.int64),
        boxes_xyxy_px=column("box_xyxy_px", np.float64).reshape(-1, 4),
        confidences=column("confidence", np.float64),
        num_hits=column("num_hits", np.int64),
        num_misses=column("num_misses", np.int64),
        ages_s=column("age_s", np.float64),
        ranges_m=column("range_m", np.float64),
        sigmas_m=_numbers([entry["range_sigma_m"] for entry in entries], unknown=math.inf),
        detections=column("detection", np.int64),
        light_kinds=_light_kinds(rows, direct, np.float64),
        vehicles=None if vehicles is None else _vehicles(vehicles, ids),
    )


def beam_entry(command: BeamCommand) -> BeamEntry:
    """The beam command as a line has it."""
    ranges_m = _to_millimetres(command.gap_ranges_m)
    borders_deg: list[float] = np.degrees(command.gaps_rad).ravel().tolist()
    rounded_deg = [round(border, 3) for border in borders_deg]
    if any(right >= left for right, left in itertools.pairwise(rounded_deg)):  # gaps that would touch are none
        rounded_deg = borders_deg
    return {
        "mode": _MODE_NAMES[command.mode],
        "gaps": [
            {"right_deg": right, "left_deg": left, "range_m": range_m}
            for right, left, range_m in zip(rounded_deg[::2], rounded_deg[1::2], ranges_m, strict=True)
        ],
        "faults": list(command.faults),
        "levels": np.rint(1000.0 * command.levels).astype(int).tolist(),
    }


def _beam_command(entry: BeamEntry, timestamp_ns: int) -> BeamCommand:
    return BeamCommand(
        timestamp_ns=timestamp_ns,
        mode=BeamMode[entry["mode"].upper()],
        levels=np.array(entry["levels"], np.float64) / 1000.0,
        gaps_rad=_gaps_rad(entry),
        gap_ranges_m=_numbers([gap["range_m"] for gap in entry["gaps"]]),
        faults=tuple(entry["faults"]),
    )


def _gaps_rad(entry: BeamEntry) -> Floats:
    """Shape (G, 2), as `BeamCommand.gaps_rad`."""
    return np.radians([(gap["right_deg"], gap["left_deg"]) for gap in entry["gaps"]]).reshape(-1, 2)


def _without_nan(values: NDArray[np.floating]) -> list[float | None]:
    return [None if math.isnan(value) else value for value in values.tolist()]


def _rows_without_nan(rows: NDArray[np.floating]) -> list[list[float] | None]:
    return [None if math.isnan(row[0]) else row for row in rows.tolist()]


def _light_kinds(
    rows: Sequence[list[float] | None] | None, direct: Sequence[float | None] | None, dtype: type[np.floating]
) -> NDArray[Any]:
    """Shape (N, 4); of `direct` alone if there are no rows, as in older files; shape (0, 4) without either."""
    if rows is None:
        return kinds_of_direct(np.array(direct or (), dtype))
    return np.array([[math.nan] * 4 if row is None else row for row in rows], dtype).reshape(-1, 4)


def _to_millimetres(values_m: NDArray[np.float64]) -> list[float | None]:
    """Rounded, but not to 0; None for NaN and infinity, which JSON does not have."""
    return [round(value, 3) or value if math.isfinite(value) else None for value in values_m.tolist()]


def _to_thousandths(box: list[float]) -> Box:
    """The edges rounded, unless nothing would be left between them."""
    x1, y1, x2, y2 = rounded = [round(edge, 3) for edge in box]
    return rounded if x1 < x2 and y1 < y2 else box


def _numbers(values: list[float | None], unknown: float = math.nan) -> Floats:
    """Shape (N,), float64, with `unknown` instead of None."""
    return np.array([unknown if value is None else value for value in values], np.float64)


def _whole_pixels(boxes: list[Box]) -> NDArray[np.int32]:
    """Shape (N, 4).

    Raises:
        ValueError: If an edge is not a whole number.
    """
    edges = np.array(boxes, np.float64).reshape(-1, 4)
    with np.errstate(invalid="ignore"):  # an edge that int32 cannot hold
        whole = edges.astype(np.int32)
    if (whole != edges).any():
        raise ValueError(f"proposals_xyxy_px: expected whole pixels, got {edges[(whole != edges).any(axis=1)][0]}")
    return whole


def has_tracks(path: Path | str) -> bool:
    """Whether the file at `path` is the `frames.jsonl` of a run with a tracker, by its first line.

    Raises:
        ValueError: If that line is broken.
    """
    path = checked_path(path)
    if path.suffix.lower() != ".jsonl" or not path.is_file():
        return False
    with path.open("rb") as file:
        first = next(bounded_lines(file, path, MAX_LINE_BYTES), b"").strip()
    return bool(first) and parse_json(first, FrameLineModel, f"{path}: line 1").root.get("tracks") is not None


def own_threshold(path: Path) -> float | None:
    """The threshold of the run that wrote the `frames.jsonl` at `path`; None if no run did.

    Raises:
        ValueError: If the run's configuration is broken.
    """
    config = path.with_name("config.toml")
    if path.name != "frames.jsonl" or not config.is_file():
        return None
    return read_config(config).classifier.score_threshold


def read_frame_lines(path: Path, convert: Callable[[FrameLine], T]) -> dict[int, T]:
    """By frame, what `convert` makes of the lines of the `frames.jsonl` at `path`: every command reads it with this.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not of that form, a line contradicts itself or cannot be converted, or the accepted boxes
            are not those of the run's threshold, as when one of the two was edited; the message names the line and the
            field. If it is no longer what the run wrote whose `summary.json` is beside it.
    """
    threshold = own_threshold(path)

    def check_and_convert(line: FrameLine) -> T:
        check_boxes(line)
        scores, accepted = line.get("scores"), line.get("detections_xyxy_px")
        if threshold is not None and scores is not None and accepted is not None:
            boxes = zip(line["proposals_xyxy_px"], scores, strict=True)
            wanted = [box for box, score in boxes if score > threshold]
            if accepted != wanted:
                expected = f"expected the {len(wanted)} boxes with scores above {threshold:g}, as config.toml has it"
                raise ValueError(f"detections_xyxy_px: {expected}, got {len(accepted)}, or others")
        return convert(line)

    values = read_lines(path, FrameLineModel, check_and_convert)
    _check_unchanged(path)
    return values


def _check_unchanged(path: Path) -> None:
    """ValueError if the `frames.jsonl` at `path` is not what the run wrote that left a `summary.json` beside it."""
    summary = path.with_name("summary.json")
    if path.name != "frames.jsonl" or not summary.is_file():
        return
    written = read_summary(summary).frames_sha256
    if written not in (None, file_digest(path)):
        raise ValueError(
            f"{path}: expected the frames that the run wrote, by frames_sha256 in summary.json; the file was changed "
            "since: make the run again, or use a copy of the file in another folder, which is taken as it is"
        )


def read_tracks(path: Path | str) -> Mapping[int, Tracks]:
    """By image id, the tracks in the `frames.jsonl` at `path`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not of that form, or the run had no tracker; the message names the line and the field.
    """
    return read_frame_lines(checked_path(path), lambda line: _tracks(_entries_of(line), line.get("vehicles")))


def read_results(path: Path | str, score_threshold: float) -> Mapping[int, FrameResult]:
    """By image id, the results of a run with a tracker from the `frames.jsonl` at `path`, without run-times.

    Args:
        path: The file.
        score_threshold: That of the run, which accepted boxes with a higher score.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not of that form, or the run had no tracker; the message names the line and the field.
    """

    def convert(line: FrameLine) -> FrameResult:
        _entries_of(line)
        return line_to_result(line, score_threshold)

    return read_frame_lines(checked_path(path), convert)


def _entries_of(line: FrameLine) -> list[TrackEntry]:
    entries = line.get("tracks")
    if entries is None:
        raise ValueError("tracks: expected a list, got nothing: the run had no model or no tracker")
    return entries


def read_gaps(path: Path | str) -> Mapping[int, Floats]:
    """By image id, the dark gaps in the `frames.jsonl` at `path`: shape (G, 2), as `BeamCommand.gaps_rad`.

    Frames without a beam are left out.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not of that form; the message names the line and the field.
    """
    beams = read_frame_lines(checked_path(path), lambda line: line.get("beam"))
    return {frame: _gaps_rad(beam) for frame, beam in beams.items() if beam is not None}
