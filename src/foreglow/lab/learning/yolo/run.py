"""A run of a YOLO, one folder with configuration, data, weights and results: its training, and its predictions."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from foreglow.checksums import check_unchanged
from foreglow.datasets import LabelledSource
from foreglow.datasets.json_files import Record, read_json
from foreglow.files import file_digest
from foreglow.lab.evaluation import Predictions
from foreglow.lab.learning.kept_files import check_torch_file
from foreglow.lab.learning.yolo.backends import BACKENDS, Detector, YoloConfig, is_here
from foreglow.lab.learning.yolo.export import (
    DATA_NAME,
    ExportSettings,
    Progress,
    check_claim,
    export_yolo,
    is_export,
    read_export,
    squashed,
)
from foreglow.provenance import provenance
from foreglow.types import Frame
from foreglow.whole_files import write_atomic

CONFIG_NAME, RESULTS_NAME, TRAINING_NAME = "config.json", "results.json", "training"

_GPUS = "CUDA_VISIBLE_DEVICES"
"""The variable of the environment with the GPUs that torch may use; ultralytics sets it, also to none."""


class YoloSettings(Record):
    """The part of `config.json` that must not change: another configuration needs another folder.

    Attributes:
        boxes: The boxes that it is trained on, as in `ExportSettings`.
        export_size_px: Side of the squares that frames are scaled to; the library scales them to its own size.
        data_sha256: Digest of the images and label files; empty for runs of an early version, which go on with any.
        weights_sha256: That of the file of weights to start from, wherever it is now; likewise, and without any.
    """

    training: YoloConfig
    boxes: str
    export_size_px: int
    data_sha256: str = ""
    weights_sha256: str = ""


_DIGESTS = ("data_sha256", "weights_sha256")


class YoloResults(Record):
    """`results.json`, written when the training is done.

    Attributes:
        weights: Path, from the run's folder, of the weights that did best on the validation split.
        seconds: Duration of the last call, without earlier calls of an interrupted training.
    """

    weights: str
    num_parameters: int
    num_multiply_adds: int
    seconds: float


@dataclass(frozen=True, slots=True)
class YoloRun:
    """A finished training."""

    folder: Path
    settings: YoloSettings
    results: YoloResults

    @property
    def weights(self) -> Path:
        """The weights that did best on the validation split."""
        return self.folder / self.results.weights


@dataclass(frozen=True, slots=True, eq=False)
class YoloPredictions:
    """The predictions of a YOLO for a split.

    Attributes:
        predictions: Boxes and scores by image id, full-frame pixels, best first; all with a score above 0.01.
        frame_ms: Shape (F,): run-time of each frame in milliseconds, with scaling but without reading and decoding.
    """

    predictions: Predictions
    frame_ms: NDArray[np.float64]


def train_yolo(
    data: Path | str,
    folder: Path | str,
    config: YoloConfig,
    *,
    preset_name: str | None = None,
    progress: Progress | None = None,
) -> YoloRun:
    """Trains a YOLO on the boxes of `data`, or continues an interrupted training in `folder`.

    Args:
        data: A data set in PVDN's layout, or an export of one by `export_yolo`.
        folder: Folder for `config.json`, `dataset` (unless exported before), `training` and `results.json`.
        config: How to train.
        preset_name: Preset of the boxes, as in `export_yolo`; None if `data` is an export.
        progress: Called after each image that is exported.

    Raises:
        FileNotFoundError: If the data or a part of them is missing.
        ValueError: If a file is broken, no box with light is in train or in val, or `folder` holds a run with other
            settings.
        ModuleNotFoundError: If the library is not installed.
    """
    data, folder = Path(data), Path(folder)
    _check_own(folder)
    backend = BACKENDS[config.backend]()
    backend.check(config)
    origin = {"data": str(data), f"{config.backend}_version": backend.version()} | provenance()
    exported, data_file = _exported(data, folder, config, preset_name, progress)
    settings = YoloSettings(
        training=config,
        boxes=exported.boxes,
        export_size_px=exported.size_px,
        data_sha256=_data_digest(data_file.parent),
        weights_sha256=file_digest(Path(config.weights)) if config.weights else "",
    )
    path = folder / CONFIG_NAME
    if not path.exists():
        _check_lit(data_file.parent)
    folder.mkdir(parents=True, exist_ok=True)
    if path.exists():
        known = read_json(path, YoloSettings)
        if known.weights_sha256 and config.weights:
            known = known.model_copy(update={"training": known.training.model_copy(update={"weights": config.weights})})
        check_claim(path, settings.training, known.training, "run")
        unknown = {name: getattr(settings, name) for name in _DIGESTS if not getattr(known, name)}
        check_claim(path, settings, known.model_copy(update=unknown), "run")
    else:
        write_atomic(path, (json.dumps(settings.model_dump() | origin, indent=1) + "\n").encode())
    if not (folder / RESULTS_NAME).exists() or not read_yolo_run(folder).weights.is_file():
        started = time.perf_counter()
        weights = backend.train(data_file, folder / TRAINING_NAME, config)
        detector = backend.load(weights, config)
        results = YoloResults(
            weights=str(weights.relative_to(folder)),
            num_parameters=detector.num_parameters,
            num_multiply_adds=detector.num_multiply_adds,
            seconds=round(time.perf_counter() - started, 1),
        )
        write_atomic(folder / RESULTS_NAME, (results.model_dump_json(indent=1) + "\n").encode())
    return read_yolo_run(folder)


def _check_lit(export: Path) -> None:
    """ValueError if no image of train, or none of val, has a box in an export: as of data that nobody has labelled."""
    for name in ("train", "val"):
        boxes = export / "labels" / name
        if not any(path.stat().st_size for path in boxes.glob("*.txt")):
            raise ValueError(f"{boxes}: expected a box with light in some image to learn from and judge by, found none")


def _data_digest(export: Path) -> str:
    """SHA-256 of the checksums of all images and label files of an export that are trained on."""
    found = sorted(check_unchanged(export).items())
    learnt = [each for each in found if Path(each[0]).parent.name in ("train", "val")]
    return hashlib.sha256(json.dumps(learnt).encode()).hexdigest()


def _check_own(folder: Path) -> None:
    """ValueError if a folder has a file or folder with the name of a result, and no run that was begun."""
    if (folder / CONFIG_NAME).exists():
        read_json(folder / CONFIG_NAME, YoloSettings)
        return
    for path in (folder / RESULTS_NAME, folder / TRAINING_NAME):
        if path.exists():
            raise ValueError(
                f"{path}: expected nothing there but earlier results of this command; choose another folder"
            )


def read_yolo_run(folder: Path | str) -> YoloRun:
    """The finished run in `folder`.

    Raises:
        FileNotFoundError: If there is none, or it is not finished.
        ValueError: If a file of it is broken.
    """
    folder = Path(folder)
    for name in (CONFIG_NAME, RESULTS_NAME):
        if not (folder / name).is_file():
            raise FileNotFoundError(f"{folder / name}: no such file, expected a finished run of `yolo train`")
    return YoloRun(folder, read_json(folder / CONFIG_NAME, YoloSettings), read_json(folder / RESULTS_NAME, YoloResults))


def check_usable(run: YoloRun) -> None:
    """Passes a run that can predict here.

    Raises:
        FileNotFoundError: If the weights are missing.
        ValueError: If they are damaged.
        ModuleNotFoundError: If the library is not installed.
    """
    if not run.weights.is_file():
        raise FileNotFoundError(f"{run.weights}: no such file, expected the weights of the run {run.folder}")
    check_torch_file(run.weights)
    BACKENDS[run.settings.training.backend]().version()


def predict_yolo(
    run: YoloRun,
    dataset: LabelledSource,
    *,
    device: str | None = None,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> YoloPredictions:
    """Runs the network of `run` over the selected images of `dataset`.

    Args:
        run: A finished training.
        dataset: The images.
        device: What it runs on, as in `YoloConfig`; None for what it was trained on, or without that GPU for `auto`.
        num_threads: Of a processor; None for as many as torch takes.
        progress: Called after each image.

    Raises:
        FileNotFoundError: If the weights or an image are missing.
        ValueError: If an image is broken, or does not have 8 bits.
        ModuleNotFoundError: If the library is not installed.
    """
    boxes: dict[int, NDArray[np.float64]] = {}
    scores: dict[int, NDArray[np.float64]] = {}
    times_ms: list[float] = []
    check_usable(run)
    config = run.settings.training
    wanted = device or (config.device if is_here(config.device) else "auto")
    with _threads(num_threads):
        detector = BACKENDS[config.backend]().load(run.weights, config.model_copy(update={"device": wanted}))
        for num_done, frame in enumerate(dataset, start=1):
            started = time.perf_counter_ns()
            boxes[frame.frame], scores[frame.frame] = detect_in_frame(detector, frame, run.settings.export_size_px)
            times_ms.append((time.perf_counter_ns() - started) / 1e6)
            if progress is not None:
                progress(num_done, len(dataset))
    return YoloPredictions(Predictions(boxes, scores), np.array(times_ms))


def detect_in_frame(detector: Detector, frame: Frame, size_px: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Boxes (N, 4), xyxy, full-frame pixels, clipped to the frame, and scores (N,), both sorted by falling score.

    Args:
        detector: A trained network.
        frame: The frame, 8 bits.
        size_px: Side of the square that the frame is scaled to.

    Raises:
        ValueError: If the frame does not have 8 bits.
    """
    boxes, scores = detector.detect(squashed(frame.image, size_px, frame.path))
    size_xyxy_px = np.array([frame.width_px, frame.height_px] * 2, np.float64)
    in_frame = np.clip(boxes / size_px * size_xyxy_px, 0.0, size_xyxy_px)
    order = np.argsort(-scores, kind="stable")
    return in_frame[order], scores[order]


@contextlib.contextmanager
def _threads(num_threads: int | None) -> Iterator[None]:
    """Lets torch use this many threads inside the block, behind which it sees the GPUs that ultralytics hid in it."""
    import torch

    before, visible = torch.get_num_threads(), os.environ.get(_GPUS)
    if num_threads is not None:
        torch.set_num_threads(num_threads)
    try:
        yield
    finally:
        torch.set_num_threads(before)
        if visible is None:
            os.environ.pop(_GPUS, None)
        else:
            os.environ[_GPUS] = visible


def _exported(
    data: Path, folder: Path, config: YoloConfig, preset_name: str | None, progress: Progress | None
) -> tuple[ExportSettings, Path]:
    """The settings and the `data.yaml` of the export to train on; made in the run's folder unless `data` is one."""
    if not is_export(data):
        export = export_yolo(
            data,
            folder / "dataset",
            preset_name=preset_name,
            size_px=config.image_size_px,
            splits=("train", "val"),
            progress=progress,
        )
        return export.settings, export.data_file
    settings = read_export(data)
    if preset_name is not None:
        raise ValueError(
            f"{data}: expected no preset with an export, its boxes are {settings.boxes}, got {preset_name!r}"
        )
    if not {"train", "val"} <= set(settings.splits):
        raise ValueError(f"{data}: splits: expected train and val to train on, got {', '.join(settings.splits)}")
    return settings, data / DATA_NAME
