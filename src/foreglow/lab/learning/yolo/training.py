"""A training run of a YOLO: one folder with configuration, data, weights and results."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from foreglow.datasets.json_files import Record, read_json
from foreglow.files import write_atomic
from foreglow.lab.learning.yolo.backends import make_backend
from foreglow.lab.learning.yolo.export import DATA_NAME, ExportSettings, Progress, export_yolo, is_export, read_export
from foreglow.lab.learning.yolo.interface import YoloConfig
from foreglow.provenance import provenance

CONFIG_NAME, RESULTS_NAME = "config.json", "results.json"


class _Settings(Record):
    """The part of `config.json` that must not change: another configuration needs another folder."""

    training: YoloConfig
    boxes: str
    export_size_px: int


class _Results(Record):
    """`results.json`, written when the training is done."""

    weights: str
    num_parameters: int
    num_multiply_adds: int
    seconds: float


@dataclass(frozen=True, slots=True)
class YoloRun:
    """A finished training.

    Attributes:
        folder: Its folder.
        config: How it was trained.
        boxes: The boxes that it was trained on, as in `ExportSettings`.
        export_size_px: Side of the squares that the frames were scaled to; the library scales them to its own size.
        weights: The weights that did best on the validation split.
        num_parameters: Number of weights and biases.
        num_multiply_adds: Multiply-adds for one image.
        seconds: Duration of the last call, without earlier calls of an interrupted training.
    """

    folder: Path
    config: YoloConfig
    boxes: str
    export_size_px: int
    weights: Path
    num_parameters: int
    num_multiply_adds: int
    seconds: float


def train_yolo(
    data: Path, folder: Path, config: YoloConfig, *, preset_name: str | None = None, progress: Progress | None = None
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
        ValueError: If a file is broken, or `folder` holds a run with other settings.
        ModuleNotFoundError: If the library is not installed.
    """
    backend = make_backend(config.backend)
    origin = {"data": str(data), f"{backend.package}_version": backend.version()} | provenance()
    exported, data_file = _exported(data, folder, config, preset_name, progress)
    _claim(folder, _Settings(training=config, boxes=exported.boxes, export_size_px=exported.size_px), origin)
    if not (folder / RESULTS_NAME).exists():
        started = time.perf_counter()
        weights = backend.train(data_file, folder / "training", config)
        detector = backend.load(weights, config)
        results = _Results(
            weights=str(weights.relative_to(folder)),
            num_parameters=detector.num_parameters,
            num_multiply_adds=detector.num_multiply_adds,
            seconds=round(time.perf_counter() - started, 1),
        )
        write_atomic(folder / RESULTS_NAME, (results.model_dump_json(indent=1) + "\n").encode())
    return read_yolo_run(folder)


def read_yolo_run(folder: Path) -> YoloRun:
    """The finished run in `folder`.

    Raises:
        FileNotFoundError: If there is none, or it is not finished.
        ValueError: If a file of it is broken.
    """
    for name in (CONFIG_NAME, RESULTS_NAME):
        if not (folder / name).is_file():
            raise FileNotFoundError(f"{folder / name}: no such file, expected a finished run of `yolo train`")
    settings = _read_settings(folder / CONFIG_NAME)
    results = read_json(folder / RESULTS_NAME, _Results)
    return YoloRun(
        folder=folder,
        config=settings.training,
        boxes=settings.boxes,
        export_size_px=settings.export_size_px,
        weights=folder / results.weights,
        num_parameters=results.num_parameters,
        num_multiply_adds=results.num_multiply_adds,
        seconds=results.seconds,
    )


def _exported(
    data: Path, folder: Path, config: YoloConfig, preset_name: str | None, progress: Progress | None
) -> tuple[ExportSettings, Path]:
    """The settings and the `data.yaml` of the export to train on; made in the run's folder unless `data` is one."""
    if is_export(data):
        settings = read_export(data)
        for split in ("train", "val"):
            if split not in settings.splits:
                raise ValueError(
                    f"{data}: splits: expected train and val to train on, got {', '.join(settings.splits)}"
                )
        return settings, data / DATA_NAME
    export = export_yolo(
        data,
        folder / "dataset",
        preset_name=preset_name,
        size_px=config.image_size_px,
        splits=("train", "val"),
        progress=progress,
    )
    return export.settings, export.data_file


def _claim(folder: Path, settings: _Settings, origin: Mapping[str, Any]) -> None:
    """Writes the run's configuration, or checks it against that of an earlier call."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / CONFIG_NAME
    if not path.exists():
        write_atomic(path, (json.dumps(settings.model_dump() | dict(origin), indent=1) + "\n").encode())
        return
    known = _fields(_read_settings(path))
    for name, value in _fields(settings).items():
        if value != known[name]:
            raise ValueError(f"{path}: {name}: expected {value!r} to go on with this run, it has {known[name]!r}")


def _read_settings(path: Path) -> _Settings:
    return read_json(path, _Settings)


def _fields(settings: _Settings) -> dict[str, Any]:
    """Everything that must not change between two calls, by name."""
    return settings.training.model_dump() | {"boxes": settings.boxes, "export_size_px": settings.export_size_px}
