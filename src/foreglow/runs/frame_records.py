"""`frames.jsonl` and `times.jsonl`: one line of JSON for every frame."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from foreglow.files import naming
from foreglow.types import BeamCommand, BeamMode, Frame, FrameResult, Tracks, TrackState

RecordOf: TypeAlias = Callable[[Frame, FrameResult], dict[str, Any]]
"""What is written about a frame."""


def frame_record(frame: Frame, result: FrameResult) -> dict[str, Any]:
    """What `frames.jsonl` says about one frame.

    Boxes are half-open `[x1, y1, x2, y2]` in full-frame pixels; `scores` goes with the proposals, in their order,
    each the exact value of the float32 that was compared with the threshold, and `ranges_m` and `range_sigmas_m`
    likewise: from the camera along the viewing ray, None for a box where nothing is known. `direct` is the probability
    of a lamp itself, box by box, None where the model does not say. `tracks` has one object a track, `beam` is the
    `beam_record`. Whatever a stage did not make is None as a whole. All depends on the frames and the configuration
    alone: what a clock touches is in the `time_record`.
    """
    detections, ranges, tracks = result.detections, result.ranges, result.tracks
    return {
        "frame": result.frame,
        "sequence": frame.sequence,
        "timestamp_ns": result.timestamp_ns,
        "proposals_xyxy_px": result.proposals.boxes_xyxy_px.tolist(),
        "scores": None if detections is None else detections.scores.tolist(),
        "direct": None if detections is None else _probabilities(detections.direct_probabilities),
        "detections_xyxy_px": None if detections is None else detections.accepted_boxes_xyxy_px.tolist(),
        "ranges_m": None if ranges is None else _numbers(ranges.ranges_m),
        "range_sigmas_m": None if ranges is None else _numbers(ranges.sigmas_m),
        "tracks": None if tracks is None else _track_records(tracks),
        "beam": None if result.beam is None else beam_record(result.beam),
    }


def time_record(frame: Frame, result: FrameResult) -> dict[str, Any]:
    """What `times.jsonl` says about one frame: the run-time of each stage, milliseconds to 0.1 us."""
    return {
        "frame": result.frame,
        "sequence": frame.sequence,
        "timestamp_ns": result.timestamp_ns,
        "stage_ms": {name: round(value, 4) for name, value in result.stage_ms.items()},
    }


def _track_records(tracks: Tracks) -> list[dict[str, Any]]:
    """One object a track, in the order of ids."""
    return [
        {
            "id": int(tracks.ids[place]),
            "state": TrackState(tracks.states[place]).name.lower(),
            "box_xyxy_px": [round(edge, 3) for edge in tracks.boxes_xyxy_px[place].tolist()],
            "confidence": float(tracks.confidences[place]),
            "num_hits": int(tracks.num_hits[place]),
            "num_misses": int(tracks.num_misses[place]),
            "age_s": round(float(tracks.ages_s[place]), 6),
            "range_m": range_m,
            "range_sigma_m": sigma_m,
            "detection": int(tracks.detections[place]),
            "direct": direct,
        }
        for place, (range_m, sigma_m, direct) in enumerate(
            zip(
                _numbers(tracks.ranges_m),
                _numbers(tracks.sigmas_m),
                _probabilities(tracks.direct_probabilities),
                strict=True,
            )
        )
    ]


def beam_record(command: BeamCommand) -> dict[str, Any]:
    """What `frames.jsonl` says about a beam command.

    Gaps go from right to left; their borders are azimuths to the left in the vehicle's frame. `levels` has a list for
    the left lamp and one for the right, in thousandths of full: whole numbers, rounded to the nearest.
    """
    ranges_m = _numbers(command.gap_ranges_m)
    return {
        "mode": BeamMode(command.mode).name.lower(),
        "gaps": [
            {"right_deg": round(right, 3), "left_deg": round(left, 3), "range_m": range_m}
            for (right, left), range_m in zip(np.degrees(command.gaps_rad).tolist(), ranges_m, strict=True)
        ],
        "faults": list(command.faults),
        "levels": np.rint(1000.0 * command.levels).astype(int).tolist(),
    }


def _probabilities(values: NDArray[np.floating]) -> list[float | None]:
    """As they are; None for NaN."""
    return [None if math.isnan(value) else value for value in values.tolist()]


def _numbers(values: NDArray[np.float64]) -> list[float | None]:
    """To a millimetre; None for what is not finite, which JSON does not know."""
    return [round(value, 3) if math.isfinite(value) else None for value in values.tolist()]


class FrameRecords:
    """A result sink that writes a line about every frame to `path`: its `frame_record`, or its `time_record`."""

    def __init__(self, path: Path, record_of: RecordOf = frame_record) -> None:
        self._path = path
        self._record_of = record_of
        with naming(path):
            self._file = path.open("w", encoding="utf-8", newline="\n")

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Adds a line.

        Raises:
            OSError: If the disk is full; the message names the path.
        """
        line = json.dumps(self._record_of(frame, result), separators=(",", ":"), allow_nan=False)
        with naming(self._path):
            self._file.write(line + "\n")

    def close(self) -> None:
        """Completes the file.

        Raises:
            OSError: If the disk is full; the message names the path.
        """
        with naming(self._path):
            self._file.close()

    def discard(self) -> None:
        """Closes the file, whatever it may hold by then."""
        with contextlib.suppress(OSError):
            self._file.close()
