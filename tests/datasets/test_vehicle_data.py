"""Frames carry what the car knew, where somebody knows it."""

from __future__ import annotations

import copy
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from foreglow.datasets import PVDN, Equipped, shipped_drive
from foreglow.datasets.simulated import read_truth
from foreglow.datasets.vehicle_data import VehicleData
from foreglow.geometry import Camera, Pose
from foreglow.street import road_from_message
from foreglow.types import EgoMotion, Frame, RoadAhead
from tests.datasets.tiny_pvdn import make_pvdn
from tests.stand_ins import ListSource, night_frames

CAMERA = Camera(128, 96, (130.0, 130.0), (64.0, 48.0), (0.0,) * 5, Pose(np.array([1.9, 0.0, 1.3]), np.eye(3)))
ROAD = RoadAhead(np.array([[0.0, 1.6, 0.0], [5.0, 1.6, 0.0]]), 3.2)


class SecondFrameOnly(VehicleData):
    """Vehicle data that begin with the second frame."""

    def camera(self, frame: Frame) -> Camera | None:
        return CAMERA if frame.frame else None

    def motion(self, frame: Frame) -> EgoMotion | None:
        return EgoMotion(20.0, 0.1) if frame.frame else None

    def road(self, frame: Frame) -> RoadAhead | None:
        return ROAD if frame.frame else None

    def is_reported(self, frame: Frame) -> bool | None:
        return False if frame.frame else None


def test_a_source_with_vehicle_data() -> None:
    source = Equipped(ListSource(night_frames(2), skipped=["a.png"]), SecondFrameOnly())
    first, second = list(source)
    assert (first.camera, first.motion, first.road, first.is_reported) == (None, None, None, None)
    assert second.is_reported is False
    assert (second.camera, second.road) == (CAMERA, ROAD)
    assert second.motion is not None
    assert second.motion.speed_mps == 20.0
    assert (source.name, source.rate_hz, source.num_frames, source.skipped) == ("stand-in", 20.0, 2, ["a.png"])


def test_what_a_frame_carries_stays_where_nothing_is_known() -> None:
    (known,) = Equipped(ListSource(list(Equipped(ListSource(night_frames(2)), SecondFrameOnly()))[1:]), _Nothing())
    assert (known.camera, known.road, known.is_reported) == (CAMERA, ROAD, False)


class _Nothing(VehicleData):
    def camera(self, _: Frame) -> Camera | None:
        return None

    def motion(self, _: Frame) -> EgoMotion | None:
        return None

    def road(self, _: Frame) -> RoadAhead | None:
        return None


def test_simulated_frames_carry_calibration_motion_and_road() -> None:
    dataset = PVDN(shipped_drive())
    image_id = dataset.frame_ids[30]
    frame = dataset.read(image_id)
    (sequence,) = read_truth(shipped_drive())
    truth = sequence.frame(image_id)
    assert frame.camera is not None
    assert (frame.camera.focal_px, frame.camera.width_px) == (sequence.camera.focal_px, frame.width_px)
    assert frame.motion is not None
    assert (frame.motion.speed_mps, frame.motion.yaw_rate_radps) == (truth.ego_speed_mps, truth.ego_yaw_rate_radps)
    assert np.isnan(frame.motion.pitch_rad)
    expected = road_from_message(truth.street)
    assert frame.road is not None
    assert expected is not None
    assert np.array_equal(frame.road.points_m, expected.points_m)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda source: pickle.loads(pickle.dumps(source))])
def test_sources_with_vehicle_data_go_to_other_processes(copied: Callable[[PVDN], PVDN]) -> None:
    """As images and videos do; one of a simulated split did not, for what it remembered of it."""
    source = PVDN(shipped_drive())
    image_id = source.frame_ids[30]
    frame = source.read(image_id)
    again = copied(source).read(image_id)
    assert again.motion is not None
    assert frame.motion is not None
    assert again.motion.speed_mps == frame.motion.speed_mps
    assert again.camera is not None
    assert frame.camera is not None
    assert again.camera.focal_px == frame.camera.focal_px
    assert np.array_equal(again.image, frame.image)


def test_a_set_without_vehicle_data(tmp_path: Path) -> None:
    frame = next(iter(PVDN(make_pvdn(tmp_path))))
    assert (frame.camera, frame.motion, frame.road) == (None, None, None)


def test_broken_vehicle_data_name_file_line_and_field(tmp_path: Path) -> None:
    split = tmp_path / "night/val"
    shutil.copytree(shipped_drive(), split)
    path = split / "simulation/S00001/frames.jsonl"
    lines = path.read_text().splitlines()
    lines[1] = lines[1].replace('"ego_speed_mps":', '"ego_speed_mps":"fast","was":')
    path.write_text("\n".join(lines))
    with pytest.raises(ValueError, match=r"frames\.jsonl: line 2: ego_speed_mps: expected a valid number"):
        next(iter(PVDN(split)))
