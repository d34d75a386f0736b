"""Roads in an OpenDRIVE file (.xodr).

The reader takes the reference line (line, arc, spiral, paramPoly3), elevation, superelevation, the lane offset and the
widths of the lanes up to the last driving one. The middle of the driving lanes is the centre line. It ignores lane
heights, crossfall and shape. The frame is the file's own; its geo-reference is not evaluated, so poses must be in the
same metres.

Source: ASAM OpenDRIVE 1.4 to 1.8.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from foreglow.geometry import Floats
from foreglow.maps.centre_line import (
    STEP_M,
    CentreLine,
    PointCount,
    check_points,
    check_steps,
    check_width,
    without_repeats,
)
from foreglow.maps.road_map import RoadMap
from foreglow.maps.xml_file import number_of, read_xml
from foreglow.street import LANE_WIDTH_M
from foreglow.wording import shortened

MAX_ROLL_RAD = 1.0
"""The largest superelevation of a road; the steepest of a race track has .6 rad."""

MAX_HEADING_RAD = 1000.0
"""Of a geometry; far beyond a full turn its sine has no digits left."""

SHAPES = ("line", "arc", "spiral", "paramPoly3")

MAX_GAP_M = 1.0
"""Where a geometry or a road ends by its length, the next one begins, or the road ends, to this. Without the rest of a
road its last geometry would go on, in a spiral with ever sharper bends."""

WIDTH_TOLERANCE_M = 0.1
"""A lane's widths begin no later behind the beginning of its section, and none falls further below 0."""

MAX_STEP_M = 5.0
"""Neighbouring points of a reference line, `STEP_M` apart along it, are no further apart than this."""

LENGTH_TOLERANCE = 0.1
"""A geometry is as long as it says to this share, and `MAX_GAP_M`: where a cubic's parameter is another than the one
that it states, the road would be squeezed into a metre."""

MAX_CURVATURE_PER_M = 1.0
"""The sharpest bend of a road has a radius of some metres."""

DRIVEN_LANES = frozenset(
    [
        "driving",
        "bidirectional",
        "entry",
        "exit",
        "onRamp",
        "offRamp",
        "connectingRamp",
        "slipLane",
        "mwyEntry",
        "mwyExit",
        "HOV",
        "bus",
        "taxi",
    ]
)
"""Types of lanes that vehicles drive on, and of all others, in OpenDRIVE 1.4 to 1.8: a lane of a type that is misspelt
would be left out, and the road lie beside the real one."""

OTHER_LANES = frozenset(
    [
        "none",
        "border",
        "curb",
        "median",
        "parking",
        "restricted",
        "roadWorks",
        "rail",
        "tram",
        "shoulder",
        "stop",
        "biking",
        "sidewalk",
        "walking",
        "shared",
        "special1",
        "special2",
        "special3",
    ]
)
_COEFFICIENTS = ("a", "b", "c", "d")
_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(4)


def read_opendrive(path: Path) -> RoadMap:
    """The roads of an OpenDRIVE file with a driving lane, or with no lanes at all: these are taken as two lanes wide.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not OpenDRIVE, a number is missing or broken, a geometry is of an unknown kind, a road has
            gaps or steps, a lane is of an unknown type, or a driving one has borders in place of widths, or there is no
            road; the message names path and road.
    """
    roads, count = read_xml(path, "OpenDRIVE").findall("road"), PointCount()
    lines = [line for road in roads if (line := _line(road, count, f"{path}: road {road.get('id')}")) is not None]
    if not lines:
        raise ValueError(f"{path}: expected at least one <road> with a driving lane, got none of {len(roads)}")
    return RoadMap(lines)


def _line(road: Element, count: PointCount, origin: str) -> CentreLine | None:
    """The middle of a road's driving lanes; None if it has other lanes only."""
    length_m = number_of(road, "length", origin)
    if length_m < 0:
        raise ValueError(f"{origin}: length: expected at least 0 m, got {length_m:g}")
    if length_m < 1e-3:
        return None
    count.add(length_m, origin)
    ways_m = np.append(np.arange(0.0, length_m - 1e-3, STEP_M), length_m)
    reference = _reference(road, ways_m, origin)
    edges = _edges_m(road, ways_m, origin)
    if edges is None:
        return None
    right_m, left_m = edges
    middle_m = _cubics(road.findall("lanes/laneOffset"), ways_m, "s", origin) + (left_m + right_m) / 2
    roll_rad = _cubics(road.findall("lateralProfile/superelevation"), ways_m, "s", origin)
    if not (np.abs(roll_rad) <= MAX_ROLL_RAD).all():
        worst_rad = float(np.abs(roll_rad).max())
        raise ValueError(f"{origin}: superelevation: expected up to {MAX_ROLL_RAD:g} rad, got {worst_rad:g}")
    level_m = middle_m * np.cos(roll_rad)
    points = np.stack(
        [
            reference[:, 0] - level_m * np.sin(reference[:, 2]),
            reference[:, 1] + level_m * np.cos(reference[:, 2]),
            _cubics(road.findall("elevationProfile/elevation"), ways_m, "s", origin) + middle_m * np.sin(roll_rad),
        ],
        -1,
    )
    # Superelevation is positive where the road falls to the right: it rises to the left.
    whole = without_repeats(np.column_stack([points, np.tan(roll_rad)]))
    if len(whole) < 2:
        return None
    check_points(whole[:, :3], origin)
    check_steps(whole[:, :3], f"{origin}: elevation, every metre")
    width_m = float(np.mean(left_m - right_m))
    check_width(width_m, f"{origin}: lanes")
    return CentreLine(whole[:, :3], width_m / 2, whole[:, 3])


def _reference(road: Element, ways_m: Floats, origin: str) -> Floats:
    """x, y and heading of the reference line, shape (N, 3), at distances along it."""
    found_geometries = ((number_of(geometry, "s", origin), geometry) for geometry in road.findall("planView/geometry"))
    geometries = sorted(found_geometries, key=lambda pair: pair[0])
    if not geometries:
        raise ValueError(f"{origin}: planView: expected at least one <geometry>, got none")
    ends_m = [0.0, *(s + number_of(geometry, "length", origin) for s, geometry in geometries)]
    for end_m, begin_m in zip(ends_m, [*(s for s, _ in geometries), float(ways_m[-1])], strict=True):
        if abs(end_m - begin_m) > MAX_GAP_M:
            expected = "expected geometries one after the other, from 0 to the road's length"
            raise ValueError(
                f"{origin}: planView: {expected}, got one to s = {end_m:g} m and the next from {begin_m:g} m"
            )
    numbers = np.clip(np.searchsorted([s for s, _ in geometries], ways_m, side="right") - 1, 0, None)
    found = np.empty((len(ways_m), 3))
    for number in np.unique(numbers).tolist():
        here = slice(*np.searchsorted(numbers, (number, number + 1)))
        begin_m, geometry = geometries[number]
        x, y, heading = (number_of(geometry, name, origin) for name in ("x", "y", "hdg"))
        if abs(heading) > MAX_HEADING_RAD:
            raise ValueError(f"{origin}: geometry: hdg: expected at most {MAX_HEADING_RAD:g} rad, got {heading:g}")
        own = _curve(geometry, ways_m[here] - begin_m, origin)
        if not np.isfinite(own).all():
            shape = next((shape.tag for shape in geometry if shape.tag in SHAPES), "no shape")
            raise ValueError(
                f"{origin}: geometry at s = {begin_m:g} m: expected finite places, got others by its {shape}"
            )
        span_m, drawn_m = np.ptp(ways_m[here]), np.hypot(*np.diff(own[:, :2], axis=0).T).sum()
        if drawn_m < (1 - LENGTH_TOLERANCE) * span_m - MAX_GAP_M:
            expected = f"expected a line of {span_m:g} m, as its length says, got {drawn_m:.3g} m"
            raise ValueError(f"{origin}: geometry at s = {begin_m:g} m: {expected} (is its pRange right?)")
        turned_x = own[:, 0] * np.cos(heading) - own[:, 1] * np.sin(heading)
        turned_y = own[:, 0] * np.sin(heading) + own[:, 1] * np.cos(heading)
        found[here] = np.stack([x + turned_x, y + turned_y, heading + own[:, 2]], -1)
    steps_m = np.hypot(*np.diff(found[:, :2], axis=0).T)
    if not (steps_m <= MAX_STEP_M).all():
        worst = int(steps_m.argmax())
        gap = f"{steps_m[worst]:g} m at s = {ways_m[worst]:g} m"
        raise ValueError(f"{origin}: planView: expected a line without gaps, got one of {gap}")
    return found


def _curve(geometry: Element, ways_m: Floats, origin: str) -> Floats:
    """x, y and heading of a geometry in its own frame, shape (N, 3), at distances from its beginning."""
    length_m = number_of(geometry, "length", origin)
    if sum(shape.tag in SHAPES for shape in geometry) > 1:
        raise ValueError(f"{origin}: geometry: expected one shape, got {', '.join(shape.tag for shape in geometry)}")
    for shape in geometry:
        if shape.tag == "line":
            return _clothoid(0.0, 0.0, ways_m)
        if shape.tag == "arc":
            return _clothoid(_curvature_per_m(shape, "curvature", origin), 0.0, ways_m)
        if shape.tag == "spiral":
            start, end = (_curvature_per_m(shape, name, origin) for name in ("curvStart", "curvEnd"))
            return _clothoid(start, (end - start) / max(length_m, 1e-9), ways_m)
        if shape.tag == "paramPoly3":
            is_arc_length = shape.get("pRange") == "arcLength"
            return _parametric(shape, ways_m if is_arc_length else ways_m / max(length_m, 1e-9), origin)
    kinds = ", ".join(shape.tag for shape in geometry) or "nothing"
    raise ValueError(f"{origin}: geometry: expected line, arc, spiral or paramPoly3, got {kinds}")


def _curvature_per_m(shape: Element, name: str, origin: str) -> float:
    value = number_of(shape, name, origin)
    if abs(value) > MAX_CURVATURE_PER_M:
        raise ValueError(f"{origin}: <{shape.tag}> {name}: expected up to {MAX_CURVATURE_PER_M:g} per m, got {value:g}")
    return value


def _clothoid(curvature_per_m: float, change_per_m2: float, ways_m: Floats) -> Floats:
    """x, y and heading of a curve with linear curvature, at rising distances from its beginning."""
    starts, steps = np.concatenate([[0.0], ways_m[:-1]]), np.diff(ways_m, prepend=0.0)
    nodes = starts[:, None] + steps[:, None] * (_GAUSS_NODES + 1) / 2
    headings = curvature_per_m * nodes + change_per_m2 / 2 * nodes**2
    x = np.cumsum((np.cos(headings) @ _GAUSS_WEIGHTS) * steps / 2)
    y = np.cumsum((np.sin(headings) @ _GAUSS_WEIGHTS) * steps / 2)
    return np.stack([x, y, curvature_per_m * ways_m + change_per_m2 / 2 * ways_m**2], -1)


@np.errstate(over="ignore", invalid="ignore")  # the points are checked when they make a line
def _parametric(shape: Element, parameters: Floats, origin: str) -> Floats:
    """x, y and heading of a curve whose x and y are cubics of a parameter."""
    powers = np.stack([parameters**k for k in range(4)])
    slopes = np.stack([k * parameters ** max(k - 1, 0) for k in range(4)])
    u, v = (np.array([number_of(shape, name + axis, origin) for name in _COEFFICIENTS]) for axis in "UV")
    return np.stack([u @ powers, v @ powers, np.arctan2(v @ slopes, u @ slopes)], -1)


@np.errstate(over="ignore", invalid="ignore")  # likewise
def _cubics(pieces: list[Element], ways_m: Floats, begin: str, origin: str) -> Floats:
    """Piecewise cubics a + b ds + c ds^2 + d ds^3, each from its `begin` on, shape (N,); 0 before the first."""
    pieces = sorted(pieces, key=lambda piece: number_of(piece, begin, origin))
    begins_m = np.array([number_of(piece, begin, origin) for piece in pieces])
    terms = [
        [number_of(piece, "a", origin), *(number_of(piece, name, origin, 0.0) for name in _COEFFICIENTS[1:])]
        for piece in pieces
    ]
    numbers = np.searchsorted(begins_m, ways_m + 1e-9, side="right")  # 0 before the first
    a, b, c, d = np.array([[0.0] * 4, *terms])[numbers].T
    ds_m = ways_m - np.concatenate([[0.0], begins_m])[numbers]
    return np.asarray(a + ds_m * (b + ds_m * (c + ds_m * d)))


def _is_driven(lane: Element, origin: str) -> bool:
    kind = lane.get("type", "driving")
    if kind not in DRIVEN_LANES | OTHER_LANES:
        expected = f"expected one of {', '.join(sorted(DRIVEN_LANES | OTHER_LANES, key=str.lower))}"
        raise ValueError(f"{origin}: lane {lane.get('id')}: type: {expected}, got {shortened(kind)}")
    return kind in DRIVEN_LANES


def _width_m(lane: Element, ways_m: Floats, origin: str) -> Floats:
    """The lane's width at distances from the beginning of its section."""
    name, widths = f"{origin}: lane {lane.get('id')}", lane.findall("width")
    first_m = min((number_of(width, "sOffset", origin) for width in widths), default=None)
    if first_m is None or abs(first_m) > WIDTH_TOLERANCE_M:
        got = "none" if first_m is None else f"the first one from {first_m:g} m on"
        raise ValueError(f"{name}: expected <width> from sOffset 0 on, got {got}")
    width_m = _cubics(widths, ways_m, "sOffset", name)
    if width_m.size and width_m.min() < -WIDTH_TOLERANCE_M:
        raise ValueError(f"{name}: width: expected at least 0 m, got {width_m.min():g}")
    return width_m


def _edges_m(road: Element, ways_m: Floats, origin: str) -> tuple[Floats, Floats] | None:
    """Right and left edge of the driving lanes, shape (N,) each, left of the lane offset; None without such lanes.

    What lies between driving lanes, such as a median, belongs to them. Both edges are 0 where a section has none.
    """
    sections = road.findall("lanes/laneSection")
    if not sections:
        return np.full(len(ways_m), -LANE_WIDTH_M), np.full(len(ways_m), LANE_WIDTH_M)
    sections = sorted(sections, key=lambda section: number_of(section, "s", origin))
    begins_m = np.array([number_of(section, "s", origin) for section in sections])
    numbers = np.clip(np.searchsorted(begins_m, ways_m + 1e-9, side="right") - 1, 0, None)
    right_m, left_m = np.full(len(ways_m), np.inf), np.full(len(ways_m), -np.inf)
    for number, section in enumerate(sections):
        here = slice(*np.searchsorted(numbers, (number, number + 1)))
        for side, sign in (("left", 1), ("right", -1)):
            lanes = sorted(section.findall(f"{side}/lane"), key=lambda lane: abs(number_of(lane, "id", origin)))
            are_driven = [_is_driven(lane, origin) for lane in lanes]
            inner_m = np.zeros(len(ways_m[here]))
            while any(are_driven):  # from the middle to the last one, with what lies before it
                lane, is_driven = lanes.pop(0), are_driven.pop(0)
                if lane.find("border") is not None:
                    raise ValueError(f"{origin}: lane {lane.get('id')}: expected <width>, got <border>, not read")
                width_m = _width_m(lane, ways_m[here] - begins_m[number], origin)
                outer_m = inner_m + width_m
                if is_driven:
                    is_there = width_m > 0
                    ends_m = np.sort([sign * inner_m[is_there], sign * outer_m[is_there]], axis=0)
                    right_m[here][is_there] = np.minimum(right_m[here][is_there], ends_m[0])
                    left_m[here][is_there] = np.maximum(left_m[here][is_there], ends_m[1])
                inner_m = outer_m
    has_lane = left_m > right_m
    if not has_lane.any():
        return None
    return np.where(has_lane, right_m, 0.0), np.where(has_lane, left_m, 0.0)
