"""Where tracks are, seen from the vehicle."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.beam.bearings import Bearings
from foreglow.geometry import Pose, rotation
from foreglow.types import Tracks, TrackState
from tests.beam.made_up import FRAME_NS, box_around, frame_at, from_origin, tracks_of
from tests.beam.policy_scenes import LAMP, brightest_there, policy, tracks_at

S = FRAME_NS / 1e9


def followed(azimuth_rad: float, state: TrackState = TrackState.CONFIRMED, number: int = 0) -> Tracks:
    return tracks_of(
        [box_around(azimuth_rad, -0.01, 0.01)], [80.0], states=[state], ages_s=1.0 + number * S, first_id=7
    )


@settings(deadline=None)
@given(st.floats(-0.3, 0.3), st.floats(-0.1, 0.05), st.floats(0.001, 0.05))
def test_directions_of_boxes(azimuth_rad: float, elevation_rad: float, width_rad: float) -> None:
    tracks = tracks_of([box_around(azimuth_rad, elevation_rad, width_rad)], [80.0])
    bearing = Bearings().update(frame_at(0), tracks)[0]
    azimuth_rad, range_m = from_origin(azimuth_rad, 80.0)
    assert bearing.azimuth_rad == pytest.approx(azimuth_rad, abs=0.003)
    assert bearing.elevation_rad == pytest.approx(elevation_rad, abs=0.005)
    assert bearing.half_width_rad == pytest.approx(width_rad / 2, rel=0.2)
    assert bearing.range_m == pytest.approx(range_m, rel=1e-3)
    assert math.isnan(bearing.direct)


def test_the_elevation_is_that_of_the_middle_of_a_box_in_a_rolled_mount_as_well() -> None:
    """It was that of its left edge, so that lamps in wide boxes were taken for light on the road."""
    frame, tracks = frame_at(0), tracks_of([np.array([700.0, 500.0, 900.0, 520.0])], [80.0])
    assert frame.camera is not None
    rolled = Pose(frame.camera.vehicle_from_camera.position_m, rotation(roll_rad=0.3))
    camera = dataclasses.replace(frame.camera, vehicle_from_camera=rolled)
    bearing = Bearings().update(dataclasses.replace(frame, camera=camera), tracks)[0]
    ahead = rolled.rotation @ camera.rays([800.0, 510.0])
    assert bearing.elevation_rad == pytest.approx(math.asin(ahead[2]), abs=1e-3)


@pytest.mark.parametrize("rate_radps", [-0.4, 0.0, 0.25])
def test_rates_settle(rate_radps: float) -> None:
    bearings = Bearings()
    rates = [
        bearings.update(frame_at(number), followed(0.05 + rate_radps * number * S, number=number))[7].rate_radps
        for number in range(12)
    ]
    assert rates[0] == 0.0
    assert rates[-1] == pytest.approx(rate_radps, abs=0.07 * abs(rate_radps) + 1e-3)
    assert abs(rates[1]) < abs(rate_radps) + 1e-9  # one step alone is not believed


@pytest.mark.parametrize("rate_hz", [36.0, 60.0])
def test_rates_are_as_calm_from_faster_cameras(rate_hz: float) -> None:
    def spread_radps(hz: float) -> float:
        bearings, rng, rates = Bearings(), np.random.default_rng(5), []
        for number in range(round(20 * hz)):
            frame = dataclasses.replace(frame_at(0), timestamp_ns=round(number / hz * 1e9))
            rates.append(bearings.update(frame, followed(0.1 + 0.003 * rng.standard_normal()))[7].rate_radps)
        return float(np.std(rates))

    assert spread_radps(rate_hz) < 1.2 * spread_radps(18.0)


def test_without_a_range_the_direction_stays_the_cameras() -> None:
    tracks = dataclasses.replace(followed(0.2), ranges_m=np.array([math.nan]), sigmas_m=np.array([math.inf]))
    bearing = Bearings().update(frame_at(0), tracks)[7]
    assert bearing.azimuth_rad == pytest.approx(0.2, abs=0.003)
    assert math.isnan(bearing.range_m)


def test_which_tracks_may_be_acted_on() -> None:
    bearings = Bearings()
    for number, state in enumerate([TrackState.TENTATIVE, TrackState.CONFIRMED, TrackState.COASTING]):
        bearing = bearings.update(frame_at(number), followed(0.0, state, number))[7]
        assert bearing.is_plausible == (state != TrackState.TENTATIVE)


def test_the_greatest_confidence_is_kept() -> None:
    bearings, kept = Bearings(), []
    for number, confidence in enumerate([0.3, 0.8, 0.5]):
        tracks = dataclasses.replace(followed(0.0, number=number), confidences=np.array([confidence]))
        kept.append(bearings.update(frame_at(number), tracks)[7].confidence)
    assert kept == [0.3, 0.8, 0.8]


def test_tracks_that_end_and_a_new_start_are_forgotten() -> None:
    bearings = Bearings()
    moving = [bearings.update(frame_at(number), followed(0.1 * number, number=number)) for number in range(3)]
    assert moving[-1][7].rate_radps > 0.5
    assert bearings.update(frame_at(3), tracks_of([], [])) == {}
    assert bearings.update(frame_at(4), followed(0.0, number=4))[7].rate_radps == 0.0
    bearings.update(frame_at(5), followed(0.2, number=5))
    bearings.reset()
    again = bearings.update(frame_at(6), followed(0.2, number=6))[7]
    assert again.rate_radps == 0.0


def test_the_same_time_again_changes_no_rate() -> None:
    bearings = Bearings()
    for number in (0, 1, 1):
        bearing = bearings.update(frame_at(number), followed(0.1 * number, number=number))[7]
    assert math.isfinite(bearing.rate_radps)


def test_two_frames_that_came_at_once_make_no_light_fast() -> None:
    """A queue gave them times 10 us apart: the noise of a box was hundreds of radians a second, for seconds."""
    bearings, first = Bearings(), frame_at(0)
    bearings.update(first, followed(0.1))
    at_once = dataclasses.replace(first, timestamp_ns=first.timestamp_ns + 10_000)
    assert abs(bearings.update(at_once, followed(0.101))[7].rate_radps) < 0.5


@pytest.mark.parametrize("step_ns", [1, 10_000, 1_000_000])
def test_a_lamp_that_jumps_between_frames_that_came_at_once_has_a_gap(step_ns: int) -> None:
    """The gap led it by more than a turn, and no command could be made of it."""
    for latency_s, jump_rad in itertools.product((0.15, 2.0), (-0.4, 0.01, 0.4)):
        made, first = policy(latency_s=latency_s), frame_at(0)
        for number in range(4):
            now = dataclasses.replace(first, timestamp_ns=first.timestamp_ns + number * step_ns)
            command = made.command(now, tracks_at(number, LAMP._replace(azimuth_rad=0.05 + jump_rad * (number % 2))))
        assert brightest_there(command, 0.05 + jump_rad) < 0.1
