"""Street messages that the tests of vehicle logs share."""

from __future__ import annotations

from typing import Any

from foreglow.street import StreetMessage, StreetSegment


def segment(number: int, **codes: Any) -> StreetSegment:
    """A straight level segment of 100 m that follows the one before it."""
    usual = {
        "segment_id": number,
        "parent_id": number - 1,
        "length_code": 50,
        "start_curvature_code": 255,
        "is_start_left": False,
        "end_curvature_code": 255,
        "is_end_left": False,
        "slope_code": 0,
    }
    return StreetSegment.model_validate(usual | codes)


def message(first: int = 1, last: int = 3, *, remaining_length_m: int = 40, error_class: int = 1) -> StreetMessage:
    """Segments `first` to `last`."""
    segments = tuple(segment(number) for number in range(first, last + 1))
    return StreetMessage(segments=segments, remaining_length_m=remaining_length_m, error_class=error_class)
