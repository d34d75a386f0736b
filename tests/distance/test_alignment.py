from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from foreglow.distance.alignment import BOUND_SHARE, LEFT_SIGMA_M, YAW_SIGMA_RAD, RoadAligner, map_alignment
from foreglow.distance.ribbon import Alignment, mapped_standing
from foreglow.geometry import MountSigmas, rotation
from foreglow.types import EgoMotion, RoadAhead
from tests.distance.roads import camera, frame, line, road, straight
from tests.distance.test_markings import NOTHING, marked

SPEED_MPS = 20.0
STEP_S = 0.25
CURVATURES = np.r_[np.zeros(120), np.full(80, 1 / 150.0), np.zeros(60), np.full(80, -1 / 200.0), np.zeros(500)]


def mapped(place_m: float, bound_m: float) -> RoadAhead:
    """The road as a map tells it that believes us at `place_m`."""
    begin = round(place_m)
    return road(line(CURVATURES[begin : begin + 400]), error_bound_m=bound_m)


def drive(error_m: float, bound_m: float, num_frames: int = 60) -> list[Alignment]:
    """A drive along the road, whose map believes us `error_m` further than we are."""
    aligner, alignments = RoadAligner(), []
    for number in range(num_frames):
        place_m = 30.0 + number * SPEED_MPS * STEP_S
        motion = EgoMotion(SPEED_MPS, SPEED_MPS * float(CURVATURES[round(place_m)]))
        known = mapped(place_m + error_m, bound_m)
        alignments.append(aligner.align(frame(NOTHING, None, known, motion, number * STEP_S)))
    return alignments


@pytest.mark.parametrize("error_m", [-12.0, 8.0])
def test_the_shift_is_found_where_the_road_bends(error_m: float) -> None:
    alignments = drive(error_m, 20.0)
    straight_on, in_bend = alignments[2], alignments[23]
    assert straight_on.shift_sigma_m > 0.7 * BOUND_SHARE * 20.0
    assert in_bend.shift_sigma_m < 0.7 * BOUND_SHARE * 20.0
    assert abs(in_bend.shift_m + error_m) < min(0.6 * abs(error_m), 2 * in_bend.shift_sigma_m)


def test_a_straight_road_tells_nothing_of_the_shift() -> None:
    aligner = RoadAligner()
    for number in range(20):
        motion = EgoMotion(SPEED_MPS, 0.0)
        alignment = aligner.align(
            frame(NOTHING, None, road(line(np.zeros(450)), error_bound_m=20.0), motion, number * 0.25)
        )
    assert alignment.shift_m == pytest.approx(0.0, abs=1e-6)
    assert alignment.shift_sigma_m == pytest.approx(BOUND_SHARE * 20.0, rel=0.1)


def test_a_gap_in_time_forgets_and_so_does_reset() -> None:
    motion = EgoMotion(SPEED_MPS, SPEED_MPS / 150.0)
    fresh = RoadAligner().align(frame(NOTHING, None, mapped(130.0, 20.0), motion))
    for time_s, reset in ((3.0, False), (-1.0, False), (0.25, True)):
        aligner = RoadAligner()
        aligner.align(frame(NOTHING, None, mapped(60.0, 20.0), EgoMotion(SPEED_MPS, 0.0)))
        if reset:
            aligner.reset()
        assert aligner.align(frame(NOTHING, None, mapped(130.0, 20.0), motion, time_s)) == fresh


@pytest.mark.parametrize("bound_m", [2.0, 100.0, math.inf])
def test_small_and_boundless_errors_are_not_searched(bound_m: float) -> None:
    assert drive(1.0, bound_m, 30)[-1].shift_m == 0.0
    assert drive(1.0, bound_m, 30)[-1].shift_sigma_m == BOUND_SHARE * bound_m


def test_without_road_or_motion_the_map_is_believed() -> None:
    for known in (frame(NOTHING, None, None), frame(NOTHING, None, straight())):
        assert RoadAligner().align(known) == map_alignment(known)
    assert math.isinf(map_alignment(frame(NOTHING, None, None)).shift_sigma_m)


def test_the_mounts_yaw_is_no_better_known_than_its_calibration_says() -> None:
    known = frame(NOTHING, camera(), straight())
    mount = MountSigmas(yaw_rad=2 * YAW_SIGMA_RAD)
    doubted = dataclasses.replace(known, camera=dataclasses.replace(camera(), mount_sigmas=mount))
    aligner = RoadAligner()
    assert aligner.align(known).yaw_sigma_rad == map_alignment(known).yaw_sigma_rad == YAW_SIGMA_RAD
    aligner.reset()
    expected = pytest.approx(math.sqrt(5) * YAW_SIGMA_RAD)
    assert aligner.align(doubted).yaw_sigma_rad == map_alignment(doubted).yaw_sigma_rad == expected


@pytest.mark.slow
def test_yaw_and_offset_come_from_the_markings_and_fade() -> None:
    aligner = RoadAligner()
    for number in range(8):
        image = marked(yaw_rad=0.01, left_m=0.4)
        alignment = aligner.align(frame(image, camera(), straight(), time_s=number * 0.1))
    assert alignment.left_m == pytest.approx(0.4, abs=0.08)
    assert 0.0 < alignment.yaw_rad < 0.012
    assert alignment.left_sigma_m < LEFT_SIGMA_M
    for number in range(60):
        alignment = aligner.align(frame(NOTHING, camera(), straight(), time_s=0.8 + number * 0.25))
    assert alignment.left_m == pytest.approx(0.0, abs=0.01)
    assert alignment.left_sigma_m == pytest.approx(LEFT_SIGMA_M, rel=0.01)
    assert alignment.yaw_sigma_rad == pytest.approx(YAW_SIGMA_RAD, rel=0.01)


def test_what_the_map_knows_of_our_pose_is_not_corrected_again() -> None:
    """Poses say how we head and where in the lane we are; the road was turned and shifted once more by the markings."""
    yaw_rad, left_m = 0.02, 0.4
    points_m = (straight().points_m - [0.0, left_m, 0.0]) @ rotation(yaw_rad=yaw_rad)
    posed, image = road(points_m), marked(yaw_rad, left_m)
    assert mapped_standing(posed) == pytest.approx((yaw_rad, left_m))
    assert mapped_standing(straight()) == pytest.approx((0.0, 0.0), abs=1e-12)
    aligner = RoadAligner()
    for number in range(8):
        alignment = aligner.align(frame(image, camera(), posed, time_s=number * 0.1))
    assert alignment.left_m == pytest.approx(0.0, abs=0.08)
    assert alignment.yaw_rad == pytest.approx(0.0, abs=0.004)
    assert alignment.left_sigma_m < LEFT_SIGMA_M
