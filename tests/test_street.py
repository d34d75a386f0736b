from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.street import (
    LANE_WIDTH_M,
    MAX_RADIUS_M,
    MIN_RADIUS_M,
    StreetMessage,
    StreetSegment,
    curvature_code,
    curvature_from_code,
    points_from_message,
    road_from_message,
    slope_code,
)
from tests.datasets.vehicle_logs.messages import segment as numbered_segment


def segment(**codes: Any) -> StreetSegment:
    return numbered_segment(codes.pop("segment_id", 1), **codes)


@settings(derandomize=True, max_examples=200)
@given(st.floats(1 / MAX_RADIUS_M, 1 / MIN_RADIUS_M), st.booleans())
def test_a_curvature_survives_within_one_and_a_half_percent(magnitude: float, is_left: bool) -> None:
    signed = magnitude if is_left else -magnitude
    assert curvature_from_code(curvature_code(signed), is_left) == pytest.approx(signed, rel=0.0138)


def test_the_ends_of_the_curvature_code() -> None:
    assert curvature_from_code(0, True) == pytest.approx(0.1)
    assert curvature_from_code(254, False) == pytest.approx(-1e-4)
    assert curvature_from_code(255, True) == 0.0
    assert curvature_code(1.0) == 0
    assert curvature_code(1 / 12_000) == 255
    assert curvature_code(1 / 9_900) == 254


@settings(derandomize=True, max_examples=100)
@given(st.floats(-0.63, 0.63))
def test_a_slope_survives_within_a_quarter_percent(slope: float) -> None:
    assert abs(segment(slope_code=slope_code(slope)).slope - slope) <= 0.0025 + 1e-12


def test_slopes_saturate() -> None:
    assert (slope_code(3.0), slope_code(-3.0)) == (127, -127)


@st.composite
def _messages(draw: st.DrawFn) -> StreetMessage:
    code, flag = st.integers(0, 255), st.booleans()
    segments = tuple(
        segment(
            segment_id=draw(st.integers(1, 62)),
            parent_id=draw(st.integers(0, 62)),
            length_code=draw(st.integers(1, 127)),
            start_curvature_code=draw(code),
            is_start_left=draw(flag),
            end_curvature_code=draw(code),
            is_end_left=draw(flag),
            slope_code=draw(st.integers(-127, 127)),
        )
        for _ in range(draw(st.integers(1, 4)))
    )
    return StreetMessage(
        segments=segments, remaining_length_m=draw(st.integers(0, 254)), error_class=draw(st.integers(0, 5))
    )


@settings(derandomize=True, max_examples=60)
@given(_messages())
def test_any_message_survives_json_and_gives_points(message: StreetMessage) -> None:
    assert StreetMessage.from_json(message.to_json()) == message
    points = points_from_message(message, 1.5)
    assert points.ndim == 2
    assert points[0].tolist() == [0.0, 1.5, 0.0]
    assert np.isfinite(points).all()


def test_a_broken_message_names_the_field() -> None:
    text = StreetMessage(segments=(segment(),), remaining_length_m=3, error_class=0).to_json()
    with pytest.raises(ValueError, match=r"segments\.0\.length_code"):
        StreetMessage.from_json(text.replace('"length_code":50', '"length_code":128'))


def test_points_of_a_circle() -> None:
    """A quarter of a circle to the left, radius 100 m, on a slope of 5 %: (r sin, r (1 - cos))."""
    code = curvature_code(0.01)
    radius_m = 1 / curvature_from_code(code, True)
    bend = segment(
        length_code=100,
        start_curvature_code=code,
        is_start_left=True,
        end_curvature_code=code,
        is_end_left=True,
        slope_code=10,
    )
    points = points_from_message(StreetMessage(segments=(bend,), remaining_length_m=160, error_class=0))
    assert points.shape == (161, 3)
    way_m = np.arange(161.0)
    level = np.stack([radius_m * np.sin(way_m / radius_m), radius_m * (1 - np.cos(way_m / radius_m)), 0.05 * way_m], -1)
    # The vehicle's nose is up by the slope: seen from it, the road ahead begins level.
    tilt = np.arctan(0.05)
    x = level[:, 0] * np.cos(tilt) + level[:, 2] * np.sin(tilt)
    z = level[:, 2] * np.cos(tilt) - level[:, 0] * np.sin(tilt)
    np.testing.assert_allclose(points, np.stack([x, level[:, 1], z], -1), atol=0.01)


def test_a_bend_to_the_right_goes_right() -> None:
    bend = segment(start_curvature_code=80, end_curvature_code=80)
    assert points_from_message(StreetMessage(segments=(bend,), remaining_length_m=90, error_class=0))[-1, 1] < -5


def test_a_segment_that_is_over_begins_at_its_end() -> None:
    message = StreetMessage(segments=(segment(), segment()), remaining_length_m=0, error_class=0)
    assert len(points_from_message(message)) == 101


def test_the_road_of_a_message() -> None:
    message = StreetMessage(segments=(segment(),), remaining_length_m=80, error_class=2)
    road = road_from_message(message)
    assert road is not None
    assert road.points_m[0].tolist() == [0.0, LANE_WIDTH_M / 2, 0.0]
    assert (len(road), road.half_width_m, road.error_bound_m) == (81, LANE_WIDTH_M, 10.0)
    assert not road.cross_slopes.any()


def test_a_vehicle_moves_on_along_the_road_of_a_message() -> None:
    """As if the message had been sent there, and in the next segment level on its slope."""
    segments = segment(slope_code=4), segment(slope_code=-6, start_curvature_code=90, end_curvature_code=90)
    message = StreetMessage(segments=segments, remaining_length_m=30, error_class=0)
    here, beyond = (road_from_message(message, travelled_m) for travelled_m in (10.0, 45.0))
    nearer = road_from_message(message.model_copy(update={"remaining_length_m": 20}))
    last = StreetMessage(segments=segments[1:], remaining_length_m=int(segments[1].length_m) - 15, error_class=0)
    for moved, sent in ((here, nearer), (beyond, road_from_message(last))):
        assert moved is not None
        assert sent is not None
        np.testing.assert_allclose(moved.points_m, sent.points_m, atol=1e-9)
    assert road_from_message(message, 1000.0) is None


def test_a_message_that_is_over_tells_no_road() -> None:
    assert road_from_message(StreetMessage(segments=(segment(),), remaining_length_m=0, error_class=2)) is None


def test_a_position_before_its_segment_is_in_another_one() -> None:
    """As where a number was given to another segment since: the road began at the one that was known."""
    first = segment()
    at_begin = StreetMessage(segments=(first,), remaining_length_m=int(first.length_m) + 2, error_class=0)
    assert road_from_message(at_begin) is not None
    assert road_from_message(at_begin.model_copy(update={"remaining_length_m": int(first.length_m) + 3})) is None
