"""The estimators that look at the road ahead, where it bends, climbs, ends or is not there."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.config import DistanceConfig
from foreglow.distance import PSD3DPlus
from foreglow.distance.pitch import REST_SIGMA_RAD
from foreglow.distance.psd import MAP_SIGMA_RAD, OFFSET_SIGMA_M
from foreglow.geometry import Floats, rotation
from foreglow.types import Frame, RoadAhead
from tests.distance.places import aimed, camera, detections, frame, range_m, ranges, straight_road

IN_SPACE = ["psd_3d", "psd_3d_plus"]
WITH_ROAD = [*IN_SPACE, "psd_2d"]


def winding(length_m: float = 400.0, radius_m: float = 300.0, slope: float = 0.03) -> Floats:
    """A climbing left bend with its centre line 1.6 m to our left."""
    angles = np.arange(0.0, length_m + 0.5) / radius_m
    level = np.stack([radius_m * np.sin(angles), 1.6 + radius_m * (1 - np.cos(angles))], -1)
    return np.column_stack([level, slope * radius_m * angles])


@pytest.mark.slow
@pytest.mark.parametrize("name", IN_SPACE)
@settings(derandomize=True, max_examples=60)
@given(st.floats(30.0, 380.0))
def test_a_point_of_a_bend_has_its_range(name: str, place_m: float) -> None:
    points = winding()
    target = points[int(place_m)] + (place_m % 1) * (points[int(place_m) + 1] - points[int(place_m)])
    seen = frame(aimed(target, 1.4, 1.9), RoadAhead(points, 3.2, error_bound_m=2.0))
    assert range_m(name, seen) == pytest.approx(np.linalg.norm(target - [1.9, 0.0, 1.4]), rel=1e-6)


@pytest.mark.slow
@settings(derandomize=True, max_examples=60)
@given(st.floats(-0.01, 0.25), st.floats(-0.08, 0.01))
def test_psd_3d_is_the_least_distance_of_ray_and_line(yaw: float, pitch: float) -> None:
    """Against brute force over places of a fine line."""
    points = winding()
    found = range_m("psd_3d", frame(camera(1.4, yaw_rad=yaw, pitch_rad=pitch), RoadAhead(points, 3.2)))
    arc_lengths = np.arange(0.0, len(points) - 1, 0.01)
    fine = np.stack([np.interp(arc_lengths, np.arange(len(points)), column) for column in points.T], -1) - [0, 0, 1.4]
    direction = rotation(yaw, pitch)[:, 0]
    along = np.maximum(fine @ direction, 0.0)
    squared = (fine**2).sum(1) - along**2
    best = int(squared.argmin())
    if np.isnan(found):
        assert along[best] < 1.0 or best in (0, len(arc_lengths) - 1)
    else:
        gap = np.linalg.norm(fine - found * direction, axis=1).min()
        assert gap <= math.sqrt(squared[best]) + 1e-4


@pytest.mark.parametrize("name", IN_SPACE)
def test_a_ray_that_runs_away_from_the_road_has_no_range(name: str) -> None:
    """It rises as steeply as it comes nearer to a line on the left, but for what makes its least distance 0.2 m away.

    Per metre forward the gap to the line is (2 - x / 4, 1 + y x) m, whose square is least at x = (2 / 4 - y) / (1 / 16
    + y^2): with y = .47 at x = 0.106, with y = .1 at x = 5.5.
    """
    for rise, expected in ((0.47, math.nan), (0.1, 0.4 / (1 / 16 + 0.01))):
        axis = np.array([1.0, 0.25, rise])
        seen = frame(aimed(np.array([0.0, 0.0, 1.0]) + 20.0 * axis, 1.0), straight_road(2.0))
        assert range_m(name, seen) == pytest.approx(expected * float(np.linalg.norm(axis)), nan_ok=True)


def test_psd_3d_by_hand() -> None:
    """A lamp above the lane beside the line: the ray falls 1 in 100 and moves 1 in 50 towards a line 2 m to the left.

    Per metre forward the gap to the line is (2 - x / 50, 1 - x / 100) m: it closes at x = 100 on both axes.
    With the line 3 m away instead, the gap (3 - x / 50, 1 - x / 100) is least where
    (3 - x / 50) / 50 + (1 - x / 100) / 100 = 0: at x = 140.
    """
    axis = np.array([1.0, 0.02, -0.01])
    seen = aimed(np.array([0.0, 0.0, 1.0]) + 100.0 * axis, 1.0)
    length = float(np.linalg.norm(axis))
    assert range_m("psd_3d", frame(seen, straight_road(2.0))) == pytest.approx(100.0 * length, rel=1e-9)
    assert range_m("psd_3d", frame(seen, straight_road(3.0))) == pytest.approx(140.0 * length, rel=1e-9)


def test_psd_2d_ignores_heights() -> None:
    level = frame(aimed([80.0, 1.6, 0.0]), straight_road())
    hilly = straight_road().points_m + np.column_stack([np.zeros((401, 2)), 5 * np.sin(np.arange(401) / 30)])
    assert range_m("psd_2d", frame(level.camera, RoadAhead(hilly, 3.2))) == range_m("psd_2d", level)
    up = aimed([80.0, 1.6, 20.0])
    assert range_m("psd_2d", frame(up, straight_road())) == pytest.approx(math.sqrt(6402.56 + 18.75**2), rel=1e-9)


def test_psd_2d_takes_the_first_crossing() -> None:
    """On an S-bend the azimuth line straight ahead crosses the road at x = 50, 100 and 150."""
    x = np.arange(0.0, 180.5)
    road = RoadAhead(np.stack([x, 4 * np.sin(np.pi * x / 50), 0 * x], -1)[1:], 3.2)
    assert range_m("psd_2d", frame(camera(pitch_rad=-0.01), road)) == pytest.approx(50 / math.cos(0.01), rel=1e-6)


@pytest.mark.parametrize("name", WITH_ROAD)
def test_a_ray_steeply_down_or_up_has_no_range_or_one_just_ahead(name: str) -> None:
    for pitch in (-math.pi / 4, math.pi / 4):
        value = range_m(name, frame(camera(pitch_rad=pitch, forward_m=2.0), straight_road(0.0)))
        assert np.isnan(value) if name == "psd_2d" or pitch > 0 else value == pytest.approx(1.25 * math.sqrt(2))


@pytest.mark.parametrize("name", WITH_ROAD)
def test_a_road_behind_us(name: str) -> None:
    assert np.isnan(range_m(name, frame(camera(pitch_rad=-0.02), straight_road(begin_m=-500.0))))


@pytest.mark.parametrize("name", WITH_ROAD)
def test_beyond_the_end_of_the_map_nothing_is_known(name: str) -> None:
    target = [120.0, 1.6, 0.0]
    assert np.isnan(range_m(name, frame(aimed(target), straight_road(length_m=100.0))))
    assert range_m(name, frame(aimed(target), straight_road(length_m=121.0))) > 119


@pytest.mark.parametrize("name", IN_SPACE)
@pytest.mark.parametrize("pitch_rad", [0.0, 1e-9, 0.02, 0.7])
def test_above_the_horizon_of_a_flat_road(name: str, pitch_rad: float) -> None:
    found = ranges(name, frame(camera(pitch_rad=pitch_rad, forward_m=2.0), straight_road()))
    assert np.isnan(found.ranges_m).all()
    assert np.isinf(found.sigmas_m).all()


@pytest.mark.parametrize("name", WITH_ROAD)
def test_no_road(name: str) -> None:
    found = ranges(name, frame(aimed([50.0, 1.6, 0.0])), [(63, 47, 64, 48)] * 3)
    assert np.isnan(found.ranges_m).all()
    assert np.isinf(found.sigmas_m).all()


@pytest.mark.parametrize("name", WITH_ROAD)
def test_a_road_of_two_points(name: str) -> None:
    road = RoadAhead(np.array([[0.0, 0.5, 0.0], [1.0, 0.5, 0.0]]), 3.2, error_bound_m=0.0)
    near, far = aimed([0.75, 0.5, 0.0], height_m=0.5), aimed([3.0, 0.5, 0.0], height_m=0.5)
    assert range_m(name, frame(near, road)) == pytest.approx(np.linalg.norm([0.75, 0.5, -0.5]), rel=1e-9)
    assert np.isnan(range_m(name, frame(far, road)))


@pytest.mark.parametrize("name", WITH_ROAD)
def test_sigma_grows_with_the_error_of_the_position(name: str) -> None:
    camera_there, sigmas = aimed([80.0, 1.6, 0.0]), []
    for bound in (0.0, 2.0, 100.0, math.inf):
        road = RoadAhead(straight_road().points_m, 3.2, error_bound_m=bound)
        sigmas.append(float(ranges(name, frame(camera_there, road)).sigmas_m[0]))
    assert sigmas == sorted(sigmas)
    assert sigmas[2] == pytest.approx(math.hypot(sigmas[0], 100 / math.sqrt(3)), rel=1e-3)
    assert math.isinf(sigmas[3])


def test_sigma_of_psd_3d_by_hand() -> None:
    """The angle between ray and road has the sine of the gap at the camera over the range."""
    found = ranges("psd_3d", frame(aimed([80.0, 1.6, 0.0]), straight_road()))
    range_to, gap = math.sqrt(6400 + 1.6**2 + 1.25**2), math.hypot(1.6, 1.25)
    across = math.hypot(range_to * math.hypot(REST_SIGMA_RAD, MAP_SIGMA_RAD), OFFSET_SIGMA_M)
    assert found.sigmas_m[0] == pytest.approx(across * range_to / gap, rel=1e-9)


class Standing:
    """In place of a `RoadAligner`: it knows how we stand."""

    def __init__(self, yaw_rad: float, left_m: float) -> None:
        self.yaw_rad, self.left_m = yaw_rad, left_m
        self.num_resets = 0

    def align(self, frame: Frame) -> Standing:  # noqa: ARG002
        return self

    def reset(self) -> None:
        self.num_resets += 1


def standing_estimator(standing: Standing) -> PSD3DPlus:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("foreglow.distance.psd.RoadAligner", lambda: standing)
        return PSD3DPlus(DistanceConfig())


@settings(derandomize=True, max_examples=50)
@given(st.floats(-0.03, 0.03), st.floats(-0.8, 0.8), st.floats(20.0, 250.0))
def test_psd_3d_plus_knows_how_we_stand(yaw: float, left_m: float, place_m: float) -> None:
    """The map believes us along the road in the middle of the lane; we head left by yaw, and stand left by left_m."""
    points = winding()
    target = points[int(place_m)]
    seen_from_us = rotation(yaw).T @ (target - [0.0, left_m, 0.0])
    seen = frame(aimed(seen_from_us), RoadAhead(points, 3.2))
    estimator = standing_estimator(Standing(yaw, left_m))
    found = estimator.estimate(seen, detections()).ranges_m[0]
    assert found == pytest.approx(np.linalg.norm(seen_from_us - [0, 0, 1.25]), rel=1e-6)


def test_psd_3d_plus_passes_the_reset_on() -> None:
    standing = Standing(0.0, 0.0)
    standing_estimator(standing).reset()
    assert standing.num_resets == 1
