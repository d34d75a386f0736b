"""From the frames in which a car sends the road piece by piece to street messages."""

from __future__ import annotations

from collections.abc import Mapping

from foreglow.datasets.vehicle_logs.mapping import CanMapping, CurvatureMeaning
from foreglow.street import (
    ERROR_BOUNDS_M,
    LENGTH_STEP_M,
    MAX_LENGTH_CODE,
    NUM_SEGMENT_IDS,
    StreetMessage,
    StreetSegment,
    curvature_code,
    slope_code,
)

SEGMENT_STALE_NS = 10_000_000_000
"""Older segments are not used: ids are used again along the road, and cars repeat what is still valid."""


class StreetFrames:
    """Keeps the segments that were received, and makes a message of those ahead of each position."""

    def __init__(self, mapping: CanMapping) -> None:
        self._mapping = mapping
        self._segments: dict[int, tuple[StreetSegment, int]] = {}
        self._slope_codes: dict[int, int] = {}
        self._child_of: dict[int, int] = {}

    def add_segment(self, values: Mapping[str, float], time_ns: int) -> None:
        """Takes a frame of the section `segment`, its values by field; ignores a frame without a valid segment."""
        number, parent = round(values["segment_id"]), round(values["parent_id"])
        length_code = round(values["length_m"] / LENGTH_STEP_M)
        is_valid = 1 <= number <= NUM_SEGMENT_IDS and 0 <= parent <= NUM_SEGMENT_IDS
        if not is_valid or not 1 <= length_code <= MAX_LENGTH_CODE or not values.get("is_probable", 1):
            return
        meaning = self._mapping.curvature
        start, end = (_curvature_per_m(values, which, meaning) for which in ("start", "end"))
        segment = StreetSegment(
            segment_id=number,
            parent_id=parent,
            length_code=length_code,
            start_curvature_code=curvature_code(start),
            is_start_left=start > 0 or _says_left(values, "start", meaning),
            end_curvature_code=curvature_code(end),
            is_end_left=end > 0 or _says_left(values, "end", meaning),
            slope_code=_slope_code(values),
        )
        if number in self._segments and self._segments[number][0] != segment:
            self._slope_codes.pop(number, None)  # of another segment with this number
        self._segments[number] = segment, time_ns
        self._child_of[parent] = number

    def add_slope(self, values: Mapping[str, float]) -> None:
        """Takes a frame of the section `slope`; ignores one of a number that no segment has."""
        number = round(values["segment_id"])
        if 1 <= number <= NUM_SEGMENT_IDS:
            self._slope_codes[number] = _slope_code(values)

    def message(self, values: Mapping[str, float], time_ns: int) -> StreetMessage | None:
        """The message of a frame of the section `position` and the segments before it; None if it is incomplete."""
        position = self._mapping.position
        first_class = position.first_error_class if position is not None else 0
        error_class, remaining_m = round(values["error_class"]) - first_class, round(values["remaining_length_m"])
        if not (0 <= error_class < len(ERROR_BOUNDS_M) and 0 <= remaining_m <= MAX_LENGTH_CODE * LENGTH_STEP_M):
            return None
        needed = round(values["num_segments"]) if "num_segments" in values else None
        chain = self._chain(round(values["segment_id"]), time_ns, needed or NUM_SEGMENT_IDS)
        if not chain or len(chain) < (needed or 0):
            return None
        return StreetMessage(segments=tuple(chain), remaining_length_m=remaining_m, error_class=error_class)

    def _chain(self, number: int | None, time_ns: int, most: int) -> list[StreetSegment]:
        chain: list[StreetSegment] = []
        seen: set[int] = set()
        while number is not None and number in self._segments and number not in seen and len(chain) < most:
            segment, received_ns = self._segments[number]
            is_next = not chain or segment.parent_id == chain[-1].segment_id
            if not is_next or time_ns - received_ns > SEGMENT_STALE_NS:
                break
            code = self._slope_codes.get(number)
            chain.append(segment if code is None else segment.model_copy(update={"slope_code": code}))
            seen.add(number)
            number = self._child_of.get(number)
        return chain


def segment_values(segment: StreetSegment) -> dict[str, float]:
    """The values of the section `segment`, by field, with curvatures as our codes."""
    return {
        "segment_id": segment.segment_id,
        "parent_id": segment.parent_id,
        "length_m": segment.length_m,
        "start_curvature": segment.start_curvature_code,
        "is_start_left": segment.is_start_left,
        "end_curvature": segment.end_curvature_code,
        "is_end_left": segment.is_end_left,
        "slope_percent": 100.0 * segment.slope,
    }


def position_values(message: StreetMessage) -> dict[str, float]:
    """The values of the section `position`, by field."""
    return {
        "segment_id": message.segments[0].segment_id,
        "remaining_length_m": message.remaining_length_m,
        "error_class": message.error_class,
        "num_segments": len(message.segments),
    }


def _curvature_per_m(values: Mapping[str, float], which: str, meaning: CurvatureMeaning) -> float:
    """Signed curvature at the start or end of a segment, positive to the left."""
    curvature = meaning.per_m(values[f"{which}_curvature"])
    if f"is_{which}_left" not in values:
        return curvature
    return abs(curvature) if _says_left(values, which, meaning) else -abs(curvature)


def _says_left(values: Mapping[str, float], which: str, meaning: CurvatureMeaning) -> bool:
    return values.get(f"is_{which}_left") == meaning.left_when


def _slope_code(values: Mapping[str, float]) -> int:
    slope = values.get("slope_percent", 0.0) / 100.0
    return slope_code(-abs(slope) if values.get("is_downhill") else slope)
