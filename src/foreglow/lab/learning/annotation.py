"""From key points to labelled boxes: of an image, and of a data set as PVDN's `labels/bounding_boxes/*.json`."""

from __future__ import annotations

import functools
import itertools
import math
import uuid
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import tomli_w
from numpy.typing import NDArray

from foreglow.checksums import CHECKSUMS, announce, check_unchanged, checksums_file
from foreglow.config import FrozenModel, PipelineConfig, ProposalConfig, read_toml, validated
from foreglow.datasets import PVDN, LabelledSource, split_folder
from foreglow.datasets.json_files import json_bytes, read_json
from foreglow.datasets.pvdn import is_split
from foreglow.datasets.pvdn.schema import BoxLabels, Sequence
from foreglow.datasets.pvdn.splits import SPLIT_NAMES, check_finished, existing_splits
from foreglow.files import checked_path, to_json
from foreglow.folder_lock import FolderLock
from foreglow.lab.evaluation import BoxQuality, annotation_quality
from foreglow.lab.evaluation.boxes.breakdown import num_outside
from foreglow.lab.evaluation.boxes.matching import lies_in
from foreglow.lab.learning.kept_files import checksum_of, file_checksum, image_contents, image_state, state_of
from foreglow.parallel import Local, Parent, Workers
from foreglow.proposals import Proposer, make_proposer
from foreglow.whole_files import write_atomic
from foreglow.wording import check_one_of

Labels: TypeAlias = NDArray[np.int8]

POSITIVE, NEGATIVE, IGNORED = 1, 0, -1


def label_boxes(
    boxes_xyxy_px: NDArray[Any], keypoints_px: NDArray[Any], doubtful_px: NDArray[Any] | None = None
) -> Labels:
    """Label of each box for a classifier: 1 with a key point in it, else -1 with a doubtful one in it, else 0.

    All four edges belong to a box, see `lies_in`.

    Args:
        boxes_xyxy_px: Shape (N, 4).
        keypoints_px: Shape (K, 2), columns x and y.
        doubtful_px: Shape (D, 2): light that counts neither as an instance nor as a false detection.

    Returns:
        Shape (N,), int8.

    >>> boxes = np.array([[0, 0, 10, 10], [20, 0, 30, 10], [40, 0, 50, 10]])
    >>> label_boxes(boxes, np.array([[10, 10], [25, 5]]), np.array([[45, 5]])).tolist()
    [1, 1, -1]
    """
    labels = np.full(len(boxes_xyxy_px), NEGATIVE, np.int8)
    if doubtful_px is not None:
        labels[lies_in(doubtful_px, boxes_xyxy_px[:, None]).any(axis=1)] = IGNORED
    labels[lies_in(keypoints_px, boxes_xyxy_px[:, None]).any(axis=1)] = POSITIVE
    return labels


def label_image(dataset: LabelledSource, image_id: int, boxes_xyxy_px: NDArray[Any]) -> Labels:
    """Label of each box of an image, shape (N,), by the data set's key points and doubtful light; see `label_boxes`.

    Raises:
        FileNotFoundError: If the image has no file of key points.
        ValueError: If that file is broken.
    """
    doubtful_px = np.array([light.position_px for light in dataset.doubtful(image_id)], np.int32).reshape(-1, 2)
    return label_boxes(boxes_xyxy_px, dataset.keypoints_px(image_id), doubtful_px)


FOLDER_NAME = "bounding_boxes"
"""Folder of the boxes in `labels`."""

RECORD_NAME = "bounding_boxes.toml"
"""File beside the folder of boxes that records the parameters they were made with, and their numbers."""

Progress: TypeAlias = Callable[[str, int, int], None]
"""Called with the name of the task, how many of its steps are done, and how many there are."""


@dataclass(frozen=True, slots=True)
class Annotation:
    """The generated boxes of one split.

    Attributes:
        num_positive: Number of boxes with a key point.
        num_ignored: Number of proposals with doubtful light and no key point, which are left out of the files.
        num_outside: Number of key points outside their image, which no box holds.
        quality: How well the positive boxes cover the key points: the upper bound of any classifier on these boxes.
    """

    root: Path
    num_images: int
    num_boxes: int
    num_positive: int
    num_ignored: int
    num_outside: int
    quality: BoxQuality

    @property
    def boxes_per_image(self) -> float:
        """Mean number of boxes per image."""
        return self.num_boxes / self.num_images if self.num_images else math.nan

    def to_json(self) -> dict[str, Any]:
        """All fields by name, for JSON."""
        names = ("num_images", "num_boxes", "num_positive", "num_ignored", "num_outside")
        counts = {name: getattr(self, name) for name in names}
        return {
            "root": str(self.root),
            **counts,
            "boxes_per_image": self.boxes_per_image if self.num_images else None,
            "quality": to_json(self.quality),
        }


class _SequenceRecord(FrozenModel):
    """What was written for a sequence.

    Attributes:
        checksum: Of all its files, as `_checksum`; those of an early version have none, and are not checked.
        sources: The state of the images and key points that they were made of, as `_sources`; boxes of an early version
            do not say it, and are made again.
        contents: What both hold, which a copy of them holds, too; boxes of an early version do not say it.
    """

    directory: str
    num_images: int
    num_boxes: int
    num_positive: int
    num_ignored: int
    checksum: int | None = None
    sources: str | None = None
    contents: str | None = None


class _Record(FrozenModel):
    """`labels/bounding_boxes.toml`; a sequence is listed once all its files are written."""

    version: str
    preset: str
    is_complete: bool
    proposals: dict[str, Any]
    white_level: int | None = None
    sequences: tuple[_SequenceRecord, ...] = ()

    def is_made_like(self, other: _Record) -> bool:
        """Whether both give the same boxes; names and progress do not matter."""
        same = ("version", "proposals", "white_level")
        return all(getattr(self, name) == getattr(other, name) for name in same)


def splits_to_annotate(data: Path | str, names: tuple[str, ...] = ()) -> tuple[Path, ...]:
    """The folders of the named splits of `data`, or of all that exist; `data` itself if it is a split.

    Raises:
        FileNotFoundError: If there is no such folder or split.
        ValueError: If a name is unknown, `data` is a single split with another name, or a name fits several folders.
    """
    root = checked_path(data, "data")
    for name in names:
        check_one_of(name, SPLIT_NAMES, "split")
    if root.is_dir() and is_split(root):
        if names and names != (root.resolve().name,):
            raise ValueError(f"{root}: split: expected none, since this is a single split, got {', '.join(names)}")
        return (root,)
    if names:
        return tuple(split_folder(root, name) for name in SPLIT_NAMES if name in names)
    found = existing_splits(root)
    if not found:
        check_finished(root)
        raise FileNotFoundError(f"{root}: expected a split, or a data set with train, val or test")
    return tuple(found.values())


def annotate_split(
    root: Path | str,
    config: PipelineConfig,
    preset: str = "",
    *,
    workers: Workers | None = None,
    progress: Progress | None = None,
) -> Annotation:
    """Writes the boxes of every image of the split `root`, replacing those of earlier calls, and rates them.

    A box is labelled 1 with a key point in it and 0 without; a box that contains only doubtful light is left out. Files
    are written atomically. An interrupted call can be repeated: sequences that were finished with the same parameters
    are kept, unless an image or its key points have changed since. Boxes that are not what was written, perhaps
    by hand, are neither counted nor replaced, whatever the parameters; see `check_boxes`.

    Raises:
        FileNotFoundError: If the split, an image or a label file is missing.
        ValueError: If one of them is broken, boxes were changed since or are of something else, or another call is
            writing there.
        OSError: If a file cannot be written.
    """
    dataset = PVDN(root)
    with FolderLock(dataset.root / "labels"):
        return _annotated(dataset, config, preset, workers, progress)


def check_boxes(root: Path | str) -> None:
    """Checks that all boxes of the split `root` are as `annotate_split` wrote them, so that it may replace them.

    Raises:
        FileNotFoundError: If the split is missing.
        ValueError: If a file was changed since, or something else wrote it; the message names it. Or if the record
            beside the boxes is broken.
    """
    dataset = PVDN(root)
    _own_boxes(dataset, _record_in(dataset.root / "labels" / RECORD_NAME))


def check_current(root: Path | str) -> None:
    """Checks that boxes in the split `root` that `annotate_split` wrote are all of one call, and of its labels as now.

    Boxes of something else, or that somebody has changed, are taken as they are.

    Raises:
        FileNotFoundError: If the split is missing.
        ValueError: If the call was interrupted, images or key points have changed since, or the record is broken.
    """
    dataset = PVDN(root)
    path = dataset.root / "labels" / RECORD_NAME
    record = _record_in(path)
    if record is not None and not record.is_complete:
        raise ValueError(f"{path}: expected boxes of a finished `annotate`, got a part of them: run it again")
    recorded = {} if record is None else {sequence.directory: sequence for sequence in record.sequences}
    for directory, image_ids in ((each.directory, each.image_ids) for each in dataset.sequences):
        known, are_there = recorded.get(directory), all(_box_file(dataset, each).exists() for each in image_ids)
        if known is not None and are_there and known.checksum == _checksum(dataset, image_ids):
            state = image_state if known.contents is None else image_contents
            if (known.contents or known.sources) != _sources(dataset, image_ids, state):
                words = "expected boxes of its images and key points as they are, these were made before a change"
                raise ValueError(f"{path}: sequence {directory}: {words}: run `annotate` again")


def _own_boxes(dataset: PVDN, record: _Record | None) -> dict[str, int]:
    """The checksums of the boxes that are there, by their paths in `labels`; raises as `check_boxes`."""
    labels = dataset.root / "labels"
    paths = {_name(image_id): _box_file(dataset, image_id) for image_id in dataset.frame_ids}
    keep = f"rename {labels / FOLDER_NAME} to keep it"
    found = check_unchanged(labels, paths, f"{keep}, or remove this file to have it made again")
    recorded = {} if record is None else {sequence.directory: sequence for sequence in record.sequences}
    for sequence in dataset.sequences:
        names = [_name(image_id) for image_id in sequence.image_ids]
        unknown = [name for name in names if name not in found and paths[name].exists()]
        known = recorded.get(sequence.directory)  # of an earlier version, whose checksums are of whole sequences
        is_whole = all(paths[name].exists() for name in names)
        if unknown and not (is_whole and known and known.checksum == _checksum(dataset, sequence.image_ids)):
            raise ValueError(
                f"{paths[unknown[0]]}: expected boxes that annotate wrote, or none, got others, which stay; {keep}, "
                "and new boxes are made"
            )
        found |= {name: file_checksum(paths[name]) for name in unknown}
    return found


def _annotated(
    dataset: PVDN, config: PipelineConfig, preset: str, workers: Workers | None, progress: Progress | None
) -> Annotation:
    folder = dataset.root / "labels" / FOLDER_NAME
    if folder.resolve() == folder.with_name("keypoints").resolve():
        raise ValueError(f"{folder}: expected a folder of its own, got a link to the key points")
    path = folder.with_name(RECORD_NAME)
    earlier = _record_in(path)
    checksums = _own_boxes(dataset, earlier)
    parameters = config.proposals.model_dump(exclude_none=True, exclude={"backend", "dispatch"})
    parameters = {name: list(value) if isinstance(value, tuple) else value for name, value in parameters.items()}
    white_level = config.guard.white_level
    record = _Record(version=version("foreglow"), preset=preset, is_complete=False, proposals=parameters)
    record = record.model_copy(update={"white_level": white_level})
    done = _kept(dataset, earlier, record)
    tell = progress or (lambda task, num_done, num_all: None)  # noqa: ARG005
    directories = [sequence.directory for sequence in dataset.sequences]
    todo = {directory: directory for directory in directories if directory not in done}
    work = functools.partial(_annotate_sequence, dataset.root, config.proposals, white_level, uuid.uuid4().hex)
    made = (workers or Local()).each(work, todo, lambda *_: None, paths=(dataset.root,))

    def part() -> _Record:
        return record.model_copy(update={"sequences": tuple(done[each] for each in directories if each in done)})

    tell(dataset.name, sum(each.num_images for each in done.values()), len(dataset))
    for index, (directory, (finished, files)) in enumerate(made):
        if not index:  # until there is something new, all stays as it is
            folder.mkdir(exist_ok=True)
            write_atomic(folder.with_name(CHECKSUMS), checksums_file(checksums, folder.parent))
            write_atomic(path, _toml(part()))
        done[directory] = finished
        written = {name: zlib.crc32(data) for name, data in files.items()}
        announce(folder.parent, written)
        for name, data in files.items():
            write_atomic(folder.parent / name, data)
        checksums |= written
        write_atomic(path, _toml(part()))
        tell(dataset.name, sum(each.num_images for each in done.values()), len(dataset))
    write_atomic(folder.with_name(CHECKSUMS), checksums_file(checksums, folder.parent))
    write_atomic(path, _toml(part().model_copy(update={"is_complete": True})))
    totals = {
        name: sum(getattr(sequence, name) for sequence in part().sequences)
        for name in ("num_images", "num_boxes", "num_positive", "num_ignored")
    }
    outside = (num_outside(dataset.image(each), dataset.keypoints_px(each).tolist()) for each in dataset.frame_ids)
    return Annotation(dataset.root, **totals, num_outside=sum(outside), quality=annotation_quality(dataset.root))


def _annotate_sequence(
    root: Path, config: ProposalConfig, white_level: int | None, call: str, directory: str, parent: Parent
) -> tuple[_SequenceRecord, dict[str, bytes]]:
    """The record of a sequence, and what its files of boxes hold, by their paths in `labels`."""
    dataset, proposer = _dataset(root, call).seen_by(white_level), make_proposer(config)
    counts, files = [], {}
    image_ids = dataset.only(directory).frame_ids
    sources, contents = (_sources(dataset, image_ids, state) for state in (image_state, image_contents))
    for image_id in image_ids:
        if parent.is_stopped:
            raise KeyboardInterrupt
        boxes, *numbers = _annotate_image(dataset, image_id, proposer)
        files[_name(image_id)] = json_bytes(boxes)
        counts.append(numbers)
    record = _SequenceRecord(
        directory=directory,
        num_images=len(counts),
        **dict(zip(("num_boxes", "num_positive", "num_ignored"), np.sum(counts, axis=0).tolist(), strict=True)),
        checksum=checksum_of([zlib.crc32(data) for data in files.values()]),
        sources=sources,
        contents=contents,
    )
    return record, files


def _sources(dataset: PVDN, image_ids: Iterable[int], state: Callable[[Path], bytes] = image_state) -> str:
    """The state of these images and of their key points."""
    keypoints = dataset.root / "labels" / "keypoints"
    paths = ((dataset.image_path(each), keypoints / f"{each:06d}.json") for each in sorted(image_ids))
    return state_of(itertools.chain(*paths), state)


def _checksum(dataset: PVDN, image_ids: Iterable[int]) -> int:
    """CRC-32 of those of the images' files of boxes, in the order of the images, in which they are made."""
    return checksum_of([file_checksum(_box_file(dataset, image_id)) for image_id in sorted(image_ids)])


@functools.lru_cache(maxsize=1)
def _dataset(root: Path, call: str) -> PVDN:  # noqa: ARG001
    """The split, read once in each process and for each call, since labels may change between calls."""
    return PVDN(root)


def _annotate_image(dataset: PVDN, image_id: int, proposer: Proposer) -> tuple[BoxLabels, int, int, int]:
    """The boxes of one image, and the numbers of boxes, of positive ones, and of those left out."""
    boxes = proposer.propose(dataset.read(image_id).image).boxes_xyxy_px
    labels = label_image(dataset, image_id, boxes)
    is_written = labels != IGNORED
    kept = labels[is_written]
    record = BoxLabels(
        boxes_xyxy_px=tuple(map(tuple, boxes[is_written].tolist())), labels=tuple(kept.astype(float).tolist())
    )
    return record, len(kept), int(kept.sum()), int(np.count_nonzero(~is_written))


def _record_in(path: Path) -> _Record | None:
    """What an earlier call recorded at `path`; None if there is nothing."""
    if not path.is_file():
        return None
    fields = {name: tuple(value) if isinstance(value, list) else value for name, value in read_toml(path).items()}
    return validated(_Record, fields, str(path))


def _kept(dataset: PVDN, there: _Record | None, wanted: _Record) -> dict[str, _SequenceRecord]:
    """The sequences that were finished with the same parameters, and of the images and labels that are there."""
    if there is None or not there.is_made_like(wanted):
        return {}
    finished = {sequence.directory: sequence for sequence in there.sequences}
    return {
        sequence.directory: finished[sequence.directory]
        for sequence in dataset.sequences
        if sequence.directory in finished and _is_current(dataset, sequence, finished[sequence.directory])
    }


def _is_current(dataset: PVDN, sequence: Sequence, record: _SequenceRecord) -> bool:
    is_current = (
        record.num_images == len(sequence.image_ids)
        and all(_box_file(dataset, image_id).exists() for image_id in sequence.image_ids)
        and record.sources == _sources(dataset, sequence.image_ids)
    )
    if is_current and record.checksum not in (None, _checksum(dataset, sequence.image_ids)):
        raise ValueError(
            f"{_box_file(dataset, 0).parent}: sequence {sequence.directory}: expected the boxes that "
            "annotate wrote, got changed ones; remove one of these files to have all of them made again"
        )
    if is_current:
        _check_counts(dataset, sequence, record)
    return is_current


def _check_counts(dataset: PVDN, sequence: Sequence, record: _SequenceRecord) -> None:
    """Checks the counts of a sequence in the record against its files.

    What was left out for doubtful light is in no file, so that its number is checked only where there is no such light.

    Raises:
        ValueError: If one is another.
    """
    boxes = [read_json(_box_file(dataset, image_id), BoxLabels) for image_id in sequence.image_ids]
    has_doubtful = any(dataset.doubtful(image_id) for image_id in sequence.image_ids)
    counts = {
        "num_boxes": sum(len(each.labels) for each in boxes),
        "num_positive": sum(each.labels.count(POSITIVE) for each in boxes),
        "num_ignored": max(record.num_ignored, 0) if has_doubtful else 0,
    }
    for name, found in counts.items():
        if getattr(record, name) != found:
            raise ValueError(
                f"{_box_file(dataset, 0).parent.with_name(RECORD_NAME)}: sequence {sequence.directory}: {name}: "
                f"expected {found}, by its files of boxes and key points, got {getattr(record, name)}; remove it "
                "to have all boxes made anew"
            )


def _box_file(dataset: PVDN, image_id: int) -> Path:
    return dataset.root / "labels" / _name(image_id)


def _name(image_id: int) -> str:
    """The file of an image's boxes, as seen from `labels`."""
    return f"{FOLDER_NAME}/{image_id:06d}.json"


def _toml(record: _Record) -> bytes:
    return tomli_w.dumps(record.model_dump(exclude_none=True)).encode()
