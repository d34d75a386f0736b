from __future__ import annotations

import math

import numpy as np
import pytest

from foreglow.distance.markings import LaneView, MarkingFinder
from foreglow.distance.pitch import REST_SIGMA_RAD, MarkingsPitch
from foreglow.geometry import rotation
from foreglow.types import Image, RoadAhead
from tests.distance.roads import HALF_WIDTH_M, camera, frame, line, road, straight

NOTHING = np.full((960, 1280), 10, np.uint8)


def marked(
    yaw_rad: float = 0.0,
    left_m: float = 0.0,
    pitch_rad: float = 0.0,
    curvature: float = 0.0,
    lanes_m: tuple[float, ...] = (),
) -> Image:
    """The road as the camera sees it from a car that heads to the left, stands to the left and has its nose up."""
    seen_by = camera()
    rows, columns = np.mgrid[:960, :1280] + 0.5
    rays = seen_by.rays(np.stack([columns, rows], -1)) @ seen_by.vehicle_from_camera.rotation.T
    body = rotation(pitch_rad=pitch_rad)
    rays, origin = rays @ body.T, body @ seen_by.vehicle_from_camera.position_m
    with np.errstate(divide="ignore"):
        reach = np.where(rays[..., 2] < -1e-3, -origin[2] / np.minimum(rays[..., 2], -1e-3), np.nan)
    x, y = origin[0] + reach * rays[..., 0], origin[1] + reach * rays[..., 1]
    along, across = (
        math.cos(yaw_rad) * x - math.sin(yaw_rad) * y,
        math.sin(yaw_rad) * x + math.cos(yaw_rad) * y + left_m,
    )
    image = NOTHING.copy()
    for lane_m in lanes_m or (HALF_WIDTH_M / 2, -HALF_WIDTH_M / 2):
        image[np.abs(across - lane_m - curvature * along**2 / 2) < 0.07] = 120
    return image


def seen(image: Image, ahead: RoadAhead | None = None) -> LaneView:
    return MarkingFinder().find(frame(image, camera(), ahead or straight()))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("yaw_deg", "left_m", "pitch_deg"),
    [(0.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.4, 0.0), (0.0, 0.0, 0.3), (0.8, -0.3, -0.3), (-0.5, 0.4, 0.2)],
)
def test_yaw_offset_and_pitch_are_those_of_the_picture(yaw_deg: float, left_m: float, pitch_deg: float) -> None:
    lane = seen(marked(math.radians(yaw_deg), left_m, math.radians(pitch_deg)))
    assert lane.left_m == pytest.approx(left_m, abs=0.06)
    assert math.degrees(lane.pitch_rad) == pytest.approx(pitch_deg, abs=0.1)
    assert math.degrees(lane.yaw_rad) == pytest.approx(yaw_deg, abs=0.35)
    assert lane.yaw_sigma_rad < math.radians(1.5)
    assert lane.pitch_sigma_rad < math.radians(0.3)


def test_the_maps_bend_is_no_yaw() -> None:
    bend = road(line(np.full(450, 1 / 250.0)))
    assert math.degrees(seen(marked(curvature=1 / 250.0), bend).yaw_rad) == pytest.approx(0.0, abs=0.3)


def test_one_marking_tells_no_pitch() -> None:
    lane = seen(marked(left_m=0.3, lanes_m=(HALF_WIDTH_M / 2,)))
    assert math.isinf(lane.pitch_sigma_rad)
    assert lane.left_m == pytest.approx(0.3, abs=0.06)
    assert lane.left_sigma_m > 0.1  # as well as the lane's width is known


def test_markings_of_other_lanes_say_nothing_of_the_offset() -> None:
    """As on a carriageway of three lanes, whose lanes are narrower than half of it."""
    apart_m = HALF_WIDTH_M / 2 - 0.6
    assert math.isinf(seen(marked(lanes_m=(apart_m, -apart_m))).left_sigma_m)
    assert seen(marked(lanes_m=(apart_m + 0.3, -apart_m - 0.3))).left_sigma_m < 0.1


def test_without_markings_nothing_is_known() -> None:
    assert seen(NOTHING) == LaneView()
    assert MarkingFinder().find(frame(NOTHING, None, straight())) == LaneView()
    noise = np.random.default_rng(1).integers(0, 12, NOTHING.shape).astype(np.uint8)
    assert seen(noise) == LaneView()


def test_images_of_sixteen_bits_are_seen_alike() -> None:
    image = marked(pitch_rad=0.004)
    deep = seen((image.astype(np.uint16) * 257).astype(np.uint16))
    assert deep.pitch_rad == pytest.approx(seen(image).pitch_rad, abs=1e-9)


def test_the_pitch_of_markings_is_weighted_with_the_body_at_rest() -> None:
    source = MarkingsPitch()
    measured = source.pitch(frame(marked(pitch_rad=0.004), camera(), straight()))
    assert 0.001 < measured.rad < 0.004
    assert measured.sigma_rad < REST_SIGMA_RAD
    unknown = source.pitch(frame(NOTHING, camera(), straight()))
    assert unknown == (0.0, REST_SIGMA_RAD)
