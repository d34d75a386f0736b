from __future__ import annotations

import numpy as np
import pytest

from foreglow.geometry import Pose, rotation
from foreglow.lab.simulation.camera.motion_blur import MotionBlur, blur, sheared
from tests.lab.simulation.cameras import camera

CAMERA = camera()


def test_flow_is_where_things_go() -> None:
    depth = np.full((240, 320), 10.0, np.float32)
    flow = MotionBlur(CAMERA).flow_px(depth, Pose(np.array([1.0, 0.0, 0.0]), np.eye(3)))
    assert flow is not None
    assert flow.shape == (240, 320, 2)
    x, y = 250, 60
    ray = CAMERA.rays([[x + 0.5, y + 0.5]])[0]
    expected = CAMERA.project(10.0 * ray - [1.0, 0.0, 0.0]) - (x + 0.5, y + 0.5)
    assert flow[y, x] == pytest.approx(expected, abs=0.05)
    assert flow[120, 160] == pytest.approx((0, 0), abs=0.2)  # the point we drive towards


def test_far_away_only_turning_moves() -> None:
    sky = np.full((240, 320), np.nan, np.float32)
    motion = MotionBlur(CAMERA)
    assert motion.flow_px(sky, Pose(np.array([2.0, 0.0, 0.0]), np.eye(3))) is None
    flow = motion.flow_px(sky, Pose(np.zeros(3), rotation(yaw_rad=0.02)))
    assert flow is not None
    assert flow[120, 160] == pytest.approx((0.02 * 328, 0), abs=0.05)  # turning left, all goes right


def test_without_motion_nothing_changes() -> None:
    image = np.random.default_rng(1).random((240, 320), np.float32)
    assert blur(image, None) is image
    assert blur(image, np.zeros((240, 320, 2), np.float32)) is image


def test_a_dot_becomes_a_line_of_that_length() -> None:
    image = np.zeros((240, 320), np.float32)
    image[120, 100] = 1.0
    kept = image.copy()
    flow = np.zeros((240, 320, 2), np.float32)
    flow[..., 0] = 16.0
    blurred = blur(image, flow)
    assert blurred.sum() == pytest.approx(1.0, abs=1e-5)
    assert blurred[120, 94:107] == pytest.approx(np.full(13, 1 / 16), rel=0.02)
    assert not blurred[120, :91].any()
    assert not blurred[121].any()
    assert (image == kept).all()


def test_only_what_moves_is_blurred() -> None:
    image = np.random.default_rng(2).random((240, 320), np.float32)
    flow = np.zeros((240, 320, 2), np.float32)
    flow[180:, :, 1] = 9.0
    blurred = blur(image, flow)
    assert (blurred[:180] == image[:180]).all()
    assert blurred[190:].std() < 0.5 * image[190:].std()
    assert blurred[190:].mean() == pytest.approx(image[190:].mean(), abs=0.01)


def test_later_rows_show_what_moves_further_on() -> None:
    line = np.zeros((101, 64), np.float32)
    line[:, 32] = 1.0
    motion_px = np.zeros((101, 64, 2), np.float32)
    motion_px[..., 0] = 8.0
    read_out = sheared(line, motion_px)
    middles = (read_out * np.arange(64)).sum(1) / read_out.sum(1)
    assert middles[50] == pytest.approx(32.0, abs=1e-3)
    assert middles[[0, 100]] == pytest.approx([28.0, 36.0], abs=0.1)
    assert (np.diff(middles) > 0).all()
