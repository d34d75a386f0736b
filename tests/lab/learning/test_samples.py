from __future__ import annotations

import dataclasses
import errno
import os
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foreglow import _native
from foreglow.datasets import PVDN, Selection
from foreglow.datasets.images import png
from foreglow.datasets.pvdn.schema import EarlierImage
from foreglow.datasets.simulated import KINDS as SIMULATED_KINDS
from foreglow.datasets.simulated import BoxShares
from foreglow.datasets.simulated.files import FRAMES_NAME, sequence_folder
from foreglow.datasets.simulated.shares import write_shares
from foreglow.folder_lock import FolderLock
from foreglow.lab.evaluation.boxes.lights import SEEN_ON, Light
from foreglow.lab.learning import sample_cache
from foreglow.lab.learning.kept_files import END_BYTES, image_state
from foreglow.lab.learning.sample_cache import cached_samples, samples_digest
from foreglow.lab.learning.samples import (
    ARRAYS,
    Jitter,
    SampleConfig,
    Samples,
    box_groups,
    jittered,
    joined,
    no_samples,
    samples_by_image,
    strongest_lights,
)
from foreglow.proposals import make_proposer
from foreglow.types import Frame
from foreglow.whole_files import RemadeWarning, output_words
from tests.datasets.tiny_pvdn import edit
from tests.lab.learning.tiny_drives import CONFIG, doubt, make_drives
from tests.lab.learning.tiny_training import make_samples
from tests.lab.studies.ranged_drives import make_split
from tests.pipes import ENDLESS, soon

pytestmark = pytest.mark.torch

PLAIN = SampleConfig(proposals=CONFIG)
FRAME = Frame(np.zeros((120, 160), np.uint8), timestamp_ns=0)
JITTERED = SampleConfig(proposals=CONFIG, jitter=Jitter(num_copies=2, seed=5))


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_drives(tmp_path_factory.mktemp("drives"))


@pytest.fixture
def own(data: Path, tmp_path: Path) -> PVDN:
    """A copy of the training split that may be changed."""
    return PVDN(shutil.copytree(data / "day/train", tmp_path / "train"))


def test_samples_are_what_the_pipeline_would_classify(data: Path) -> None:
    dataset = PVDN(data / "day/train")
    found = collect_samples(dataset, PLAIN)
    assert np.unique(found.image_ids).tolist() == list(dataset.frame_ids)
    assert found.num_labelled(1) == 8  # one light an image
    assert found.num_labelled(0) == 16  # and two that are none
    for image_id in dataset.frame_ids:
        own = found[found.image_ids == image_id]
        image = dataset.read(image_id).image
        boxes = make_proposer(CONFIG).propose(image).boxes_xyxy_px
        assert np.array_equal(own.boxes_xyxy_px, boxes)
        crops, _ = _native.extract_crops(image, np.array(boxes), 2, 64, None)
        assert np.abs(own.crops / 255 - crops).max() <= 0.5001 / 255
        x, y = dataset.keypoints_px(image_id)[0]
        x1, y1, x2, y2 = boxes.T
        assert (own.labels == 1).tolist() == ((x1 <= x) & (x <= x2) & (y1 <= y) & (y <= y2)).tolist()
        assert set(own.sequence_ids.tolist()) == {dataset.sequence(image_id).id}


def test_a_drive_may_have_any_number(own: PVDN) -> None:
    """Such as the time at which it began."""
    path, number = own.root / "labels/sequences.json", 20261127165800
    edit(path, "sequences", 0, "id", value=number)
    assert number in collect_samples(PVDN(own.root), PLAIN).sequence_ids.tolist()


def collect_samples(dataset: PVDN, config: SampleConfig) -> Samples:
    return joined([no_samples(config.inputs), *samples_by_image(dataset, config)])


def test_doubtful_light_is_marked(own: PVDN) -> None:
    doubt(own.root, 101)
    found = collect_samples(own, PLAIN)
    assert (found.labels[found.image_ids == 101] == -1).sum() == 1
    assert found.num_labelled(1) == 7
    assert found.num_labelled(0) == 16


def test_whose_light_it_is_where_that_is_stored(own: PVDN) -> None:
    config = SampleConfig(proposals=CONFIG, inputs=PLAIN.inputs, by_light=True)
    by_key_points = collect_samples(own, config)
    assert by_key_points.kinds[by_key_points.labels == 1, 4].tolist() == [0.0] * by_key_points.num_labelled(1)
    rows = []
    for image_id in own.frame_ids:
        boxes = np.array(by_key_points.boxes_xyxy_px[by_key_points.image_ids == image_id])
        shares = np.tile(np.array([0.0, 0.06, 0.05, 0.0, 0.5, 0.39], np.float32), (len(boxes), 1))
        shares[0] = (0.0, 0.02, 0.07, 0.0, 0.0, 0.91)
        rows += [(image_id, BoxShares("mine", boxes[:0], shares[:0])), (image_id, BoxShares("foreglow", boxes, shares))]
    folder = own.root / "simulation" / "S00001"
    folder.mkdir(parents=True)
    write_shares(folder / "shares.parquet", rows)
    found = collect_samples(own, config)
    num_images = len(own.frame_ids)
    assert (found.num_labelled(0), found.num_labelled(1)) == (num_images, len(found) - num_images)
    np.testing.assert_allclose(found.kinds[found.labels == 1][0], [0.0, 0.06, 0.05, 0.0, 0.89], atol=1e-6)
    assert collect_samples(own, PLAIN).labels.tolist() == by_key_points.labels.tolist()
    other = config.model_copy(update={"proposals": CONFIG.model_copy(update={"kappa": 3.0})})
    with pytest.raises(ValueError, match=r"image \d+: expected whose light is in these proposals; simulate with"):
        collect_samples(own, other)


def test_groups_are_kind_and_sight(data: Path) -> None:
    found = collect_samples(PVDN(data / "day/train"), PLAIN)
    lights = {image_id: found.groups[(found.image_ids == image_id) & (found.labels == 1)] for image_id in (100, 101)}
    assert lights[100].tolist() == [2 * SEEN_ON.index("indirect") + 1]  # hidden: no lamp yet
    assert lights[101].tolist() == [2 * SEEN_ON.index("lamp")]
    assert (found.groups[found.labels == 0] == -1).all()
    assert set(SIMULATED_KINDS) <= set(SEEN_ON)


def test_the_strongest_light_names_the_group() -> None:
    def light(kind: str, rank: int, x: float) -> Light:
        return Light(1, 1, 1, (x, 5.0), kind, is_direct=rank < 0, is_rear=False, is_hidden=rank >= 0, rank=rank)

    boxes = np.array([[0, 0, 10, 10], [20, 0, 30, 10], [40, 0, 50, 10]], np.int32)
    lights = (light("rail", 1, 5.0), light("road", 0, 6.0), light("lamp", -1, 21.0), light("road", 0, 22.0))
    groups = box_groups(strongest_lights(boxes, lights))
    assert groups.tolist() == [2 * SEEN_ON.index("road") + 1, 2 * SEEN_ON.index("lamp"), -1]


def test_jittered_copies_follow_their_boxes(data: Path) -> None:
    dataset = PVDN(data / "day/train")
    plain, found = collect_samples(dataset, PLAIN), collect_samples(dataset, JITTERED)
    assert len(found) == 3 * len(plain)
    again = collect_samples(dataset, JITTERED)
    assert all(np.array_equal(getattr(found, name), getattr(again, name)) for name in ARRAYS)
    for image_id in dataset.frame_ids:
        own, copies = plain[plain.image_ids == image_id], found[found.image_ids == image_id]
        num_boxes = len(own)
        assert np.array_equal(copies.boxes_xyxy_px[:num_boxes], own.boxes_xyxy_px)
        assert copies.labels.tolist() == 3 * own.labels.tolist()
        assert not np.array_equal(copies.boxes_xyxy_px[num_boxes : 2 * num_boxes], own.boxes_xyxy_px)


def test_jitter_keeps_to_its_bounds_and_to_the_frame() -> None:
    boxes = np.repeat(np.array([[100, 60, 140, 80], [0, 0, 4, 3], [150, 110, 160, 120]], np.int32), 200, axis=0)
    found = jittered(boxes, FRAME, Jitter(num_copies=1), np.random.default_rng(0))
    assert found.dtype == np.int32
    assert (found[:, :2] >= 0).all()
    assert (found[:, 2:] <= (160, 120)).all()
    assert (found[:, :2] < found[:, 2:]).all()
    inner, sizes = found[:200], found[:200, 2:] - found[:200, :2]
    assert (np.abs(sizes - (40, 20) * np.array([0.85])).min(axis=0) <= 3).all()  # both ends are reached
    assert (sizes >= (33, 16)).all()
    assert (sizes <= (49, 25)).all()
    moved = np.abs((inner[:, :2] + inner[:, 2:]) / 2 - (120, 70))
    assert (moved <= (6.5, 3.5)).all()
    assert (moved.max(axis=0) > (5, 2.5)).all()


def test_the_cache_holds_the_same_and_is_used(own: PVDN, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = collect_samples(own, JITTERED)
    seen: list[tuple[int, int]] = []
    first = cached_samples(own, JITTERED, tmp_path / "cache", lambda *done: seen.append(done))
    assert seen[0] == (0, 8)
    assert seen[-1] == (8, 8)
    monkeypatch.setattr(sample_cache, "samples_by_image", None)  # would fail if it were called
    second = cached_samples(own, JITTERED, tmp_path / "cache")
    for found in (first, second):
        assert found.digest == samples_digest(own, JITTERED)
        for name in ARRAYS:
            assert np.array_equal(getattr(found, name), getattr(expected, name)), name
    assert isinstance(second.crops, np.memmap)
    assert [path.name for path in (tmp_path / "cache").iterdir()] == [first.digest[:16]]


def test_two_trainings_make_the_same_samples_at_once(
    own: PVDN, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each makes them, as none are there when it begins; the second to end takes those of the first."""
    made: list[Any] = []

    def meanwhile(*_: object) -> None:
        if not made:
            made.append("begun")
            with monkeypatch.context() as other:
                other.setattr(os, "getpid", lambda: 1)
                made.append(cached_samples(own, SampleConfig(), tmp_path / "cache"))

    samples = cached_samples(own, SampleConfig(), tmp_path / "cache", meanwhile)
    assert len(made) == 2
    assert len(list((tmp_path / "cache").iterdir())) == 1
    np.testing.assert_array_equal(samples.crops, made[1].crops)


@pytest.mark.parametrize("kind", ["labels", "image"])
def test_what_changes_while_samples_are_made_is_said(own: PVDN, tmp_path: Path, kind: str) -> None:
    """They would be of other files than their digest says, to which a person may well go back."""
    path = own.image_path(103) if kind == "image" else own.root / "labels/keypoints/000103.json"
    before, cache = path.read_bytes(), tmp_path / "cache"

    def meanwhile(num_done: int, num_images: int) -> None:  # noqa: ARG001
        if num_done == 1:
            if kind == "image":
                path.write_bytes(png(own.read(103).image[::-1]))
            else:
                doubt(own.root, 103)

    with pytest.raises(ValueError, match=f"^{re.escape(str(own.root))}: expected the images and labels"):
        cached_samples(own, PLAIN, cache, meanwhile)
    assert list(cache.iterdir()) == []
    changed = cached_samples(own, PLAIN, cache).digest
    path.write_bytes(before)
    assert cached_samples(own, PLAIN, cache).digest != changed
    np.testing.assert_array_equal(cached_samples(own, PLAIN, cache).labels, collect_samples(own, PLAIN).labels)


def test_whatever_matters_changes_the_digest(own: PVDN) -> None:
    digests = [samples_digest(own, PLAIN), samples_digest(own, JITTERED)]
    other = PLAIN.model_copy(update={"proposals": CONFIG.model_copy(update={"kappa": 0.5})})
    digests.append(samples_digest(own, other))
    digests.append(samples_digest(PVDN(own.root, select=Selection(scenes=[1])), PLAIN))
    doubt(own.root, 101)
    digests.append(samples_digest(own, PLAIN))
    image = own.image_path(102)
    image.write_bytes(own.image_path(103).read_bytes())
    digests.append(samples_digest(own, PLAIN))
    assert len(set(digests)) == len(digests)
    assert samples_digest(own, PLAIN) == digests[-1]


def test_what_a_simulator_knows_counts(tmp_path: Path) -> None:
    """What a light is seen on and how strong it is: a box is of the group and the kind of its strongest light."""
    simulated = PVDN(make_split(tmp_path))
    before = samples_digest(simulated, PLAIN)
    truth = sequence_folder(simulated.root, simulated.sequences[0].id) / FRAMES_NAME
    truth.write_bytes(truth.read_bytes() + b"\n")
    assert samples_digest(simulated, PLAIN) != before


@pytest.mark.parametrize("is_cut", [True, False])
@pytest.mark.parametrize("name", ["samples.json", "labels.npy", "crops.npy"])
def test_a_damaged_cache_is_made_again(own: PVDN, tmp_path: Path, name: str, *, is_cut: bool) -> None:
    first = cached_samples(own, PLAIN, tmp_path)
    expected = {array: np.array(getattr(first, array)) for array in ("labels", "crops")}
    folder = tmp_path / first.digest[:16]
    content = bytearray((folder / name).read_bytes())
    content[-20] ^= 1
    (folder / name).write_bytes(content[:-20] if is_cut else content)
    with pytest.warns(RemadeWarning, match=f"^{re.escape(str(folder))}: the samples kept here are damaged"):
        again = cached_samples(own, PLAIN, tmp_path)
    for array, values in expected.items():
        np.testing.assert_array_equal(getattr(again, array), values)


@pytest.mark.parametrize("name", ["", "samples.json", "crops.npy"])
def test_something_else_in_place_of_a_cache(own: PVDN, tmp_path: Path, name: str) -> None:
    folder = tmp_path / cached_samples(own, PLAIN, tmp_path).digest[:16]
    if name:
        (folder / name).unlink()
        (folder / name).mkdir()
    else:
        shutil.rmtree(folder)
        folder.write_text("a file")
    with pytest.warns(RemadeWarning):
        assert len(cached_samples(own, PLAIN, str(tmp_path))) > 0


@pytest.mark.parametrize("name", ["", "samples.json", "labels.npy", "crops.npy"])
@pytest.mark.parametrize("kind", ENDLESS)
def test_a_pipe_in_a_cache_is_not_waited_for(own: PVDN, tmp_path: Path, kind: str, name: str) -> None:
    folder = tmp_path / cached_samples(own, PLAIN, tmp_path).digest[:16]
    if name:
        (folder / name).unlink()
    else:
        shutil.rmtree(folder)
    ENDLESS[kind](folder / name)
    with soon(), pytest.warns(RemadeWarning):
        assert len(cached_samples(own, PLAIN, tmp_path)) > 0


def test_an_image_of_the_same_size_and_time_is_noticed(own: PVDN, tmp_path: Path) -> None:
    path = own.image_path(102)
    image = own.read(102).image
    contents = (png(image), png(image[::-1]))
    size = max(map(len, contents))  # what follows the end of a PNG is not read
    states = []
    for content in contents:
        path.write_bytes(content.ljust(size, b"\0"))
        os.utime(path, ns=(10**18, 10**18))
        states.append(cached_samples(own, PLAIN, tmp_path).crops.tobytes())
    assert states[0] != states[1]


def test_an_earlier_image_counts(own: PVDN, monkeypatch: pytest.MonkeyPatch) -> None:
    earlier = EarlierImage(file_name="before.png", age_ms=50.0)
    records = {image_id: own.image(image_id).model_copy(update={"earlier": earlier}) for image_id in own.frame_ids}
    monkeypatch.setattr(own, "image", records.__getitem__)
    path = own.image_path(102).with_name("before.png")
    digests = [samples_digest(own, PLAIN)]
    for level in (1, 2):
        path.write_bytes(png(np.full((4, 4), level, np.uint8)))
        os.utime(path, ns=(10**18, 10**18))
        digests.append(samples_digest(own, PLAIN))
    assert len(set(digests)) == 3


def test_state_of_an_image_is_of_its_end(tmp_path: Path) -> None:
    path, states = tmp_path / "noise.png", set()
    image = np.random.default_rng(0).integers(0, 256, (600, 500), np.uint8)
    for y, x in ((0, 0), (300, 200), (599, 499), (0, 0)):
        changed = image.copy()
        changed[y, x] ^= 1
        path.write_bytes(png(changed))
        assert path.stat().st_size > 2 * END_BYTES
        os.utime(path, ns=(10**18, 10**18))
        states.add(image_state(path))
    assert len(states) == 3
    raw = tmp_path / "noise.npy"
    for y in (0, 300, 599):
        changed = image.copy()
        changed[y] ^= 1
        np.save(raw, changed)
        os.utime(raw, ns=(10**18, 10**18))
        states.add(image_state(raw))
    assert len(states) == 6


def test_a_full_disk_is_named(own: PVDN, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(file: Any, *_: object) -> None:
        file.close()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(np.lib.format, "write_array_header_1_0", fails)
    with pytest.raises(OSError, match="No space left") as caught:
        cached_samples(own, PLAIN, tmp_path / "cache")
    named = tmp_path / "cache" / samples_digest(own, PLAIN)[:16] / f"{next(iter(ARRAYS))}.npy"
    assert output_words(caught.value) == f"{named}: No space left on device"
    assert list((tmp_path / "cache").iterdir()) == []


def test_an_interrupted_collection_leaves_nothing(own: PVDN, tmp_path: Path) -> None:
    def interrupt(num_done: int, num_images: int) -> None:  # noqa: ARG001
        if num_done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cached_samples(own, PLAIN, tmp_path / "cache", interrupt)
    assert list((tmp_path / "cache").iterdir()) == []


def test_what_a_killed_collection_left_is_removed(own: PVDN, tmp_path: Path) -> None:
    killed, running, mine = (
        tmp_path / name for name in (f".{'a' * 16}.7.partial", f".{'b' * 16}.8.partial", ".c.partial")
    )
    for folder in (killed, running, mine):
        folder.mkdir()
        (folder / "crops.npy").write_text("half")
    with FolderLock(running):
        cached_samples(own, PLAIN, tmp_path)
    assert not killed.exists()
    assert (running / "crops.npy").exists()
    assert (mine / "crops.npy").exists()


def test_a_split_without_proposals_has_no_samples(own: PVDN, tmp_path: Path) -> None:
    blind = PLAIN.model_copy(update={"proposals": CONFIG.model_copy(update={"min_deviation": 1.0})})
    for found in (collect_samples(own, blind), cached_samples(own, blind, tmp_path), no_samples(blind.inputs)):
        assert found.crops.shape == (0, 1, 64, 64)
        assert found.boxes_xyxy_px.shape == (0, 4)


@pytest.mark.parametrize(
    ("name", "array", "message"),
    [
        ("labels", np.full(10, 2, np.int8), "labels: expected 1, 0 or -1"),
        ("crops", np.zeros((10, 1, 16, 16), np.float32), r"crops: expected uint8 of shape .*, got float32"),
        ("boxes_xyxy_px", np.zeros((10, 3), np.int32), r"boxes_xyxy_px: expected int32 of shape \(10, 4\), got int32"),
        ("features", np.zeros((9, 0), np.float32), r"features: expected float32 of shape \(10, 'any'\)"),
    ],
)
def test_arrays_that_do_not_fit(name: str, array: Any, message: str) -> None:
    with pytest.raises(ValueError, match=f"Samples.{message}"):
        dataclasses.replace(make_samples(10, seed=0), **dict[str, Any]({name: array}))


def test_selection() -> None:
    some = make_samples(30, seed=0)
    assert isinstance(some[some.labels == 1], Samples)
    assert len(some[::3]) == 10
    assert some[[4, 2]].image_ids.tolist() == [4, 2]
