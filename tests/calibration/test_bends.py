"""A bend that lasts for the whole drive, made of lines and of the flow of posts."""

from __future__ import annotations

import math

import numpy as np
import pytest

from foreglow.calibration.auto.drive import FLOOR_DEG, SLIP_M, _Drive, _Estimate, bend_of
from foreglow.calibration.auto.flow import Tracks, turn_of
from foreglow.calibration.auto.lines import BEND_SIGMA, UNKNOWN_BEND, Segments
from foreglow.calibration.auto.views import Lens
from tests.calibration.roads import LENS
from tests.calibration.test_lines import HEIGHT_M, POINT, markings

STEP_S = 0.06
SPEED_MPS = 14.0
NUM_FRAMES = 20


def flow(bend_per_m: float, seed: int = 0) -> Tracks:
    """Posts, seen by a camera that travels towards `POINT` and turns to the right as the bend does."""
    ahead_m, right_m, down_m = np.random.default_rng(seed).uniform([8.0, -12.0, -2.0], [60.0, 12.0, 1.0], (120, 3)).T
    way_m, turn_rad = SPEED_MPS * STEP_S, bend_per_m * SPEED_MPS * STEP_S
    before = np.stack([right_m, down_m], -1) / ahead_m[:, None]
    ahead_m, right_m, down_m = ahead_m - way_m, right_m - way_m * POINT[0], down_m - way_m * POINT[1]
    turned_m = ahead_m * math.cos(turn_rad) + right_m * math.sin(turn_rad)
    right_m = right_m * math.cos(turn_rad) - ahead_m * math.sin(turn_rad)
    after = np.stack([right_m, down_m], -1) / turned_m[:, None]
    return Tracks((before + after) / 2, after - before, STEP_S)


def shaken(segments: Segments, seed: int) -> Segments:
    """Segments whose directions are off by about a third of a degree."""
    slopes = segments.slopes + np.random.default_rng(seed).normal(0.0, 0.006, len(segments))
    return Segments(segments.middles, slopes, segments.lengths, segments.tops)


def yaw_error_deg(bend_per_m: float, *, has_flow: bool) -> tuple[float, float]:
    """The error of the yaw of a drive in a bend, and its stated standard deviation."""
    drive = _Drive(Lens(LENS))
    drive.segments = [shaken(markings(0.0, bend_per_m), seed) for seed in range(NUM_FRAMES)]
    drive.tracks = [flow(bend_per_m, seed) if has_flow else None for seed in range(NUM_FRAMES)]
    drive.is_steady = [True] * NUM_FRAMES
    lines, num_flows, _ = drive.directions(HEIGHT_M)
    assert (len(lines), num_flows) == (NUM_FRAMES, NUM_FRAMES if has_flow else 0)
    found = _Estimate.of(lines, HEIGHT_M)
    return math.degrees(found.point[0] - POINT[0]), math.degrees(found.sigmas[0])


@pytest.mark.parametrize("bend_per_m", [0.004, -0.004, 0.0005, 0.0])
def test_the_yaw_shows_in_a_bend_that_never_ends(bend_per_m: float) -> None:
    error_deg, sigma_deg = yaw_error_deg(bend_per_m, has_flow=True)
    assert abs(error_deg) < min(0.15, 2 * sigma_deg)
    assert sigma_deg >= math.hypot(FLOOR_DEG[0], math.degrees(0.7 * SLIP_M * bend_per_m))


@pytest.mark.parametrize("bend_per_m", [0.004, 0.0])
def test_without_the_flow_the_bend_turns_the_yaw_more(bend_per_m: float) -> None:
    with_flow, without = (abs(yaw_error_deg(bend_per_m, has_flow=has_flow)[0]) for has_flow in (True, False))
    assert with_flow < 0.5 * without


@pytest.mark.parametrize("bend_per_m", [0.004, -0.004, 0.0])
def test_the_flow_shows_the_turn(bend_per_m: float) -> None:
    turn = turn_of(flow(bend_per_m), POINT + 0.002, 600.0)
    assert turn.rate_radps == pytest.approx(bend_per_m * SPEED_MPS, abs=min(math.radians(0.2), 3 * turn.sigma_radps))


def test_the_bend_follows_from_the_turn_and_is_known_less_well_where_it_is_sharp() -> None:
    sharp, straight = (bend_of(flow(bend_per_m), POINT, 600.0, HEIGHT_M) for bend_per_m in (0.004, 0.0))
    assert abs(sharp.mean - 0.004 * HEIGHT_M) < sharp.sigma
    assert abs(straight.mean) < straight.sigma < min(BEND_SIGMA, 0.1 * sharp.sigma)
    assert bend_of(None, POINT, 600.0, HEIGHT_M) == UNKNOWN_BEND
