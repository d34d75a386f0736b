"""The label files of a PVDN split, read and checked against each other once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from foreglow.datasets.json_files import read_json
from foreglow.datasets.pvdn.schema import ImageAnnotationsFile, ImageCategory, ImageRecord, Sequence, SequencesFile


@dataclass(frozen=True, slots=True, eq=False)
class PVDNLabels:
    """`sequences.json` and `image_annotations.json`, and what they say about each image.

    Attributes:
        sequences_file: The first file as it is.
        images_file: The second file as it is.
        images: Image by its id, in the file's order.
        sequence_of: The sequence of each image, by the image's id.
        number_of: Number of each image in its sequence, from 0, by the image's id.
        categories: Categories of each annotated image, by the image's id, in the file's order.
    """

    sequences_file: SequencesFile
    images_file: ImageAnnotationsFile
    images: dict[int, ImageRecord]
    sequence_of: dict[int, Sequence]
    number_of: dict[int, int]
    categories: dict[int, tuple[ImageCategory, ...]]


def read_labels(split: Path) -> PVDNLabels:
    """The labels of the split folder `split`, without the keypoints of each image.

    Raises:
        FileNotFoundError: If one of the two files is missing.
        ValueError: If a file is broken, or they contradict each other or the keypoint files: an id or, in a sequence,
            an image file that occurs twice, an image without sequence or sequence without image, a keypoint file
            without its image, a reference to nothing.
    """
    folder = split / "labels"
    sequences_path, images_path = folder / "sequences.json", folder / "image_annotations.json"
    sequences_file = read_json(sequences_path, SequencesFile)
    images_file = read_json(images_path, ImageAnnotationsFile)

    images: dict[int, ImageRecord] = {}
    for index, image in enumerate(images_file.images):
        if image.id in images:
            raise ValueError(f"{images_path}: images.{index}.id: expected each image once, {image.id} is there twice")
        if image.camera_configuration >= len(images_file.camera_configurations):
            raise ValueError(
                f"{images_path}: images.{index}.camera_configuration: expected an index in a list of "
                f"{len(images_file.camera_configurations)}, got {image.camera_configuration}"
            )
        images[image.id] = image

    sequence_of = _sequence_of(sequences_file.sequences, images, sequences_path)
    for image_id in images:
        if image_id not in sequence_of:
            raise ValueError(f"{sequences_path}: image_ids: expected image {image_id} of {images_path} in a sequence")
    _check_names(images_file.images, sequence_of, images_path)

    categories: dict[int, tuple[ImageCategory, ...]] = {}
    for index, annotation in enumerate(images_file.annotations):
        if annotation.image_id not in images:
            raise ValueError(
                f"{images_path}: annotations.{index}.image_id: expected an id of images, got {annotation.image_id}"
            )
        categories[annotation.image_id] = (*categories.get(annotation.image_id, ()), annotation.category)

    _check_keypoint_files(folder / "keypoints", images)
    number_of = {
        image_id: number
        for sequence in sequences_file.sequences
        for number, image_id in enumerate(sorted(sequence.image_ids))
    }
    return PVDNLabels(sequences_file, images_file, images, sequence_of, number_of, categories)


def _sequence_of(sequences: Iterable[Sequence], images: dict[int, ImageRecord], path: Path) -> dict[int, Sequence]:
    """The sequence of each image; checks that each image has one sequence, and each sequence its own id and folder."""
    sequence_of: dict[int, Sequence] = {}
    ids: set[int] = set()
    directories: set[str] = set()
    for index, sequence in enumerate(sequences):
        where = f"{path}: sequences.{index}"
        if sequence.id in ids:
            raise ValueError(f"{where}.id: expected each sequence once, {sequence.id} is there twice")
        if sequence.directory in directories:
            raise ValueError(f"{where}.dir: expected each folder once, {sequence.directory} is there twice")
        ids.add(sequence.id)
        directories.add(sequence.directory)
        for image_id in sequence.image_ids:
            if image_id not in images:
                raise ValueError(
                    f"{where}.image_ids: expected images of image_annotations.json, {image_id} is not there"
                )
            if image_id in sequence_of:
                other = sequence_of[image_id].directory
                raise ValueError(
                    f"{where}.image_ids: expected each image in one sequence once, {image_id} is in {other} and "
                    f"{sequence.directory}"
                )
            sequence_of[image_id] = sequence
    return sequence_of


def _check_names(images: Iterable[ImageRecord], sequence_of: dict[int, Sequence], path: Path) -> None:
    """Checks that no two images of a sequence are the same file."""
    names: set[tuple[int, str]] = set()
    for index, image in enumerate(images):
        sequence = sequence_of[image.id]
        if (sequence.id, image.file_name) in names:
            raise ValueError(
                f"{path}: images.{index}.file_name: expected each file of {sequence.directory} once, "
                f"{image.file_name} is there twice"
            )
        names.add((sequence.id, image.file_name))


def _check_keypoint_files(folder: Path, images: dict[int, ImageRecord]) -> None:
    if not folder.is_dir():
        return
    for path in sorted(folder.glob("*.json")):
        if not (path.stem.isascii() and path.stem.isdigit() and path.stem == f"{int(path.stem):06d}"):
            raise ValueError(f"{path}: name: expected an image id of six digits, got {path.name}")
        if int(path.stem) not in images:
            raise ValueError(
                f"{path}: keypoint file without its image, {int(path.stem)} is not in image_annotations.json"
            )
