"""The sequences of a source, one by one, are the source."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from foreglow.datasets import PVDN, Equipped, Selection, part_names, part_of
from foreglow.datasets.vehicle_data import VehicleData
from foreglow.geometry import Camera
from foreglow.types import EgoMotion, Frame, RoadAhead
from tests.lab.learning.night_set import make_night_set
from tests.stand_ins import ListSource, night_frames


class Moving(VehicleData):
    """Knows one speed."""

    def camera(self, frame: Frame) -> Camera | None:  # noqa: ARG002
        return None

    def motion(self, frame: Frame) -> EgoMotion | None:  # noqa: ARG002
        return EgoMotion(20.0, 0.0)

    def road(self, frame: Frame) -> RoadAhead | None:  # noqa: ARG002
        return None


@pytest.fixture
def split(tmp_path: Path) -> Path:
    return make_night_set(tmp_path, ("val",), num_images=3) / "night" / "val"


def test_parts_of_a_split_are_its_frames_in_order(split: Path) -> None:
    whole = PVDN(split)
    assert part_names(whole) == ("S00001", "S00002")
    frames = [frame for name in part_names(whole) for frame in part_of(whole, name)]
    for each, other in zip(frames, whole, strict=True):
        assert (each.frame, each.sequence, each.timestamp_ns, each.path) == (
            other.frame, other.sequence, other.timestamp_ns, other.path,
        )  # fmt: skip
        assert np.array_equal(each.image, other.image)


def test_a_part_keeps_the_selection_and_skips_for_itself(split: Path) -> None:
    whole = PVDN(split, select=Selection(scenes=["S00002"]), on_error="skip")
    assert part_names(whole) == ("S00002",)
    part = part_of(whole, "S00002")
    (split / "images" / "S00002" / whole.image(whole.frame_ids[0]).file_name).unlink()
    assert len(list(part)) == 2
    assert (len(part.skipped), len(whole.skipped)) == (1, 0)


def test_parts_are_equipped_like_the_whole(split: Path) -> None:
    whole = Equipped(PVDN(split), Moving())
    assert part_names(whole) == ("S00001", "S00002")
    motions = [frame.motion for frame in part_of(whole, "S00001")]
    assert [motion and motion.speed_mps for motion in motions] == [20.0] * 3


def test_what_is_all_of_a_piece_is_its_own_part() -> None:
    source = ListSource(night_frames(2))
    assert part_names(source) == ("",)
    assert part_of(source, "") is source
