"""The type of a line of `frames.jsonl`, which pydantic checks when a file is read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal, NotRequired, TypeAlias

from pydantic import Field, RootModel
from typing_extensions import TypedDict  # pydantic takes that of typing from Python 3.12 on

from foreglow.runs.json_lines import Whole, checked
from foreglow.types.kinds import LIGHT_KINDS

Box: TypeAlias = Annotated[list[float], Field(min_length=4, max_length=4)]
"""`[x1, y1, x2, y2]`, half-open, in full-frame pixels."""

StateName: TypeAlias = Literal["tentative", "confirmed", "coasting"]
ModeName: TypeAlias = Literal["low", "glare_free", "full"]
Probability: TypeAlias = Annotated[float, Field(ge=0, le=1)]
Count: TypeAlias = Annotated[Whole, Field(ge=0)]
LightKinds: TypeAlias = Annotated[list[Probability], Field(min_length=len(LIGHT_KINDS), max_length=len(LIGHT_KINDS))]
"""The probabilities of `LIGHT_KINDS`."""

Thousandths: TypeAlias = Annotated[int, Field(ge=0, le=1000)]


@checked
class TrackEntry(TypedDict):
    """A track in a line, with the fields of `Tracks`.

    The box is rounded to 0.001 pixels, the age to a microsecond, range and sigma to a millimetre, unless that would
    leave nothing of it. Range, sigma and the probability `direct` of a lamp itself are None where unknown. `detection`
    is an index among the proposals, or -1. `light_kinds` is left out where `direct` says all that is known of the
    kinds.
    """

    id: Whole
    state: StateName
    box_xyxy_px: Box
    confidence: Probability
    num_hits: Annotated[Whole, Field(ge=1)]
    num_misses: Count
    age_s: Annotated[float, Field(ge=0)]
    range_m: float | None
    range_sigma_m: Annotated[float, Field(ge=0)] | None
    detection: Annotated[Whole, Field(ge=-1)]
    direct: NotRequired[Probability | None]
    light_kinds: NotRequired[LightKinds | None]


@checked
class VehicleEntry(TypedDict):
    """A vehicle in a line, with the fields of `Vehicles`; `tracks` has the ids of its tracks, `leading` one of them."""

    id: Whole
    state: StateName
    confidence: Probability
    is_in_sight: bool
    tracks: Annotated[list[Whole], Field(min_length=1)]
    leading: Whole


@checked
class GapEntry(TypedDict):
    """A dark gap of a beam: azimuths to 0.001 degrees, or in full where gaps would touch; range to a millimetre or
    None; otherwise as in `BeamCommand`.
    """

    right_deg: float
    left_deg: float
    range_m: float | None


@checked
class BeamEntry(TypedDict):
    """The beam command in a line, as `BeamCommand`; `levels` are those of each LED in thousandths of full."""

    mode: ModeName
    gaps: list[GapEntry]
    faults: list[str]
    levels: Annotated[list[list[Thousandths]], Field(min_length=2, max_length=2)]


@checked
class FrameLine(TypedDict):
    """A line of `frames.jsonl`; it depends on the frames and the configuration alone and not on any clock.

    Lists that have a value for each box are in the order of the proposals. If a stage did not run, its fields are None.
    Another program may write just `frame`, `proposals_xyxy_px` and perhaps `scores`: its boxes can be evaluated.

    Attributes:
        frame: Number of the frame, as in `Frame.frame`.
        sequence: Name of its sequence; empty where there is none.
        timestamp_ns: Time of exposure in nanoseconds.
        is_damaged: True where the source knows that the image is damaged (`Frame.is_damaged`); left out elsewhere.
        proposals_xyxy_px: All boxes that were proposed.
        scores: Their scores, each the exact value of the float32 that was compared with the threshold.
        direct: Probability that each box holds a lamp itself, if it holds light of a vehicle; None where it is unknown.
        light_kinds: Probability of each of `LIGHT_KINDS`, if it holds light of a vehicle; `direct` is the sum of the
            first two. Left out where the model does not tell front from rear.
        detections_xyxy_px: The accepted boxes alone.
        ranges_m: Range of each box from the camera along the viewing ray, rounded to a millimetre; None where unknown.
        range_sigmas_m: Standard deviations of the ranges; None for infinity.
        tracks: In the order of ids.
        vehicles: In the order of ids; left out where the tracker confirms tracks alone.
        beam: The beam command.
    """

    frame: Whole
    sequence: NotRequired[str]
    timestamp_ns: NotRequired[Whole]
    is_damaged: NotRequired[bool]
    proposals_xyxy_px: list[Box]
    scores: NotRequired[list[float] | None]
    direct: NotRequired[list[float | None] | None]
    light_kinds: NotRequired[list[LightKinds | None] | None]
    detections_xyxy_px: NotRequired[list[Box] | None]
    ranges_m: NotRequired[list[float | None] | None]
    range_sigmas_m: NotRequired[list[float | None] | None]
    tracks: NotRequired[list[TrackEntry] | None]
    vehicles: NotRequired[list[VehicleEntry]]
    beam: NotRequired[BeamEntry | None]


FrameLineModel = RootModel[FrameLine]


def check_boxes(line: FrameLine) -> None:
    """Passes a line whose lists with a value for each box are as long as those, and whose probabilities are such.

    Raises:
        ValueError: If it is another one; the message names the field.
    """
    num_boxes = len(line["proposals_xyxy_px"])
    check_per_box(line.get("light_kinds"), num_boxes, "light_kinds")
    check_per_box(line.get("ranges_m"), num_boxes, "ranges_m")
    check_per_box(line.get("range_sigmas_m"), num_boxes, "range_sigmas_m")
    check_probabilities(line.get("scores"), num_boxes, "scores")
    check_probabilities(line.get("direct"), num_boxes, "direct")


def check_per_box(values: Sequence[object] | None, num_boxes: int, field: str) -> None:
    """Passes a list with a value for each box, or None.

    Raises:
        ValueError: If it is longer or shorter.
    """
    if values is not None and len(values) != num_boxes:
        raise ValueError(f"{field}: expected {num_boxes}, one a box, got {len(values)}")


def check_probabilities(values: Sequence[float | None] | None, num_boxes: int, field: str) -> None:
    """As `check_per_box`, for values from 0 to 1 or None.

    Raises:
        ValueError: Also if one is outside.
    """
    check_per_box(values, num_boxes, field)
    for index, value in enumerate(values or ()):
        if value is not None and not 0 <= value <= 1:
            raise ValueError(f"{field}.{index}: expected a number from 0 to 1, got {value}")
