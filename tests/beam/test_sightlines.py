"""Directions from the lamps: as by the camera's own rays, and monotone in what is not known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.beam.sightlines import CLOSEST_M, Sightlines
from foreglow.geometry import Camera, Floats, Pose, rotation
from tests.beam.made_up import CAMERA, guard_config

LAMPS_M = np.array([[3.6, 0.6, 0.7], [3.6, -0.6, 0.7]])
MOUNT = Pose(np.array([1.8, 0.02, 1.35]), rotation(0.02, -0.01, 0.015))
TURNED = Camera(640, 481, (600.0, 610.0), (310.0, 260.0), (-0.09, 0.02, 2e-4, 1e-4, 0.0), MOUNT)


def check_within(spans: Floats, box: list[float], range_m: float, camera: Camera) -> None:
    """Whether all that is seen in the box, at this range, lies within the spans of both lamps, shape (2, 4)."""
    pose = camera.vehicle_from_camera
    pixels = np.random.default_rng(0).uniform(box[:2], box[2:], (300, 2))
    points_m = pose.position_m + camera.rays(pixels) @ pose.rotation.T * range_m
    for lamp_m, span in zip(LAMPS_M, spans, strict=True):
        x, y, z = (points_m - lamp_m).T
        azimuths, elevations = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
        assert azimuths.min() > span[0] - 2e-3
        assert azimuths.max() < span[1] + 2e-3
        assert elevations.min() > span[2] - 2e-3
        assert elevations.max() < span[3] + 2e-3


@pytest.mark.parametrize("camera", [CAMERA, TURNED])
def test_a_small_box_far_away_is_seen_as_by_the_camera(camera: Camera) -> None:
    lines = Sightlines(LAMPS_M, guard_config(eyes_above_m=0.0))
    middles = np.random.default_rng(0).random((50, 2)) * [camera.width_px, camera.height_px]
    rays = camera.rays(middles) @ camera.vehicle_from_camera.rotation.T
    spans, _ = lines.spans_rad(camera, np.hstack([middles, middles]), np.full(50, 1e9), np.full(50, 1e-6))
    azimuths, elevations = np.arctan2(rays[:, 1], rays[:, 0]), np.arcsin(rays[:, 2])
    expected = np.stack([azimuths, azimuths, elevations, elevations], -1)
    np.testing.assert_allclose(spans, np.repeat(expected[:, np.newaxis], 2, 1), atol=1e-6)


@pytest.mark.parametrize(("roll_rad", "pitch_rad"), [(0.0, 0.0), (0.5, 0.0), (0.0, -0.25)])
@pytest.mark.parametrize(
    "box",
    [
        [-500, 100, -20, 200],
        [1200, 900, 1900, 1300],
        [-90, -90, 1400, 1100],
        [600, -300, 640, 9],
        [1150, -140, 1200, -20],
    ],
)
def test_what_lies_beyond_the_image_is_inside_too(box: list[float], roll_rad: float, pitch_rad: float) -> None:
    """The tracker may expect a vehicle there, or a part of it."""
    lines = Sightlines(LAMPS_M, guard_config())
    pose = Pose(np.array([1.8, 0.02, 1.35]), rotation(0.0, pitch_rad, roll_rad))
    camera = Camera(1280, 960, (1100.0, 1100.0), (640.0, 480.0), (0.0,) * 5, pose)
    (spans,), _ = lines.spans_rad(camera, np.array([box], float), np.array([60.0]), np.array([1e-6]))
    check_within(spans, box, 60.0, camera)


@pytest.mark.parametrize(
    ("box", "range_m"),
    [([1035, 121, 1040, 131], 12.0), ([-400, 121, 100, 131], 8.0), ([300, 400, 320, 900], 12.0), ([-90, -60, 9, 9], 6)],
)
@pytest.mark.parametrize("yaw_pitch_roll_rad", [(0.0, 0.0, 0.0), (0.05, -0.03, 0.1)])
def test_near_the_lamps_what_lies_beyond_the_image_is_further_aside(
    box: list[float], range_m: float, yaw_pitch_roll_rad: tuple[float, float, float]
) -> None:
    """A narrow camera behind the windscreen: a lamp of ours is much nearer to what it sees than the camera is."""
    pose = Pose(np.array([0.6, 0.34, 0.87]), rotation(*yaw_pitch_roll_rad))
    camera = Camera(640, 480, (3000.0, 3000.0), (320.0, 240.0), (0.0,) * 5, pose)
    (spans,), _ = Sightlines(LAMPS_M, guard_config()).spans_rad(
        camera, np.array([box], float), np.array([range_m]), np.array([1e-6])
    )
    check_within(spans, box, range_m, camera)


@pytest.mark.parametrize("x", [205.0, 315.0, 330.0, 435.0])
def test_a_vehicle_that_may_be_beside_us_may_be_anywhere_from_there_to_far_ahead(x: float) -> None:
    """Lamps far before the camera, as of a coach: they see the nearest place behind them, past 180 degrees or not."""
    camera = Camera(640, 480, (640.0, 640.0), (320.0, 240.0), (0.0,) * 5, Pose(np.array([1.7, -0.8, 3.0]), np.eye(3)))
    lamps_m = np.array([[7.5, 0.9, 0.8], [7.5, -0.9, 0.8]])
    (spans,), nearest_m = Sightlines(lamps_m, guard_config()).spans_rad(
        camera, np.array([[x, 250.0, x + 4.0, 254.0]]), np.array([150.0]), np.array([450.0])
    )
    assert nearest_m == CLOSEST_M
    points_m = (
        camera.vehicle_from_camera.position_m + camera.rays([[x + 2.0, 252.0]]) / np.linspace(1e-3, 0.25, 99)[:, None]
    )
    for lamp_m, span in zip(lamps_m, spans, strict=True):
        x_m, y_m, _ = (points_m - lamp_m).T
        azimuths = np.arctan2(y_m, x_m)[x_m > 0.0]
        assert len(azimuths) > 5
        assert azimuths.min() > span[0] - 1e-4
        assert azimuths.max() < span[1] + 1e-4


def test_a_box_far_beyond_the_image_ends_at_a_right_angle() -> None:
    lines = Sightlines(LAMPS_M, guard_config())
    boxes = np.array([[-1e9, 100.0, -20.0, 200.0], [1200.0, 900.0, 5000.0, 1e9]])
    spans, _ = lines.spans_rad(CAMERA, boxes, np.full(2, 60.0), np.full(2, 6.0))
    assert np.isfinite(spans).all()
    assert np.abs(spans).max() < math.pi


@settings(derandomize=True, max_examples=60, deadline=None)
@given(
    st.floats(0, 1200),
    st.floats(100, 800),
    st.floats(1, 80),
    st.floats(5, 400),
    st.floats(0.1, 60),
    st.integers(0, 99),
)
def test_spans_hold_all_that_may_be_seen(
    x: float, y: float, size: float, range_m: float, sigma: float, seed: int
) -> None:
    """Any point of the box within two sigmas, and up to the eyes above it, is inside, from both lamps."""
    config = guard_config(eyes_above_m=0.5)
    box = np.array([[x, y, x + size, y + size]])
    spans, nearest_m = Sightlines(LAMPS_M, config).spans_rad(CAMERA, box, np.array([range_m]), np.array([sigma]))
    assert nearest_m == pytest.approx(max(range_m - 2 * sigma, CLOSEST_M))
    random = np.random.default_rng(seed)
    pixels = np.minimum(box[0, :2] + size * random.random((200, 2)), [1280, 960])
    rays = CAMERA.rays(pixels) @ CAMERA.vehicle_from_camera.rotation.T
    ranges_m = np.maximum(range_m + sigma * random.uniform(-2, 2, (200, 1)), CLOSEST_M)
    points = CAMERA.vehicle_from_camera.position_m + rays * ranges_m + random.random((200, 1)) * [0.0, 0.0, 0.5]
    for lamp in range(2):
        seen = points - LAMPS_M[lamp]
        azimuths = np.arctan2(seen[:, 1], seen[:, 0])
        elevations = np.arctan2(seen[:, 2], np.hypot(seen[:, 0], seen[:, 1]))
        least, most, lowest, highest = spans[0, lamp]
        slack = np.radians(0.002)
        assert (least - slack <= azimuths).all()
        assert (azimuths <= most + slack).all()
        assert (lowest - slack <= elevations).all()
        assert (elevations <= highest + slack).all()


@pytest.mark.parametrize("box", [[100, 440, 1180, 470], [0, 300, 900, 700], [300, 100, 1280, 480], [500, 0, 800, 960]])
@pytest.mark.parametrize("roll_deg", [-4.0, 0.0, 4.0])
@pytest.mark.parametrize("range_m", [6.0, 20.0, 100.0])
def test_spans_hold_all_of_a_wide_box(box: list[float], roll_deg: float, range_m: float) -> None:
    """Between its corners, directions reach further: a lorry close by, or the glare around a lamp, is as wide."""
    pose = Pose(np.array([1.8, 0.02, 2.2]), rotation(0.0, math.radians(-4.0), math.radians(roll_deg)))
    camera = Camera(1280, 960, (900.0, 900.0), (640.0, 480.0), (-0.07, 0.015, 0.0, 0.0, 0.0), pose)
    lines = Sightlines(LAMPS_M, guard_config())
    (spans,), _ = lines.spans_rad(camera, np.array([box], float), np.array([range_m]), np.array([1e-6]))
    pixels = np.random.default_rng(0).uniform(box[:2], box[2:], (2000, 2))
    pixels[::2, 1] = np.random.default_rng(1).choice(box[1::2], 1000)  # the upper and the lower edge
    points_m = pose.position_m + camera.rays(pixels) @ pose.rotation.T * range_m
    for lamp_m, span in zip(LAMPS_M, spans, strict=True):
        x, y, z = (points_m - lamp_m).T
        azimuths, elevations = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
        slack = np.radians(0.15)  # less than a cell of the guard's table, by which spans are widened
        assert azimuths.min() > span[0] - slack
        assert azimuths.max() < span[1] + slack
        assert elevations.min() > span[2] - slack
        assert elevations.max() < span[3] + slack


def test_spans_are_no_wider_than_the_box_needs() -> None:
    """A far point is seen as from the camera; the lamps' offset shows at 50 m."""
    lines = Sightlines(LAMPS_M, guard_config(eyes_above_m=0.0))
    box = np.array([[640.0, 490.0, 641.0, 491.0]] * 2)
    spans, _ = lines.spans_rad(CAMERA, box, np.array([1e7, 50.0]), np.array([1e-3, 1e-3]))
    assert np.degrees(np.abs(spans[0])).max() < 0.05
    middles = np.degrees(spans[1, :, :2].mean(axis=1))
    assert middles == pytest.approx(np.degrees([(0.02 - 0.6) / 48.2, (0.02 + 0.6) / 48.2]), abs=0.05)
    assert np.degrees(spans[1, :, 2:].mean(axis=1)) == pytest.approx(np.degrees([0.65 / 48.2] * 2), abs=0.05)


@pytest.mark.parametrize(
    ("range_m", "sigma_m", "nearest_m"),
    [
        (math.nan, math.inf, 15.0),
        (80.0, math.inf, CLOSEST_M),
        (80.0, math.nan, CLOSEST_M),
        (8.0, math.inf, CLOSEST_M),
        (80.0, 1e9, CLOSEST_M),
        (80.0, 5.0, 70.0),
        (9.0, 0.1, 8.8),
        (3.0, 0.1, CLOSEST_M),
    ],
)
def test_what_is_not_known_may_be_anywhere(range_m: float, sigma_m: float, nearest_m: float) -> None:
    lines = Sightlines(LAMPS_M, guard_config())
    box = np.array([[700.0, 500.0, 720.0, 520.0]])
    spans, told_m = lines.spans_rad(CAMERA, box, np.array([range_m]), np.array([sigma_m]))
    assert told_m == pytest.approx(nearest_m)
    if nearest_m == 15.0:
        known, _ = lines.spans_rad(CAMERA, box, np.array([15.0]), np.array([1e-9]))
        assert (spans[..., [0, 2]] <= known[..., [0, 2]] + 1e-7).all()
        assert (spans[..., [1, 3]] >= known[..., [1, 3]] - 1e-7).all()


@pytest.mark.parametrize("range_m", [8.0, 80.0])
def test_a_range_without_a_sigma_is_as_one_with_a_very_great_sigma(range_m: float) -> None:
    lines = Sightlines(LAMPS_M, guard_config())
    box = np.array([[700.0, 500.0, 720.0, 520.0]])
    spans = [lines.spans_rad(CAMERA, box, np.array([range_m]), np.array([sigma]))[0] for sigma in (math.inf, 1e12)]
    np.testing.assert_allclose(spans[0], spans[1], atol=1e-9)


def test_no_tracks() -> None:
    lines = Sightlines(LAMPS_M, guard_config())
    spans, nearest_m = lines.spans_rad(CAMERA, np.zeros((0, 4)), np.zeros(0), np.zeros(0))
    assert spans.shape == (0, 2, 4)
    assert nearest_m.shape == (0,)
