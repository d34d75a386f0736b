from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foreglow.maps import GeographicOrigin, RoadMap, read_road_map
from foreglow.street import LANE_WIDTH_M
from tests.maps.roads import pose

PLACES = [[9.0, 48.0, 400.0], [9.001, 48.0, 401.0], [9.002, 48.0005, 402.0]]


def line(coordinates: Any, **properties: Any) -> dict[str, Any]:
    geometry = {"type": "LineString", "coordinates": coordinates}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def read(tmp_path: Path, *features: Any) -> RoadMap:
    return read_text(tmp_path, json.dumps({"type": "FeatureCollection", "features": features}))


def read_text(tmp_path: Path, text: str) -> RoadMap:
    path = tmp_path / "town.geojson"
    path.write_text(text)
    return read_road_map(path)


def test_lines_in_metres_around_the_first_place(tmp_path: Path) -> None:
    point = {"type": "Feature", "properties": None, "geometry": {"type": "Point", "coordinates": [9, 48]}}
    road_map = read(tmp_path, point, line(PLACES, width="7.5"), line(PLACES[1:]))
    assert road_map.origin == GeographicOrigin(48.0, 9.0)
    assert road_map.has_heights
    first, second = road_map.lines
    expected = np.array([[0.0, 0.0, 400.0], [74.6, 0.0, 401.0], [149.2, 55.6, 402.0]])
    np.testing.assert_allclose(first.points_m, expected, atol=0.06)
    assert (first.half_width_m, second.half_width_m) == (3.75, LANE_WIDTH_M)
    road = road_map.ahead(pose(10.0, -1.5, z=400.2))
    assert road is not None
    assert road.points_m[0].tolist() == pytest.approx([0.0, 1.5, -0.07], abs=0.01)


def test_without_heights(tmp_path: Path) -> None:
    road_map = read(tmp_path, line([[9.0, 48.0], [9.0, 48.0], [9.001, 48.0]]))
    assert not road_map.has_heights
    assert road_map.lines[0].points_m.shape == (2, 3)  # a repeated place is one


@pytest.mark.parametrize(
    "document",
    [
        {"type": "LineString", "coordinates": PLACES},
        line(PLACES),
        {"type": "Feature", "geometry": {"type": "MultiLineString", "coordinates": [PLACES]}},
    ],
)
def test_other_outermost_objects(tmp_path: Path, document: Any) -> None:
    assert len(read_text(tmp_path, json.dumps(document)).lines) == 1


@pytest.mark.parametrize(
    ("features", "message"),
    [
        ([], r"town\.geojson: expected at least one LineString"),
        ([line([[9.0, 48.0]])], "expected at least one LineString with two points"),
        ([line([[3500.0, 5300000.0], [3600.0, 5300000.0]])], r"feature 0: coordinates: expected a latitude of -90"),
        ([line([[9.0, float("nan")], [9.1, 48.0]])], r"feature 0: coordinates: expected a list of \[longitude"),
        ([line([[9.0, 48.0], [9.1, "x"]])], r"feature 0: coordinates: expected a list of \[longitude"),
        ([line([[9.0, 48.0], [9.1, "48"]])], r"feature 0: coordinates: expected a list of \[longitude"),
        ([line([[9.0, 48.0], [9.1, True]])], r"feature 0: coordinates: expected a list of \[longitude"),
        ([line([[9.0, 48.0], [9.1, 48.0, 3.0]])], r"feature 0: coordinates: expected a list of \[longitude"),
        ([line([[9.0, 48.0], [9.1, 48.0]]), line(PLACES)], "coordinates: expected a height at all points or at none"),
        ([line(PLACES), line(PLACES, width=-3)], r"feature 1: width: expected a number of metres above 0 .*, got -3$"),
        ([line(PLACES, width="narrow")], "feature 0: width: expected a number of metres above 0 .*, got 'narrow'$"),
        ([line(PLACES, width="1_0")], "feature 0: width: expected a number of metres above 0 .*, got '1_0'$"),
        ([line(PLACES, width=1e11)], "feature 0: width: expected a number of metres above 0 and up to 200, got 1000"),
        ([line(PLACES, width="1e11")], "feature 0: width: expected a number .*, got '1e11'$"),
        ([line(PLACES, width=10**400)], "feature 0: width: expected a number .*, got 1000"),
        ([line(PLACES, width=True)], "feature 0: width: expected a number .*, got True$"),
        ([line([[9.0, 48.0, 1e11], [9.1, 48.0, 3.0]])], "feature 0: coordinates: height: expected up to 10000 m"),
        (
            [line(PLACES), line([PLACES[0], [9.0005, 48.0, -9999], *PLACES[1:]])],
            r"feature 1: coordinates: expected heights that differ by .*, got 400 m and -9999 m of points 0 and 1$",
        ),
        ([line([*PLACES, [9.002, 48.0006, 0]])], "feature 0: coordinates: .*, got 402 m and 0 m of points 2 and 3$"),
        ([line([[9.0, 48.0], [9.1, 10**400]])], r"feature 0: coordinates: expected a list of \[longitude"),
        ([line([[9.0, 48.0], [9.0, 48.0]])], "feature 0: coordinates: expected points that differ"),
        (
            [line([[9.0, 48.0], [9.1, 48.0]]), line([[9.0, 48.0], [9.0, 49.2]])],
            "feature 1: length: expected at most 100000 m, got 133",
        ),
        ([line([[9.0, 48.0], [9.0, 48.5], [9.0, 48.0]])], "feature 0: length: expected at most 100000 m, got 111"),
        ([7], "feature 0: expected a GeoJSON object, got int"),
        ([{"type": "MultiLineString", "coordinates": 3}], "feature 0: coordinates: expected a list"),
        (
            [{"type": "LineSting", "coordinates": PLACES}],
            "feature 0: type: expected one of GeoJSON, such as LineString",
        ),
        ([{"coordinates": PLACES}], "feature 0: type: expected one of GeoJSON, such as LineString, got None"),
    ],
)
def test_errors(tmp_path: Path, features: list[Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        read(tmp_path, *features)
    assert "town.geojson" in str(caught.value)


def test_coordinates_of_another_system(tmp_path: Path) -> None:
    path = tmp_path / "town.geojson"
    for name, is_known in (
        ("urn:ogc:def:crs:OGC:1.3:CRS84", True),
        ("EPSG:4326", True),
        ("urn:ogc:def:crs:EPSG::25832", False),
        (7, False),
    ):
        crs = {"type": "name", "properties": {"name": name}}
        path.write_text(json.dumps({"type": "FeatureCollection", "crs": crs, "features": [line(PLACES)]}))
        if is_known:
            assert len(read_road_map(path).lines) == 1
        else:
            with pytest.raises(ValueError, match=r"town\.geojson: crs: expected WGS 84 \(CRS84\), or none, got "):
                read_road_map(path)


def test_broken_files(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"town\.geojson: expected JSON: .*line 1"):
        read_text(tmp_path, '{"type": ')
    with pytest.raises(ValueError, match="features: expected a list"):
        read_text(tmp_path, '{"type": "FeatureCollection"}')
    with pytest.raises(FileNotFoundError, match="nowhere"):
        read_road_map(tmp_path / "nowhere.geojson")
    with pytest.raises(ValueError, match=r"town\.shp: expected a map that ends in \.geojson, \.json, \.osm, \.xodr"):
        read_road_map(tmp_path / "town.shp")
