"""`times.jsonl`: how long each stage took, frame by frame."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pydantic import RootModel
from typing_extensions import TypedDict  # pydantic takes that of typing from Python 3.12 on

from foreglow.runs.json_lines import Whole, checked, read_lines
from foreglow.types import Frame, FrameResult


@checked
class TimesLine(TypedDict):
    """A line of `times.jsonl`.

    Attributes:
        frame: As in the `FrameLine` of the same frame, as are the next two.
        sequence: Name of the sequence.
        timestamp_ns: Time of exposure.
        stage_ms: Run-time of each stage in milliseconds, to 0.1 us.
    """

    frame: Whole
    sequence: str
    timestamp_ns: Whole
    stage_ms: dict[str, float]


def frame_to_times(frame: Frame, result: FrameResult) -> TimesLine:
    """The line about one frame."""
    return {
        "frame": result.frame,
        "sequence": frame.sequence,
        "timestamp_ns": result.timestamp_ns,
        "stage_ms": {name: round(value, 4) for name, value in result.stage_ms.items()},
    }


def read_stage_times(path: Path) -> Mapping[int, Mapping[str, float]]:
    """By frame, how long each stage took, in milliseconds, from the `times.jsonl` at `path`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is broken; the message names the line and the field.
    """
    return read_lines(path, RootModel[TimesLine], lambda line: line["stage_ms"])
