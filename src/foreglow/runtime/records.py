"""`frames.jsonl`: one line of JSON for every frame."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

from foreglow.files import naming
from foreglow.types import Frame, FrameResult


def frame_record(frame: Frame, result: FrameResult) -> dict[str, Any]:
    """What `frames.jsonl` says about one frame.

    Boxes are half-open `[x1, y1, x2, y2]` in full-frame pixels; `scores` goes with the proposals, in their order,
    each the exact value of the float32 that was compared with the threshold. `scores` and `detections_xyxy_px`
    are None where no model was given. All but `stage_ms` depend on the frame and the configuration alone.
    """
    detections = result.detections
    return {
        "frame": result.frame,
        "sequence": frame.sequence,
        "timestamp_ns": result.timestamp_ns,
        "proposals_xyxy_px": result.proposals.boxes_xyxy_px.tolist(),
        "scores": None if detections is None else detections.scores.tolist(),
        "detections_xyxy_px": None if detections is None else detections.accepted_boxes_xyxy_px.tolist(),
        "stage_ms": {name: round(value, 4) for name, value in result.stage_ms.items()},
    }


class FrameRecords:
    """A result sink that writes `frame_record` lines to `path`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with naming(path):
            self._file = path.open("w", encoding="utf-8", newline="\n")

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Adds a line.

        Raises:
            OSError: If the disk is full; the message names the path.
        """
        line = json.dumps(frame_record(frame, result), separators=(",", ":"), allow_nan=False)
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
