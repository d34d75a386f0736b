"""A data format with labels is a class and a line in the table of formats."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from foreglow.datasets import ImageCategory, Instance, LabelledSource, Sequence, Vehicle, formats, open_labelled
from foreglow.datasets.formats import FORMATS, DataFormat, open_source
from foreglow.datasets.pvdn.schema import ImageRecord
from foreglow.lab.evaluation.boxes.lights import empty_images, read_lights
from foreglow.types import Frame
from tests.datasets.tiny_pvdn import make_pvdn


class TwoImages(LabelledSource):
    """A drive of two images, a vehicle's light in the second."""

    name = "two"
    rate_hz = 10.0
    sequences = (Sequence.plain(1, image_ids=(5, 6)),)

    def __init__(self, root: Path) -> None:
        self.root, self.frame_ids, self.skipped = root, (5, 6), []

    def __iter__(self) -> Iterator[Frame]:
        return map(self.read, self.frame_ids)

    def read(self, image_id: int) -> Frame:
        return Frame(np.zeros((64, 64), np.uint8), round(self.time_s(image_id) * 1e9), image_id, "S00001")

    def annotations(self, image_id: int) -> tuple[Vehicle, ...]:
        light = Instance(position_px=(9, 8), iid=0, is_direct=True)
        return (Vehicle(position_px=(9, 8), oid=3, instances=(light,)),) if image_id == 6 else ()

    def image(self, image_id: int) -> ImageRecord:
        return ImageRecord(id=image_id, file_name="x.png", height_px=64, width_px=64, camera_configuration=0)

    def image_path(self, image_id: int) -> Path:
        return self.root / f"{image_id}.png"

    def sequence(self, image_id: int) -> Sequence:  # noqa: ARG002
        return self.sequences[0]

    def categories(self, image_id: int) -> tuple[ImageCategory, ...]:
        return (ImageCategory(image_id - 5),)

    def time_s(self, image_id: int) -> float:
        return (image_id - 5) / self.rate_hz


@pytest.fixture
def two(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file of the new format, which the table knows."""
    path = tmp_path / "drive.two"
    path.write_bytes(b"")
    known = DataFormat(lambda at: at.suffix == ".two", lambda at, _: TwoImages(at), TwoImages)
    monkeypatch.setattr(formats, "FORMATS", {"two": known, **FORMATS})
    return path


def test_a_format_of_the_table_is_run_and_evaluated(two: Path) -> None:
    assert [frame.frame for frame in open_source(two)] == [5, 6]
    source = open_labelled(two)
    assert (len(source), source.num_frames, source.directories) == (2, 2, ("S00001",))
    assert [light.position_px for light in read_lights(source)[6]] == [(9.0, 8.0)]
    assert empty_images(source) == (5,)
    assert source.keypoints_px(6).tolist() == [[9, 8]]
    assert source.first_with(source.sequences[0], ImageCategory.FIRST_VISIBLE_SIGNS) == 6
    assert source.only("S00001").frame_ids == (5, 6)
    with pytest.raises(ValueError, match="directory: expected that of a sequence, got 'other'"):
        source.only("other")


def test_the_other_formats_stay(two: Path, tmp_path: Path) -> None:
    split = make_pvdn(tmp_path)
    assert open_labelled(tmp_path).root == split
    with pytest.raises(FileNotFoundError, match="expected a PVDN split"):
        open_labelled(tmp_path / "absent")
    with pytest.raises(ValueError, match="expected a recording, as a topic was named"):
        open_source(two, topic="/camera")
