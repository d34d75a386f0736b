"""Points of the bird's-eye view, worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("rerun")

from foreglow.display.viewer.entities import (
    FARTHEST_M,
    arc_m,
    fan_triangles,
    gap_sector_m,
    map_entities,
    road_lines_m,
    track_bars,
)
from foreglow.geometry import Camera, Pose
from foreglow.rays import RayCaster
from foreglow.types import Frame, RoadAhead, Tracks
from tests.stand_ins import tracks_of

MOUNT_M = np.array([2.0, 0.5, 1.2])
CAMERA = Camera(1000, 800, (1000.0, 1000.0), (500.0, 400.0), (0.0,) * 5, Pose(MOUNT_M, np.eye(3)))
"""Looks straight ahead: the tangent of an azimuth to the left is (500 - column) / 1000."""


def bars_of(tracks: Tracks) -> tuple[np.ndarray, list[np.ndarray]]:
    bars = track_bars(CAMERA, tracks, RayCaster())
    return bars.places_m, list(bars.bars_m)


def test_a_track_straight_ahead() -> None:
    places, (bar,) = bars_of(tracks_of([(450, 390, 550, 410)], ranges_m=[100.0]))  # sigma 10 m
    np.testing.assert_allclose(places, [[102.0, 0.5]])
    along, aside = np.array([1.0, 0.05]) / math.hypot(1.0, 0.05)
    left = [2.0 + 90 * along, 0.5 + 90 * aside]
    far_right = [2.0 + 110 * along, 0.5 - 110 * aside]
    assert bar.shape == (5, 2)
    np.testing.assert_allclose(bar[0], left)
    np.testing.assert_allclose(bar[2], far_right)
    np.testing.assert_allclose(bar[4], bar[0])


def test_a_track_aside_and_below() -> None:
    """A range is along the ray: what is far down is not as far ahead."""
    places, _ = bars_of(tracks_of([(-1, 799, 1, 801)], ranges_m=[60.0]))
    ray = np.array([1.0, 0.5, -0.4])
    np.testing.assert_allclose(places[0], MOUNT_M[:2] + 60.0 * ray[:2] / np.linalg.norm(ray))


def test_nothing_lies_behind_the_camera() -> None:
    tracks = tracks_of([(450, 390, 550, 410)], ranges_m=[5.0])
    wide = Tracks(**{name: getattr(tracks, name) for name in Tracks.__slots__} | {"sigmas_m": np.array([9.0])})
    _, (bar,) = bars_of(wide)
    np.testing.assert_allclose(bar[0], MOUNT_M[:2])


def test_without_a_range_there_is_only_a_direction() -> None:
    places, (bar,) = bars_of(tracks_of([(450, 390, 550, 410)]))
    assert np.isnan(places).all()
    np.testing.assert_allclose(bar[1], MOUNT_M[:2])
    np.testing.assert_allclose(np.hypot(*(bar[[0, 2]] - bar[1]).T), FARTHEST_M)
    assert bar[0, 1] > bar[2, 1]


def test_without_a_deviation_there_is_a_line_across() -> None:
    tracks = tracks_of([(400, 390, 600, 410)], ranges_m=[10.0])
    sure = Tracks(**{name: getattr(tracks, name) for name in Tracks.__slots__} | {"sigmas_m": np.array([np.inf])})
    _, (bar,) = bars_of(sure)
    assert bar.shape == (2, 2)
    np.testing.assert_allclose(bar[0] - bar[1], [0.0, 2 * 10 * 0.1 / math.hypot(1.0, 0.1)], atol=1e-12)


def test_a_track_beyond_the_view_leaves_the_words_of_the_others_to_them() -> None:
    tracks = tracks_of([(450, 390, 470, 410), (550, 390, 570, 410)], ranges_m=[300.0, 100.0])
    frame = Frame(np.zeros((CAMERA.height_px, CAMERA.width_px), np.uint8), 0, camera=CAMERA)
    places = dict(map_entities(frame, tracks, None, RayCaster()))["map/tracks/places"]
    words = [str(each) for each in places.labels.as_arrow_array().to_pylist()]
    assert len(places.positions.as_arrow_array()) == len(words) == 1
    assert words[0].startswith(f"#{tracks.ids[1]} 100")


def test_no_tracks() -> None:
    places, bars = bars_of(tracks_of([]))
    assert (places.shape, bars) == ((0, 2), [])


def test_a_gap_is_a_sector() -> None:
    sector = gap_sector_m(np.radians([5.0, 10.0]), 40.0)
    np.testing.assert_allclose(sector[0], [0.0, 0.0])
    np.testing.assert_allclose(np.hypot(*sector[1:].T), 40.0)
    azimuths = np.degrees(np.arctan2(sector[1:, 1], sector[1:, 0]))
    np.testing.assert_allclose(azimuths[[0, -1]], [5.0, 10.0])
    assert (np.diff(azimuths) > 0).all()
    for range_m in (math.nan, 2 * FARTHEST_M):
        np.testing.assert_allclose(np.hypot(*gap_sector_m(np.radians([5.0, 10.0]), range_m)[1]), FARTHEST_M)


def test_a_fan_fills_its_sector() -> None:
    corners = gap_sector_m(np.radians([-30.0, 30.0]), 10.0)
    a, b, c = (corners[fan_triangles(len(corners))[:, corner]] for corner in range(3))
    twice = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert twice.sum() / 2 == pytest.approx(100.0 * math.pi / 6, rel=1e-4)


def test_corners_of_arcs_are_close() -> None:
    arc = arc_m(100.0, -0.3, 0.3)
    assert np.hypot(*np.diff(arc, axis=0).T).max() <= 100.0 * math.radians(1.0)


def test_road() -> None:
    road = RoadAhead(np.array([[0.0, 1.5, 0.0], [80.0, 1.5, 3.0]]), half_width_m=3.5)
    for line, left_m in zip(road_lines_m(road), (1.5, 5.0, -2.0), strict=True):
        np.testing.assert_allclose(line[:, 1], left_m)
        np.testing.assert_allclose(line[[0, -1], 0], [0.0, 80.0])
