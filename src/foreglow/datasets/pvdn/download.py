"""The download of PVDN, of which every obstacle becomes a message of a single line, and what is there of a copy."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from foreglow.datasets.pvdn.labels import read_labels
from foreglow.files import checked_path

PVDN_COUNTS = {
    "day/train": (113, 19_078),
    "day/val": (20, 3_898),
    "day/test": (19, 3_132),
    "night/train": (145, 25_264),
    "night/val": (25, 4_322),
    "night/test": (24, 4_052),
}
"""Scenes and images of each split: 346 and 59,746 in all. Source: Ohnemus et al., arXiv 2012.15376."""


@dataclass(frozen=True, slots=True)
class SplitCount:
    """What is there of one split.

    Attributes:
        name: The split, such as `day/val`.
        num_scenes: Scenes by its labels.
        num_stated_scenes: What it should have.
        num_images: Images that its labels name and that are there.
        num_stated_images: What it should have.
        missing: A line for each kind of thing that is missing or broken.
    """

    name: str
    num_scenes: int
    num_stated_scenes: int
    num_images: int
    num_stated_images: int
    missing: tuple[str, ...]


def count_pvdn(folder: Path) -> tuple[SplitCount, ...]:
    """What is there of each split of the copy of PVDN in `folder`.

    Raises:
        FileNotFoundError: If there is neither of the folders `day` and `night` in it.
    """
    if not any((folder / name).is_dir() for name in PVDN_COUNTS):
        raise FileNotFoundError(f"{folder}: expected a copy of PVDN with folders such as day/train, found none")
    return tuple(_counted(folder, name, *stated) for name, stated in PVDN_COUNTS.items())


def _counted(folder: Path, name: str, num_stated_scenes: int, num_stated_images: int) -> SplitCount:
    split = folder / name
    try:
        labels = read_labels(split)
    except (FileNotFoundError, ValueError) as error:
        return SplitCount(name, 0, num_stated_scenes, 0, num_stated_images, (str(error),))
    images = {
        image_id: Path("images") / labels.sequence_of[image_id].directory / image.file_name
        for image_id, image in labels.images.items()
    }
    keypoints = (Path("labels") / "keypoints" / f"{image_id:06d}.json" for image_id in images)
    absent = [path for path in images.values() if not (split / path).is_file()]
    num_scenes = len(labels.sequences_file.sequences)
    missing = [
        *_differing("scenes in the labels", num_scenes, num_stated_scenes, split),
        *_differing("images in the labels", len(images), num_stated_images, split),
        *_absent("images", absent, split),
        *_absent("files of key points", [path for path in keypoints if not (split / path).is_file()], split),
    ]
    return SplitCount(name, num_scenes, num_stated_scenes, len(images) - len(absent), num_stated_images, tuple(missing))


def _differing(what: str, number: int, num_stated: int, split: Path) -> Iterator[str]:
    if number != num_stated:
        yield f"{split}: expected {num_stated} {what}, got {number}"


def _absent(what: str, paths: list[Path], split: Path) -> Iterator[str]:
    if paths:
        yield f"{split}: {len(paths)} {what} missing, the first is {paths[0]}"


PVDN_HANDLE = "saralajew/provident-vehicle-detection-at-night-pvdn"
"""PVDN at Kaggle. Source: README of the code published with the data set."""


def download_pvdn(target: Path | str, handle: str = PVDN_HANDLE) -> Path:
    """The folder `target`, into which the data set was downloaded.

    Needs the extra `download`, a Kaggle account that has accepted the data set's terms on its page, and an API token
    (`kaggle.json`, or the environment variables that kagglehub reads).

    Args:
        target: Folder to download into; made if absent, and empty or from an earlier download.
        handle: The data set's name at Kaggle, `owner/name`.

    Raises:
        ValueError: If kagglehub is not installed or too old, or Kaggle does not have the data set, denies access or
            cannot be reached; a line says what to do.
        OSError: If the folder cannot be written.
    """
    target = checked_path(target, "target")
    try:
        kagglehub: Any = importlib.import_module("kagglehub")
        errors: Any = importlib.import_module("kagglehub.exceptions")
        requests: Any = importlib.import_module("requests")
    except ImportError as error:
        raise ValueError("kagglehub: expected to be installed: pip install 'foreglow[download]'") from error
    if "output_dir" not in inspect.signature(kagglehub.dataset_download).parameters:
        raise ValueError("kagglehub: expected a version that can choose the folder: pip install -U kagglehub")
    target.mkdir(parents=True, exist_ok=True)
    try:
        kagglehub.dataset_download(handle, output_dir=str(target))
    except (errors.UnauthenticatedError, errors.CredentialError) as error:
        raise ValueError(_not_allowed(handle)) from error
    except errors.NotFoundError as error:
        raise ValueError(f"{handle}: expected a data set at Kaggle, there is none of this name") from error
    except requests.exceptions.HTTPError as error:
        status = getattr(error.response, "status_code", None)
        if status in (401, 403):
            raise ValueError(_not_allowed(handle)) from error
        raise ValueError(f"{handle}: Kaggle refuses the download: {_first_line(error)}") from error
    except requests.exceptions.RequestException as error:
        raise ValueError(
            f"{handle}: Kaggle cannot be reached, is this machine online? ({type(error).__name__})"
        ) from error
    except (errors.DataCorruptionError, errors.BackendError) as error:
        raise ValueError(f"{handle}: the download is damaged or failed, try again: {_first_line(error)}") from error
    return target


def _not_allowed(handle: str) -> str:
    return (
        f"{handle}: Kaggle does not let us in: sign in, accept the terms at https://www.kaggle.com/datasets/{handle}, "
        "and make an API token in your account's settings (kaggle.json)"
    )


def _first_line(error: BaseException) -> str:
    lines = str(error).strip().splitlines()
    return lines[0] if lines else type(error).__name__
