from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.distance.ground_plane import HEIGHT_SIGMA_M, ROAD_SIGMA_RAD
from foreglow.distance.pitch import REST_SIGMA_RAD, SENSOR_SIGMA_RAD
from foreglow.types import EgoMotion
from tests.distance.places import aimed, camera, frame, range_m, ranges


def row(number: int) -> tuple[int, int, int, int]:
    """The pixel `number` rows below the principal point."""
    return (63, 47 + number, 64, 48 + number)


def test_by_hand() -> None:
    """A level camera, 1.25 m high: 25 of 1000 px below the axis the ray falls 1 in 40 and meets the road at x = 50."""
    assert range_m("gp", frame(camera()), row(25)) == pytest.approx(math.hypot(50.0, 1.25), rel=1e-12)
    assert range_m("gp", frame(camera()), row(10)) == pytest.approx(math.hypot(125.0, 1.25), rel=1e-12)
    # One more by the side: 20 px to the right at the same row, x = 50, y = -1.
    assert range_m("gp", frame(camera()), (83, 72, 84, 73)) == pytest.approx(math.sqrt(2501 + 1.5625), rel=1e-12)
    # Pitched down by 1 in 10, the axis itself meets the road at x = 12.5.
    assert range_m("gp", frame(camera(pitch_rad=-math.atan(0.1)))) == pytest.approx(math.hypot(12.5, 1.25), rel=1e-12)


@pytest.mark.parametrize(("range_to", "share"), [(50.0, 0.075), (100.0, 0.16), (200.0, 0.39), (400.0, 1.27)])
def test_what_a_tenth_of_a_degree_does(range_to: float, share: float) -> None:
    """Figures worked out elsewhere, for a camera 1.25 m above the road."""
    depression = math.asin(1.25 / range_to)
    wrong = camera(pitch_rad=math.radians(0.1) - depression)
    assert range_m("gp", frame(wrong)) / range_to - 1 == pytest.approx(share, abs=0.006)


def test_light_above_the_road_seems_too_far() -> None:
    """A lamp at half the camera's height seems twice as far as it is."""
    assert range_m("gp", frame(aimed([60.0, 1.0, 0.625]))) == pytest.approx(2 * math.sqrt(3601 + 0.625**2), rel=1e-9)


def test_the_body_is_pitched_about_the_rear_axle() -> None:
    """Nose up by p: the camera, 2 m ahead of the axle, rises, and the axis looks up by p."""
    pitch = math.radians(0.3)
    seen = frame(camera(pitch_rad=-0.03, forward_m=2.0), motion=EgoMotion(20.0, 0.0, pitch))
    height_m = 1.25 * math.cos(pitch) + 2.0 * math.sin(pitch)
    assert range_m("gp", seen, pitch="motion") == pytest.approx(height_m / math.sin(0.03 - pitch), rel=1e-12)
    assert range_m("gp", seen) == pytest.approx(1.25 / math.sin(0.03), rel=1e-12)


@pytest.mark.parametrize("motion", [None, EgoMotion(20.0, 0.0)])
def test_an_unknown_pitch_is_that_at_rest(motion: EgoMotion | None) -> None:
    seen = frame(camera(pitch_rad=-0.03), motion=motion)
    fixed, asked = ranges("gp", seen), ranges("gp", seen, pitch="motion")
    assert (fixed.ranges_m, fixed.sigmas_m) == (asked.ranges_m, asked.sigmas_m)


@pytest.mark.parametrize("pitch_rad", [0.0, 1e-12, 0.01, 0.7])
def test_nothing_is_on_the_road_at_and_above_the_horizon(pitch_rad: float) -> None:
    found = ranges("gp", frame(camera(pitch_rad=pitch_rad)))
    assert np.isnan(found.ranges_m).all()
    assert np.isinf(found.sigmas_m).all()


def test_sigma_by_hand() -> None:
    """25 px below a level camera's axis: an error e of the angle moves the range by r e / sin, of height by e / sin."""
    sine = 1.25 / math.hypot(50.0, 1.25)
    for motion, source, own in ((None, "fixed", REST_SIGMA_RAD), (EgoMotion(0, 0, 0.0), "motion", SENSOR_SIGMA_RAD)):
        angle = math.hypot(own, ROAD_SIGMA_RAD)
        expected = math.hypot(math.hypot(50.0, 1.25) * angle / sine, HEIGHT_SIGMA_M / sine)
        found = ranges("gp", frame(camera(), motion=motion), [row(25)], pitch=source)
        assert found.sigmas_m[0] == pytest.approx(expected, rel=1e-9)


@settings(derandomize=True, max_examples=50)
@given(st.floats(0.005, 0.3), st.floats(0.8, 2.5))
def test_sigma_is_what_small_errors_do(depression: float, height_m: float) -> None:
    """To first order, the range moves by (d range / d pitch) times the error."""
    step = 1e-7
    low, high = (range_m("gp", frame(camera(height_m, pitch_rad=-depression + s))) for s in (-step, step))
    slope = (high - low) / (2 * step)
    found = ranges("gp", frame(camera(height_m, pitch_rad=-depression)))
    by_height = HEIGHT_SIGMA_M / math.sin(depression)
    by_angle = math.sqrt(found.sigmas_m[0] ** 2 - by_height**2)
    assert by_angle / math.hypot(REST_SIGMA_RAD, ROAD_SIGMA_RAD) == pytest.approx(
        slope / math.cos(depression), rel=1e-4
    )


@settings(derandomize=True, max_examples=100)
@given(st.integers(1, 40), st.integers(1, 7))
def test_lower_in_the_image_is_nearer_and_surer(number: int, further: int) -> None:
    found = ranges("gp", frame(camera()), [row(number), row(number + further)])
    assert found.ranges_m[1] < found.ranges_m[0]
    assert found.sigmas_m[1] < found.sigmas_m[0]
