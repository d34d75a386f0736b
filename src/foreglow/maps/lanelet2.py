"""Roads in a Lanelet2 file (.osm): carriageways between the borders of lanelets.

Two lanelets on either side of the same left border are the two directions of a carriageway, in left-hand traffic those
on either side of the same right border; any other lanelet is a carriageway of its own. The reader takes the nodes' lat,
lon and `ele`, and relations of type lanelet whose subtype is a road for cars; it ignores projections and regulatory
elements.

Source: Poggenhans et al., Lanelet2: A high-definition map framework, ITSC 2018.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
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
from foreglow.maps.geographic import GeographicOrigin, check_position
from foreglow.maps.road_map import RoadMap
from foreglow.maps.xml_file import number_of, read_xml
from foreglow.types.frame import MAX_CROSS_SLOPE

LEAST_WIDTH_M = 1.0
"""Of the cross slope: where borders are nearer to each other, as they meet, it would be that of their errors."""

DRIVEN_SUBTYPES = frozenset({"road", "highway", "play_street"})
SIDES = ("left", "right")

MAX_BORDERS_M = 40.0
"""Greatest mean distance of the borders of a carriageway of one or two lanelets: of a wider one, they do not belong
together, or one is much longer than the other."""


def read_lanelet2(path: Path) -> RoadMap:
    """The carriageways of a Lanelet2 file, whose first node becomes the map's origin.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not OSM XML, two elements of a kind have the same id, a lanelet lacks a border, a border
            lacks a node, a number is broken, only some nodes have heights, a height is far from the one before, or
            there is no lanelet; the message names path and element.
    """
    root = read_xml(path, "osm")
    nodes, earth = _nodes(root, path)
    ways = {number: [str(nd.get("ref")) for nd in way.findall("nd")] for number, way in _kept(root, "way", path)}
    lanelets = _lanelets(root, path)
    if not lanelets:
        raise ValueError(f"{path}: expected at least one lanelet for cars, got none")
    once = dict.fromkeys(way for pair in lanelets for way in pair)  # many lanelets may have the same
    borders = {way: _border(way, ways, nodes, path) for way in once}
    is_missing = np.concatenate([np.isnan(border[:, 2]) for border in borders.values()])
    if is_missing.any():
        if not is_missing.all():
            raise ValueError(f"{path}: ele: expected a height at all nodes of borders, or at none")
        borders = {way: np.nan_to_num(border) for way, border in borders.items()}
    for way, border in borders.items():
        check_points(border, f"{path}: way {way}")
        names = ways[way]
        check_steps(np.array([nodes[name] for name in names]), f"{path}: way {way}: ele", names)
    count = PointCount()
    lines = [
        _line(borders[first], borders[second], count, f"{path}: ways {first} and {second}")
        for first, second in _carriageways(lanelets, borders)
    ]
    return RoadMap(lines, earth, has_heights=not is_missing.any())


def _kept(root: Element, kind: str, path: Path) -> Iterator[tuple[str, Element]]:
    """The elements of a kind with their ids, without deleted ones: so marked by an editor such as JOSM, or by OSM."""
    seen = set[str]()
    for element in root.findall(kind):
        if element.get("action") == "delete" or element.get("visible") == "false":
            continue
        number = element.get("id")
        if number is None or number in seen:
            got = "one without" if number is None else f"{number} twice"
            raise ValueError(f"{path}: {kind}: expected an id of its own for each, got {got}")
        seen.add(number)
        yield number, element


def _nodes(root: Element, path: Path) -> tuple[dict[str, Floats], GeographicOrigin]:
    """The position of every node, shape (3,), with NaN for a missing height; and the first node as the origin."""
    ids, degrees, heights_m = [], [], []
    for number, node in _kept(root, "node", path):
        origin = f"{path}: node {number}"
        latitude_deg, longitude_deg = number_of(node, "lat", origin), number_of(node, "lon", origin)
        check_position(latitude_deg, longitude_deg, origin)
        ele = [tag for tag in node.findall("tag") if tag.get("k") == "ele"]
        ids.append(number)
        degrees.append((latitude_deg, longitude_deg))
        heights_m.append(number_of(ele[0], "v", origin) if ele else np.nan)
    if not ids:
        raise ValueError(f"{path}: expected nodes, got none")
    earth = GeographicOrigin(*degrees[0])
    level_m = earth.local(*np.array(degrees).T)
    return dict(zip(ids, np.column_stack([level_m, heights_m]), strict=True)), earth


def _lanelets(root: Element, path: Path) -> list[tuple[str, str]]:
    """Ids of the left and the right border of each lanelet for cars."""
    found = []
    for number, relation in _kept(root, "relation", path):
        tags = {tag.get("k"): tag.get("v") for tag in relation.findall("tag")}
        if tags.get("type") != "lanelet" or tags.get("subtype", "road") not in DRIVEN_SUBTYPES:
            continue
        members = relation.findall("member")
        ways = {side: [member.get("ref") for member in members if member.get("role") == side] for side in SIDES}
        for side, refs in ways.items():
            if len(refs) != 1:
                raise ValueError(f"{path}: lanelet {number}: expected one {side} border, got {len(refs)}")
        found.append((str(ways["left"][0]), str(ways["right"][0])))
    return found


def _border(way: str, ways: dict[str, list[str]], nodes: dict[str, Floats], path: Path) -> Floats:
    """The points of a border, shape (N, 3)."""
    missing = [node for node in ways.get(way, []) if node not in nodes]
    if way not in ways or missing:
        raise ValueError(f"{path}: way {way}: expected it with all its nodes, {missing[:1] or 'it'} is missing")
    points = np.array([nodes[node] for node in ways[way]]).reshape(-1, 3)
    border = without_repeats(points) if len(points) else points
    if len(border) < 2:
        raise ValueError(f"{path}: way {way}: expected at least two nodes that differ")
    return border


def _carriageways(lanelets: list[tuple[str, str]], borders: dict[str, Floats]) -> list[tuple[str, str]]:
    """The outer borders of each carriageway: the others of two lanelets with their left or right border in common."""
    found, alone = [], dict(enumerate(lanelets))
    for side in range(len(SIDES)):
        at_border: dict[str, list[int]] = {}
        for number, lanelet in alone.items():
            at_border.setdefault(lanelet[side], []).append(number)
        for border, numbers in at_border.items():
            others = [alone[number][1 - side] for number in numbers]
            if len(numbers) == 2 and len({_side(borders[border], borders[other]) for other in others}) == 2:
                found.append((others[0], others[1]))
                del alone[numbers[0]], alone[numbers[1]]
    return found + list(alone.values())


def _side(line: Floats, other: Floats) -> float:
    """1 if `other` lies to the left of `line` in its direction, -1 if to the right."""
    along, away = line[-1] - line[0], other.mean(axis=0) - line.mean(axis=0)
    return 1.0 if along[0] * away[1] - along[1] * away[0] > 0 else -1.0


def _line(first: Floats, second: Floats, count: PointCount, origin: str) -> CentreLine:
    """The middle between two borders, which may have either direction."""
    if np.linalg.norm((first[0] - second[0])[:2]) > np.linalg.norm((first[0] - second[-1])[:2]):
        second = second[::-1]
    length_m = float(max(_ways_m(first)[-1], _ways_m(second)[-1]))
    count.add(length_m, origin, max(len(first), len(second)))
    num = 1 + math.ceil(length_m / STEP_M)
    first, second = _spread(first, num), _spread(second, num)
    points = (first + second) / 2
    across, along = second - first, np.gradient(points, axis=0)
    widths_m = np.hypot(across[:, 0], across[:, 1])
    is_left = (
        across[:, 1] * along[:, 0] - across[:, 0] * along[:, 1] > 0
    )  # the second border, in the direction of the points
    cross_slopes = np.where(is_left, 1.0, -1.0) * across[:, 2] / np.maximum(widths_m, LEAST_WIDTH_M)
    if np.abs(cross_slopes).max() > MAX_CROSS_SLOPE:
        steepest = float(np.abs(cross_slopes).max())
        raise ValueError(
            f"{origin}: borders: expected a cross slope of at most {MAX_CROSS_SLOPE:g}, got {steepest:.3g}"
        )
    whole = without_repeats(np.column_stack([points, cross_slopes]))
    check_width(float(widths_m.mean()), f"{origin}: borders", MAX_BORDERS_M)
    if len(whole) < 2:
        raise ValueError(f"{origin}: expected borders side by side, the middle between them is a single point")
    return CentreLine(whole[:, :3], float(widths_m.mean()) / 2, whole[:, 3])


def _ways_m(border: Floats) -> Floats:
    """Horizontal distance of each point from the first along the border."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(border[:, :2], axis=0).T))])


def _spread(border: Floats, num: int) -> Floats:
    """`num` points at equal distances along the border."""
    ways_m = _ways_m(border)
    return np.stack([np.interp(np.linspace(0.0, ways_m[-1], num), ways_m, values) for values in border.T], -1)
