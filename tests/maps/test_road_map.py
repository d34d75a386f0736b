from __future__ import annotations

import numpy as np
import pytest

from foreglow.maps import CentreLine, RoadMap
from tests.maps.roads import pose, straight


def line(*points: tuple[float, float], half_width_m: float = 3.0) -> CentreLine:
    return CentreLine(np.array([(*point, 0.0) for point in points]), half_width_m)


def test_the_nearest_road_with_our_heading() -> None:
    parallel, across = line((0, 12), (300, 12), half_width_m=4.0), line((100, -50), (100, 50), half_width_m=5.0)
    road = RoadMap([straight(), parallel, across]).ahead(pose(100.0, 1.0))
    assert road is not None
    assert road.half_width_m == 3.5


def test_it_goes_on_in_the_straightest_line_whichever_way_that_runs() -> None:
    first, ours = line((0, 0), (100, 0)), line((300, 40), (200, 10), (100.5, 0))
    side = line((100, 0), (100, -80), half_width_m=2.0)
    sharp = line((100, 0), (180, 60))
    road = RoadMap([first, side, sharp, ours]).ahead(pose(50.0, 0.0), length_m=150.0)
    assert road is not None
    assert len(road) == 151
    x, y, _ = road.points_m[-1]
    assert 50 + x == pytest.approx(200.0, abs=1.0)
    assert y == pytest.approx(10.0, abs=0.3)


def test_short_lines_and_ends_that_overlap() -> None:
    pieces = [line((x, 0), (x + 10.5, 0)) for x in (0, 10, 20)] + [line((30.5, 0), (31, 0)), line((31, 0), (60, 0))]
    road = RoadMap(pieces).ahead(pose(5.0, 0.0), length_m=200.0)
    assert road is not None
    np.testing.assert_allclose(road.points_m[:, 0], np.arange(56.0), atol=1e-9)


def test_a_single_lane_through_a_junction() -> None:
    lane = line(*[(x, -1.75) for x in range(50, 71)], half_width_m=1.75)
    pieces = [line((0, 0), (50, 0)), lane, line((70, 0), (120, 0))]
    road = RoadMap(pieces).ahead(pose(5.0, -1.75), length_m=200.0)
    assert road is not None
    assert road.half_width_m == 3.0
    assert road.points_m[-1, :2].tolist() == pytest.approx([115.0, 1.75], abs=1.0)
    assert np.abs(road.points_m[50:60, 1]).max() < 0.01


def test_it_ends_at_a_crossing_where_nothing_goes_on() -> None:
    road = RoadMap([line((0, 0), (100, 0)), line((100, 0), (100, 80))]).ahead(pose(50.0, 0.0))
    assert road is not None
    assert road.points_m[-1].tolist() == pytest.approx([50.0, 0.0, 0.0])


def test_a_ring_is_driven_once() -> None:
    turns = np.linspace(0.0, np.pi, 60)
    half = np.stack([50 * np.sin(turns), 50 - 50 * np.cos(turns), 0 * turns], -1)
    other = half[::-1] * [-1, 1, 1]
    road = RoadMap([CentreLine(half, 3.0), CentreLine(other, 3.0)]).ahead(pose(1.0, 0.0), length_m=2000.0)
    assert road is not None
    assert len(road) == pytest.approx(2 * np.pi * 50, abs=3)


def test_far_from_every_road() -> None:
    road_map = RoadMap([straight()])
    assert road_map.ahead(pose(100.0, 500.0)) is None
    assert road_map.distance_m(np.array([100.0, 500.0])) == 500.0


def test_a_map_without_heights_is_a_flat_road_under_us() -> None:
    road = RoadMap([straight()], has_heights=False).ahead(pose(100.0, 0.0, z=412.0, pitch_deg=2.0))
    assert road is not None
    assert np.abs(road.points_m[:, 2]).max() < 1e-9


def test_a_map_needs_a_road() -> None:
    with pytest.raises(ValueError, match=r"RoadMap\.lines: expected at least one road"):
        RoadMap([])
