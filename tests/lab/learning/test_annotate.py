"""Boxes of a whole data set: the files, what is in them, and going on after an interruption."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from foreglow.checksums import CHECKSUMS
from foreglow.config import PipelineConfig, ProposalConfig, preset, read_toml
from foreglow.datasets import PVDN
from foreglow.folder_lock import FolderLock
from foreglow.lab.evaluation import annotation_quality
from foreglow.lab.learning import annotation
from foreglow.lab.learning.annotation import RECORD_NAME, annotate_split, check_current, splits_to_annotate
from foreglow.parallel import Local
from foreglow.proposals import make_proposer
from foreglow.whole_files import write_atomic
from tests.cli.commands import complaint, foreglow_command
from tests.datasets.tiny_pvdn import edit
from tests.lab.learning.night_set import NUM_IMAGES, NUM_SEQUENCES, make_night_set

pytestmark = pytest.mark.slow

PAPER = preset("paper")
NUM_ALL = NUM_SEQUENCES * NUM_IMAGES


@pytest.fixture(scope="module")
def night(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_night_set(tmp_path_factory.mktemp("made"), ("val",)) / "night" / "val"


@pytest.fixture
def split(night: Path, tmp_path: Path) -> Path:
    return shutil.copytree(night, tmp_path / "night" / "val")


def box_files(split: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (split / "labels" / "bounding_boxes").iterdir()}


def changed(split: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in (split / "labels" / "bounding_boxes").iterdir()}


def test_files_have_the_layout_of_pvdn(split: Path) -> None:
    annotate_split(split, PAPER)
    document = json.loads((split / "labels" / "bounding_boxes" / "000100.json").read_text())
    assert list(document) == ["bounding_boxes", "labels"]
    # Paper: both lamps in one box; the doubtful light's box is the third one.
    assert len(document["bounding_boxes"]) == 2
    assert document["labels"] == [1.0, 1.0]
    assert all(isinstance(value, int) for box in document["bounding_boxes"] for value in box)


def test_every_proposal_is_in_the_file_or_left_out_for_doubt(split: Path) -> None:
    made = annotate_split(split, PAPER)
    dataset, proposer = PVDN(split), make_proposer(PAPER.proposals)
    for frame in dataset:
        labels = dataset.boxes(frame.frame)
        assert labels is not None
        proposed = {tuple(box) for box in proposer.propose(frame.image).boxes_xyxy_px.tolist()}
        x, y = dataset.doubtful(frame.frame)[0].position_px
        doubtful = {(x1, y1, x2, y2) for x1, y1, x2, y2 in proposed if x1 <= x <= x2 and y1 <= y <= y2}
        assert set(labels.boxes_xyxy_px) == proposed - doubtful
    assert (made.num_images, made.num_boxes, made.num_positive, made.num_ignored) == (
        NUM_ALL,
        2 * NUM_ALL,
        2 * NUM_ALL,
        NUM_ALL,
    )
    assert made.boxes_per_image == 2.0


def test_quality_is_that_of_the_files(split: Path) -> None:
    made = annotate_split(split, PAPER)
    assert made.quality == annotation_quality(split)
    # By hand: two boxes an image, of two lamps and of one reflection.
    assert (made.quality.precision, made.quality.recall, made.quality.q) == (1.0, 1.0, 0.75)


def test_boxes_without_light_are_labelled_zero(split: Path) -> None:
    path = split / "labels" / "keypoints" / "000100.json"
    edit(path, "annotations", value=[])
    annotate_split(split, PAPER)
    labels = PVDN(split).boxes(100)
    assert labels is not None
    assert labels.labels == (0.0, 0.0)


@pytest.mark.process
def test_processes_change_nothing(split: Path) -> None:
    first = annotate_split(split, PAPER), box_files(split)
    (split / "labels" / RECORD_NAME).unlink()
    assert (annotate_split(split, PAPER, workers=Local(2)), box_files(split)) == first


def test_second_call_keeps_the_files(split: Path) -> None:
    first, times = annotate_split(split, PAPER, "paper"), changed(split)
    reported: list[tuple[int, int]] = []
    again = annotate_split(split, PAPER, "paper", progress=lambda _, done, whole: reported.append((done, whole)))
    assert again == first
    assert changed(split) == times
    assert reported == [(NUM_ALL, NUM_ALL)]


def test_other_parameters_replace_the_files(split: Path) -> None:
    annotate_split(split, PAPER)
    made = annotate_split(split, PipelineConfig(proposals=ProposalConfig(gap_px=1)))
    assert made.num_boxes == 3 * NUM_ALL
    assert made.quality.q == 1.0
    assert read_toml(split / "labels" / RECORD_NAME)["proposals"]["gap_px"] == 1


def test_interrupted_call_goes_on(split: Path) -> None:
    def interrupt(_: str, done: int, __: int) -> None:
        if done == NUM_IMAGES:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        annotate_split(split, PAPER, progress=interrupt)
    record = read_toml(split / "labels" / RECORD_NAME)
    assert (record["is_complete"], len(record["sequences"])) == (False, 1)
    times = changed(split)
    made = annotate_split(split, PAPER)
    assert made.num_boxes == 2 * NUM_ALL
    assert {name: time for name, time in changed(split).items() if name in times} == times
    assert read_toml(split / "labels" / RECORD_NAME)["is_complete"]


@pytest.mark.parametrize("name", ["labels/keypoints/000100.json", "images/S00001/000100.png"])
def test_sequence_with_newer_files_is_made_again(split: Path, name: str) -> None:
    annotate_split(split, PAPER)
    times = changed(split)
    later = np.max(list(times.values())) + 10**9
    os.utime(split / name, ns=(later, later))
    annotate_split(split, PAPER)
    new = {name for name, time in changed(split).items() if time != times[name]}
    assert new == {f"{100 + index:06d}.json" for index in range(NUM_IMAGES)}


def test_key_points_that_are_older_than_the_boxes_are_others_too(split: Path) -> None:
    """As after a restored backup, or an archive that keeps times."""
    annotate_split(split, PAPER)
    path = split / "labels" / "keypoints" / "000100.json"
    before = path.stat().st_mtime_ns
    edit(path, "annotations", value=[])
    os.utime(path, ns=(before - 10**9, before - 10**9))
    made = annotate_split(split, PAPER)
    assert made.quality.precision == 1.0
    labels = PVDN(split).boxes(100)
    assert labels is not None
    assert labels.labels == (0.0, 0.0)


def test_key_points_that_change_while_boxes_are_made_are_others_too(
    split: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What learns of the boxes asks whether they are current, and trains on those of earlier key points else."""
    made: list[int] = []

    def label_image(dataset: PVDN, image_id: int, boxes: NDArray[np.int32]) -> NDArray[np.int8]:
        labels = annotation.label_boxes(boxes, dataset.keypoints_px(image_id))
        made.append(image_id)
        if image_id == 100:
            edit(split / "labels" / "keypoints" / "000100.json", "annotations", value=[])
        return labels

    with monkeypatch.context() as meanwhile:
        meanwhile.setattr(annotation, "label_image", label_image)
        annotate_split(split, PAPER)
    assert len(made) == NUM_ALL
    with pytest.raises(ValueError, match=r"sequence S00001: expected boxes of its images and key points as they are"):
        check_current(split)
    annotate_split(split, PAPER)
    check_current(split)
    labels = PVDN(split).boxes(100)
    assert labels is not None
    assert labels.labels == (0.0, 0.0)


def test_images_may_be_listed_in_any_order(split: Path) -> None:
    path = split / "labels" / "sequences.json"
    sequences = json.loads(path.read_text())
    for sequence in sequences["sequences"]:
        sequence["image_ids"].reverse()
    path.write_text(json.dumps(sequences))
    annotate_split(split, PAPER)
    times = changed(split)
    annotate_split(split, PAPER)
    assert changed(split) == times


def test_missing_box_file_is_made_again(split: Path) -> None:
    annotate_split(split, PAPER)
    before = box_files(split)
    (split / "labels" / "bounding_boxes" / "000203.json").unlink()
    annotate_split(split, PAPER)
    assert box_files(split) == before


def make_newer(path: Path) -> None:
    later_ns = path.stat().st_mtime_ns + 10**9
    os.utime(path, ns=(later_ns, later_ns))


def with_newer_images(split: Path) -> None:
    """As after a copy without the times."""
    for path in (split / "images").rglob("*.png"):
        make_newer(path)


REASONS: dict[str, tuple[PipelineConfig, Callable[[Path], None]]] = {
    "the same parameters": (PAPER, lambda _: None),
    "another preset": (preset("baseline"), lambda _: None),
    "another parameter": (PipelineConfig(proposals=ProposalConfig(gap_px=1)), lambda _: None),
    "other key points in the sequence": (PAPER, lambda split: make_newer(split / "labels/keypoints/000101.json")),
    "other key points in another one": (PAPER, lambda split: make_newer(split / "labels/keypoints/000200.json")),
    "newer images": (PAPER, with_newer_images),
    "boxes that are missing": (PAPER, lambda split: (split / "labels/bounding_boxes/000101.json").unlink()),
    "no record": (PAPER, lambda split: (split / "labels" / RECORD_NAME).unlink()),
}
"""Why boxes are made anew."""


@pytest.mark.parametrize("reason", REASONS)
def test_boxes_that_were_changed_are_neither_counted_nor_replaced(split: Path, reason: str) -> None:
    annotate_split(split, PAPER)
    config, change = REASONS[reason]
    change(split)
    path = split / "labels" / "bounding_boxes" / "000100.json"
    path.write_text(json.dumps({"bounding_boxes": [[1, 2, 3, 4]], "labels": [0.0]}))
    before = box_files(split), changed(split)
    words = rf"{path}: expected the file that Foreglow wrote, got a changed one, which stays; rename .*bounding_boxes "
    with pytest.raises(ValueError, match=words):
        annotate_split(split, config)
    assert (box_files(split), changed(split)) == before
    path.unlink()
    annotate_split(split, config)
    assert path.read_bytes() != before[0][path.name]


def test_no_split_is_begun_where_boxes_of_another_were_changed(tmp_path: Path) -> None:
    data = make_night_set(tmp_path, ("train", "val"), num_images=1)
    annotate_split(data / "night/val", PAPER)
    path = min((data / "night/val/labels/bounding_boxes").iterdir())
    path.write_text(json.dumps({"bounding_boxes": [[1, 2, 3, 4]], "labels": [0.0]}))
    assert f"{path}: expected the file that Foreglow wrote" in complaint("annotate", data, "--preset", "baseline")
    assert box_files(data / "night/train") == {}


def test_boxes_of_something_else_stay(split: Path) -> None:
    """Such as those that came with PVDN, or of an early version without checksums."""
    path = split / "labels/bounding_boxes/000101.json"
    path.write_text(json.dumps({"bounding_boxes": [[1, 2, 3, 4]], "labels": [0.0]}))
    before = box_files(split), changed(split)
    words = f"{path}: expected boxes that annotate wrote, or none, got others, which stay; rename {path.parent} to keep"
    assert words in complaint("annotate", split)
    assert (box_files(split), changed(split)) == before
    path.parent.rename(path.parent.with_name("bounding_boxes.original"))
    assert annotate_split(split, PAPER).num_boxes == 2 * NUM_ALL


def test_an_earlier_version_had_checksums_of_whole_sequences_only(split: Path) -> None:
    annotate_split(split, PAPER)
    (split / "labels" / CHECKSUMS).unlink()
    before = changed(split)
    annotate_split(split, PAPER)
    assert changed(split) == before
    (split / "labels" / CHECKSUMS).unlink()
    (split / "labels/bounding_boxes/000101.json").unlink()
    with pytest.raises(ValueError, match=r"000100\.json: expected boxes that annotate wrote"):
        annotate_split(split, PAPER)


def test_killed_calls_go_on(split: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whichever file was the last that was written, boxes are known as ours."""
    annotate_split(split, PAPER)
    baseline = preset("baseline")
    for last in range(2 * NUM_IMAGES):
        with monkeypatch.context() as patched:
            patched.setattr(annotation, "write_atomic", _failing_after(last))
            with pytest.raises(OSError, match="killed"):
                annotate_split(split, PAPER if last % 2 else baseline)
    annotate_split(split, baseline)
    made = box_files(split)
    shutil.rmtree(split / "labels/bounding_boxes")
    annotate_split(split, baseline)
    assert box_files(split) == made


def _failing_after(number: int) -> Callable[[Path, bytes], None]:
    left = iter(range(number))

    def write(path: Path, data: bytes) -> None:
        if path.parent.name == "bounding_boxes" and next(left, None) is None:
            raise OSError("killed")
        write_atomic(path, data)

    return write


@pytest.mark.parametrize("name", ["num_boxes", "num_positive", "num_ignored"])
def test_counts_that_are_not_those_of_the_files(split: Path, name: str) -> None:
    for path in (split / "labels" / "keypoints").iterdir():  # with doubtful light, any number may be left out
        edit(path, "doubtful", value=[])
    annotate_split(split, PAPER)
    record = split / "labels" / RECORD_NAME
    text = record.read_text()
    made = annotate_split(split, PAPER)
    record.write_text(re.sub(rf"^{name} = \d+$", f"{name} = 50000", text, count=1, flags=re.MULTILINE))
    before = changed(split)
    with pytest.raises(
        ValueError, match=rf"bounding_boxes\.toml: sequence S\d+: {name}: expected \d+, .*, got 50000; "
    ):
        annotate_split(split, PAPER)
    assert changed(split) == before
    record.unlink()
    assert annotate_split(split, PAPER).to_json() == made.to_json()
    assert record.read_text() == text


def test_broken_record_is_an_error(split: Path) -> None:
    annotate_split(split, PAPER)
    (split / "labels" / RECORD_NAME).write_text("version = 1\n")
    with pytest.raises(ValueError, match=r"bounding_boxes\.toml: version"):
        annotate_split(split, PAPER)


def test_boxes_never_replace_key_points(split: Path) -> None:
    before = (split / "labels/keypoints/000100.json").read_bytes()
    (split / "labels/bounding_boxes").rmdir()
    (split / "labels/bounding_boxes").symlink_to("keypoints")
    with pytest.raises(ValueError, match=r"bounding_boxes: expected a folder of its own, got a link to the key points"):
        annotate_split(split, PAPER)
    assert (split / "labels/keypoints/000100.json").read_bytes() == before


def test_a_split_is_annotated_by_one(split: Path) -> None:
    """Else the boxes of two presets would be mixed, and each record would call them its own."""
    with FolderLock(split / "labels"):  # as another process has it
        with pytest.raises(ValueError, match="labels: another run is writing into this folder"):
            annotate_split(split, PAPER)
        assert "another run is writing into this folder" in complaint("annotate", split)
    annotate_split(split, PAPER)


def test_missing_image(split: Path) -> None:
    (split / "images" / "S00002" / "000200.png").unlink()
    with pytest.raises(FileNotFoundError, match="no such image"):
        annotate_split(split, PAPER)


def test_the_command_tells_that_a_part_is_written(split: Path) -> None:
    image = max((split / "images").rglob("*.png"))
    kept = image.rename(image.with_suffix(".kept"))
    said = foreglow_command("annotate", split)
    words = f"{split / 'labels' / 'bounding_boxes'}: a part is written, finished sequences with "
    assert f"{words}{NUM_ALL - NUM_IMAGES} of {NUM_ALL} images; the same command continues" in said.stdout
    assert said.exit_code == 2
    assert len(said.stderr.splitlines()) == 1
    kept.rename(image)
    said = foreglow_command("annotate", split)
    assert said.exit_code == 0
    assert "a part is written" not in said.output


@pytest.mark.parametrize("is_annotated", [False, True])
def test_a_call_that_finishes_nothing_leaves_all_as_it_was(split: Path, *, is_annotated: bool) -> None:
    (split / "labels/bounding_boxes").rmdir()
    if is_annotated:
        annotate_split(split, PipelineConfig(proposals=ProposalConfig(gap_px=1)))
    image = min((split / "images").rglob("*.png"))
    image.rename(image.with_suffix(".kept"))
    before = {path: path.read_bytes() for path in (split / "labels").rglob("*.*") if path.is_file()}
    folders = {path for path in (split / "labels").iterdir() if path.is_dir()}
    said = complaint("annotate", split)
    assert f"{image}: no such image" in said
    assert {path: path.read_bytes() for path in (split / "labels").rglob("*.*") if path.is_file()} == before
    assert {path for path in (split / "labels").iterdir() if path.is_dir()} == folders


def test_splits_to_annotate(tmp_path: Path) -> None:
    data = make_night_set(tmp_path, ("train", "val"), num_images=1)
    train, val = data / "night" / "train", data / "night" / "val"
    assert splits_to_annotate(data) == (train, val)
    assert splits_to_annotate(data, ("val", "train")) == (train, val)
    assert splits_to_annotate(data, ("val",)) == (val,)
    assert splits_to_annotate(val) == splits_to_annotate(val, ("val",)) == (val,)
    for names, error in (
        (("test",), "expected the split test"),
        (("all",), "split: expected one of train, val, test, got 'all'"),
    ):
        with pytest.raises((FileNotFoundError, ValueError), match=error):
            splits_to_annotate(data, names)
    with pytest.raises(ValueError, match="single split, got train"):
        splits_to_annotate(val, ("train",))
    with pytest.raises(FileNotFoundError, match="expected a split, or a data set"):
        splits_to_annotate(tmp_path / "nothing")


def test_command(tmp_path: Path) -> None:
    data = make_night_set(tmp_path / "data", ("train", "val"), num_images=2)
    config, numbers = tmp_path / "gap.toml", tmp_path / "numbers.json"
    config.write_text("[proposals]\ngap_px = 1\n")
    result = foreglow_command("annotate", data, "--config", config, "--json", numbers)
    assert result.exit_code == 0, result.output
    assert "left out: doubtful light only" in result.stdout
    found = json.loads(numbers.read_text())
    assert list(found) == ["train", "val"]
    assert found["val"]["num_boxes"] == 3 * NUM_SEQUENCES * 2
    assert found["val"]["quality"]["q"] == 1.0
    assert read_toml(data / "night" / "train" / "labels" / RECORD_NAME)["preset"] == "paper"


def test_a_key_point_outside_the_image_is_told(split: Path) -> None:
    """PVDN may have such points, so they are no error."""
    result = foreglow_command("annotate", split)
    assert "outside the image" not in result.stdout
    keypoints = split / "labels/keypoints/000100.json"
    edit(keypoints, "annotations", 0, "instances", 0, "pos", value=[40, -1])
    result = foreglow_command("annotate", split)
    assert result.exit_code == 0, result.output
    assert f"{split}: outside the image, so that no box holds them: 1 key point\n" in result.stdout


def test_command_complains(tmp_path: Path) -> None:
    assert "expected a split" in complaint("annotate", tmp_path / "nothing")
    assert "preset: expected one of" in complaint("annotate", tmp_path, "--preset", "mine")
