"""Reads files in processes of their own, whose memory and time are bounded; `test_bounds.py` runs it as a program.

On standard input it takes JSON, a list of pairs: the name of a reader and the path that it shall read. On standard
output it gives what each reading came to: the name of the exception and its message.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from foreglow.calibration import read_intrinsics
from foreglow.classifier.onnx import OnnxClassifier
from foreglow.config import ClassifierConfig, read_config
from foreglow.datasets import open_source
from foreglow.datasets.exchange import read_labels_file
from foreglow.datasets.pvdn import PVDN
from foreglow.datasets.vehicle_logs.can_log import read_can_log, read_mapping
from foreglow.datasets.vehicle_logs.dbc import read_dbc
from foreglow.lab.simulation.scenes.scene_file import read_scene
from foreglow.lab.studies.glare.drive import read_glare_drive
from foreglow.maps import read_poses, read_road_map
from foreglow.parallel import cluster, workers_at
from foreglow.photometry import read_headlamps, read_lamp_file
from foreglow.runs.frames_file import read_tracks
from foreglow.runs.predictions import read_predictions
from foreglow.types import Frame, Proposals

MEMORY = 2 << 30
"""Bytes of addresses above what the imports take."""

SECONDS = 30
"""Of the processor, and three times as many by the clock."""


def all_frames(path: Path) -> None:
    for _ in open_source(path):
        pass


def run_model(path: Path) -> None:
    crops = Proposals(np.array([[0, 0, 9, 9]], np.int32))
    OnnxClassifier(ClassifierConfig(model=path)).classify(Frame(np.zeros((64, 64), np.uint8), 0), crops)


READERS: dict[str, Callable[[Path], Any]] = {
    "frames": all_frames,
    "labels": PVDN,
    "labels of a tool": read_labels_file,
    "predictions": read_predictions,
    "tracks": read_tracks,
    "road map": read_road_map,
    "poses": read_poses,
    "lamp": read_lamp_file,
    "headlamps": read_headlamps,
    "calibration": read_intrinsics,
    "configuration": read_config,
    "scene": read_scene,
    "CAN log": read_can_log,
    "DBC": read_dbc,
    "mapping": read_mapping,
    "model": lambda path: OnnxClassifier(ClassifierConfig(model=path)),
    "model run": run_model,
    "glare drive": read_glare_drive,
    "cluster": lambda path: workers_at(1, path.read_text()).num_workers,
}


def outcome(reader: str, path: Path) -> tuple[str, str]:
    try:
        READERS[reader](path)
    except Exception as error:
        return type(error).__name__, str(error)
    return "", "was read"


def bounded(reader: str, path: Path) -> tuple[str, str]:
    """The outcome in a process of its own."""
    out, into = os.pipe()
    if (child := os.fork()) == 0:
        size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() + MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (size, size))
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
        signal.alarm(3 * SECONDS)
        with os.fdopen(into, "w") as file:
            json.dump(outcome(reader, path), file)
        os._exit(0)
    os.close(into)
    with os.fdopen(out) as file:
        text = file.read()
    _, status = os.waitpid(child, 0)
    if not text:
        return "Killed", signal.Signals(os.WTERMSIG(status)).name if os.WIFSIGNALED(status) else str(status)
    name, message = json.loads(text)
    return name, message


if __name__ == "__main__":
    cluster.CONNECT_S = 0.5  # what never answers needs no longer
    json.dump([bounded(reader, Path(path)) for reader, path in json.load(sys.stdin)], sys.stdout)
