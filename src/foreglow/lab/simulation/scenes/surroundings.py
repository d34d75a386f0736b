"""The surroundings of the road as a part of a `Scene`, and the small types that all parts of a scene use."""

from __future__ import annotations

import itertools
from typing import Annotated, Any, Literal, TypeAlias, TypeVar

from pydantic import AfterValidator, Field, model_validator

from foreglow.config import FrozenModel
from foreglow.types.frame import MAX_SPEED_MPS

T = TypeVar("T")

MAX_ALONG_M = 100_000.0
"""Arc lengths, and times in s: the longest road has 5 km and the longest drive an hour."""

Along: TypeAlias = Annotated[float, Field(ge=-MAX_ALONG_M, le=MAX_ALONG_M)]
Profile: TypeAlias = Annotated[tuple[tuple[Along, Along], ...], Field(min_length=1, max_length=10_000)]
"""Pairs (position, value) with growing positions."""


def _growing(quantity: str) -> AfterValidator:
    """Passes spans from a smaller to a larger value of a quantity."""

    def check(span: tuple[float, float]) -> tuple[float, float]:
        if not span[0] < span[1]:
            raise ValueError(f"expected a span from a smaller to a larger {quantity}, got {span}")
        return span

    return AfterValidator(check)


TimeSpan: TypeAlias = Annotated[tuple[Along, Along], _growing("time in s")]
"""From one time to another, seconds."""

Span: TypeAlias = Annotated[tuple[Along, Along], _growing("arc length")]
"""From one arc length to another, metres."""


def _drivable(timetable: Profile) -> Profile:
    """Passes pairs with growing times and possible speeds."""
    for (begin_s, begin_m), (end_s, end_m) in itertools.pairwise(timetable):
        if end_s <= begin_s:
            raise ValueError(f"expected growing times, got {end_s:g} s after {begin_s:g} s")
        if abs(end_m - begin_m) > MAX_SPEED_MPS * (end_s - begin_s):
            raise ValueError(
                f"expected at most {MAX_SPEED_MPS:g} m/s, got {abs(end_m - begin_m) / (end_s - begin_s):.4g} m/s from "
                f"{begin_m:g} m at {begin_s:g} s to {end_m:g} m at {end_s:g} s"
            )
    return timetable


Timetable: TypeAlias = Annotated[Profile, AfterValidator(_drivable)]
"""Pairs (time in s, arc length in m) with growing times."""

MIN_SPACING_M = 0.5
"""Between posts and trees: a road of 5 km has 10,000 of them."""

MAX_TREES = 50_000
"""Trees of one wood, by its size and their spacing: the densest that we draw has 15,000 on 5 km."""

MAX_THINGS = 1000
"""Things of one kind in a scene, such as signs; each is a mesh of its own."""

# No number of a scene or camera profile is without both limits: memory, time or an overflow may depend on it.
Spacing: TypeAlias = Annotated[float, Field(ge=MIN_SPACING_M, le=5000)]
Size: TypeAlias = Annotated[float, Field(gt=0, le=500)]
Height: TypeAlias = Annotated[float, Field(gt=0, le=100)]
LowHeight: TypeAlias = Annotated[float, Field(ge=0, le=100)]
Distance: TypeAlias = Annotated[float, Field(gt=0, le=5000)]
Listed: TypeAlias = Annotated[T, Field(max_length=MAX_THINGS)]
Turn: TypeAlias = Annotated[float, Field(ge=-360, le=360)]
Luminance: TypeAlias = Annotated[float, Field(ge=0, le=1_000_000)]
Intensity: TypeAlias = Annotated[float, Field(ge=0, le=1_000_000)]
Factor: TypeAlias = Annotated[float, Field(gt=0, le=1_000_000)]
FactorOrNone: TypeAlias = Annotated[float, Field(ge=0, le=1000)]
Share: TypeAlias = Annotated[float, Field(ge=0, le=1)]
Blur: TypeAlias = Annotated[float, Field(gt=0, le=20)]
"""Standard deviation in pixels; the memory that blurring takes grows with it."""

Side: TypeAlias = Literal["left", "right"]

SignKind: TypeAlias = Literal["chevron_left", "chevron_right", "round", "triangle", "rectangle", "guide", "post_marker"]


class SpecModel(FrozenModel):
    """A part of a scene; lists, as TOML and JSON have them, become tuples."""

    @model_validator(mode="before")
    @classmethod
    def _with_tuples(cls, fields: Any) -> Any:
        return {name: _as_tuple(value) for name, value in fields.items()} if isinstance(fields, dict) else fields


def _as_tuple(value: Any) -> Any:
    return tuple(_as_tuple(part) for part in value) if isinstance(value, list | tuple) else value


class _At(SpecModel):
    """A thing beside the road.

    Attributes:
        side: Side of the road.
        s_m: Position of its middle along the road.
    """

    side: Side
    s_m: Along


class _Along(SpecModel):
    """A thing along the road.

    Attributes:
        side: Side of the road.
        span_m: Begin and end along the road.
    """

    side: Side
    span_m: Span


class Rail(_Along):
    """A guardrail.

    Attributes:
        offset_m: From the edge of the carriageway to the rail's face.
        post_spacing_m: Distance between posts.
    """

    offset_m: Size = 0.8
    post_spacing_m: Spacing = 4.0


class Wall(_Along):
    """A wall along the road.

    Attributes:
        offset_m: From the edge of the carriageway.
        height_m: Height above the ground.
        material: Its material.
    """

    offset_m: Size = 2.0
    height_m: Height = 1.2
    material: Literal["concrete", "brick", "plaster", "rock"] = "concrete"


class Sign(_At):
    """A retroreflective sign.

    Attributes:
        kind: Shape and picture.
        offset_m: From the edge of the carriageway.
        height_m: Height of its lower edge above the ground.
        size_m: Its width.
        faces_oncoming: Whether it faces oncoming traffic, so that we see its dull back.
    """

    kind: SignKind
    offset_m: Size = 1.2
    height_m: LowHeight = 1.8
    size_m: Size = 0.6
    faces_oncoming: bool = False


class Woods(_Along):
    """Trees along one side.

    Attributes:
        offset_m: From the edge of the carriageway to the first trees.
        depth_m: Depth of the wood; 0 for a single row of trees.
        spacing_m: Mean distance between trees.
        leaves: From 0, bare, to 1, in full leaf.
        height_m: Height of a tree.
        has_undergrowth: Whether bushes stand between and in front of the trees.
    """

    offset_m: Size = 5.0
    depth_m: Annotated[float, Field(ge=0, le=500)] = 25.0
    spacing_m: Spacing = 4.0
    leaves: Share = 0.5
    height_m: Height = 12.0
    has_undergrowth: bool = True

    @model_validator(mode="after")
    def _check(self) -> Woods:
        num_trees = (self.span_m[1] - self.span_m[0]) * max(self.depth_m, self.spacing_m) / self.spacing_m**2
        if num_trees > MAX_TREES:
            raise ValueError(f"spacing_m: expected at most {MAX_TREES} trees in a wood, got {num_trees:.0f}")
        return self


class House(_At):
    """A house with a gable roof.

    Attributes:
        offset_m: From the edge of the carriageway to its front.
        size_m: Length along the road, depth, and height of the walls.
        num_lit_windows: Number of lit windows.
        window_cd_m2: Luminance of a lit window.
        has_panes: Whether lit windows are surfaces behind their frames; otherwise each is a few points of light.
        shop_cd_m2: Luminance of shop windows along the whole ground floor; 0 for none.
        yaw_deg: Rotation away from the direction of the road.
    """

    offset_m: Size = 8.0
    size_m: tuple[Size, Size, Size] = (10.0, 8.0, 5.0)
    num_lit_windows: Annotated[int, Field(ge=0, le=60)] = 2
    window_cd_m2: Luminance = 30.0
    has_panes: bool = False
    shop_cd_m2: Luminance = 0.0
    yaw_deg: Turn = 0.0


class StreetLamp(_At):
    """A lamp on a pole.

    Attributes:
        offset_m: From the edge of the carriageway.
        height_m: Height of the light above the ground.
        intensity_cd: Intensity straight down; 0 for a lamp that is off.
    """

    offset_m: Size = 1.5
    height_m: Height = 6.0
    intensity_cd: Intensity = 900.0


class Panel(_At):
    """A lit billboard on posts, which faces us.

    Attributes:
        offset_m: From the edge of the carriageway to its nearer edge.
        height_m: Height of its lower edge above the ground.
        size_m: Width and height.
        screen_cd_m2: Its mean luminance.
        yaw_deg: Rotation away from facing us, towards the road.
    """

    offset_m: Size = 3.0
    height_m: LowHeight = 2.5
    size_m: tuple[Size, Size] = (3.6, 2.7)
    screen_cd_m2: Luminance = 150.0
    yaw_deg: Turn = 0.0


class Settlement(SpecModel):
    """The lamps of a place in the distance: points of light, without posts or houses.

    Attributes:
        side: Side of the road.
        s_m: Position of its middle along the road, which is straight beyond its end.
        offset_m: From the road to its middle.
        size_m: Length along the road and width across.
        height_m: Height of its highest lamps above the road.
        num_lamps: Number of its lamps.
        intensity_cd: Median intensity of a lamp towards us.
    """

    side: Side
    s_m: Along
    offset_m: Annotated[float, Field(ge=0, le=5000)] = 0.0
    size_m: tuple[Distance, Distance] = (600.0, 800.0)
    height_m: Height = 15.0
    num_lamps: Annotated[int, Field(ge=1, le=500)] = 40
    intensity_cd: Annotated[float, Field(gt=0, le=1_000_000)] = 150.0


class Signal(_At):
    """A traffic light on a mast, or on an arm above the road.

    Attributes:
        offset_m: From the edge of the carriageway to the mast.
        height_m: Height of the housing's lower edge above the ground.
        arm_m: Length of the arm that reaches over the road.
        lit: Which of its three lenses is lit.
        intensity_cd: Intensity of the lit lens on its axis; 0 for a signal that is off.
        faces_oncoming: Whether it faces oncoming traffic, so that we see its back.
    """

    offset_m: Size = 0.8
    height_m: Height = 2.4
    arm_m: Annotated[float, Field(ge=0, le=15)] = 0.0
    lit: Literal["red", "amber", "green"] = "red"
    intensity_cd: Intensity = 200.0
    faces_oncoming: bool = False


class Gantry(_At):
    """Guide signs on a beam above the carriageway of one side, facing its traffic.

    Attributes:
        height_m: Height of the signs' lower edges above the road.
        signs_m: Width of each sign, from the edge of the road inwards.
    """

    height_m: Height = 5.6
    signs_m: Annotated[tuple[Size, ...], Field(min_length=1, max_length=5)] = (4.0, 3.0)


class Bridge(SpecModel):
    """Another road's bridge above ours.

    Attributes:
        s_m: Position of its middle along our road.
        width_m: Its width along our road.
        height_m: Height of its lower edge above our road.
    """

    s_m: Along
    width_m: Annotated[float, Field(ge=2, le=60)] = 10.0
    height_m: Annotated[float, Field(ge=4, le=20)] = 5.2


class Verge(SpecModel):
    """The ground on one side of the carriageway.

    Attributes:
        bank_m: Height of the bank, which rises within a few metres; negative for an embankment.
        bank_offset_m: From the edge of the carriageway to the foot of the bank.
        ditch_m: Depth of a ditch in front of it.
        ground: Cover of the ground.
        snow: Share of the ground under snow, drifts first.
        grass_height_m: Height of the blades; 0 for none.
        grass_per_m2: Number of blades near the road.
    """

    bank_m: Annotated[float, Field(ge=-10, le=15)] = 0.5
    bank_offset_m: Annotated[float, Field(ge=0, le=500)] = 2.0
    ditch_m: Annotated[float, Field(ge=0, le=10)] = 0.2
    ground: Literal["grass_ground", "soil", "gravel", "pavement"] = "grass_ground"
    snow: Share = 0.0
    grass_height_m: Annotated[float, Field(ge=0, le=5)] = 0.12
    grass_per_m2: Annotated[float, Field(ge=0, le=10_000)] = 20.0


class SurroundingsSpec(SpecModel):
    """The surroundings of the road.

    Attributes:
        left: The ground to the left.
        right: The ground to the right.
        rails: Guardrails.
        walls: Walls.
        signs: Traffic signs and chevrons.
        woods: Rows of trees and forests.
        houses: Houses.
        street_lamps: Lamps on poles.
        panels: Lit billboards.
        signals: Traffic lights.
        gantries: Guide signs above the road.
        bridges: Bridges above the road.
        settlements: Lamps of places in the distance.
        delineator_spacing_m: Distance between posts with reflectors on both sides; 0 for none.
        num_bushes: Number of single bushes.
    """

    left: Verge = Verge()
    right: Verge = Verge()
    rails: Listed[tuple[Rail, ...]] = ()
    walls: Listed[tuple[Wall, ...]] = ()
    signs: Listed[tuple[Sign, ...]] = ()
    woods: Listed[tuple[Woods, ...]] = ()
    houses: Listed[tuple[House, ...]] = ()
    street_lamps: Listed[tuple[StreetLamp, ...]] = ()
    panels: Listed[tuple[Panel, ...]] = ()
    signals: Listed[tuple[Signal, ...]] = ()
    gantries: Listed[tuple[Gantry, ...]] = ()
    bridges: Listed[tuple[Bridge, ...]] = ()
    settlements: Annotated[tuple[Settlement, ...], Field(max_length=20)] = ()
    delineator_spacing_m: Annotated[float, Field(ge=0, le=5000)] = 50.0
    num_bushes: Annotated[int, Field(ge=0, le=2000)] = 0

    @model_validator(mode="after")
    def _check(self) -> SurroundingsSpec:
        if 0 < self.delineator_spacing_m < MIN_SPACING_M:
            raise ValueError(
                f"delineator_spacing_m: expected 0 for none, or at least {MIN_SPACING_M:g} m, "
                f"got {self.delineator_spacing_m:g}"
            )
        return self
