"""NumPy's numbers and truth values are taken wherever Python's own are, and kept as those."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foreglow import Pipeline
from foreglow.calibration.values import ImageChoice
from foreglow.config import BeamConfig, ProposalConfig, preset
from foreglow.datasets import PVDN, BoxLabels, Instance, LabelledImage, PVDNWriter, Sequence, Vehicle
from foreglow.datasets.vehicle_logs import read_can_log, write_can_log
from foreglow.geometry import Camera, MountSigmas, Pose
from foreglow.lab.learning.recipes import RECIPES, changed
from foreglow.lab.simulation import Scene, adapted, resized, scenario
from foreglow.maps import CentreLine, GeographicOrigin
from foreglow.parallel import Local, workers_at
from foreglow.runtime.live import LiveLoop, Paced
from foreglow.runtime.live.cameras import CameraOptions
from foreglow.types import Detections, EgoMotion, Frame, Proposals, RoadAhead
from tests.stand_ins import ListSource, night_frames

LINE = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]])
POSE = Pose(np.array([1.9, 0.0, 1.3]), np.eye(3))
RECIPE = RECIPES["paper"]


def detections(threshold: Any) -> Detections:
    return Detections(Proposals(np.zeros((0, 4), np.int32)), np.zeros(0, np.float32), threshold)


MADE: dict[str, tuple[Callable[[Any], Any], Any]] = {
    "configuration": (lambda value: ProposalConfig(window_px=value).window_px, np.int64(41)),
    "one of some": (lambda value: ProposalConfig(blur_width_px=value).blur_width_px, np.int8(3)),
    "truth": (lambda value: BeamConfig(ask=value).ask, np.True_),
    "part": (lambda value: ProposalConfig(region_xyxy_px=(0, 0, value, 9)).region_xyxy_px[2], np.int32(8)),  # type: ignore[index]
    "fields": (lambda value: ProposalConfig.model_validate({"kappa": value}).kappa, np.float32(0.5)),
    "changed": (lambda value: preset("foreglow").changed("proposals", gap_px=value).proposals.gap_px, np.uint8(3)),
    "scene": (lambda value: Scene(seed=value).seed, np.int64(3)),
    "scenario": (lambda value: scenario("curve", value).seed, np.int64(3)),
    "resized": (lambda value: resized(Scene(), value, 240).camera.width_px, np.int64(320)),
    "adapted": (lambda value: adapted(Scene(), (320, value), 18.0, "day").camera.height_px, np.int64(240)),
    "rate": (lambda value: adapted(Scene(), (320, 240), value, "day").rate_hz, np.float32(20.0)),
    "images": (lambda value: ImageChoice(size_px=(value, 240)).size_px[0], np.int64(320)),  # type: ignore[index]
    "recipe": (lambda value: changed(RECIPE, {"epochs": value}).epochs, np.int64(3)),
    "inputs": (lambda value: changed(RECIPE, {"inputs": {"size_px": value}}).inputs.size_px, np.int64(32)),
    "jobs": (lambda value: Local(value).jobs, np.int64(1)),
    "workers": (lambda value: workers_at(value, None).num_workers, np.int64(2)),
    "light": (lambda value: Instance(pos=(value, 4), iid=1).position_px[0], np.int32(3)),  # type: ignore[call-arg]
    "vehicle": (lambda value: Vehicle(position_px=(3, 4), oid=value, instances=()).oid, np.int64(1)),
    "is direct": (lambda value: Instance(position_px=(3, 4), iid=1, is_direct=value).is_direct, np.True_),
    "sequence": (lambda value: Sequence.plain(value).id, np.int64(121)),
    "speed": (lambda value: EgoMotion(value, 0.0).speed_mps, np.float32(20.5)),
    "pitch": (lambda value: EgoMotion(0.0, 0.0, value).pitch_rad, np.float16(0.25)),
    "road": (lambda value: RoadAhead(LINE, value).half_width_m, np.float32(3.5)),
    "bound": (lambda value: RoadAhead(LINE, 3.5, error_bound_m=value).error_bound_m, np.float32(2.0)),
    "line": (lambda value: CentreLine(LINE, value).half_width_m, np.float32(3.5)),
    "origin": (lambda value: GeographicOrigin(value, 9.0).latitude_deg, np.float32(48.5)),
    "sigmas": (lambda value: MountSigmas(value).yaw_rad, np.longdouble(0.25)),
    "camera": (lambda value: Camera(value, 48, (60, 60), (32, 24), (0.0,) * 5, POSE).width_px, np.int64(64)),
    "threshold": (lambda value: detections(value).score_threshold, np.float32(0.5)),
    "replay": (lambda value: Paced(ListSource([]), value).speed, np.float32(2.0)),
    "requested": (lambda value: CameraOptions(rate_hz=value).rate_hz, np.float32(20.0)),
    "delay": (lambda value: CameraOptions(delay_s=value).delay_s, np.float16(0.5)),
    "size": (lambda value: CameraOptions(size_px=[value, 240]).size_px[0], np.int64(320)),  # type: ignore[arg-type,index]
}
"""By name, what is made of a value and read from it again, and the value."""


@pytest.mark.parametrize("name", MADE)
def test_a_scalar_becomes_python_s_own(name: str) -> None:
    made, value = MADE[name]
    kept = made(value)
    assert kept == value
    assert type(kept) in (int, float, bool)


@pytest.mark.parametrize("wrong", [np.float64(19.0), np.True_, np.str_("19"), np.array(19), np.array([19])])
def test_what_is_no_whole_number_stays_none(wrong: Any) -> None:
    with pytest.raises(ValueError, match=r"window_px\n  Input should be a valid integer"):
        ProposalConfig(window_px=wrong)


def test_lists_of_json_are_no_other_than_before() -> None:
    text = json.dumps({"region_xyxy_px": [0, 0, 8, 9]})
    assert ProposalConfig.model_validate_json(text).region_xyxy_px == (0, 0, 8, 9)
    assert BoxLabels.model_validate_json('{"bounding_boxes": [[1, 2, 3, 4]], "labels": [1]}').labels == (1.0,)


def test_labels_of_key_points_and_boxes_of_ours(tmp_path: Path) -> None:
    (frame,) = night_frames(1)
    keypoints_px = np.array([[3, 4], [5, 6]], np.int32)
    lights = [Instance(position_px=keypoints_px[0], iid=1), Instance(position_px=[5, 6], iid=2)]  # type: ignore[arg-type]
    vehicle = Vehicle(position_px=tuple(keypoints_px[1]), oid=1, instances=lights)  # type: ignore[arg-type]
    boxes = BoxLabels(boxes_xyxy_px=np.array([[1, 2, 3, 4]], np.int32), labels=np.array([1]))  # type: ignore[arg-type]
    with PVDNWriter(tmp_path / "val", info={"rate_hz": np.int64(10), "of": [np.float32(1.5)]}) as writer:
        writer.add_sequence(Sequence.plain(1), [LabelledImage(frame, (vehicle,), boxes=boxes)])
    split = PVDN(tmp_path / "val")
    assert split.rate_hz == 10.0
    assert split.keypoints_px(frame.frame).tolist() == keypoints_px.tolist()
    stored = json.loads((tmp_path / "val/labels/image_annotations.json").read_text())
    assert stored["info"] == {"rate_hz": 10, "of": [1.5]}


class OwnCamera:
    """A live source of somebody's own, which has a rate and a speed of any kind."""

    name, skipped, num_frames = "own", (), None
    is_lossless = is_endless = False

    def __init__(self, kind: Callable[[float], Any]) -> None:
        self.rate_hz, self.speed, self.max_silence_s = kind(20.0), kind(1.0), kind(2.0)

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def __iter__(self) -> Iterator[Frame]:
        for frame in night_frames(3):
            yield dataclasses.replace(frame, timestamp_ns=self.now_ns())
            time.sleep(0.05)


@pytest.mark.parametrize("kind", [np.float16, np.float32])
def test_a_live_loop_at_a_rate_and_speed_of_numpy_s(kind: Callable[[float], Any]) -> None:
    config = preset("foreglow").commanding()
    source = ListSource(night_frames(3))
    source.rate_hz = kind(20.0)
    paced = Paced(source, kind(1.0))
    assert (type(paced.rate_hz), type(paced.speed)) == (float, float)
    assert LiveLoop(paced, lambda: Pipeline(config), config).run().run.num_frames > 0
    assert LiveLoop(OwnCamera(kind), lambda: Pipeline(config), config).run().run.num_frames > 0


def test_a_can_log_of_motions_in_single_precision(tmp_path: Path) -> None:
    speed_mps: Any = np.float32(20.5)
    write_can_log(tmp_path / "log.asc", [], [(0, EgoMotion(speed_mps, 0.0))])
    motion = read_can_log(tmp_path / "log.asc").motion(0)
    assert motion is not None
    assert motion.speed_mps == pytest.approx(20.5, abs=0.01)
