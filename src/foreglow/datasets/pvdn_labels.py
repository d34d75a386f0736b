"""The label files of one PVDN split, read and checked against each other once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from foreglow.datasets.json_files import read_json
from foreglow.datasets.pvdn_schema import ImageAnnotationsFile, ImageCategory, ImageRecord, Sequence, SequencesFile


@dataclass(frozen=True, slots=True, eq=False)
class PVDNLabels:
    """`sequences.json` and `image_annotations.json`, and what they say about each image.

    Attributes:
        sequences_file: The first file as it is.
        images_file: The second file as it is.
        images: Image by its id, in the file's order.
        sequence_of: The sequence of each image, by the image's id.
        place_of: Place of each image in its sequence, from 0, by the image's id.
        categories: Categories of each annotated image, by the image's id, in the file's order.
    """

    sequences_file: SequencesFile
    images_file: ImageAnnotationsFile
    images: dict[int, ImageRecord]
    sequence_of: dict[int, Sequence]
    place_of: dict[int, int]
    categories: dict[int, tuple[ImageCategory, ...]]


def read_labels(split: Path) -> PVDNLabels:
    """The labels of the split folder `split`; the keypoints of each image are left for later.

    Raises:
        FileNotFoundError: If one of the two files is missing.
        ValueError: If a file is broken, or they contradict each other or the keypoint files: an id that is twice
            there, an image without sequence or sequence without image, a keypoint file without its image, a
            reference to nothing.
    """
    folder = split / "labels"
    sequences_path, images_path = folder / "sequences.json", folder / "image_annotations.json"
    sequences_file = read_json(sequences_path, SequencesFile)
    images_file = read_json(images_path, ImageAnnotationsFile)

    images: dict[int, ImageRecord] = {}
    for place, image in enumerate(images_file.images):
        if image.id in images:
            raise ValueError(f"{images_path}: images.{place}.id: expected each image once, {image.id} is there twice")
        if image.camera_configuration >= len(images_file.camera_configurations):
            raise ValueError(
                f"{images_path}: images.{place}.camera_configuration: expected a place in a list of "
                f"{len(images_file.camera_configurations)}, got {image.camera_configuration}"
            )
        images[image.id] = image

    sequence_of = _sequence_of(sequences_file.sequences, images, sequences_path)
    for image_id in images:
        if image_id not in sequence_of:
            raise ValueError(f"{sequences_path}: image_ids: expected image {image_id} of {images_path} in a sequence")

    categories: dict[int, tuple[ImageCategory, ...]] = {}
    for place, annotation in enumerate(images_file.annotations):
        if annotation.image_id not in images:
            raise ValueError(
                f"{images_path}: annotations.{place}.image_id: expected an id of images, got {annotation.image_id}"
            )
        categories[annotation.image_id] = (*categories.get(annotation.image_id, ()), annotation.category)

    _check_keypoint_files(folder / "keypoints", images)
    place_of = {
        image_id: place
        for sequence in sequences_file.sequences
        for place, image_id in enumerate(sorted(sequence.image_ids))
    }
    return PVDNLabels(sequences_file, images_file, images, sequence_of, place_of, categories)


def _sequence_of(sequences: Iterable[Sequence], images: dict[int, ImageRecord], path: Path) -> dict[int, Sequence]:
    """The sequence of each image; checks that both are one to one."""
    sequence_of: dict[int, Sequence] = {}
    ids: set[int] = set()
    directories: set[str] = set()
    for place, sequence in enumerate(sequences):
        if sequence.id in ids:
            raise ValueError(f"{path}: sequences.{place}.id: expected each sequence once, {sequence.id} is there twice")
        if sequence.directory in directories:
            raise ValueError(
                f"{path}: sequences.{place}.dir: expected each folder once, {sequence.directory} is there twice"
            )
        ids.add(sequence.id)
        directories.add(sequence.directory)
        for image_id in sequence.image_ids:
            field = f"{path}: sequences.{place}.image_ids"
            if image_id not in images:
                raise ValueError(f"{field}: expected images of image_annotations.json, {image_id} is not there")
            if image_id in sequence_of:
                other = sequence_of[image_id].directory
                raise ValueError(
                    f"{field}: expected each image in one sequence once, {image_id} is in {other} and "
                    f"{sequence.directory}"
                )
            sequence_of[image_id] = sequence
    return sequence_of


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
