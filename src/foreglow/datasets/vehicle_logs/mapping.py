"""The meaning of a DBC's signals: a TOML file that users write for their own car.

Values of signals are scaled as the DBC says. A section names its message, and a signal for each field; fields with a
default may be left out. `street.toml` in this folder is the mapping of our own `street.dbc`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from foreglow.config import FrozenModel
from foreglow.config.fields import ONE_OF
from foreglow.street import MAX_RADIUS_M, MIN_RADIUS_M, STRAIGHT_CODE

MIN_FACTOR, MAX_FACTOR = 1e-9, 100.0
"""In amount: units of speeds and yaw rates are at most some m/s and rad/s, raw codes tiny parts of them."""


class Section(FrozenModel):
    """Fields that come in the same message.

    Attributes:
        message: Its name in the DBC.
        SIGNS: Fields with signals of either sign, and the fields that may name a signal for the sign.
    """

    SIGNS: ClassVar[Mapping[str, str]] = MappingProxyType({})

    message: str

    def signals(self) -> dict[str, str]:
        """The signals that the section names, by its fields."""
        fields = self.model_dump(exclude={"message"}, exclude_none=True)
        return {field: value for field, value in fields.items() if isinstance(value, str)}


class SlopeSignals(Section):
    """A frame with the slope of a segment.

    Attributes:
        segment_id: The segment's number.
        slope_percent: Its slope.
        is_downhill: 1 where the slope is negative; None if it has a sign.
    """

    SIGNS = MappingProxyType({"slope_percent": "is_downhill"})

    segment_id: str
    slope_percent: str
    is_downhill: str | None = None


class SegmentSignals(Section):
    """A frame with a segment.

    Attributes:
        segment_id: Its number, 1..62; frames with another number are ignored.
        parent_id: The number of the segment before it.
        length_m: Its length; frames with 0 are ignored.
        start_curvature: Curvature at its beginning, see `CurvatureMeaning`.
        end_curvature: Curvature at its end.
        is_start_left: The direction of the bend at its beginning; None if the curvature has a sign (positive: left).
        is_end_left: The direction of the bend at its end.
        slope_percent: Its slope; None if another message has it, or no message has it: then the segment is level.
        is_downhill: 1 where the slope is negative; None if it has a sign.
        is_probable: 1 where the segment is on the most probable path; other segments are ignored. None: all are on it.
    """

    SIGNS = MappingProxyType(
        {"start_curvature": "is_start_left", "end_curvature": "is_end_left", "slope_percent": "is_downhill"}
    )

    segment_id: str
    parent_id: str
    length_m: str
    start_curvature: str
    end_curvature: str
    is_start_left: str | None = None
    is_end_left: str | None = None
    slope_percent: str | None = None
    is_downhill: str | None = None
    is_probable: str | None = None


class PositionSignals(Section):
    """A frame with the assumed position of the vehicle.

    Attributes:
        segment_id: The segment it is in; a number beyond 1..62 is an unknown position.
        remaining_length_m: To the end of that segment; above 254 is unknown.
        error_class: Class of the longitudinal error; above the last class is unknown.
        first_error_class: The value of `error_class` for an error below 2 m.
        num_segments: Number of segments of the message; None: as many as follow each other.
    """

    segment_id: str
    remaining_length_m: str
    error_class: str
    first_error_class: Annotated[int, Field(ge=0, lt=2**32)] = 0
    num_segments: str | None = None


class CurvatureMeaning(FrozenModel):
    """The meaning of the signals of curvature.

    Attributes:
        meaning: `code`: radii in equal ratios; `radius_m`; `per_m`, the curvature itself. A radius of 0 is straight.
        straight_code: The code of a straight road; the codes below it are the radii.
        min_radius_m: Radius of code 0.
        max_radius_m: Radius of the last code before straight.
        left_when: Value of `is_start_left` and `is_end_left` that means left.
    """

    meaning: Literal["code", "radius_m", "per_m"] = "code"
    straight_code: Annotated[int, Field(ge=2, lt=2**32)] = STRAIGHT_CODE
    min_radius_m: Annotated[float, Field(gt=0)] = MIN_RADIUS_M
    max_radius_m: Annotated[float, Field(gt=0)] = MAX_RADIUS_M
    left_when: Annotated[Literal[0, 1], ONE_OF] = 1

    @model_validator(mode="after")
    def _check(self) -> CurvatureMeaning:
        if self.max_radius_m <= self.min_radius_m:
            raise ValueError(f"max_radius_m: expected more than min_radius_m, {self.min_radius_m:g}")
        return self

    def per_m(self, value: float) -> float:
        """The curvature, 1/m, that a signal's value means; it keeps the value's sign."""
        if self.meaning == "per_m":
            return value
        if self.meaning == "radius_m":
            return 1.0 / value if value else 0.0
        code = abs(value)
        if code >= self.straight_code:
            return 0.0
        ratio = self.max_radius_m / self.min_radius_m
        return math.copysign(ratio ** (-code / (self.straight_code - 1)) / self.min_radius_m, value)


class NumberSignal(Section):
    """A single number.

    Attributes:
        signal: Name of its signal.
        factor: From the signal's unit to ours: 0.277778 for km/h, 0.0174533 for degrees; in amount within `MIN_FACTOR`
            and `MAX_FACTOR`. None: that of the DBC's unit.
        is_negative: 1 where the signal is negative; None if it has a sign.
    """

    signal: str
    factor: float | None = None
    is_negative: str | None = None

    @model_validator(mode="after")
    def _check(self) -> NumberSignal:
        if self.factor is not None and not MIN_FACTOR <= abs(self.factor) <= MAX_FACTOR:
            raise ValueError(f"factor: expected from {MIN_FACTOR:g} to {MAX_FACTOR:g} in amount, got {self.factor:g}")
        if self.is_negative == self.signal:
            raise ValueError(f"is_negative: expected another signal than {self.signal!r}, whose number it gives a sign")
        return self


class SignedNumber(NumberSignal):
    """A number of either sign."""

    SIGNS = MappingProxyType({"signal": "is_negative"})


class CanMapping(FrozenModel):
    """The whole mapping: the road, the motion, the production system, or several of them.

    Attributes:
        segment: Needs `position`.
        position: Needs `segment`.
        slope: Slopes in a separate message.
        curvature: The meaning of curvatures.
        speed: Forward speed, m/s; needs `yaw_rate`.
        yaw_rate: Rate of turn to the left, rad/s; needs `speed`.
        production: How many vehicles the production system reports, or 1 for any; it reports none at 0.
        bus: The bus that is read, of a log of several on which the same identifier may mean something else: `can0` in
            candump's logs, the number of the channel in Vector's. None: each message must come from one bus.
    """

    segment: SegmentSignals | None = None
    position: PositionSignals | None = None
    slope: SlopeSignals | None = None
    curvature: CurvatureMeaning = CurvatureMeaning()
    speed: NumberSignal | None = None
    yaw_rate: SignedNumber | None = None
    production: NumberSignal | None = None
    bus: Annotated[str, Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _check(self) -> CanMapping:
        for first, second in (("segment", "position"), ("speed", "yaw_rate")):
            if (getattr(self, first) is None) != (getattr(self, second) is None):
                raise ValueError(f"{first}, {second}: expected both sections or neither")
        if self.segment is None and self.speed is None and self.production is None:
            raise ValueError("expected the sections segment and position, speed and yaw_rate, or production, or more")
        if self.slope is not None and self.segment is None:
            raise ValueError("slope: expected a section segment beside it")
        return self

    def sections(self) -> Iterator[tuple[str, Section]]:
        """The sections that name a message, with their names."""
        for name in ("segment", "position", "slope", "speed", "yaw_rate", "production"):
            section = getattr(self, name)
            if section is not None:
                yield name, section
