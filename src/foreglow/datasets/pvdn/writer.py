"""Writing data sets in PVDN's format: new sets sequence by sequence, and copies of sets that were read."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from foreglow.datasets.image_folder import earlier_name
from foreglow.datasets.images import png
from foreglow.datasets.json_files import check_storable, read_json, write_json
from foreglow.datasets.pvdn.reader import PVDN, rate_of
from foreglow.datasets.pvdn.schema import (
    BoxLabels,
    CameraConfiguration,
    Category,
    Cycle,
    EarlierImage,
    ImageAnnotation,
    ImageAnnotationsFile,
    ImageCategory,
    ImageRecord,
    Instance,
    KeypointsFile,
    Sequence,
    SequencesFile,
    Vehicle,
)
from foreglow.datasets.pvdn.splits import splits_below
from foreglow.files import checked_path
from foreglow.numbers import checked_whole, plain
from foreglow.types import Frame
from foreglow.types.arrays import check_kind
from foreglow.whole_files import write_atomic

CAMERA_CONFIGURATIONS = tuple(CameraConfiguration(camera="Cam01", cycle=cycle) for cycle in Cycle)
"""The two configurations of PVDN's camera: 0 day, 1 night."""

CATEGORIES = tuple(
    Category(supercategory="image", id=int(category), name=category.name.lower()) for category in ImageCategory
)
"""The image categories, named as in `ImageCategory`."""

LABEL_FILES = ("image_annotations.json", "sequences.json")
"""Files of the whole split, in the order in which they are written."""

LABEL_FOLDERS = ("labels/keypoints", "labels/bounding_boxes")
"""Folders with a file per image."""


@dataclass(frozen=True, slots=True, eq=False)
class LabelledImage:
    """A frame with its labels, to be written.

    Attributes:
        frame: The image; `Frame.frame` becomes the image's id.
        vehicles: The oncoming vehicles, with their light artifacts.
        categories: The image's categories.
        boxes: Generated boxes; None writes no file.
        camera_configuration: Index in the writer's list of camera configurations.
        doubtful: As in `KeypointsFile`.
        earlier: As in `LabelledSource.earlier`.
    """

    frame: Frame
    vehicles: tuple[Vehicle, ...] = ()
    categories: tuple[ImageCategory, ...] = ()
    boxes: BoxLabels | None = None
    camera_configuration: int = 0
    doubtful: tuple[Instance, ...] = ()
    earlier: Frame | None = None


class PVDNWriter(AbstractContextManager["PVDNWriter"]):
    """Writes a split, sequence by sequence; images as PNG, in constant memory.

    Every file appears whole or not at all, and `sequences.json` comes last, when the block ends without an error:
    until then the folder is not a PVDN split. With an error, nothing of the split stays. The reader takes an image's
    time from its sequence's start and 18 Hz, or `rate_hz` in `info`; with that, the times of a sequence's frames have
    to increase with their ids, or they are refused.

    >>> import numpy as np, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     image = Frame(np.zeros((64, 64), np.uint8), timestamp_ns=0, frame=1)
    ...     with PVDNWriter(Path(folder) / "night" / "val") as writer:
    ...         _ = writer.add_sequence(Sequence.plain(1), [LabelledImage(image)])
    ...     len(PVDN(Path(folder) / "night" / "val"))
    1
    """

    def __init__(
        self, root: Path | str, *, info: Mapping[str, Any] | None = None, name: Path | str | None = None
    ) -> None:
        """Makes the split's folders.

        Args:
            root: The split's folder, such as `out/night/val`; made if absent, must hold no split yet.
            info: Describes the data set: description, url, version, year, contributor, date_created, changed.
            name: The folder's name in messages, if it is to be moved.

        Raises:
            ValueError: If the folder holds images or labels already, `info` has something that JSON does not, such as
                NaN, or its `rate_hz` is none that images can have.
            OSError: If the folders cannot be made.
        """
        self.root = checked_path(root, "root")
        self._name = self.root if name is None else checked_path(name, "name")
        check_kind("info", {} if info is None else info, Mapping)
        self._info = plain(dict(info or {}))
        rate_of(self._info, self._name)
        check_storable(f"{self._name}: info", self._info)
        _make_folders(self.root)
        self._sequences: list[Sequence] = []
        self._images: dict[int, ImageRecord] = {}
        self._annotations: list[ImageAnnotation] = []
        self._written: list[Path] = []

    def add_sequence(self, sequence: Sequence, images: Iterable[LabelledImage]) -> Sequence:
        """Writes `images` as the sequence's, and returns the sequence as stored, with its ids and their number.

        Args:
            sequence: The attributes; its `image_ids` must be empty, or those of `images` in any order.
            images: At least one image; an id may occur once in the whole split. They are read one at a time.

        Raises:
            ValueError: If an id is negative, an id or a folder occurs twice, a camera configuration does not exist, the
                ids differ from the sequence's, or `info` has a `rate_hz` and the times do not increase with the ids, by
                a millisecond at least. Nothing of the sequence is left behind then.
            OSError: If a file cannot be written; likewise.
        """
        for known in self._sequences:
            if known.id == sequence.id or known.directory == sequence.directory:
                raise ValueError(f"{self._name}: sequence: {sequence.id} ({sequence.directory}) is there already")
        folder = self.root / "images" / sequence.directory
        written: list[Path] = []
        added: dict[int, ImageRecord] = {}
        times_ns: dict[int, int] = {}
        annotations: list[ImageAnnotation] = []
        try:
            folder.mkdir(exist_ok=True)
            for labelled in images:
                record = self._record(labelled, added)
                added[record.id] = record
                times_ns[record.id] = labelled.frame.timestamp_ns
                self._write(labelled, folder / record.file_name, written)
                if labelled.earlier is not None and record.earlier is not None:
                    written.append(folder / record.earlier.file_name)
                    write_atomic(written[-1], png(labelled.earlier.image))
                next_id = len(self._annotations) + len(annotations)
                annotations += [
                    ImageAnnotation(id=next_id + number, category=category, image_id=record.id)
                    for number, category in enumerate(labelled.categories)
                ]
            if "rate_hz" in self._info:
                self._check_times(sequence, times_ns)
            stored = self._stored(sequence, times_ns)
        except BaseException:
            for path in written:
                path.unlink(missing_ok=True)
            raise
        self._sequences.append(stored)
        self._images |= added
        self._annotations += annotations
        self._written += written
        return stored

    def close(self) -> None:
        """Writes the label files that make the folder a split; more sequences and another `close` may follow.

        Raises:
            OSError: If a file cannot be written.
        """
        images_file = ImageAnnotationsFile(
            info=self._info,
            licences=(),
            camera_configurations=CAMERA_CONFIGURATIONS,
            categories=CATEGORIES,
            images=tuple(self._images.values()),
            annotations=tuple(self._annotations),
        )
        write_label_files(self.root, images_file, SequencesFile(sequences=tuple(self._sequences)))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self.close()
        except BaseException:
            self._discard()
            raise
        if kind is not None:
            self._discard()

    def _discard(self) -> None:
        for path in (*self._written, *(self.root / "labels" / name for name in LABEL_FILES)):
            path.unlink(missing_ok=True)
        images = self.root / "images"
        for folder in (*images.iterdir(), images, *(self.root / name for name in LABEL_FOLDERS), self.root / "labels"):
            with contextlib.suppress(OSError):  # not empty
                folder.rmdir()

    def _record(self, labelled: LabelledImage, added: Mapping[int, ImageRecord]) -> ImageRecord:
        frame = labelled.frame
        checked_whole(f"{self._name}: image id", frame.frame)
        if frame.frame in self._images or frame.frame in added:
            raise ValueError(f"{self._name}: image id: expected each once, {frame.frame} is there twice")
        if not 0 <= labelled.camera_configuration < len(CAMERA_CONFIGURATIONS):
            raise ValueError(
                f"{self._name}: camera_configuration: expected an index in a list of "
                f"{len(CAMERA_CONFIGURATIONS)}, got {labelled.camera_configuration}"
            )
        size_px = frame.width_px, frame.height_px
        record = image_record(frame.frame, size_px, frame.timestamp_ns, labelled.camera_configuration)
        if labelled.earlier is None:
            return record
        age_ms = (frame.timestamp_ns - labelled.earlier.timestamp_ns) / 1e6
        name = earlier_name(record.file_name)
        return record.model_copy(update={"earlier": EarlierImage(file_name=name, age_ms=age_ms)})

    def _check_times(self, sequence: Sequence, times_ns: Mapping[int, int]) -> None:
        """ValueError if the reader would refuse the images' times, which are written in milliseconds."""
        times_ms = {image_id: times_ns[image_id] // 1_000_000 for image_id in sorted(times_ns)}
        for before, after in itertools.pairwise(times_ms):
            if times_ms[before] >= times_ms[after]:
                raise ValueError(
                    f"{self._name}: sequence {sequence.directory}: timestamp_ns of image {after}: expected a later "
                    f"millisecond than that of image {before}, {times_ms[before]}, got {times_ms[after]}"
                )

    def _write(self, labelled: LabelledImage, path: Path, written: list[Path]) -> None:
        """Writes the image and its label files; each path is added to `written` before the file is there."""
        image_id = labelled.frame.frame
        more = {"doubtful": labelled.doubtful} if labelled.doubtful else {}  # what is not given is not written
        records: list[tuple[str, KeypointsFile | BoxLabels]] = [
            ("keypoints", KeypointsFile(image_id=image_id, annotations=labelled.vehicles, **more))
        ]
        if labelled.boxes is not None:
            records.append(("bounding_boxes", labelled.boxes))
        written.append(path)
        write_atomic(path, png(labelled.frame.image))
        for kind, record in records:
            target = self.root / "labels" / kind / f"{image_id:06d}.json"
            written.append(target)
            write_json(target, record)

    def _stored(self, sequence: Sequence, times_ns: Mapping[int, int]) -> Sequence:
        image_ids = tuple(times_ns)
        if not image_ids:
            raise ValueError(f"{self._name}: sequence {sequence.directory}: expected at least one image")
        if not sequence.image_ids:
            lasts_ms = (max(times_ns.values()) - min(times_ns.values())) / 1e6
            end_ms = sequence.end_time_ms or sequence.start_time_ms + lasts_ms
            update = {"image_ids": image_ids, "num_images": len(image_ids), "end_time_ms": end_ms}
            return sequence.model_copy(update=update)
        if sorted(sequence.image_ids) != sorted(image_ids):
            raise ValueError(
                f"{self._name}: sequence {sequence.directory}: image_ids: expected those of the images, or none"
            )
        return sequence


def write_pvdn(source: PVDN, root: Path | str) -> None:
    """Writes the whole split that `source` reads, selected or not, to the folder `root`.

    Label files hold the same JSON values, with keys that are not part of the layout; images are written as PNG with
    the same pixels.

    Raises:
        FileNotFoundError: If an image or a keypoint file of the source is missing.
        ValueError: If such a file is broken, an image's name does not end in .png, or `root` has images or labels.
        OSError: If a file cannot be written.
    """
    check_kind("source", source, PVDN)
    root = checked_path(root, "root")
    _make_folders(root)
    for image_id, record in source.labels.images.items():
        if not record.file_name.lower().endswith(".png"):
            raise ValueError(
                f"{source.root}: images: file_name: expected a name ending in .png, got {record.file_name}"
            )
        folder = root / "images" / source.sequence(image_id).directory
        folder.mkdir(exist_ok=True)
        frame = source.read(image_id)
        write_atomic(folder / record.file_name, png(frame.image))
        if frame.earlier is not None:
            write_atomic(folder / Path(frame.earlier.path).name, png(frame.earlier.image))
        source.annotations(image_id)  # checks the file against its name
        name = f"{image_id:06d}.json"
        keypoints = read_json(source.root / "labels" / "keypoints" / name, KeypointsFile)
        write_json(root / "labels" / "keypoints" / name, keypoints)
        boxes = source.boxes(image_id)
        if boxes is not None:
            write_json(root / "labels" / "bounding_boxes" / name, boxes)
    write_label_files(root, source.labels.images_file, source.labels.sequences_file)


def image_record(image_id: int, size_px: tuple[int, int], timestamp_ns: int, camera_configuration: int) -> ImageRecord:
    """The labels' record of an image of `size_px` (width, height); its file is the id in six digits, as PNG."""
    return ImageRecord(
        id=image_id,
        file_name=f"{image_id:06d}.png",
        height_px=size_px[1],
        width_px=size_px[0],
        camera_configuration=camera_configuration,
        date_captured="",
        timestamp=timestamp_ns // 1_000_000,
        licence=0,
    )


def write_label_files(root: Path, images_file: ImageAnnotationsFile, sequences_file: SequencesFile) -> None:
    """Writes the two files that make the folder `root` a split, `sequences.json` last.

    Raises:
        OSError: If a file cannot be written.
    """
    for name, record in zip(LABEL_FILES, (images_file, sequences_file), strict=True):
        write_json(root / "labels" / name, record)


def check_new_split(root: Path) -> None:
    """Checks that a folder holds no images and labels, which would contradict the new labels, and no other splits.

    Raises:
        ValueError: If it does.
    """
    for folder in ("labels", "images"):
        found = next((path for path in (root / folder).rglob("*") if path.is_file()), None)
        if found is not None:
            raise ValueError(f"{found}: expected a folder without a data set, this file is there")
    for split in splits_below(root):
        raise ValueError(f"{root}: expected a folder without a data set, the split {split} is there")


def _make_folders(root: Path) -> None:
    check_new_split(root)
    for folder in ("images", *LABEL_FOLDERS):
        (root / folder).mkdir(parents=True, exist_ok=True)
