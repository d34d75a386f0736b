"""Splits and images that judge are not learnt from, by whatever name, in every command that learns."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from foreglow.config import preset
from foreglow.datasets import PVDN
from foreglow.datasets.images import png
from foreglow.lab.learning.apart import check_apart
from foreglow.lab.learning.ranges import fit_ranges
from foreglow.lab.learning.yolo import export_yolo
from foreglow.lab.studies.detector.rows import DetectorPlan
from foreglow.lab.studies.detector.run import run_experiment
from tests.lab.learning.tiny_drives import make_drives

SIZE_PX = (120, 160)

LEARNING: dict[str, Callable[[Path, Path], object]] = {
    "yolo": lambda data, out: export_yolo(data, out, splits=("train", "val")),
    "ranges": lambda data, _: fit_ranges(data, preset("foreglow")),
    "detector": lambda data, out: run_experiment(data, out, DetectorPlan(rows=("paper",), split="val")),
}


@pytest.mark.torch
@pytest.mark.parametrize("name", LEARNING)
def test_train_under_another_name(name: str, tmp_path: Path) -> None:
    """`train` and `tune` looked, these did not."""
    data = make_drives(tmp_path / "data", num_images=1) / "day"
    (data / "val").rename(tmp_path / "away")
    (data / "val").symlink_to(data / "train")
    with pytest.raises(ValueError, match="train: expected a split to train on, got one that judges what is learnt"):
        LEARNING[name](data, tmp_path / "out")


def test_one_image_is_enough(tmp_path: Path) -> None:
    data = make_drives(tmp_path, num_images=1) / "day"
    splits = [data / name for name in ("train", "val")]
    check_apart(splits[:1], splits[1:])
    own, judge = (PVDN(split).image_path(PVDN(split).frame_ids[-1]) for split in splits)
    for copied in (np.zeros(SIZE_PX, np.uint8), np.full(SIZE_PX, 9, np.uint16)):  # flat ones are alike by themselves
        for path in (own, judge):
            path.write_bytes(png(copied))
        check_apart(splits[:1], splits[1:])
    image = np.zeros(SIZE_PX, np.uint8)
    image[5, 7] = 1
    for path in (own, judge):
        path.write_bytes(png(image))
    with pytest.raises(ValueError, match=f"{judge}: expected an image that nothing is learnt from, got that of {own}"):
        check_apart(splits[:1], splits[1:])
