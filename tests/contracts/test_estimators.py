"""Laws that hold for every estimator of ranges."""

from __future__ import annotations

import dataclasses
from typing import get_args

import numpy as np
import pytest

from foreglow.config import DistanceConfig
from foreglow.distance import ESTIMATORS, RangeEstimator, make_estimator
from foreglow.types import Detections, EgoMotion, Frame, Proposals, Ranges, RoadAhead
from tests.distance.places import HEIGHT_PX, WIDTH_PX, aimed, camera, detections, frame, straight_road

HEURISTICS = get_args(DistanceConfig.model_fields["heuristic"].annotation)

pytestmark = pytest.mark.parametrize("name", ESTIMATORS)


def make(name: str, **fields: str) -> RangeEstimator:
    return make_estimator(DistanceConfig.model_validate({"estimator": name, **fields}))


def some_boxes(seed: int = 0, num: int = 40) -> Detections:
    """Boxes anywhere in the image, some at its edges and some one pixel large."""
    generator = np.random.default_rng(seed)
    firsts = generator.integers((0, 0), (WIDTH_PX, HEIGHT_PX), (num, 2))
    lasts = np.minimum(firsts + generator.integers(1, 30, (num, 2)), (WIDTH_PX, HEIGHT_PX))
    boxes = np.concatenate([firsts, lasts], axis=1)
    boxes[:2] = [(0, 0, WIDTH_PX, HEIGHT_PX), (WIDTH_PX - 1, HEIGHT_PX - 1, WIDTH_PX, HEIGHT_PX)]
    return Detections(Proposals(boxes.astype(np.int32)), np.ones(num, np.float32), 0.5)


def some_frames() -> list[Frame]:
    """What the estimators know may be much or little."""
    x = np.arange(0.0, 400.0)
    hill = np.stack([x, 1.6 + x**2 / 2000, 3 * np.sin(x / 60)], -1)
    seen = camera(pitch_rad=-0.02, forward_m=1.9, distortion=(-0.1, 0.05, 1e-3, 1e-3, 0.0))
    roads = [None, straight_road(), straight_road(length_m=20.0), straight_road(begin_m=-500.0), RoadAhead(hill, 3.2)]
    motions = [None, EgoMotion(20.0, 0.01), EgoMotion(20.0, -0.1, 0.004)]
    return [frame(seen, road, motion) for road in roads for motion in motions]


def same(a: Ranges, b: Ranges) -> bool:
    pairs = ((a.ranges_m, b.ranges_m), (a.sigmas_m, b.sigmas_m))
    return all(np.array_equal(array, other, equal_nan=True) for array, other in pairs)


@pytest.mark.parametrize("heuristic", HEURISTICS)
@pytest.mark.parametrize("pitch", ["fixed", "motion"])
def test_every_box_has_a_range_or_none(name: str, heuristic: str, pitch: str) -> None:
    estimator, boxes = make(name, heuristic=heuristic, pitch=pitch), some_boxes()
    num_known = 0
    for seen in some_frames():
        ranges = estimator.estimate(seen, boxes)
        assert ranges.detections is boxes
        assert ranges.ranges_m.shape == ranges.sigmas_m.shape == (len(boxes),)
        assert not ranges.ranges_m.flags.writeable
        is_unknown = np.isnan(ranges.ranges_m)
        assert np.isinf(ranges.sigmas_m[is_unknown]).all()
        assert (ranges.ranges_m[~is_unknown] > 0).all()
        assert (ranges.sigmas_m > 0).all()
        num_known += int((~is_unknown).sum())
    assert num_known > 0


def test_no_boxes(name: str) -> None:
    for seen in some_frames():
        assert len(make(name).estimate(seen, detections([]))) == 0


def test_a_frame_without_a_calibration_is_an_error(name: str) -> None:
    with pytest.raises(ValueError, match=r"Frame\.camera: expected a calibration"):
        make(name).estimate(frame(None, straight_road()), detections())


def test_the_same_frames_give_the_same_ranges(name: str) -> None:
    """From the start, and again after a reset, whatever came before."""
    boxes, frames = some_boxes(1), some_frames()
    estimator, other = make(name), make(name)
    first = [estimator.estimate(seen, boxes) for seen in frames]
    estimator.estimate(frame(aimed([30.0, 0.0, 0.0])), some_boxes(2))
    estimator.reset()
    again = [estimator.estimate(seen, boxes) for seen in frames]
    assert all(map(same, first, again))
    assert all(map(same, first, [other.estimate(seen, boxes) for seen in frames]))


def test_boxes_do_not_know_each_other(name: str) -> None:
    """But for two that look like the lamps of one vehicle: those are far from each other in size here."""
    boxes, seen = some_boxes(3), some_frames()[-1]
    if name == "road_surface":
        boxes = detections([[40, 60, 43, 63], [100, 50, 130, 95], [200, 70, 206, 72]])
    together = make(name).estimate(seen, boxes)
    for index in range(len(boxes)):
        alone = make(name).estimate(seen, detections([boxes.boxes_xyxy_px[index].tolist()]))
        assert alone.ranges_m[0] == pytest.approx(together.ranges_m[index], rel=1e-5, nan_ok=True)
        assert alone.sigmas_m[0] == pytest.approx(together.sigmas_m[index], rel=1e-5)


def test_the_image_may_have_another_size(name: str) -> None:
    """Twice the pixels, boxes twice as large: the same light in the same place, but for half a pixel at the rim."""
    small = some_frames()[-1]
    assert small.camera is not None
    large = dataclasses.replace(
        small,
        image=np.zeros((2 * HEIGHT_PX, 2 * WIDTH_PX), np.uint8),
        camera=small.camera.scaled(2 * WIDTH_PX, 2 * HEIGHT_PX),
    )
    estimator, boxes = make(name), [(40, 60, 51, 71), (100, 50, 103, 61)]
    ranges = estimator.estimate(small, detections(boxes))
    doubled = estimator.estimate(large, detections([[2 * corner for corner in box] for box in boxes]))
    assert not np.isnan(ranges.ranges_m).any()
    assert doubled.ranges_m == pytest.approx(ranges.ranges_m, rel=1e-6)


def test_nothing_is_changed(name: str) -> None:
    seen = some_frames()[-1]
    assert seen.road is not None
    before = seen.road.points_m.copy()
    boxes = some_boxes(4)
    corners = boxes.boxes_xyxy_px.copy()
    make(name, heuristic="mean").estimate(seen, boxes)
    assert (seen.road.points_m == before).all()
    assert (boxes.boxes_xyxy_px == corners).all()
