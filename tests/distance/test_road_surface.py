from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.config import DistanceConfig
from foreglow.distance import road_surface
from foreglow.distance.lamp_pairs import twin_columns_px
from foreglow.distance.road_surface import RoadSurface
from foreglow.types import EgoMotion, Frame, Ranges, RoadAhead
from tests.distance.roads import HALF_WIDTH_M, camera, detections, frame, lights, line, road, straight

LAMPS_M = np.array([[x, HALF_WIDTH_M, 0.65] for x in (30.0, 60.0, 120.0)])


def ranges_of(known: Frame, boxes: list[list[int]] | None = None, **fields: object) -> Ranges:
    config = DistanceConfig.model_validate({"estimator": "road_surface", **fields})
    return RoadSurface(config).estimate(known, detections(boxes or []))


def estimated(points_m: np.ndarray, ahead: RoadAhead | None) -> tuple[Ranges, np.ndarray]:
    image, boxes = lights(camera(), points_m)
    truth_m = np.linalg.norm(points_m - camera().vehicle_from_camera.position_m, axis=1)
    return RoadSurface(DistanceConfig()).estimate(frame(image, camera(), ahead), boxes), truth_m


def test_lamps_over_the_oncoming_lane() -> None:
    ranges, truth_m = estimated(LAMPS_M, straight())
    np.testing.assert_allclose(ranges.ranges_m, truth_m, rtol=0.2)
    assert (np.abs(ranges.ranges_m - truth_m) < 2 * ranges.sigmas_m).all()
    assert (ranges.sigmas_m < 0.5 * truth_m).all()


def test_lamps_in_a_bend_behind_a_crest() -> None:
    s = np.arange(451.0)
    points = line(np.r_[np.zeros(40), np.full(410, -1 / 220.0)], -(s**2) / 2 / 4000.0)
    hill = road(points)
    heading = np.arctan2(*(points[91] - points[89])[[1, 0]])
    lamp = points[90] + [-np.sin(heading) * 1.6, np.cos(heading) * 1.6, 0.65]
    ranges, truth_m = estimated(lamp[None], hill)
    assert ranges.ranges_m == pytest.approx(truth_m, rel=0.15)


def test_without_a_road_there_still_is_a_range() -> None:
    ranges, truth_m = estimated(LAMPS_M[:2], None)
    assert (np.abs(ranges.ranges_m - truth_m) < 2 * ranges.sigmas_m).all()
    with_road, _ = estimated(LAMPS_M[:2], straight())
    assert (ranges.sigmas_m > with_road.sigmas_m).all()


@pytest.mark.parametrize("ahead", [straight(), None], ids=["road", "no road"])
@pytest.mark.parametrize("range_m", [100.0, 150.0, 200.0])
def test_the_spacing_of_two_lamps_in_one_box_tells_their_range(range_m: float, ahead: RoadAhead | None) -> None:
    lamps = np.array([[range_m, HALF_WIDTH_M + side, 0.65] for side in (-0.65, 0.65)])
    image, found = lights(camera(), lamps, radius_px=2)
    both = detections([[*found.boxes_xyxy_px[:, :2].min(axis=0), *found.boxes_xyxy_px[:, 2:].max(axis=0)]])
    filled = image.copy()
    (x1, y1, x2, y2), level = both.boxes_xyxy_px[0], image.max()
    filled[y1 + 1 : y2 - 1, x1 + 1 : x2 - 1] = level
    apart, merged = (
        RoadSurface(DistanceConfig()).estimate(frame(its, camera(), ahead), both) for its in (image, filled)
    )
    assert apart.ranges_m == pytest.approx(range_m, rel=0.1)
    assert apart.sigmas_m < 0.7 * merged.sigmas_m


def test_two_lights_of_one_box_are_no_lamps_of_a_near_vehicle(monkeypatch: pytest.MonkeyPatch) -> None:
    """A vehicle that is seen from the side would seem too far away."""
    lamps = np.array([[40.0, HALF_WIDTH_M + side, 0.65] for side in (-0.35, 0.35)])
    image, found = lights(camera(), lamps, radius_px=2)
    both = detections([[*found.boxes_xyxy_px[:, :2].min(axis=0), *found.boxes_xyxy_px[:, 2:].max(axis=0)]])
    assert not np.isnan(twin_columns_px(image, both.boxes_xyxy_px)).any()
    known = frame(image, camera(), straight())
    ranges = RoadSurface(DistanceConfig()).estimate(known, both)
    monkeypatch.setattr(road_surface, "twin_columns_px", lambda _, boxes: np.full((len(boxes), 2), np.nan))
    assert ranges.ranges_m == RoadSurface(DistanceConfig()).estimate(known, both).ranges_m


def test_a_lamp_with_a_partner_in_another_box_is_not_halved() -> None:
    """Each headlamp at 30 m is two lights, 0.3 m apart, which alone would be a vehicle 130 m away."""
    near = np.array([[30.0, HALF_WIDTH_M + side, 0.65] for side in (-0.8, -0.5, 0.5, 0.8)])
    image, found = lights(camera(), near, radius_px=4)
    corners = found.boxes_xyxy_px.reshape(2, 2, 4)
    boxes = detections([[*each[:, :2].min(axis=0), *each[:, 2:].max(axis=0)] for each in corners])
    assert not np.isnan(twin_columns_px(image, boxes.boxes_xyxy_px)).any()
    ranges = RoadSurface(DistanceConfig()).estimate(frame(image, camera(), straight()), boxes)
    np.testing.assert_allclose(ranges.ranges_m, 30.0, rtol=0.15)


def test_a_place_that_is_not_known_at_all_is_no_place() -> None:
    boundless = dataclasses.replace(straight(), error_bound_m=np.inf)
    lost, _ = estimated(LAMPS_M, boundless)
    none, _ = estimated(LAMPS_M, None)
    np.testing.assert_array_equal(lost.ranges_m, none.ranges_m)


def test_where_light_contradicts_the_map_the_map_does_not_count() -> None:
    """The maps turn away to the right at once, each otherwise; the lamp is ahead to the left."""
    lamp = np.array([[60.0, 12.0, 0.65]])
    (sharp, truth_m), (wide, _) = (
        estimated(lamp, road(line(np.full(120, -1 / radius_m)))) for radius_m in (40.0, 55.0)
    )
    np.testing.assert_allclose(sharp.ranges_m, wide.ranges_m, rtol=0.05)
    assert np.abs(sharp.ranges_m - truth_m) < 2 * sharp.sigmas_m
    assert sharp.sigmas_m > 0.3 * sharp.ranges_m


@pytest.mark.slow
@settings(derandomize=True, max_examples=20)
@given(
    st.lists(st.tuples(st.integers(0, 1200), st.integers(0, 900), st.integers(1, 80), st.integers(1, 60)), max_size=8)
)
def test_every_box_has_a_range_and_a_sigma(corners: list[tuple[int, int, int, int]]) -> None:
    boxes = [[x, y, x + width, y + height] for x, y, width, height in corners]
    image = np.random.default_rng(len(boxes)).integers(0, 255, (960, 1280)).astype(np.uint8)
    for ahead in (straight(60), None):
        ranges = ranges_of(frame(image, camera(), ahead), boxes)
        assert np.isfinite(ranges.ranges_m).all()
        assert np.isfinite(ranges.sigmas_m).all()


def test_no_boxes_no_ranges() -> None:
    assert len(ranges_of(frame(np.zeros((960, 1280), np.uint8), camera(), straight()))) == 0


def test_a_frame_without_camera_is_an_error() -> None:
    with pytest.raises(ValueError, match=r"Frame\.camera: expected a calibration"):
        ranges_of(frame(np.zeros((960, 1280), np.uint8), None, None))


def test_the_same_frames_give_the_same_ranges_after_a_reset() -> None:
    image, boxes = lights(camera(), LAMPS_M)
    bend = road(line(np.r_[np.zeros(30), np.full(420, 1 / 200.0)]), error_bound_m=20.0)
    frames = [frame(image, camera(), bend, EgoMotion(20.0, 0.02 * number), number * 0.25) for number in range(4)]
    estimator = RoadSurface(DistanceConfig(estimator="road_surface", align=True, pitch="markings"))
    first = [estimator.estimate(image, boxes).ranges_m for image in frames]
    estimator.reset()
    np.testing.assert_array_equal([estimator.estimate(image, boxes).ranges_m for image in frames], first)
    assert (first[3] != first[0]).any()  # what came before counts


def test_a_pitch_that_is_measured_is_taken_out() -> None:
    pitch_rad = 0.006
    image, boxes = lights(camera(), LAMPS_M[1:2], pitch_rad=pitch_rad)
    level = EgoMotion(20.0, 0.0, pitch_rad)
    known = frame(image, camera(), straight(), level)
    truth_m = float(np.linalg.norm(LAMPS_M[1] - camera().vehicle_from_camera.position_m))
    off = {
        pitch: abs(float(RoadSurface(DistanceConfig(pitch=pitch)).estimate(known, boxes).ranges_m[0]) - truth_m)
        for pitch in ("fixed", "motion")
    }
    assert off["motion"] < off["fixed"]
