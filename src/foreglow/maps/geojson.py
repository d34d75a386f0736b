"""Roads in a GeoJSON file: every LineString is a centre line.

    {"type": "FeatureCollection", "features": [
      {"type": "Feature", "properties": {"width": 6.5},
       "geometry": {"type": "LineString", "coordinates": [[9.1, 48.7, 410.2], [9.1013, 48.7004, 411.0]]}}]}

Coordinates are longitude, latitude and, in all places or in none, a height. The property `width` is that of the
carriageway in metres, as OpenStreetMap has it; two lanes of `LANE_WIDTH_M` where it is missing.

Source: RFC 7946.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from foreglow.files import read_text
from foreglow.geometry import Floats
from foreglow.maps.centre_line import CentreLine, without_repeats
from foreglow.maps.geographic import GeographicOrigin, check_place
from foreglow.maps.road_map import RoadMap
from foreglow.street import LANE_WIDTH_M


def read_geojson(path: Path) -> RoadMap:
    """The lines of a GeoJSON file, whose first place becomes the map's origin; other geometries are passed over.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is no GeoJSON, has no line, a coordinate is no number or out of range, only some have
            heights, or a width is not positive; the message names path and feature.
    """
    try:
        document = json.loads(read_text(path))
    except (json.JSONDecodeError, RecursionError) as error:
        raise ValueError(f"{path}: expected GeoJSON: {error}") from None
    found = [(origin, places, width_m) for origin, places, width_m in _lines(document, str(path)) if len(places) > 1]
    if not found:
        raise ValueError(f"{path}: expected at least one LineString with two places, got none")
    heights = {places.shape[1] for _, places, _ in found}
    if len(heights) > 1:
        raise ValueError(f"{path}: coordinates: expected a height in all places or in none")
    longitude_deg, latitude_deg = found[0][1][0, :2].tolist()
    earth = GeographicOrigin(latitude_deg, longitude_deg)
    lines = []
    for origin, places, width_m in found:
        z_m = places[:, 2:] if places.shape[1] == 3 else np.zeros((len(places), 1))
        points = without_repeats(np.hstack([earth.local(places[:, 1], places[:, 0]), z_m]))
        if len(points) < 2:
            raise ValueError(f"{origin}: coordinates: expected places that differ")
        lines.append(CentreLine(points, width_m / 2))
    return RoadMap(lines, earth, has_heights=heights == {3})


def _lines(document: Any, origin: str) -> Iterator[tuple[str, Floats, float]]:
    """For each line where it is, its places (longitude, latitude and perhaps height), and the road's width."""
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
        yield from ((where, places, width_m) for where, places, _ in _lines(document.get("geometry") or {}, origin))
    elif kind == "MultiLineString":
        coordinates = document.get("coordinates")
        for line in coordinates if isinstance(coordinates, list) else [coordinates]:
            yield origin, _places(line, origin), 2 * LANE_WIDTH_M
    elif kind == "LineString":
        yield origin, _places(document.get("coordinates"), origin), 2 * LANE_WIDTH_M
    elif not isinstance(document, dict):
        raise ValueError(f"{origin}: expected a GeoJSON object, got {type(document).__name__}")


def _places(coordinates: Any, origin: str) -> Floats:
    """The coordinates as an array, shape (N, 2) or (N, 3)."""
    try:
        places = np.array(coordinates, np.float64)
    except (TypeError, ValueError):
        places = np.zeros(0)
    if places.ndim != 2 or places.shape[1] not in (2, 3) or not np.isfinite(places).all():
        raise ValueError(f"{origin}: coordinates: expected a list of [longitude, latitude] or [.., .., height]")
    for longitude_deg, latitude_deg in places[:, :2].tolist():
        check_place(latitude_deg, longitude_deg, f"{origin}: coordinates")
    return places


def _width_m(value: Any, origin: str) -> float:
    """The width that a property says; OpenStreetMap writes it as a text."""
    try:
        width_m = 2 * LANE_WIDTH_M if value is None else float(value)
    except (TypeError, ValueError):
        width_m = math.nan
    if not (math.isfinite(width_m) and width_m > 0):
        raise ValueError(f"{origin}: width: expected a positive number of metres, got {value!r}")
    return width_m
