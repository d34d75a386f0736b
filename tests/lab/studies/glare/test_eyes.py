from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foreglow.lab.studies.glare.drive import DriverEye, GlareDrive, RoadLight
from foreglow.lab.studies.glare.eyes import FMVSS_108, R123, Glare, first_glare_s, score_eye
from tests.lab.studies.glare_drives import approach

ON, OFF = np.ones((2, 1, 1)), np.zeros((2, 1, 1))


def eye(ranges_m: list[float], base_lx: list[float], led_lx: list[float], **changes: Any) -> DriverEye:
    """With one LED on the left, always in sight."""
    num = len(ranges_m)
    leds_lx = np.zeros((num, 2, 1))
    leds_lx[:, 0, 0] = led_lx
    fields: dict[str, Any] = {"vehicle_id": 1, "kind": "car", "is_oncoming": True} | changes
    in_sight = np.ones(num, np.bool_)
    return DriverEye(
        ranges_m=np.array(ranges_m), azimuths_rad=np.zeros(num), is_in_sight=in_sight, base_lx=np.array(base_lx),
        leds_lx=leds_lx.astype(np.float32), **fields,
    )  # fmt: skip


def drive_with(one: DriverEye, rate_hz: float = 2.0, **changes: Any) -> GlareDrive:
    num = len(one.ranges_m)
    road = RoadLight(np.ones((num, 2)), np.ones((num, 2, 2, 1), np.float32))
    fields: dict[str, Any] = {"runs": {}, "light_s": {}} | changes
    return GlareDrive("a", "curve", rate_hz, np.arange(num) / rate_hz, np.full(num, 20.0), (one,), road, **fields)


def test_two_frames_and_one_led() -> None:
    # The limits at 100 m and 20 m are 0.6 and 3.1 lx; half a second a frame.
    one = eye([100.0, 20.0], [0.1, 4.1], [1.0, 2.0])
    levels = np.zeros((2, 2, 1))
    levels[:, 0, 0] = 0.75
    found = score_eye(drive_with(one), one, levels, FMVSS_108)
    near, far = found.bins[0], found.bins[2]
    assert dataclasses.astuple(far) == pytest.approx((0.5, 0.5, 0.5 * 0.25, 0.5 * 0.75, 0.0))
    assert dataclasses.astuple(near) == pytest.approx((0.5, 0.5, 0.5 * 2.5, 0.5 * 1.5, 0.5 * 1.0))
    assert found.bins[1] == found.bins[3] == Glare(0.0, 0.0, 0.0, 0.0, 0.0)
    assert found.dose_lxs == pytest.approx(1.375)


def test_preceding_drivers_have_limits_of_their_own() -> None:
    one = eye([50.0, 70.0], [0.0, 0.0], [10.0, 10.0], is_oncoming=False)
    found = score_eye(drive_with(one), one, np.ones((2, 2, 1)), FMVSS_108)
    assert [bin_.dose_lxs for bin_ in found.bins] == [0.0, 0.0, pytest.approx(3.0), 0.0]


def test_where_there_is_no_range_there_is_no_glare() -> None:
    one = eye([math.nan, 300.0, 10.0], [9.0] * 3, [99.0] * 3)
    one = dataclasses.replace(one, azimuths_rad=np.array([math.nan, 0.0, 0.0]))
    found = score_eye(drive_with(one), one, np.ones((3, 2, 1)), FMVSS_108)
    assert found.dose_lxs == 0.0
    assert [bin_.in_sight_s for bin_ in found.bins] == [0.0] * 4


def test_the_first_sight_far_away_counts_at_any_range() -> None:
    # In sight from the second frame on, 300 m away; within the limits' reach from the fourth on.
    one = eye([320.0, 300.0, 260.0, 200.0, 180.0], [0.01] * 5, [0.5] * 5)
    one = dataclasses.replace(one, is_in_sight=np.array([False, True, True, True, True]))
    levels = np.zeros((5, 2, 1))
    levels[:3] = 1.0
    found = score_eye(drive_with(one, light_s={1: 0.0}), one, levels, FMVSS_108)
    assert (found.first_glare_s, found.first_glare_anywhere_s) == (0.0, 1.0)
    assert found.lead_s == 0.5
    assert found.is_occluded
    assert not score_eye(drive_with(one, light_s={1: 0.5}), one, levels, FMVSS_108).is_occluded
    assert not score_eye(drive_with(one), one, levels, FMVSS_108).is_occluded


@pytest.mark.parametrize(
    ("ranges_m", "in_sight"),
    [
        ([320.0, 300.0, 260.0, 200.0, 180.0], [True] * 5),  # from the drive's first frame on
        ([math.nan, 390.0, 350.0, 200.0, 180.0], [False, True, True, True, True]),  # as soon as it is near enough
        ([math.nan, math.nan, 350.0, 200.0, 180.0], [False, True, True, True, True]),
    ],
)
def test_who_was_never_hidden_is_not_occluded(ranges_m: list[float], in_sight: list[bool]) -> None:
    """Whatever was labelled before: its lamps, on an open road, or before the drive counts."""
    one = dataclasses.replace(eye([100.0] * 5, [0.01] * 5, [0.5] * 5), is_in_sight=np.array(in_sight))
    one = dataclasses.replace(one, ranges_m=np.array(ranges_m))
    found = score_eye(drive_with(one, light_s={1: -1.0}), one, np.ones((5, 2, 1)), FMVSS_108)
    assert math.isnan(found.lead_s)
    assert not found.is_occluded
    assert found.first_glare_s == 1.0


@pytest.mark.parametrize(
    ("lux", "expected"),
    [
        ([0, 2, 2, 2, 2, 2], 5 / 4),
        ([0, 0, 0, 0, 0, 0], 0.0),
        ([0, 2, 0, 0, 2, 2], 1 / 4),  # over after two dark frames
        ([0, 2, 0, 2, 0, 0], 2 / 4),  # not after one
        ([0, 0, 2, 0, 0, 0], 1 / 4),  # one lamp before the other
        ([0, 0, 0, 2, 2, 2], 0.0),  # dark from the beginning: what comes later is no first moment
        ([0, 1.0, 1.0, 1.0, 1.0, 1.0], 0.0),  # at the limit, not above
    ],
)
def test_first_glare(lux: list[float], expected: float) -> None:
    values = np.array(lux, np.float64)
    assert first_glare_s(values, 0 * values, np.ones(6), np.array([1, 2, 5]), rate_hz=4.0) == expected


def test_first_glare_is_not_the_low_beams() -> None:
    low = np.full(6, 2.0)
    sights = np.array([1, 2, 3, 4, 5])
    assert first_glare_s(1.05 * low, low, np.ones(6), sights, rate_hz=4.0) == 0.0
    assert first_glare_s(1.06 * low, low, np.ones(6), sights, rate_hz=4.0) == 1.25


def test_a_first_sight_that_nobody_saw() -> None:
    values = np.ones(3)
    assert math.isnan(first_glare_s(values, values, values, np.array([0, 1]), rate_hz=4.0))
    assert math.isnan(first_glare_s(values, values, values, np.array([], np.intp), rate_hz=4.0))


@pytest.mark.slow
@given(st.integers(0, 9), st.floats(0.0, 1.0), st.sampled_from([FMVSS_108, R123]))
def test_more_light_is_never_less_glare(seed: int, share: float, limits: Any) -> None:
    drive = approach(seed, duration_s=8.0)
    one, run = drive.eyes[0], drive.runs["production"]
    more, less = (score_eye(drive, one, levels, limits) for levels in (run.levels, share * run.levels))
    for brighter, darker in zip(more.bins, less.bins, strict=True):
        assert brighter.dose_lxs >= darker.dose_lxs >= darker.low_dose_lxs - 1e-9
        assert brighter.above_s >= darker.above_s
        assert brighter.added_lxs >= darker.added_lxs
        assert brighter.in_sight_s == darker.in_sight_s
    assert not more.first_glare_s < less.first_glare_s


def test_limits_go_on_beyond_their_reach() -> None:
    far = eye([5.0, 300.0, math.nan], [0.0] * 3, [0.0] * 3)
    assert FMVSS_108.at(far).tolist() == [math.inf] * 3
    assert FMVSS_108.extended(far).tolist() == [3.1, 0.3, math.inf]
    behind = dataclasses.replace(far, is_oncoming=False)
    assert FMVSS_108.extended(behind).tolist() == [18.9, 4.0, math.inf]


def test_un_r123_between_its_distances() -> None:
    one = eye([49.0, 50.0, 75.0, 100.0, 200.0, 201.0], [0.0] * 6, [0.0] * 6)
    assert R123.at(one) == pytest.approx([math.inf, 0.5, 0.425, 0.35, 0.2725, math.inf])
    preceding = dataclasses.replace(one, is_oncoming=False)
    assert R123.at(preceding) == pytest.approx([math.inf, 1.48, 1.27, 1.06, 0.8, math.inf])
    assert R123.extended(one)[0] == 0.5
