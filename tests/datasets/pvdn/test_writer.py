from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.datasets import PVDN, ImageCategory, Instance, LabelledImage, PVDNWriter, Sequence, Vehicle, Weather
from foreglow.datasets.json_files import write_json
from foreglow.datasets.pvdn.schema import BoxLabels
from foreglow.types import Frame


def _frame(image_id: int, timestamp_ns: int = 0, dtype: type[np.uint8] | type[np.uint16] = np.uint8) -> Frame:
    image = np.random.default_rng(image_id).integers(0, 65536, (64, 80), dtype=np.uint16)
    return Frame((image >> 8).astype(np.uint8) if dtype is np.uint8 else image, timestamp_ns, frame=image_id)


_VEHICLE = Vehicle(
    position_px=(10, 20),
    oid=1,
    is_direct=True,
    instances=(Instance(position_px=(9, 21), iid=0), Instance(position_px=(12, 21), iid=1, is_direct=True)),
)


def test_what_is_written_sequence_by_sequence_is_read_back(tmp_path: Path) -> None:
    root = tmp_path / "day" / "train"
    boxes = BoxLabels(boxes_xyxy_px=((1, 2, 30, 40),), labels=(1.0,))
    with PVDNWriter(root, info={"description": "made"}) as writer:
        first = writer.add_sequence(
            Sequence.plain(2, weather=Weather.SNOW, start_time_ms=1000),
            [
                LabelledImage(_frame(4), (_VEHICLE,), (ImageCategory.FIRST_VISIBLE_SIGNS,), boxes),
                LabelledImage(_frame(5, dtype=np.uint16), camera_configuration=1),
            ],
        )
        writer.add_sequence(Sequence.plain(1), (LabelledImage(_frame(number)) for number in (9, 8)))
    assert (first.image_ids, first.num_images) == ((4, 5), 2)
    dataset = PVDN(root)
    assert dataset.frame_ids == (8, 9, 4, 5)
    for frame in dataset:
        expected = _frame(frame.frame, dtype=frame.image.dtype.type)
        assert np.array_equal(frame.image, expected.image)
    assert dataset.read(5).image.dtype == np.uint16
    assert dataset.read(5).timestamp_ns == 1_055_555_556
    assert dataset.annotations(4) == (_VEHICLE,)
    assert dataset.annotations(8) == ()
    assert dataset.categories(4) == (ImageCategory.FIRST_VISIBLE_SIGNS,)
    assert dataset.boxes(4) == boxes
    assert dataset.sequence(4).weather is Weather.SNOW
    assert dataset.labels.images_file.info == {"description": "made"}


def test_files_use_the_data_sets_own_spelling(tmp_path: Path) -> None:
    with PVDNWriter(tmp_path) as writer:
        writer.add_sequence(Sequence.plain(1), [LabelledImage(_frame(4), (_VEHICLE,))])
    sequence = json.loads((tmp_path / "labels/sequences.json").read_text())["sequences"][0]
    assert {"id", "dir", "start_time", "proband_id", "proband_behaviour", "dome", "image_ids"} <= sequence.keys()
    images = json.loads((tmp_path / "labels/image_annotations.json").read_text())
    assert "licences" in images
    assert images["images"][0]["height"] == 64
    vehicle = json.loads((tmp_path / "labels/keypoints/000004.json").read_text())["annotations"][0]
    assert vehicle["pos"] == [10, 20]
    assert vehicle["instances"][1] == {"pos": [12, 21], "iid": 1, "direct": True}


def test_until_the_block_ends_it_is_no_split(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="expected at least one image"), PVDNWriter(tmp_path) as writer:
        _add_one_then_none(writer)
    assert not list(tmp_path.iterdir())


def test_a_disk_that_is_full_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(path: Path, record: Any) -> None:
        if path.name == "sequences.json":
            raise OSError(28, "No space left on device", str(path))
        write_json(path, record)

    writer = PVDNWriter(tmp_path)
    writer.add_sequence(Sequence.plain(1), [LabelledImage(_frame(4))])
    monkeypatch.setattr("foreglow.datasets.pvdn.writer.write_json", fail)
    with pytest.raises(OSError, match="No space left"), writer:
        pass
    assert not list(tmp_path.iterdir())


def test_an_error_leaves_what_was_there_before(tmp_path: Path) -> None:
    (tmp_path / "images" / "mine").mkdir(parents=True)
    (tmp_path / "notes.txt").touch()
    writer = PVDNWriter(tmp_path)
    (tmp_path / "images" / "mine" / "a.txt").touch()
    with pytest.raises(ValueError, match="expected at least one image"), writer:
        _add_one_then_none(writer)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a.txt", "images", "mine", "notes.txt"]


def _add_one_then_none(writer: PVDNWriter) -> None:
    writer.add_sequence(Sequence.plain(1), [LabelledImage(_frame(4))])
    writer.add_sequence(Sequence.plain(2), [])


def test_a_sequence_that_fails_leaves_nothing_behind(tmp_path: Path) -> None:
    with PVDNWriter(tmp_path) as writer:
        writer.add_sequence(Sequence.plain(1), [LabelledImage(_frame(4))])
        with pytest.raises(ValueError, match="image id: expected each once, 4 is there twice"):
            writer.add_sequence(Sequence.plain(2), [LabelledImage(_frame(5)), LabelledImage(_frame(4))])
        writer.add_sequence(Sequence.plain(2), [LabelledImage(_frame(6))])
    assert PVDN(tmp_path).frame_ids == (4, 6)
    assert sorted(path.name for path in tmp_path.rglob("*.png")) == ["000004.png", "000006.png"]


def test_bad_use_is_refused(tmp_path: Path) -> None:
    with PVDNWriter(tmp_path) as writer:
        writer.add_sequence(Sequence.plain(1), [LabelledImage(_frame(4))])
        with pytest.raises(ValueError, match=r"1 \(S00001\) is there already"):
            writer.add_sequence(Sequence.plain(1), [LabelledImage(_frame(5))])
        with pytest.raises(ValueError, match="camera_configuration: expected an index in a list of 2, got 2"):
            writer.add_sequence(Sequence.plain(2), [LabelledImage(_frame(5), camera_configuration=2)])
        with pytest.raises(ValueError, match="expected at least one image"):
            writer.add_sequence(Sequence.plain(2), [])
        with pytest.raises(ValueError, match="image_ids: expected those of the images"):
            writer.add_sequence(Sequence.plain(2, image_ids=(7,)), [LabelledImage(_frame(5))])
    with pytest.raises(ValueError, match="expected a folder without a data set"):
        PVDNWriter(tmp_path)


@pytest.mark.parametrize(("ids", "times_ns"), [((4, 5), (0, 0)), ((4, 5), (0, 999_999)), ((5, 4), (0, 10**9))])
def test_times_that_the_reader_would_refuse(ids: tuple[int, ...], times_ns: tuple[int, ...], tmp_path: Path) -> None:
    images = [LabelledImage(_frame(number, time_ns)) for number, time_ns in zip(ids, times_ns, strict=True)]
    words = r"S00001: timestamp_ns of image 5: expected a later millisecond than that of image 4, \d+, got 0"
    with pytest.raises(ValueError, match=words), PVDNWriter(tmp_path, info={"rate_hz": 18.0}) as writer:
        writer.add_sequence(Sequence.plain(1), images)
    assert not list(tmp_path.iterdir())
    with PVDNWriter(tmp_path) as writer:  # without a rate the times are not read
        writer.add_sequence(Sequence.plain(1), images)
    assert len(PVDN(tmp_path)) == 2


def test_leftovers_of_an_interrupted_run_are_named(tmp_path: Path) -> None:
    PVDNWriter(tmp_path).add_sequence(Sequence.plain(1), [LabelledImage(_frame(4))])
    with pytest.raises(ValueError, match=r"00000.*: expected a folder without a data set, this file is there"):
        PVDNWriter(tmp_path)


def test_given_ids_keep_their_order(tmp_path: Path) -> None:
    given_sequence = Sequence.plain(2, image_ids=(6, 5), num_images=2)
    with PVDNWriter(tmp_path) as writer:
        stored = writer.add_sequence(given_sequence, [LabelledImage(_frame(5)), LabelledImage(_frame(6))])
    assert stored == given_sequence == PVDN(tmp_path).sequence(5)


_PIXELS = st.tuples(st.integers(-100, 2000), st.integers(-100, 2000))


@st.composite
def _vehicles(draw: st.DrawFn) -> tuple[Vehicle, ...]:
    return tuple(
        Vehicle(
            position_px=draw(_PIXELS),
            oid=oid,
            is_direct=draw(st.booleans()),
            instances=tuple(
                Instance(position_px=draw(_PIXELS), iid=iid, is_direct=draw(st.booleans()), is_rear=draw(st.booleans()))
                for iid in range(draw(st.integers(0, 3)))
            ),
        )
        for oid in range(draw(st.integers(0, 2)))
    )


@settings(derandomize=True, max_examples=25)
@given(st.lists(_vehicles(), min_size=1, max_size=3))
def test_any_vehicles_survive(vehicles: list[tuple[Vehicle, ...]]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        with PVDNWriter(folder) as writer:
            writer.add_sequence(
                Sequence.plain(1), [LabelledImage(_frame(number), each) for number, each in enumerate(vehicles)]
            )
        dataset = PVDN(folder)
        assert [dataset.annotations(number) for number in range(len(vehicles))] == vehicles


@pytest.mark.parametrize("rate_hz", [float("nan"), 0, -5, 1e9, "x", None, float("inf")])
def test_a_rate_that_no_reader_takes_is_refused_before_anything_is_written(tmp_path: Path, rate_hz: object) -> None:
    with pytest.raises(ValueError, match=r"info\.rate_hz: expected a number from 0\.01 to 1000, got"):
        PVDNWriter(tmp_path / "val", info={"rate_hz": rate_hz})
    assert not (tmp_path / "val").exists()
