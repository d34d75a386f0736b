"""A gap is dark, more gaps are never brighter, and light goes at once but returns slowly."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from foreglow.beam.dimming import Dimmer, Ramp
from foreglow.beam.gaps import Gap
from foreglow.geometry import Floats
from foreglow.photometry import read_headlamps
from foreglow.photometry.matrix import LedGrid
from tests.beam.made_up import lamps_of

LAMPS = read_headlamps()
LIMIT_LX = 0.03
NEAREST_M = 8.0
DIMMER = Dimmer(LAMPS, LIMIT_LX)

GAPS = st.builds(
    lambda middle, half, near, depth: Gap(middle - half, middle + half, near, near + depth),
    st.floats(-0.35, 0.35),
    st.floats(0.001, 0.1),
    st.floats(NEAREST_M, 400),
    st.floats(0, 300) | st.just(math.inf),
)


def led_lx(levels: Floats, azimuths_rad: Floats, ranges_m: Floats, elevations_rad: Floats) -> Floats:
    """Shape (P,): the light of the strongest LED of both lamps at eyes: directions and ranges from the vehicle's
    origin, elevations from the lamps."""
    lamps_m = np.stack([LAMPS.left.vehicle_from_lamp.position_m, LAMPS.right.vehicle_from_lamp.position_m])
    ahead, left = ranges_m * np.cos(azimuths_rad), ranges_m * np.sin(azimuths_rad)
    strongest = np.zeros(len(ranges_m))
    for lamp, (x, y, z) in enumerate(lamps_m):
        up = z + np.hypot(ahead - x, left - y) * np.tan(elevations_rad)
        points = np.stack([ahead, left, up], axis=1)
        leds_lx = LAMPS.illuminance_lx(points)[1][:, lamp] * levels[lamp]
        strongest = np.maximum(strongest, leds_lx.max(axis=1))
    return strongest


@settings(max_examples=60, deadline=None)
@given(GAPS, st.integers(0, 2**16))
@example(Gap(-0.01, 0.01, 300.0, math.inf), 0)
@example(Gap(-0.05, 0.05, NEAREST_M, NEAREST_M + 0.1), 0)
def test_a_gap_is_dark(gap: Gap, seed: int) -> None:
    """For eyes anywhere in it, at any range and height; between the table's directions an LED may shine 5 % more."""
    generator = np.random.default_rng(seed)
    ranges_m = generator.uniform(gap.near_m, min(gap.far_m, 600.0 + gap.near_m), 40)
    azimuths, elevations = generator.uniform(*gap[:2], 40), np.radians(generator.uniform(-0.5, 4.0, 40))
    shining_lx = led_lx(DIMMER.levels([gap]), azimuths, ranges_m, elevations)
    assert shining_lx.max() <= 1.05 * LIMIT_LX


@settings(max_examples=100, deadline=None)
@given(st.lists(GAPS, max_size=4), GAPS)
def test_more_gaps_are_never_brighter(gaps: list[Gap], another: Gap) -> None:
    before, after = DIMMER.levels(gaps), DIMMER.levels([*gaps, another])
    assert (after <= before).all()
    assert after.min() >= 0.0
    assert before.max() <= 1.0
    np.testing.assert_array_equal(after, DIMMER.levels([another, *gaps]))


@settings(max_examples=100, deadline=None)
@given(GAPS, st.floats(0, 0.1), st.floats(0, 1), st.floats(0, 100))
def test_wider_and_nearer_is_never_brighter(gap: Gap, more: float, share: float, further_m: float) -> None:
    near_m = NEAREST_M + share * (gap.near_m - NEAREST_M)
    larger = Gap(gap.right_rad - more, gap.left_rad + more, near_m, gap.far_m + further_m)
    assert (DIMMER.levels([larger]) <= DIMMER.levels([gap]) + 1e-12).all()


def test_without_gaps_all_is_lit_and_beside_one_it_stays_so() -> None:
    assert (DIMMER.levels([]) == 1.0).all()
    levels = DIMMER.levels([Gap(0.15, 0.2, 80.0, 90.0)])
    columns = levels.reshape(2, -1, LAMPS.num_columns)
    assert columns[:, :, :14].min() == 1.0  # the right half
    assert columns[:, :, -8:].min() < 0.05
    assert (DIMMER.levels([Gap(1.0, 1.3, 80.0, 90.0)]) == 1.0).all()  # beside all that the LEDs reach
    assert (DIMMER.levels([Gap(-1.3, -1.0, 80.0, 90.0)]) == 1.0).all()


@pytest.mark.parametrize("back_rad", [2.0, 3.1, math.pi, 3.3, 6.0, 2 * math.pi])
def test_a_gap_that_ends_behind_us_is_dark_up_to_the_side(back_rad: float) -> None:
    """It was bright: its border was taken for one on the other side."""
    for border_rad in (-0.1, 0.0, 0.3):
        to_the_left, to_the_right = Gap(border_rad, back_rad, 50.0, 60.0), Gap(-back_rad, border_rad, 50.0, 60.0)
        left, right = Gap(border_rad, math.pi / 2, 50.0, 60.0), Gap(-math.pi / 2, border_rad, 50.0, 60.0)
        np.testing.assert_array_equal(DIMMER.levels([to_the_left]), DIMMER.levels([left]))
        np.testing.assert_array_equal(DIMMER.levels([to_the_right]), DIMMER.levels([right]))


def test_each_lamp_has_its_own_place() -> None:
    """What is near ahead of the left lamp lies to the left of the right one."""
    levels = DIMMER.levels([Gap(0.005, 0.055, 12.0, 14.0)]).reshape(2, -1, LAMPS.num_columns).mean(axis=1)
    left, right = ((1.0 - lamp) @ np.arange(LAMPS.num_columns) / (1.0 - lamp).sum() for lamp in levels)
    assert right > left + 2.0


TARGETS = st.lists(
    st.tuples(st.integers(0, 400), st.lists(st.floats(0, 1), min_size=4, max_size=4)), min_size=1, max_size=20
)


@given(TARGETS, st.floats(0, 0.5), st.floats(0.1, 3))
def test_light_goes_at_once_and_returns_slowly(
    steps: list[tuple[int, list[float]]], hold_s: float, restore_s: float
) -> None:
    ramp, time_ms, shown = Ramp(hold_s, restore_s), 0, []
    for step_ms, target in steps:
        time_ms += step_ms
        wanted = np.array(target).reshape(2, 2)
        shown.append((time_ms, wanted, ramp.step(wanted, time_ms * 1_000_000).copy()))
    np.testing.assert_array_equal(shown[0][2], shown[0][1])
    for (before_ms, _, before), (now_ms, wanted, now) in pairwise(shown):
        assert (now <= wanted).all()
        assert (now <= before + (now_ms - before_ms) / 1e3 / restore_s + 1e-9).all()
        assert (now >= np.minimum(wanted, before)).all()


def test_dark_for_the_hold_and_then_up_at_the_rate() -> None:
    ramp = Ramp(hold_s=0.3, restore_s=2.0)
    full = np.ones((2, 1))
    levels = [ramp.step(full * (step != 1), step * 100_000_000)[0, 0] for step in range(27)]
    assert levels[:4] == [1.0, 0.0, 0.0, 0.0]  # dimmed at 0.1 s, held to 0.4 s
    assert levels[4] == pytest.approx(0.05)
    assert levels[13] == pytest.approx(0.5)
    assert levels[23] == pytest.approx(1.0)
    assert levels[26] == 1.0


def test_the_hold_begins_when_nothing_asks_for_darkness_any_more() -> None:
    ramp = Ramp(hold_s=0.25, restore_s=1.0)
    wanted = [1.0] + [0.2] * 5 + [1.0] * 4
    levels = [ramp.step(np.full((2, 1), level), k * 100_000_000)[0, 0] for k, level in enumerate(wanted)]
    assert levels == pytest.approx([1.0] + [0.2] * 7 + [0.3, 0.4])


def test_leds_finer_than_the_tables_directions_are_dimmed_as_well() -> None:
    """Rows of light between the elevations of the table."""
    grid = LedGrid(
        num_columns=3,
        pitch_deg=1.0,
        row_elevations_deg=(0.25, 0.75),
        row_peaks_cd=(30_000.0, 20_000.0),
        side_sigma_deg=6.5,
        everywhere_cd=0.0,
        half_width_deg=0.4,
        half_height_deg=0.05,
        edge_exponent=2.0,
        reach_width_deg=0.8,
        reach_height_deg=0.15,
    )
    levels = Dimmer(lamps_of(grid), LIMIT_LX).levels([Gap(-0.1, 0.1, 100.0, 200.0)])
    assert (levels * np.repeat([30_000.0, 20_000.0], 3)).max() <= 1.05 * LIMIT_LX * 100.0**2


def test_time_that_goes_back_brings_no_light() -> None:
    ramp = Ramp(hold_s=0.0, restore_s=1.0)
    for time_ns in (5_000_000_000, 4_000_000_000):
        assert (ramp.step(np.full((2, 1), time_ns == 4_000_000_000, np.float64), time_ns) == 0.0).all()


def test_a_new_start_knows_nothing() -> None:
    ramp = Ramp(hold_s=1.0, restore_s=1.0)
    ramp.step(np.zeros((2, 1)), 0)
    ramp.reset()
    assert (ramp.step(np.ones((2, 1)), 1) == 1.0).all()


def test_after_time_went_back_light_returns_after_the_hold() -> None:
    """What was dimmed at a time far ahead, as by a camera with a wrong clock, is not held until then."""
    ramp = Ramp(hold_s=0.1, restore_s=0.5)
    ramp.step(np.ones((2, 1)), 0)
    ramp.step(np.zeros((2, 1)), 3_600_000_000_000)
    levels = [ramp.step(np.ones((2, 1)), step * 100_000_000)[0, 0] for step in range(1, 9)]
    assert levels[0] == 0.0
    assert levels[-1] == 1.0
