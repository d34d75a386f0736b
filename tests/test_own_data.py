"""The smallest data set of its page can be read, measured and learned from."""

from __future__ import annotations

import re
from pathlib import Path

import cv2

from foreglow.datasets import PVDN, EnvironmentLighting
from foreglow.lab.evaluation import read_split_labels
from tests.stand_ins import night_image

PAGE = Path(__file__).parents[1] / "docs" / "own_data.md"


def test_the_smallest_data_set(tmp_path: Path) -> None:
    files = dict(re.findall(r"^`(labels/\S+)`:\n\n```json\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL))
    assert len(files) == 3
    for name, content in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(content)
    (image,) = re.findall(r"^`(images/\S+)`: any image of (\d+) x (\d+)", PAGE.read_text(), re.MULTILINE)
    (tmp_path / image[0]).parent.mkdir(parents=True)
    assert cv2.imwrite(str(tmp_path / image[0]), night_image(0, int(image[2]), int(image[1])))
    split = PVDN(tmp_path)
    (frame,) = split
    assert split.keypoints_px(frame.frame).tolist() == [[38, 31]]
    assert split.sequences[0].environment_lighting == EnvironmentLighting.DARK
    assert read_split_labels(split) is not None
