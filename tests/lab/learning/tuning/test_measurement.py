"""What a proposer is worth: by hand, on parts of the frames, and with pixels that come from one file."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest

from foreglow.config import ProposalConfig
from foreglow.datasets import PVDN, read_image
from foreglow.datasets.images import png
from foreglow.lab.evaluation import Predictions, evaluate_boxes
from foreglow.lab.evaluation.boxes.box_quality import split_keypoints_px
from foreglow.lab.evaluation.boxes.lights import Light
from foreglow.lab.learning.tuning.measurement import (
    NUM_CHUNKS,
    Bench,
    LabelledLights,
    Tally,
    evenly_spread,
    interleaved,
    measure_split,
    read_material,
    stack_frames,
)
from foreglow.proposals import make_proposer
from foreglow.types import Frame, Image
from foreglow.whole_files import RemadeWarning
from tests.datasets.tiny_pvdn import make_pvdn
from tests.lab.learning.night_set import make_night_set
from tests.pipes import ENDLESS, soon

PAPER = ProposalConfig()


def light(x: float, y: float, rank: int = -1, *, is_hidden: bool = False) -> Light:
    return Light(1, 1, 0, (x, y), "lamp", is_direct=rank < 0, is_rear=False, is_hidden=is_hidden, rank=rank)


@pytest.fixture(scope="module")
def val(tmp_path_factory: pytest.TempPathFactory) -> PVDN:
    return PVDN(make_night_set(tmp_path_factory.mktemp("data"), ("val",)))


def test_recall_by_kind_by_hand() -> None:
    tally = Tally()
    boxes = np.array([[0, 0, 10, 10], [100, 100, 110, 110]], np.int32)
    lights = [light(10, 10), light(50, 50), light(105, 105, 0, is_hidden=True), light(60, 60, 2), light(5, 5, 3)]
    tally.add(1, boxes, LabelledLights.of(lights))
    tally.add(2, boxes[:1], LabelledLights.of([light(20, 20, 0, is_hidden=True)]))
    found = tally.measurement()
    assert found.recall_lamps == 1 / 2  # the edge belongs to the box
    assert found.recall_strongest == 1 / 3  # rank 3 is no more among the strongest
    assert found.recall_hidden == 1 / 2
    assert (found.num_images, found.num_boxes, found.boxes_per_image) == (2, 3, 1.5)
    # Three of six in a box; boxes with 2 and 1 key points.
    assert (found.quality.recall, found.quality.q) == (0.5, 0.75)


def test_nothing_to_rate_is_nan() -> None:
    tally = Tally()
    tally.add(1, np.empty((0, 4), np.int32), LabelledLights.of([]))
    found = tally.measurement()
    assert math.isnan(found.recall_lamps)
    assert math.isnan(found.quality.q)
    assert found.to_json()["recall_lamps"] is None


@pytest.mark.slow
def test_last_part_is_the_metric_on_all_images(val: PVDN, tmp_path: Path) -> None:
    material = read_material(val, 1000, tmp_path)
    parts = list(Bench(material).measure(PAPER))
    assert len(parts) == NUM_CHUNKS
    assert [part.num_images for part in parts] == [2, 4, 6, 8, 10, 12, 14, 16]
    boxes = {frame.frame: make_proposer(PAPER).propose(frame.image).boxes_xyxy_px.astype(float) for frame in val}
    predictions = Predictions(boxes, {key: np.ones(len(one)) for key, one in boxes.items()}, is_scored=False)
    assert parts[-1].quality == evaluate_boxes(split_keypoints_px(val), predictions)
    assert (parts[-1],) == measure_split(val, [PAPER])


def test_every_part_is_spread_over_the_sequences(val: PVDN, tmp_path: Path) -> None:
    ids = read_material(val, 1000, tmp_path).image_ids
    assert sorted(ids) == list(val.frame_ids)
    for start in range(0, 16, 2):
        assert {val.sequence(image_id).id for image_id in ids[start : start + 2]} == {1, 2}


def test_subset_is_spread_evenly() -> None:
    assert evenly_spread(range(10), 4) == (0, 2, 5, 7)
    assert evenly_spread(range(3), 4) == (0, 1, 2)
    assert interleaved(range(5), 8) == (0, 1, 2, 3, 4)


def test_fewer_images_than_parts(val: PVDN, tmp_path: Path) -> None:
    assert [one.num_images for one in Bench(read_material(val, 3, tmp_path)).measure(PAPER)] == [1, 2, 3]


def test_stack_holds_the_pixels(val: PVDN, tmp_path: Path) -> None:
    ids = (203, 100, 101)
    stack = stack_frames(val, ids, tmp_path / "frames", jobs=2)
    for image_id, image in zip(ids, stack.images(), strict=True):
        np.testing.assert_array_equal(image, val.read(image_id).image)
        assert not image.flags.writeable


def test_stack_of_two_sizes_and_depths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dataset = PVDN(make_pvdn(tmp_path))
    frames: dict[int, Image] = {
        11: np.full((72, 96), 9, np.uint8),
        13: np.arange(4160, dtype=np.uint16).reshape(64, 65) * np.uint16(15),
    }

    for image_id, image in frames.items():
        dataset.image_path(image_id).write_bytes(png(image))
    frame_of = {image_id: Frame(read_image(dataset.image_path(image_id)), 0, image_id) for image_id in frames}
    monkeypatch.setattr(dataset, "read", frame_of.__getitem__)  # which insists on the size in the labels
    stack = stack_frames(dataset, (13, 11), tmp_path / "frames")
    for image, expected in zip(stack.images(), (frames[13], frames[11]), strict=True):
        np.testing.assert_array_equal(image, expected)
        assert image.dtype == expected.dtype


def test_stack_is_decoded_once_and_again_when_a_file_changes(val: PVDN, tmp_path: Path) -> None:
    counts: list[int] = []

    def stack() -> None:
        stack_frames(val, (100, 101), tmp_path, progress=lambda _, done, __: counts.append(done))

    stack()
    stack()
    assert counts == [1, 2]
    path = val.image_path(100)
    os.utime(path, ns=(1, path.stat().st_mtime_ns + 1))
    stack()
    assert counts == [1, 2, 1, 2]
    assert len(list(tmp_path.glob("*.bin"))) == 2


@pytest.mark.parametrize("suffix", [".bin", ".json"])
def test_damaged_frames_are_decoded_again(val: PVDN, tmp_path: Path, suffix: str) -> None:
    stack = stack_frames(val, (100, 101), tmp_path)
    damaged = stack.path.with_suffix(suffix)
    content = bytearray(damaged.read_bytes())
    content[len(content) // 2] ^= 1
    damaged.write_bytes(content)
    with pytest.warns(RemadeWarning, match=r"\.bin: the frames kept here are damaged, and are decoded again"):
        again = stack_frames(val, (100, 101), tmp_path)
    assert again == stack
    np.testing.assert_array_equal(again.images()[0], val.read(100).image)


@pytest.mark.parametrize("kind", ENDLESS)
def test_a_pipe_is_no_file_of_frames(val: PVDN, tmp_path: Path, kind: str) -> None:
    stack = stack_frames(val, (100, 101), tmp_path)
    stack.path.unlink()
    ENDLESS[kind](stack.path)
    with soon(), pytest.raises(ValueError, match=f"expected a file, is {kind}$"):
        stack.images()


@pytest.mark.parametrize(
    "index", ["", "[]", "null", "[" * 100_000, '{"frames": 1}', '{"frames": [[1, 2, null]]}', "\0"]
)
def test_an_index_that_holds_something_else_is_made_anew(val: PVDN, tmp_path: Path, index: str) -> None:
    stack = stack_frames(val, (100, 101), tmp_path)
    stack.path.with_suffix(".json").write_text(index)
    with pytest.warns(RemadeWarning, match=r"\.bin: the frames kept here are damaged, and are decoded again"):
        assert stack_frames(val, (100, 101), tmp_path) == stack


def test_a_frame_of_the_same_size_and_time_is_noticed(val: PVDN, tmp_path: Path) -> None:
    path = val.image_path(100)
    content = path.read_bytes()
    image = val.read(100).image
    turned = image[::-1]
    size = max(len(png(image)), len(png(turned)))
    for changed in (image, turned):
        path.write_bytes(png(changed).ljust(size, b"\0"))
        os.utime(path, ns=(10**18, 10**18))
        np.testing.assert_array_equal(stack_frames(val, (100, 101), tmp_path).images()[0], changed)
    path.write_bytes(content)
