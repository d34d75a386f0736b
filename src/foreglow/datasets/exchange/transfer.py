"""Labels from any data set to the files of annotation tools, and from those to PVDN's format."""

from __future__ import annotations

import contextlib
import itertools
import shutil
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import RootModel

from foreglow.datasets.exchange.files import LABEL_FORMATS
from foreglow.datasets.exchange.marks import (
    EARLIER_IMAGE,
    MAX_IMAGES,
    ImageLabels,
    LabelSet,
    Mark,
    marks_of,
    plain_path,
)
from foreglow.datasets.exchange.source import LabelFile
from foreglow.datasets.image_folder import ImageFolder
from foreglow.datasets.labelled import LabelledSource
from foreglow.datasets.pvdn import schema
from foreglow.datasets.pvdn.schema import ImageCategory, Vehicle
from foreglow.datasets.pvdn.writer import LabelledImage, PVDNWriter, check_new_split
from foreglow.datasets.source import FrameSource, also_left_out
from foreglow.datasets.vehicle_data import origin_of
from foreglow.datasets.video import Video
from foreglow.files import checked_path
from foreglow.folder_lock import FolderLock
from foreglow.own_files import labels_format, with_labels_digest
from foreglow.types import Frame
from foreglow.types.arrays import check_kind
from foreglow.whole_files import write_atomic
from foreglow.wording import check_one_of, exact_seconds

_HIDDEN = ".import.partial"
"""Folder for a split until all of it is written."""

RENUMBERED = "renumbered"
"""The field of a set's `info` that names the file of COCO whose images have other ids than those of the set."""

ORIGIN = "origin"
"""The field of a set's `info` that says for which video or folders its labels are: a list of `Origin`."""

_OWN = {"id", "directory", "image_ids", "num_images"}
"""Fields of a sequence that its images say."""


@dataclass(frozen=True, slots=True)
class Origin:
    """What a run may have been made from, of which a data set has labels.

    Attributes:
        digest: By which it is known, wherever it is; see `foreglow.runs.origin.origin_digest`.
        folder: Its path below the folder of the images, with `/`; empty for that itself, a video or a split.
        is_split: Whether a run on it takes its frames' numbers from PVDN's labels.
        ids: Pairs of a run's frame and the id of the same image in the data set, for all images of the data set that
            are there; None if these are all that it has, with the same numbers.
    """

    digest: str
    folder: str = ""
    is_split: bool = False
    ids: tuple[tuple[int, int], ...] | None = None


class OriginsFile(RootModel[tuple[Origin, ...]]):
    """The list of them in a set's `info`."""


@dataclass(frozen=True, slots=True)
class Guess:
    """What a run found in a frame.

    Attributes:
        timestamp_ns: The frame's time.
        marks: The points.
        sequence: The frame's sequence.
    """

    timestamp_ns: int
    marks: tuple[Mark, ...]
    sequence: str = ""


def labels_of(dataset: LabelledSource, chosen: Collection[int] | None = None) -> LabelSet:
    """The labels of a data set, or of the images with the ids `chosen`, with what no annotation tool takes as lost."""
    check_kind("dataset", dataset, LabelledSource)
    lost: Counter[str] = Counter()
    images = []
    for image_id in _wanted(dataset, chosen):
        record, vehicles = dataset.image(image_id), dataset.annotations(image_id)
        doubtful = dataset.doubtful(image_id)
        lost["file of generated boxes"] += dataset.boxes(image_id) is not None
        is_beside = isinstance(dataset, LabelFile) and dataset.has_earlier(image_id)
        lost[EARLIER_IMAGE] += record.earlier is not None or is_beside
        for name in _unknown_fields(vehicles):
            lost[f"field {name}"] += 1
        categories = tuple(each for each in dataset.categories(image_id) if each != ImageCategory.NONE)
        name = f"{dataset.sequence(image_id).directory}/{record.file_name}"
        if isinstance(dataset, LabelFile) and dataset.image_path(image_id).name == record.file_name:  # of no video
            name = dataset.image_path(image_id).relative_to(dataset.folder).as_posix()
        size_px = record.width_px, record.height_px
        images.append(ImageLabels(name, size_px, marks_of(vehicles, doubtful), categories, image_id))
    if not images:
        raise ValueError(f"{dataset.root}: frames: expected at least one image, got none")
    ordinary = _attributes(schema.Sequence.plain(0))
    lost["sequence with attributes (weather, road, driver, times, ...)"] = sum(
        _attributes(sequence) != ordinary for sequence in dataset.sequences
    )
    if isinstance(dataset, LabelFile):
        lost.update(dataset.labels.lost)
    return LabelSet(tuple(images), +lost, origin=str(dataset.origin))


def _wanted(dataset: LabelledSource, chosen: Collection[int] | None) -> tuple[int, ...]:
    if chosen is None:
        return dataset.frame_ids
    check_kind("chosen", chosen, Collection)
    unknown = set(chosen) - set(dataset.frame_ids)
    if unknown:
        raise ValueError(f"{dataset.root}: frames: expected images of the data set, got {min(unknown)}")
    return tuple(image_id for image_id in dataset.frame_ids if image_id in chosen)


def _unknown_fields(vehicles: Collection[Vehicle]) -> list[str]:
    records = [record for vehicle in vehicles for record in (vehicle, *vehicle.instances)]
    return [name for record in records for name in record.model_extra or {}]


def _attributes(sequence: schema.Sequence) -> dict[str, Any]:
    return sequence.model_dump(exclude=_OWN)


def guesses_of(frames: FrameSource, guesses: Mapping[int, Guess], chosen: Collection[int] | None = None) -> LabelSet:
    """The first guess for each frame that a run went over, or for those with the numbers `chosen`.

    A damaged frame has no points: what is in it nobody knows, and an import leaves it out.

    Raises:
        ValueError: If the run did not go over a chosen frame, there is no guess at all, or the frames are not those of
            the run.
    """
    unknown = set(chosen or ()) - guesses.keys()
    if unknown:
        raise ValueError(f"frames: expected numbers of frames of the run, got {min(unknown)}")
    images: list[ImageLabels] = []
    lost: Counter[str] = Counter()
    waiting, gap = set(guesses), ""
    for place, frame in enumerate(frames):
        if frame.frame not in waiting:
            continue
        waiting.remove(frame.frame)
        guess = guesses[frame.frame]
        if frame.timestamp_ns != guess.timestamp_ns:
            raise ValueError(
                f"{frames.name}: expected the frames of the run, frame {frame.frame} is at "
                f"{exact_seconds(frame.timestamp_ns)} s, and was at {exact_seconds(guess.timestamp_ns)} s"
            )
        if chosen is None or frame.frame in chosen:
            size_px = frame.width_px, frame.height_px
            known = frame.frame if isinstance(frames, Video) else place + len(frames.skipped)
            if known > len(images) and not gap:
                gap = f"the run has {len(images)} of the {known} before frame {frame.frame}"
            lost["point in a damaged frame"] += len(guess.marks) * frame.is_damaged
            marks = () if frame.is_damaged else guess.marks
            images.append(ImageLabels(_name_of(frame, frames), size_px, marks, number=frame.frame))
        if len(images) > MAX_IMAGES:
            raise ValueError(f"{frames.name}: expected at most {MAX_IMAGES} frames, got more")
    if waiting:
        reason = also_left_out(frames.skipped)
        raise ValueError(f"{frames.name}: expected the frames of the run, has no frame {min(waiting)}{reason}")
    if not images:
        raise ValueError(f"{frames.name}: expected frames of the run, found none")
    origin = str(origin_of(frames) or frames.name)
    return LabelSet(tuple(images), +lost, is_video=isinstance(frames, Video), origin=origin, gap=gap)


def _name_of(frame: Frame, frames: FrameSource) -> str:
    if isinstance(frames, LabelledSource):
        return f"{frame.sequence}/{frames.image(frame.frame).file_name}"
    return Path(frame.path).name if isinstance(frames, ImageFolder) else f"frame_{frame.frame:06d}.png"


def check_target(path: Path | str, name: str) -> None:
    """Passes a format and a file that has its ending, so that it can be read again.

    Raises:
        ValueError: If there is no such format, the ending is another, or labels in another format are there.
    """
    path = checked_path(path)
    check_one_of(name, LABEL_FORMATS, "--format")
    if path.suffix.lower() != LABEL_FORMATS[name].suffix:
        raise ValueError(f"{path}: expected a name ending in {LABEL_FORMATS[name].suffix} for {name}")
    there = labels_format(path) if path.is_file() else None
    if there not in (None, name):
        raise ValueError(f"{path}: expected nothing there but labels as {name}, got {there}; choose another name")


def write_labels_file(path: Path | str, labels: LabelSet, name: str, *, is_guess: bool = False) -> Counter[str]:
    """Writes labels in the format called `name`, whole or not at all; returns what was lost on the whole way.

    Raises:
        ValueError: If there is no such format, the ending is another, or it cannot take these labels.
        OSError: If the file cannot be written.
    """
    path = checked_path(path)
    check_target(path, name)
    check_kind("labels", labels, LabelSet)
    form = LABEL_FORMATS[name]
    if form.has_names:
        for image in labels.images:
            plain_path(image.name, f"{labels.origin or path}: name of an image")
    elif labels.gap:
        raise ValueError(
            f"{labels.origin}: expected every frame of a drive for {name}, {labels.gap}; choose --format cvat, which "
            "has the images' names"
        )
    text, lost = (form.guess_text if is_guess else form.text)(labels)
    write_atomic(path, with_labels_digest(text))
    return Counter(labels.lost) + lost


def write_split(
    dataset: LabelledSource, root: Path | str, origins: Sequence[Origin] = (), renumbered: Path | str | None = None
) -> int:
    """Writes a data set with its images as a split in PVDN's format, and returns the number of images.

    Images and labels appear when all are written; what a killed process has left of them is removed by the next one.

    Args:
        dataset: The data set.
        root: The folder of the split.
        origins: The video or the folders that it is of, for its `info`.
        renumbered: The file of COCO in which its images have other ids, for its `info`; None without one.

    Raises:
        ValueError: If an image or its labels cannot be used, `root` holds images or labels already, or another run is
            writing into it.
        OSError: If a file cannot be read or written.
    """
    check_kind("dataset", dataset, LabelledSource)
    root = checked_path(root, "root")
    check_kind("origins", origins, Sequence)
    for origin in origins:
        check_kind("origins", origin, Origin)
    with FolderLock(root):
        check_new_split(root)
        hidden = root / _HIDDEN
        shutil.rmtree(hidden, ignore_errors=True)  # of a run that was killed
        try:
            info = {"rate_hz": dataset.rate_hz} | ({} if renumbered is None else {RENUMBERED: str(renumbered)})
            info |= {ORIGIN: OriginsFile(tuple(origins)).model_dump(mode="json")} if origins else {}
            num_images = _write_sequences(dataset, hidden, root, info)
            if not num_images:
                raise ValueError(f"{dataset.origin}: expected at least one labelled image that can be read, found none")
            for part in ("images", "labels"):
                _remove_empty(root / part)
                (hidden / part).rename(root / part)
        finally:
            shutil.rmtree(hidden, ignore_errors=True)
    return num_images


def _remove_empty(folder: Path) -> None:
    """Removes a folder in which there is nothing but folders."""
    for each in (*sorted(folder.rglob("*"), reverse=True), folder):
        with contextlib.suppress(OSError):
            each.rmdir()


def _write_sequences(dataset: LabelledSource, folder: Path, root: Path, info: Mapping[str, Any]) -> int:
    """As `write_split`, into `folder`, which becomes `root`."""
    num_images = 0
    with PVDNWriter(folder, info=info, name=root) as writer:
        for sequence in dataset.sequences:
            part = dataset.only(sequence.directory)
            recordings = itertools.groupby(part, key=lambda frame: frame.sequence)  # of a video perhaps several
            for index, (directory, frames) in enumerate(recordings):
                first = next(frames)
                own = {"id": sequence.id + index, "directory": directory, "image_ids": ()}
                own["start_time_ms"] = first.timestamp_ns / 1e6  # as a log of the drive has it
                images = (_labelled(frame, dataset) for frame in itertools.chain([first], frames))
                num_images += len(writer.add_sequence(sequence.model_copy(update=own), images).image_ids)
    return num_images


def _labelled(frame: Frame, dataset: LabelledSource) -> LabelledImage:
    categories = tuple(each for each in dataset.categories(frame.frame) if each != ImageCategory.NONE)
    vehicles, doubtful = dataset.annotations(frame.frame), dataset.doubtful(frame.frame)
    return LabelledImage(frame, vehicles, categories, doubtful=doubtful, earlier=frame.earlier)
