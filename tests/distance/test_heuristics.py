from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.distance.heuristics import HEURISTICS
from foreglow.geometry import Floats
from tests.distance.places import camera, frame, range_m, ranges, straight_road

NAN, INF = np.nan, np.inf
RANGES = np.array([[30.0, 10.0, NAN, 20.0, NAN], [NAN] * 5, [40.0, 10.0, 30.0, 20.0, 5.0]])
SIGMAS = np.array([[3.0, 1.0, INF, 2.0, INF], [INF] * 5, [4.0, 1.0, 3.0, 2.0, 0.5]])


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("maximum", [(30.0, 3.0), (NAN, INF), (40.0, 4.0)]),
        ("minimum", [(10.0, 1.0), (NAN, INF), (5.0, 0.5)]),
        ("mean", [(20.0, 2.0), (NAN, INF), (21.0, 2.1)]),
        ("median", [(20.0, 2.0), (NAN, INF), (20.0, 2.0)]),
        ("centre", [(30.0, 3.0), (NAN, INF), (40.0, 4.0)]),
        ("lowest", [(30.0, 3.0), (NAN, INF), (40.0, 4.0)]),
    ],
)
def test_by_hand(name: str, expected: list[tuple[float, float]]) -> None:
    ranges, sigmas = HEURISTICS[name].reduce(RANGES, SIGMAS)
    np.testing.assert_allclose(np.stack([ranges, sigmas], -1), expected)


def test_the_median_of_an_even_number() -> None:
    ranges, sigmas = HEURISTICS["median"].reduce(np.array([[NAN, 4.0, 1.0]]), np.array([[INF, 0.4, 0.1]]))
    assert (ranges.tolist(), sigmas.tolist()) == ([2.5], [0.25])


def test_places_in_a_box() -> None:
    boxes = np.array([[10, 20, 15, 23], [0, 0, 1, 1]], np.int32)
    assert HEURISTICS["centre"].pixels(boxes).tolist() == [[[12.5, 21.5]], [[0.5, 0.5]]]
    assert HEURISTICS["lowest"].pixels(boxes).tolist() == [[[12.5, 22.5]], [[0.5, 0.5]]]
    samples = HEURISTICS["mean"].pixels(boxes)
    assert samples[0].min(axis=0).tolist() == [10.5, 20.5]
    assert samples[0].max(axis=0).tolist() == [14.5, 22.5]
    assert (samples[1] == 0.5).all()
    assert HEURISTICS["mean"].pixels(boxes[:0]).shape == (0, 9, 2)


@st.composite
def tables(draw: st.DrawFn) -> tuple[Floats, Floats]:
    shape = (draw(st.integers(0, 4)), draw(st.integers(1, 9)))
    values = st.floats(0.1, 1e6) | st.just(NAN)
    ranges = np.array(draw(st.lists(values, min_size=shape[0] * shape[1], max_size=shape[0] * shape[1])))
    ranges = ranges.reshape(shape)
    return ranges, np.where(np.isnan(ranges), INF, ranges / 10)


@pytest.mark.slow
@settings(derandomize=True, max_examples=200)
@given(tables())
def test_in_order_and_unknown_together(table: tuple[Floats, Floats]) -> None:
    found = {name: heuristic.reduce(*table) for name, heuristic in HEURISTICS.items()}
    is_unknown = np.isnan(table[0]).all(axis=1)
    for name in ("minimum", "median", "mean", "maximum"):
        ranges, sigmas = found[name]
        assert (np.isnan(ranges) == is_unknown).all()
        assert (np.isinf(sigmas) == is_unknown).all()
        known = ranges[~is_unknown]
        assert (known >= found["minimum"][0][~is_unknown] * (1 - 1e-12)).all()
        assert (known <= found["maximum"][0][~is_unknown] * (1 + 1e-12)).all()


def test_pixels_above_the_horizon_are_left_out() -> None:
    """The upper part of the box is sky: the lowest row, at 10 px below the axis, has a range, the centre has none."""
    seen, box = frame(camera()), (50, 30, 60, 58)
    lowest = range_m("gp", seen, box, heuristic="lowest")
    assert np.isnan(range_m("gp", seen, box))
    assert lowest == pytest.approx(np.sqrt(125.0**2 * (1 + (8.5 / 1000) ** 2) + 1.25**2), rel=1e-9)
    # Of three rows only the lowest is below the horizon; a corner is a little farther than the middle.
    assert range_m("gp", seen, box, heuristic="minimum") == pytest.approx(lowest, rel=1e-4)
    assert range_m("gp", seen, box, heuristic="maximum") == pytest.approx(lowest, rel=1e-3)


@pytest.mark.parametrize("name", ["gp", "psd_3d", "psd_3d_plus", "psd_2d"])
def test_extremes_are_close_to_those_of_all_pixels(name: str) -> None:
    seen, box = frame(camera(pitch_rad=-0.03), straight_road(-1.6)), (70, 40, 90, 62)
    pixels = [(x, y, x + 1, y + 1) for x in range(70, 90) for y in range(40, 62)]
    every = np.array([range_m(name, seen, pixel) for pixel in pixels])
    assert not np.isnan(every).any()
    for heuristic, expected in (("minimum", every.min()), ("maximum", every.max())):
        # Of GP they lie on the rim; of PSD the farthest may lie inside.
        close = 1e-9 if name == "gp" else 0.05
        assert range_m(name, seen, box, heuristic=heuristic) == pytest.approx(expected, rel=close)
    assert range_m(name, seen, box, heuristic="mean") == pytest.approx(every.mean(), rel=0.2)
    assert range_m(name, seen, box, heuristic="median") == pytest.approx(np.median(every), rel=0.2)


@pytest.mark.parametrize(("name", "reduce"), [("maximum", max), ("mean", np.mean), ("median", np.median)])
def test_all_pixels_of_a_box(name: str, reduce: Callable[[list[float]], float]) -> None:
    """Each pixel alone, as a box of one pixel; boxes of different sizes in one call."""
    seen, small = frame(camera()), (40, 60, 43, 65)
    pixels = [(x, y, x + 1, y + 1) for x in range(40, 43) for y in range(60, 65)]
    expected = reduce([range_m("gp", seen, pixel) for pixel in pixels])
    assert range_m("gp", seen, small, heuristic=name, all_pixels=True) == pytest.approx(expected, rel=1e-12)
    both = ranges("gp", seen, [small, (40, 60, 41, 61)], heuristic=name, all_pixels=True)
    assert both.ranges_m == pytest.approx([expected, range_m("gp", seen, (40, 60, 41, 61))])
    assert len(ranges("gp", seen, [], heuristic=name, all_pixels=True).ranges_m) == 0
