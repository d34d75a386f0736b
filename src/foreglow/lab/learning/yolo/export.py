"""Export of a data set in PVDN's layout as a YOLO data set: square images, and the boxes with a light artifact."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from foreglow.checksums import CHECKSUMS, announce, check_unchanged, checksums_file, missing_files
from foreglow.config import FrozenModel, preset
from foreglow.datasets import SPLIT_NAMES, LabelledSource, SplitName, open_labelled
from foreglow.datasets.images import IMAGE_SUFFIXES, png
from foreglow.datasets.json_files import read_json
from foreglow.datasets.pvdn.splits import existing_splits
from foreglow.files import MIB, read_bytes
from foreglow.folder_lock import FolderLock
from foreglow.lab.learning.annotation import POSITIVE, check_current, label_boxes
from foreglow.lab.learning.apart import check_apart
from foreglow.lab.learning.kept_files import file_checksum, state_of
from foreglow.own_files import has_title, named_png
from foreglow.own_folders import EXPORT, UNFINISHED_EXPORT, check_new
from foreglow.proposals import Proposer, make_proposer
from foreglow.types import Frame, Image
from foreglow.whole_files import write_atomic
from foreglow.wording import check_one_of

_ANNOTATED, _PRESET = "as annotated", "preset "  # which boxes an export has, as its settings say it

_LEARNT_SUFFIXES = IMAGE_SUFFIXES - {".npy"}
"""Of images that a YOLO learns from; in `.npy` libraries keep what they have read of others."""

CLASS_NAME = "light_artifact"
DATA_NAME = "data.yaml"

PAPER_SIZE_PX = 960
"""Side of YOLO's images in the paper. Source: published conversion script."""

Progress: TypeAlias = Callable[[int, int], None]
"""Called with the number of images done, and of all images."""


class ExportSettings(FrozenModel):
    """The settings of an export; a folder holds exports of one setting only.

    Attributes:
        boxes: `preset NAME`, or `as annotated` for the boxes in the data set's `labels/bounding_boxes`.
        size_px: Side of the images.
    """

    data: str
    boxes: str
    size_px: Annotated[int, Field(ge=32, le=4096)]
    splits: Annotated[tuple[SplitName, ...], Field(strict=False)]


@dataclass(frozen=True, slots=True)
class YoloExport:
    """An exported data set.

    Attributes:
        data_file: Its `data.yaml`, the input of every YOLO.
    """

    data_file: Path
    settings: ExportSettings
    num_images: dict[SplitName, int]
    num_boxes: dict[SplitName, int]


def export_yolo(
    data: Path | str,
    folder: Path | str,
    *,
    preset_name: str | None = None,
    size_px: int = PAPER_SIZE_PX,
    splits: Sequence[SplitName] = SPLIT_NAMES,
    progress: Progress | None = None,
) -> YoloExport:
    """Writes `folder/images/SPLIT/ID.png`, `folder/labels/SPLIT/ID.txt` and `folder/data.yaml`.

    The images are grey and scaled to a square, as in the published conversion. A line of a label file is
    `0 cx cy w h`, the centre and size of a box with a key point in it, relative to the image. Images without boxes have
    an empty file. All files appear at the end; after an error none do. An interrupted export, whose files are hidden,
    continues where it stopped; images are exported again if they or their labels have changed since, and those that are
    no longer in the data set are removed. What somebody has changed in an earlier export, by its `checksums.json`, is
    neither counted nor replaced.

    Args:
        data: A data set with train, val and test in PVDN's layout, with frames of 8 bits.
        folder: Where to write; made if it does not exist.
        preset_name: The boxes are this preset's proposals, labelled by the key points. None takes the boxes that
            `annotate` has written into the data set, or else the proposals of `paper`.
        size_px: Side of the images.
        splits: The splits to export; splits that the data set lacks are left out.
        progress: Called after each image.

    Raises:
        FileNotFoundError: If the data set lacks all of the splits, or an image or a label is missing.
        ValueError: If a file is broken, there is no such preset or split, `folder` holds something other than this
            export, a file of it was changed since, an image was added, or another run is writing into it.
        OSError: If the disk is full; the message names the file.
    """
    data, folder = Path(data), Path(folder)
    for name in splits:
        check_one_of(name, SPLIT_NAMES, "splits")
    if not data.is_dir():
        raise FileNotFoundError(f"{data}: no such folder, expected a data set with train, val and test")
    wanted = existing_splits(data, splits)
    if not wanted:
        raise FileNotFoundError(f"{data}: expected one of the splits {', '.join(splits)}, found none")
    learnt = [wanted["train"]] if "train" in wanted else []
    check_apart(learnt, [path for path in wanted.values() if path not in learnt])
    is_annotated = preset_name is None and all(
        any((found / "labels" / "bounding_boxes").glob("*.json")) for found in wanted.values()
    )
    settings = ExportSettings(
        data=str(Path(data).resolve()),
        boxes=_ANNOTATED if is_annotated else f"{_PRESET}{preset_name or 'paper'}",
        size_px=size_px,
        splits=tuple(wanted),
    )
    proposer = proposer_of(settings.boxes)
    if proposer is None:
        for found in wanted.values():
            check_current(found)
    with FolderLock(folder):
        _claim(folder, settings)
        try:
            export, checksums, gone = _exported(folder, settings, wanted, proposer, progress)
            announce(folder, checksums)
        except Exception:
            shutil.rmtree(folder / UNFINISHED_EXPORT, ignore_errors=True)
            raise
        for part in (EXPORT, "labels", "images", CHECKSUMS, DATA_NAME):  # images say what both were made of
            if part == CHECKSUMS:  # which does not know them
                for image in gone:
                    (folder / image).unlink()
            _move(folder / UNFINISHED_EXPORT / part, folder / part)
        (folder / UNFINISHED_EXPORT).rmdir()
    return export


def _exported(
    folder: Path,
    settings: ExportSettings,
    splits: Mapping[SplitName, Path],
    proposer: Proposer | None,
    progress: Progress | None,
) -> tuple[YoloExport, dict[str, int], set[str]]:
    """Exports into the hidden folder in `folder` what is in neither; that may hold what is done already.

    Returns:
        What is exported then, the checksums of all its images and label files, and the files of an earlier export of
        this data set that are of none of its images now.
    """
    work = folder / UNFINISHED_EXPORT
    known = check_unchanged(folder)
    if not _has_begun(work, settings):
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir()
        write_atomic(work / EXPORT, (settings.model_dump_json(indent=1) + "\n").encode())
    datasets = {name: open_labelled(found) for name, found in splits.items()}
    num_images = sum(len(dataset) for dataset in datasets.values())
    num_done, num_boxes = 0, dict.fromkeys(datasets, 0)
    checksums: dict[str, int] = {}
    for name, dataset in datasets.items():
        for kind in ("images", "labels"):
            (work / kind / name).mkdir(parents=True, exist_ok=True)
        for image_id in dataset.frame_ids:
            pair = f"images/{name}/{image_id:06d}.png", f"labels/{name}/{image_id:06d}.txt"
            state = _state(dataset, image_id, proposer)
            home = next((each for each in (work, folder) if _is_current(each, pair, state)), None)
            if home is None:
                home = work
                frame = dataset.read(image_id)
                boxes = positive_boxes(dataset, frame, proposer)
                image = png(squashed(frame.image, settings.size_px, frame.path))
                write_atomic(work / pair[1], label_lines(boxes, frame.width_px, frame.height_px).encode())
                write_atomic(work / pair[0], named_png(image, state))
            for part in pair:
                is_known = home == folder and part in known
                checksums[part] = known[part] if is_known else file_checksum(home / part)
            num_boxes[name] += read_bytes(home / pair[1], MIB).count(b"\n")
            num_done += 1
            if progress is not None:
                progress(num_done, num_images)
    for path in work.glob("*/*/*"):  # of images that were in the data set when it was interrupted
        if path.relative_to(work).as_posix() not in checksums:
            path.unlink()
    _check_alone(folder, known.keys() | checksums.keys())
    write_atomic(work / CHECKSUMS, checksums_file(checksums))
    write_atomic(work / DATA_NAME, _data_text(tuple(datasets)).encode())
    counts = {name: len(dataset) for name, dataset in datasets.items()}
    return YoloExport(folder / DATA_NAME, settings, counts, num_boxes), checksums, known.keys() - checksums.keys()


def _check_alone(folder: Path, known: Collection[str]) -> None:
    """ValueError if there is an image that is not `known`: a YOLO learns from all in a folder."""
    for path in sorted((folder / "images").glob("*/*")):
        if path.suffix.lower() in _LEARNT_SUFFIXES and path.relative_to(folder).as_posix() not in known:
            raise ValueError(f"{path}: expected images that were exported here, and no others; move this one elsewhere")


def _move(path: Path, target: Path) -> None:
    """Gives a file or folder its final name; where a folder is there, what is in it moves into that."""
    if path.is_dir() and target.is_dir():
        for part in sorted(path.iterdir()):
            _move(part, target / part.name)
        path.rmdir()
    else:
        path.replace(target)


def _state(dataset: LabelledSource, image_id: int, proposer: Proposer | None) -> str:
    """What an image and its labels are exported from, and what proposes boxes, as the title of the exported image."""
    labels = (dataset.root / "labels" / kind / f"{image_id:06d}.json" for kind in ("keypoints", "bounding_boxes"))
    by = "" if proposer is None else f" by {version('foreglow')}"
    return f"Foreglow: of {state_of((dataset.image_path(image_id), *labels))}{by}"


def _is_current(home: Path, pair: tuple[str, str], state: str) -> bool:
    """Whether an earlier call has exported an image and its labels in this state; the image came last."""
    image_file, label_file = (home / part for part in pair)
    return image_file.is_file() and label_file.exists() and has_title(image_file, state)


def read_export(folder: Path) -> ExportSettings:
    """The settings of the complete export in `folder`.

    Raises:
        FileNotFoundError: If there is none, it was interrupted, or a file of it is gone.
        ValueError: If its settings are broken, or a file of it was changed since, or an image was added.
    """
    for name in (EXPORT, DATA_NAME):
        if not (folder / name).is_file():
            raise FileNotFoundError(f"{folder / name}: no such file, expected a complete export of `export-yolo`")
    settings = read_json(folder / EXPORT, ExportSettings)
    known = check_unchanged(folder)
    if known:  # an export of an early version has no checksums
        _check_alone(folder, known)
    for path in missing_files(folder):
        raise FileNotFoundError(f"{path}: no such file, expected a complete export of `export-yolo`")
    return settings


def is_export(folder: Path) -> bool:
    """Whether `folder` holds an export, complete or not, rather than a data set."""
    return any((home / EXPORT).is_file() for home in (folder, folder / UNFINISHED_EXPORT))


def proposer_of(boxes: str) -> Proposer | None:
    """What proposes the `boxes` of `ExportSettings`; None for those in the data set.

    Raises:
        ValueError: If there is no such preset.
    """
    return None if boxes == _ANNOTATED else make_proposer(preset(boxes.removeprefix(_PRESET)).proposals)


def positive_boxes(dataset: LabelledSource, frame: Frame, proposer: Proposer | None) -> NDArray[np.float64]:
    """The boxes of `frame` with a key point in them, shape (N, 4), xyxy, full-frame pixels.

    Args:
        dataset: The split.
        frame: One of its frames.
        proposer: Makes the proposals; None takes the boxes and labels in the split.

    Raises:
        FileNotFoundError: If the split has boxes, but none for this image.
        ValueError: If a label file is broken.
    """
    if proposer is not None:
        proposed = proposer.propose(frame.image).boxes_xyxy_px
        is_positive = label_boxes(proposed, dataset.keypoints_px(frame.frame)) == POSITIVE
        return np.asarray(proposed[is_positive], np.float64)
    found = dataset.boxes(frame.frame)
    if found is None:
        path = dataset.root / "labels" / "bounding_boxes" / f"{frame.frame:06d}.json"
        raise FileNotFoundError(f"{path}: no such file, expected boxes of every image: run `annotate` again")
    kept = [box for box, label in zip(found.boxes_xyxy_px, found.labels, strict=True) if label == POSITIVE]
    return np.array(kept, np.float64).reshape(-1, 4)


def label_lines(boxes_xyxy_px: NDArray[Any], width_px: int, height_px: int) -> str:
    r"""The lines of a label file: `0 cx cy w h` for each box, clipped to the image and relative to it.

    Boxes outside the image are left out.

    >>> label_lines(np.array([[-10, 0, 10, 50]]), 100, 100)
    '0 0.050000 0.250000 0.100000 0.500000\n'
    """
    corners = np.clip(boxes_xyxy_px.reshape(-1, 4), 0, [width_px, height_px] * 2) / ([width_px, height_px] * 2)
    lines = []
    for x1, y1, x2, y2 in corners.tolist():
        if x1 < x2 and y1 < y2:
            lines.append(f"0 {(x1 + x2) / 2:.6f} {(y1 + y2) / 2:.6f} {x2 - x1:.6f} {y2 - y1:.6f}\n")
    return "".join(lines)


def squashed(image: Image, size_px: int, origin: str = "") -> NDArray[np.uint8]:
    """`image` scaled to a square of `size_px` by averaging over areas; each axis has its own scale.

    Raises:
        ValueError: If it does not have 8 bits.

    Source: published conversion script (960 x 960 of 1280 x 960, INTER_AREA).
    """
    if image.dtype != np.uint8:
        raise ValueError(f"{origin}: expected an image of 8 bits for a YOLO, got {image.dtype}")
    return np.asarray(cv2.resize(image, (size_px, size_px), interpolation=cv2.INTER_AREA), np.uint8)


def _claim(folder: Path, settings: ExportSettings) -> None:
    """ValueError if `folder` holds an export with other settings, another data set, or anything else."""
    path = folder / EXPORT
    if path.exists():
        check_claim(path, settings, read_json(path, ExportSettings), "export")
    else:
        for name in (DATA_NAME, "images", "labels"):
            if (folder / name).exists():
                words = "expected a folder without a YOLO data set that is not of export-yolo"
                raise ValueError(f"{folder / name}: {words}")
        check_new(str(folder), folder)


def _has_begun(work: Path, settings: ExportSettings) -> bool:
    """Whether an export with these settings, which was interrupted or killed, is in the folder `work`."""
    with contextlib.suppress(FileNotFoundError, ValueError):
        return read_json(work / EXPORT, ExportSettings) == settings
    return False


def check_claim(path: Path, wanted: BaseModel, known: BaseModel, what: str) -> None:
    """Passes settings that are those of the `what` that was begun before, which are in the file `path`.

    Raises:
        ValueError: If a field differs.
    """
    for name in type(wanted).model_fields:
        ours, theirs = getattr(wanted, name), getattr(known, name)
        if ours != theirs:
            raise ValueError(
                f"{path}: {name}: expected {ours!r} to go on with this {what}, it has {theirs!r}; choose another folder"
            )


def _data_text(splits: Sequence[SplitName]) -> str:
    """`data.yaml`; without a `path`, folders are relative to the file, so that the export can be moved."""
    lines = [f"{name}: images/{name}" for name in splits]
    return "\n".join([*lines, "nc: 1", "names:", f"  0: {CLASS_NAME}", ""])
