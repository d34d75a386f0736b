"""On a flat, straight road without errors every method of the paper is exact."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.distance import ESTIMATORS
from foreglow.distance.pixelwise import PixelwiseEstimator
from tests.distance.places import aimed, frame, range_m, straight_road

METHODS = [name for name, kind in ESTIMATORS.items() if issubclass(kind, PixelwiseEstimator)]


@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
@settings(derandomize=True, max_examples=100)
@given(
    st.floats(8.0, 390.0),
    st.floats(0.5, 4.0),
    st.booleans(),
    st.floats(0.8, 2.5),
    st.floats(-0.4, 0.4),
    st.floats(0, 3),
)
def test_a_point_of_the_road_has_its_range(
    name: str, x_m: float, offset_m: float, is_left: bool, height_m: float, left_m: float, forward_m: float
) -> None:
    line_m = left_m + (offset_m if is_left else -offset_m)
    target = np.array([x_m, line_m, 0.0])
    camera = aimed(target, height_m, forward_m, left_m)
    expected = np.linalg.norm(target - [forward_m, left_m, height_m])
    assert range_m(name, frame(camera, straight_road(line_m))) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("step_m", [0.5, 1.0, 7.0, 400.0])
def test_how_the_map_is_cut_does_not_matter(name: str, step_m: float) -> None:
    target = np.array([87.3, 1.6, 0.0])
    seen = frame(aimed(target), straight_road(step_m=step_m))
    assert range_m(name, seen) == pytest.approx(np.linalg.norm(target - [0, 0, 1.25]), rel=1e-6)


@pytest.mark.parametrize("name", METHODS)
def test_a_centre_line_under_the_camera(name: str) -> None:
    """In the vertical plane of the road the ray meets it; seen from above both run alongside."""
    value = range_m(name, frame(aimed([60.0, 0.0, 0.0]), straight_road(0.0)))
    if name == "psd_2d":
        assert np.isnan(value)
    else:
        assert value == pytest.approx(np.hypot(60.0, 1.25), rel=1e-6)
