"""The road ahead, in the image and in space."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from foreglow.geometry import Camera, Pose
from foreglow.lab.reports.road_picture import edges_m, road_picture, road_px
from foreglow.types import Frame, RoadAhead
from tests.stand_ins import night_image

HEIGHT_M, FOCAL_PX, HALF_WIDTH_M = 1.5, 1000.0, 3.5


def camera(yaw: np.ndarray | None = None) -> Camera:
    mount = Pose(np.array([0.0, 0.0, HEIGHT_M]), np.eye(3) if yaw is None else yaw)
    return Camera(1280, 960, (FOCAL_PX, FOCAL_PX), (640.0, 480.0), (0.0,) * 5, mount)


def straight(*ahead_m: float) -> RoadAhead:
    return RoadAhead(np.array([[x, 0.0, 0.0] for x in ahead_m]), HALF_WIDTH_M)


def test_the_edges_of_a_straight_flat_road_run_to_the_vanishing_point() -> None:
    left, right = road_px(camera(), straight(10.0, 50.0, 1e6))
    for index, ahead_m in enumerate((10.0, 50.0)):
        across_px, down_px = FOCAL_PX * HALF_WIDTH_M / ahead_m, FOCAL_PX * HEIGHT_M / ahead_m
        np.testing.assert_allclose(left[index], [640.0 - across_px, 480.0 + down_px])
        np.testing.assert_allclose(right[index], [640.0 + across_px, 480.0 + down_px])
    np.testing.assert_allclose([left[2], right[2]], [[640.0, 480.0]] * 2, atol=0.01)


def test_what_is_beside_or_behind_us_is_not_in_the_image() -> None:
    left, right = road_px(camera(), straight(-5.0, 0.5, 2.0, 30.0))
    assert np.isnan(left[:3]).all()
    assert np.isnan(right[:3]).all()
    assert np.isfinite([left[3], right[3]]).all()


def test_a_lens_that_bends_far_folds_nothing_into_the_image() -> None:
    wide = dataclasses.replace(camera(), distortion=(-0.2, 0.0, 0.0, 0.0, 0.0))
    near = wide.project(wide.vehicle_from_camera.to_body(np.array([1.75, HALF_WIDTH_M, 0.0])))
    assert (near > 0).all()
    assert (near < [1280, 960]).all()  # by the lens's polynomial alone, 63 degrees aside is near the middle
    left, right = road_px(wide, straight(1.75, 30.0, 60.0))
    assert np.isnan([left[0], right[0]]).all()
    assert np.isfinite([left[1:], right[1:]]).all()


def test_a_road_that_turns_back_has_edges() -> None:
    road = RoadAhead(np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), HALF_WIDTH_M)
    assert np.isfinite(edges_m(road)).all()


def test_the_picture_has_the_road_in_both_halves() -> None:
    pytest.importorskip("matplotlib")
    frame = Frame(night_image(1, 960, 1280), timestamp_ns=0, frame=1, camera=camera())
    with pytest.raises(ValueError, match="expected a frame with a calibration and the road ahead"):
        road_picture(frame)
    bend = RoadAhead(np.array([[x, 0.002 * x * x, 0.01 * x] for x in range(80)], float), HALF_WIDTH_M)
    picture = cv2.imdecode(
        np.frombuffer(road_picture(dataclasses.replace(frame, road=bend)), np.uint8), cv2.IMREAD_COLOR
    )
    assert picture is not None
    near = cv2.inRange(picture, np.array([225, 175, 60]), np.array([255, 205, 100]))  # the colour of the road
    assert min((half > 0).sum() for half in np.array_split(near, 2, axis=1)) > 50
