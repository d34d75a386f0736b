"""What surrounds a command: variables of the environment, runs that were not finished, links, images of rare kinds."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

ENVIRONMENTS = (
    "MPLBACKEND=nonsense",
    "OPENCV_IO_MAX_IMAGE_PIXELS=x",
    "OPENCV_FOR_THREADS_NUM=",
    "OPENCV_LOG_LEVEL=nonsense",
    "OMP_NUM_THREADS=x OPENBLAS_NUM_THREADS=-1",
    "PYTHONWARNINGS=error",
    "PYTHONIOENCODING=ascii LC_ALL=C PYTHONUTF8=0",
    "COLUMNS=0 LINES=-1",
    "COLUMNS=x TERM=dumb NO_COLOR=1",
    "HOME=/nonexistent XDG_CACHE_HOME=/proc/x XDG_CONFIG_HOME=/proc/x MPLCONFIGDIR=/proc/x",
    "TMPDIR=/nonexistent",
    "CAN_CONFIG={",
    "TZ=nonsense/zone",
)
"""Variables that libraries read, set to what no library expects; commands are done, or say what is wrong."""


def with_variables(words: Sequence[str], variables: str) -> int:
    """The exit code of a command in a process of its own, which loads its libraries with these variables."""
    own = dict(variable.split("=", 1) for variable in variables.split())
    return subprocess.run([sys.executable, "-m", "foreglow.cli", *words], env=os.environ | own, check=False).returncode


def _lines(change: Callable[[list[dict[str, Any]]], list[dict[str, Any]]]) -> Callable[[Path], None]:
    def apply(run: Path) -> None:
        path = run / "frames.jsonl"
        lines = change([json.loads(line) for line in path.read_text().splitlines()])
        path.write_text("".join(f"{json.dumps(line)}\n" for line in lines))
        _summary(frames_sha256=None)(run)  # as of an earlier version: else it is refused whatever the lines are

    return apply


def _with(**fields: Any) -> Callable[[Path], None]:
    return _lines(lambda lines: [line | fields for line in lines])


def _without(*names: str) -> Callable[[Path], None]:
    return _lines(lambda lines: [{name: value for name, value in line.items() if name not in names} for line in lines])


def _summary(**fields: Any) -> Callable[[Path], None]:
    def apply(run: Path) -> None:
        path = run / "summary.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | fields))

    return apply


def _killed(run: Path) -> None:
    (run / "frames.jsonl").rename(run / "frames.jsonl.partial")
    (run / "summary.json").unlink()


def _cut(run: Path) -> None:
    path = run / "frames.jsonl"
    path.write_bytes(path.read_bytes()[:-200])


UNFINISHED: dict[str, Callable[[Path], None]] = {
    "killed": _killed,
    "the last line is cut": _cut,
    "no summary": lambda run: (run / "summary.json").unlink(),
    "no times": lambda run: (run / "times.jsonl").unlink(),
    "no configuration": lambda run: (run / "config.toml").unlink(),
    "no frame": _lines(lambda lines: []),  # noqa: ARG005
    "one frame": _lines(lambda lines: lines[:1]),
    "backwards": _lines(lambda lines: lines[::-1]),
    "frames twice": _lines(lambda lines: lines + lines[:2]),
    "all at one time": _with(timestamp_ns=5),
    "far in time": _with(timestamp_ns=2**62),
    "no tracks": _with(tracks=None),
    "an early format": _without("light_kinds", "direct", "vehicles", "beam", "sequence", "ranges_m", "range_sigmas_m"),
    "not complete": _summary(is_complete=False),
    "the drive is gone": _summary(source="/nonexistent/drive"),
    "another number of frames": _summary(num_frames=99_999),
}
"""What may have become of the folder of a run."""

LATER: dict[str, tuple[str, ...]] = {
    "report": ("report", "@results", "--out", "out.html"),
    "beam": (
        "beam", "@results", "--out", "out", "--calibration", "@camera.toml", "--can-log", "@drive.log", "--can", "blf",
    ),
    "export-mot": ("export-mot", "@results", "@night/val", "--out", "out"),
    "labels": ("labels", "export", "@night/val", "--run", "@results", "--out", "out.xml"),
    "evaluate": ("evaluate", "@night/val", "--predictions", "@results/frames.jsonl", "--json", "out.json"),
}  # fmt: skip
"""What is done with a run afterwards; of labelled drives the run is `of_split`."""

LINKED: dict[str, tuple[str, str, tuple[str, ...]]] = {
    name: (output, target, words)
    for name, output, target, words in (
        ("frames", "out/frames.jsonl", "../inputs/results/frames.jsonl", ("run", "@images", "--out", "out")),
        ("unfinished frames", "out/frames.jsonl.partial", "../inputs/camera.toml", ("run", "@images", "--out", "out")),
        ("a loop", "out/summary.json", "summary.json", ("run", "@images", "--out", "out")),
        ("nowhere", "out", "nowhere", ("run", "@images", "--out", "out")),
        ("video", "out/overlay.mp4.partial", "../inputs/night.mp4", ("run", "@night.mp4", "--out", "out", "--video")),
        ("report", "out.html", "inputs/results/frames.jsonl", ("report", "@results", "--out", "out.html")),
        ("recording", "out.mcap.partial", "inputs/night.mcap", ("record", "@images", "--out", "out.mcap")),
        ("tracks", "out/gt", "../inputs/night", ("export-mot", "@of_split", "@night/val", "--out", "out")),
        ("boxes", "out/images", "../inputs/images", ("export-yolo", "@night", "--out", "out")),
    )
}
"""Outputs in whose place there is a link, often to an input."""


def _image() -> NDArray[np.uint8]:
    return np.random.default_rng(1).integers(0, 90, (240, 320)).astype(np.uint8)


RARE_IMAGES: dict[str, tuple[str, NDArray[Any]]] = {
    "transparent": ("png", np.dstack([_image()] * 3 + [np.zeros_like(_image())])),
    "16 bits": ("png", _image().astype(np.uint16) * 257),
    "16 bits, colour": ("png", np.dstack([_image()] * 3).astype(np.uint16) * 257),
    "one pixel": ("png", _image()[:1, :1]),
    "one row": ("png", np.zeros((1, 9000), np.uint8)),
    "one column": ("png", np.zeros((9000, 1), np.uint8)),
    "noise": ("png", np.random.default_rng(1).integers(0, 256, (960, 1280)).astype(np.uint8)),
    "dots": ("png", np.kron(np.ones((120, 160)), np.pad(np.full((2, 2), 255), 3)).astype(np.uint8)),
    "32 bits": ("tif", _image().astype(np.float32)),
    "portable, 16 bits": ("pgm", _image().astype(np.uint16) * 257),
}
"""Images as cameras and tools write them, if rarely."""


def write_image(path: Path, image: NDArray[Any]) -> None:
    if not cv2.imwrite(str(path), image):
        raise OSError(f"{path}: cannot be written")
