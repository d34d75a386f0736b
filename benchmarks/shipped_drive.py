"""Makes the drive that ships with the package: `python -m benchmarks.shipped_drive [FOLDER]`, or `make drive`.

FOLDER holds `scene.toml`, the drive's specification, and gets everything else: the images as JPEG, PVDN's labels, and
the simulator's truth without depth images. The lossless drive is rendered into `bench_output` first and kept there,
which takes minutes; a second call only compresses it again.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import sys
from pathlib import Path

import cv2

import foreglow
from foreglow.datasets import read_image
from foreglow.display.progress import SceneProgress
from foreglow.lab.simulation import DatasetConfig, drive_frames, read_scene, simulate_dataset
from foreglow.whole_files import write_atomic

FOLDER = Path(foreglow.__file__).parent / "shipped_drives" / "curve"
LOSSLESS = Path("bench_output") / "shipped_drive"

JPEG_QUALITY = 87
"""Chosen so that the drive takes less than 10 MB; docs/demo.md has what it costs the proposals."""

TRUTH_NAMES = ("scene.json", "camera.toml", "road.json", "frames.jsonl")
"""What is kept of a sequence's truth: all but the depth images."""


def main(folder: Path) -> None:
    scene = read_scene(folder / "scene.toml")
    config = DatasetConfig.of(seed=None, split=folder.name, cycle="day", quality="training")
    with contextlib.closing(SceneProgress(1, scene.num_frames)) as progress:
        made = simulate_dataset(LOSSLESS, (scene,), drive_frames, config, progress=progress)
    num_bytes = compress(made.root, folder, JPEG_QUALITY)
    print(f"{folder}: {made.labels.num_images} images, {num_bytes / 1e6:.2f} MB")


def compress(split: Path, folder: Path, quality: int) -> int:
    """Writes the simulated `split` to `folder` with its images as JPEG and without depth; returns its size in bytes."""
    for name in ("images", "labels", "simulation"):
        shutil.rmtree(folder / name, ignore_errors=True)
    for path in sorted(split.glob("images/*/*.png")):
        data = jpeg(path, quality)
        target = (folder / path.relative_to(split)).with_suffix(".jpg")
        target.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(target, data)
    for path in sorted(split.glob("simulation/*/*")):
        if path.name in TRUTH_NAMES:
            _copy(path, folder / path.relative_to(split))
    _copy(split / "simulation" / "info.json", folder / "simulation" / "info.json")
    shutil.copytree(split / "labels", folder / "labels")
    annotations = folder / "labels" / "image_annotations.json"
    document = json.loads(annotations.read_text(encoding="utf-8"))
    for image in document["images"]:
        image["file_name"] = str(Path(image["file_name"]).with_suffix(".jpg"))
    write_atomic(annotations, (json.dumps(document, indent=1) + "\n").encode())
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def jpeg(path: Path, quality: int) -> bytes:
    """The grey image in the file at `path` as a progressive JPEG."""
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1, cv2.IMWRITE_JPEG_PROGRESSIVE, 1]
    return bytes(cv2.imencode(".jpg", read_image(path), options)[1])


def _copy(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER)
