"""Roads in a GeoJSON file: every LineString is a centre line.

    {"type": "FeatureCollection", "features": [
      {"type": "Feature", "properties": {"width": 6.5},
       "geometry": {"type": "LineString", "coordinates": [[9.1, 48.7, 410.2], [9.1013, 48.7004, 411.0]]}}]}

Coordinates are longitude, latitude and, at all points or at none, a height. The property `width` is the width of the
carriageway in metres, as in OpenStreetMap; without it there are two lanes of `LANE_WIDTH_M`.

Source: RFC 7946.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from foreglow.files import number_in, read_plain_json
from foreglow.geometry import Floats
from foreglow.maps.centre_line import MAX_WIDTH_M, CentreLine, check_length, check_points, check_steps, without_repeats
from foreglow.maps.geographic import GeographicOrigin, check_position
from foreglow.maps.road_map import RoadMap
from foreglow.numbers import checked_number
from foreglow.street import LANE_WIDTH_M
from foreglow.wording import shortened

OTHER_GEOMETRIES = ("Point", "MultiPoint", "Polygon", "MultiPolygon", "GeometryCollection")
"""Kinds of geometries that are no roads."""

NOWHERE = {"type": "GeometryCollection"}
"""What a feature without a geometry has."""


def read_geojson(path: Path) -> RoadMap:
    """The lines of a GeoJSON file, whose first point becomes the map's origin; other geometries are ignored.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not GeoJSON, has no line, a coordinate is not a number or out of range, only some points
            have heights, a height is far from the one before, a line is too long, or a width is not that of a road; the
            message names path and feature.
    """
    document = read_plain_json(path)
    _check_crs(document, path)
    found = [line for line in _lines(document, str(path)) if len(line[1]) > 1]
    if not found:
        raise ValueError(f"{path}: expected at least one LineString with two points, got none")
    heights = {coordinates.shape[1] for _, coordinates, _ in found}
    if len(heights) > 1:
        raise ValueError(f"{path}: coordinates: expected a height at all points or at none")
    longitude_deg, latitude_deg = found[0][1][0, :2].tolist()
    earth = GeographicOrigin(latitude_deg, longitude_deg)
    lines = []
    for origin, coordinates, width_m in found:
        z_m = coordinates[:, 2:] if coordinates.shape[1] == 3 else np.zeros((len(coordinates), 1))
        given = np.hstack([earth.local(coordinates[:, 1], coordinates[:, 0]), z_m])
        points = without_repeats(given)
        if len(points) < 2:
            raise ValueError(f"{origin}: coordinates: expected points that differ")
        check_points(given, f"{origin}: coordinates")
        check_steps(given, f"{origin}: coordinates")
        line = CentreLine(points, width_m / 2)
        check_length(line.length_m, origin)
        lines.append(line)
    return RoadMap(lines, earth, has_heights=heights == {3})


def _check_crs(document: Any, path: Path) -> None:
    """Refuses coordinates that are not of WGS 84; before RFC 7946, a member `crs` could say so."""
    crs = document.get("crs") if isinstance(document, dict) else None
    properties = crs.get("properties") if isinstance(crs, dict) else None
    name = properties.get("name") if isinstance(properties, dict) else None
    if crs is not None and str(name).rpartition(":")[2] not in ("CRS84", "CRS84h", "4326", "4979"):
        raise ValueError(f"{path}: crs: expected WGS 84 (CRS84), or none, got {shortened(name or crs)}")


def _lines(document: Any, origin: str) -> Iterator[tuple[str, Floats, float]]:
    """For each line its origin for messages, its points (longitude, latitude, maybe height) and the road's width."""
    kind = document.get("type") if isinstance(document, dict) else None
    if kind == "FeatureCollection":
        features = document.get("features")
        if not isinstance(features, list):
            raise ValueError(f"{origin}: features: expected a list")
        for number, feature in enumerate(features):
            yield from _lines(feature, f"{origin}: feature {number}")
    elif kind == "Feature":
        properties = document.get("properties") or {}
        width_m = _width_m(properties.get("width"), origin) if isinstance(properties, dict) else 2 * LANE_WIDTH_M
        yield from (
            (where, coordinates, width_m)
            for where, coordinates, _ in _lines(document.get("geometry") or NOWHERE, origin)
        )
    elif kind == "MultiLineString":
        coordinates = document.get("coordinates")
        for line in coordinates if isinstance(coordinates, list) else [coordinates]:
            yield origin, _coordinates(line, origin), 2 * LANE_WIDTH_M
    elif kind == "LineString":
        yield origin, _coordinates(document.get("coordinates"), origin), 2 * LANE_WIDTH_M
    elif not isinstance(document, dict):
        raise ValueError(f"{origin}: expected a GeoJSON object, got {type(document).__name__}")
    elif kind not in OTHER_GEOMETRIES:
        raise ValueError(f"{origin}: type: expected one of GeoJSON, such as LineString, got {shortened(kind)}")


def _coordinates(values: Any, origin: str) -> Floats:
    """The coordinates as an array, shape (N, 2) or (N, 3)."""
    try:
        coordinates = np.array([[checked_number("coordinates", value) for value in point] for point in values])
    except (TypeError, ValueError, OverflowError):
        coordinates = np.zeros(0)
    if coordinates.ndim != 2 or coordinates.shape[1] not in (2, 3) or not np.isfinite(coordinates).all():
        raise ValueError(f"{origin}: coordinates: expected a list of [longitude, latitude] or [.., .., height]")
    for longitude_deg, latitude_deg in coordinates[:, :2].tolist():
        check_position(latitude_deg, longitude_deg, f"{origin}: coordinates")
    return coordinates


def _width_m(value: Any, origin: str) -> float:
    """The width in a property; OpenStreetMap writes it as a text."""
    try:
        width_m = 2 * LANE_WIDTH_M if value is None else math.nan if isinstance(value, bool) else number_in(str(value))
    except (TypeError, ValueError, OverflowError):
        width_m = math.nan
    if not 0 < width_m <= MAX_WIDTH_M:
        wanted = f"a number of metres above 0 and up to {MAX_WIDTH_M:g}"
        raise ValueError(f"{origin}: width: expected {wanted}, got {shortened(value)}")
    return width_m
