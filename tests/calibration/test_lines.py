from __future__ import annotations

import math

import numpy as np
import pytest

from foreglow.calibration.auto import lines
from foreglow.calibration.auto.lines import MAX_WAYS, Bend, Segments, meet, num_ways
from foreglow.geometry import Floats

HEIGHT_M = 1.3
LATERALS_M = (-5.4, -1.8, 1.8, 5.4)
POINT = np.array([0.02, -0.03])


def seen(offsets_m: Floats, ahead_m: Floats, fall_per_m: float, bend_per_m: float = 0.0) -> Floats:
    """Tangents (u, v) of points on a road that falls and bends away, below the way ahead at `POINT`."""
    right = (offsets_m + bend_per_m * ahead_m**2 / 2) / ahead_m
    down = (HEIGHT_M + fall_per_m * ahead_m**2 / 2) / ahead_m
    return POINT + np.stack([right, down], -1)


def markings(fall_per_m: float = 0.0, bend_per_m: float = 0.0) -> Segments:
    """Segments of 3 m of four lines, from 6 to 24 m ahead."""
    offsets, starts = (grid.ravel() for grid in np.meshgrid(LATERALS_M, np.arange(6.0, 24.0, 3.0)))
    near, far = (seen(offsets, starts + along, fall_per_m, bend_per_m) for along in (0.0, 3.0))
    spans = near - far
    return Segments((near + far) / 2, spans[:, 0] / spans[:, 1], np.hypot(*spans.T), far[:, 1])


def test_a_straight_and_level_road_leads_to_its_vanishing_point() -> None:
    found = meet(markings(), POINT + 0.003, 600.0)
    assert found is not None
    assert np.abs(np.degrees(found.point - POINT)).max() < 0.05


@pytest.mark.parametrize(
    ("fall_per_m", "bend_per_m", "axis"), [(1 / 2500, 0.0, 1), (-1 / 2500, 0.0, 1), (0.0, 0.003, 0)]
)
def test_hills_and_bends_are_told_from_the_way_ahead(
    fall_per_m: float, bend_per_m: float, axis: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = meet(markings(fall_per_m, bend_per_m), POINT, 600.0)
    monkeypatch.setattr(lines, "HILL_SIGMA", 1e-6)
    straight = meet(markings(fall_per_m, bend_per_m), POINT, 600.0, Bend(0.0, 1e-6))
    assert found is not None
    assert straight is not None
    assert abs((found.point - POINT)[axis]) < 0.9 * abs((straight.point - POINT)[axis])


def test_a_bend_that_is_known_does_not_turn_the_way_ahead() -> None:
    bend_per_m = 0.004
    known = meet(markings(0.0, bend_per_m), POINT, 600.0, Bend(bend_per_m * HEIGHT_M, 1e-4))
    assert known is not None
    assert abs(math.degrees(known.point[0] - POINT[0])) < 0.06
    assert known.bend == pytest.approx(bend_per_m * HEIGHT_M, rel=0.05)


def test_a_road_has_few_ways_and_snow_has_all() -> None:
    assert num_ways(markings(), POINT) == pytest.approx(len(LATERALS_M), abs=0.5)
    generator = np.random.default_rng(3)
    middles = generator.uniform([-0.5, 0.05], [0.5, 0.3], (300, 2))
    slopes = middles[:, 0] / middles[:, 1]
    assert num_ways(Segments(middles + POINT, slopes, np.full(300, 0.05), middles[:, 1] + POINT[1]), POINT) > MAX_WAYS
    assert num_ways(Segments(np.zeros((0, 2)), *np.zeros((3, 0))), POINT) == 0.0
