"""Samples on disk, so that later trainings need not decode, propose and crop again."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import shutil
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

import foreglow._native as _native
import foreglow.classifier as classifier
import foreglow.lab.evaluation.boxes.lights as lights
import foreglow.lab.learning.annotation as annotation
import foreglow.lab.learning.samples as samples
import foreglow.proposals as proposals
from foreglow.datasets import LabelledSource
from foreglow.datasets.images import NPY_ERRORS
from foreglow.datasets.simulated import shares_path
from foreglow.datasets.simulated.files import FRAMES_NAME, sequence_folder
from foreglow.files import MAX_JSON_BYTES, file_digest, read_bytes, read_plain_json
from foreglow.folder_lock import FolderLock
from foreglow.lab.learning.kept_files import file_checksum, image_state
from foreglow.lab.learning.samples import ARRAYS, Progress, SampleConfig, Samples, no_samples, samples_by_image
from foreglow.whole_files import RemadeWarning, naming

FORMAT = 5
"""Increased whenever the samples made from the same images and configuration change."""

_DONE = "samples.json"
_HEADER_BYTES = 128
_PARTIAL = re.compile(r"\.[0-9a-f]{16}\.\d+\.partial")


def cached_samples(
    dataset: LabelledSource, config: SampleConfig, cache: Path | str, progress: Progress | None = None
) -> Samples:
    """The samples of the selected images of `dataset`, memory-mapped from a folder in `cache`.

    Unless samples of these images, labels and configuration exist, they are collected and written image by image:
    0.35 GB for 86,000 crops of 64x64. An interrupted call leaves nothing behind, and what a killed one left is removed.
    Damaged ones are made again, with a `RemadeWarning`.

    Raises:
        FileNotFoundError: If an image or a label file is missing.
        ValueError: If one of them is broken, or has changed while samples were made.
        OSError: If the samples cannot be written.
    """
    digest = samples_digest(dataset, config)
    cache = Path(cache)
    folder = cache / digest[:16]
    found = _read(folder, digest)
    if found is not None:
        return found
    if folder.exists():
        warnings.warn(RemadeWarning(f"{folder}: the samples kept here are damaged, and are made again"), stacklevel=2)
    cache.mkdir(parents=True, exist_ok=True)
    _clear(cache)
    partial = cache / f".{digest[:16]}.{os.getpid()}.partial"
    partial.mkdir()
    writing = FolderLock(partial)
    try:
        num_samples = _write(partial, folder, samples_by_image(dataset, config, progress), no_samples(config.inputs))
        if samples_digest(dataset, config) != digest:
            words = "expected the images and labels as they were when their samples were begun, one has changed since"
            raise ValueError(f"{dataset.root}: {words}; repeat the command")
        about = {"digest": digest, "data": str(dataset.root), "num_samples": num_samples, "format": FORMAT}
        about |= {"config": config.model_dump(mode="json"), "checksums": _checksums(partial)}
        with naming(folder / _DONE):
            (partial / _DONE).write_text(json.dumps(about, indent=2) + "\n")
        if _read(folder, digest) is None:  # or else another training has made the same meanwhile
            shutil.rmtree(folder, ignore_errors=True)
            if not folder.is_dir():
                folder.unlink(missing_ok=True)
            partial.rename(folder)
        shutil.rmtree(partial, ignore_errors=True)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    finally:
        writing.release()
    written = _read(folder, digest)
    if written is None:
        raise ValueError(f"{folder}: expected the samples just written, found them broken")
    return written


def _clear(cache: Path) -> None:
    """Removes what killed processes, here or on another machine, have left: they hold no locks any more."""
    for left in cache.glob(".*.partial"):
        if _PARTIAL.fullmatch(left.name):
            with contextlib.suppress(OSError, ValueError), FolderLock(left):
                shutil.rmtree(left, ignore_errors=True)


def samples_digest(dataset: LabelledSource, config: SampleConfig) -> str:
    """SHA-256 of everything that determines the samples.

    That is: images (path and `image_state`) and their white level, labels, what a simulator knows of them,
    configuration, and the code that makes samples of them.
    """
    digest = hashlib.sha256()

    def add(*values: Any) -> None:
        digest.update(json.dumps(values).encode() + b"\n")

    add(FORMAT, _code_digest(), config.model_dump(mode="json"), dataset.rate_hz, dataset.white_level)
    for image_id in dataset.frame_ids:
        path = dataset.image_path(image_id)
        sequence = dataset.sequence(image_id)
        about_time = (sequence.id, sequence.start_time_ms, dataset.time_s(image_id))
        add(image_id, str(path.resolve()), image_state(path).hex(), *about_time)
        if (earlier := dataset.image(image_id).earlier) is not None:
            before = path.with_name(earlier.file_name)
            add(earlier.file_name, earlier.age_ms, image_state(before).hex() if before.is_file() else None)
        keypoints = dataset.root / "labels" / "keypoints" / f"{image_id:06d}.json"
        digest.update(read_bytes(keypoints, MAX_JSON_BYTES))
    for sequence in dataset.sequences:
        beside = [sequence_folder(dataset.root, sequence.id) / FRAMES_NAME]  # which light is strong, and what it is on
        beside += [shares_path(dataset.root, sequence.id)] if config.by_light else []
        add(*(file_digest(path) if path.is_file() else None for path in beside))
    return digest.hexdigest()


def _code_digest() -> str:
    """SHA-256 of the code that makes boxes and crops, so that samples of older code are not used."""
    folders = (Path(proposals.__file__).parent, Path(classifier.__file__).parent)
    own = [Path(str(module.__file__)) for module in (annotation, lights, samples)]
    files = [Path(_native.__file__), *own, *(path for folder in folders for path in sorted(folder.glob("*.py")))]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


def _write(folder: Path, home: Path, parts: Iterator[Samples], empty: Samples) -> int:
    """Writes all parts, with one file for each array; returns the number of samples.

    Errors name the files as they are to be called, in the folder `home`.
    """
    files = {name: (folder / f"{name}.npy").open("wb") for name in ARRAYS}
    try:
        for name, file in files.items():
            with naming(home / f"{name}.npy"):
                _write_header(file, getattr(empty, name), 0)
        num_samples = 0
        for part in parts:
            num_samples += len(part)
            for name, file in files.items():
                with naming(home / f"{name}.npy"):
                    file.write(np.ascontiguousarray(getattr(part, name)).tobytes())
        for name, file in files.items():
            with naming(home / f"{name}.npy"):
                _write_header(file, getattr(empty, name), num_samples)
    finally:
        for name, file in files.items():
            with naming(home / f"{name}.npy"):
                file.close()
    return num_samples


def _write_header(file: BinaryIO, empty: np.ndarray[Any, Any], num_samples: int) -> None:
    """Writes the header of a .npy file of `num_samples` rows; NumPy leaves room in it for the first axis to grow."""
    header = {"descr": empty.dtype.str, "fortran_order": False, "shape": (num_samples, *empty.shape[1:])}
    file.seek(0)
    np.lib.format.write_array_header_1_0(file, header)


def _checksums(folder: Path) -> dict[str, int]:
    return {name: file_checksum(folder / f"{name}.npy") for name in ARRAYS}


def _read(folder: Path, digest: str) -> Samples | None:
    """The samples in `folder` if they are as they were written, and have this digest."""
    try:
        about = read_plain_json(folder / _DONE)
        if about["digest"] != digest or about["checksums"] != _checksums(folder):
            return None
        # Only the crops are memory-mapped; NumPy cannot map an empty array.
        has_crops = (folder / "crops.npy").stat().st_size > _HEADER_BYTES
        modes = dict.fromkeys(ARRAYS) | {"crops": "r" if has_crops else None}
        arrays = {name: np.load(folder / f"{name}.npy", mode, allow_pickle=False) for name, mode in modes.items()}
        return Samples(**arrays, digest=digest)
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError, KeyError, *NPY_ERRORS):
        return None
