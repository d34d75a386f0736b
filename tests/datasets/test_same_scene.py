"""The same scene in other kinds of files is seen alike: by boxes, scores and kinds of light."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from foreglow.config import GuardConfig, preset
from foreglow.datasets import PVDN, open_source, shipped_drive
from foreglow.pipeline import Pipeline
from foreglow.types import Detections, Image

NUM_FRAMES = 3

ROUNDING = 0.04
"""Crops of 8 bits are rounded to whole grey levels; scores of the whole drive differ by up to .035 for it."""


@pytest.fixture(scope="module")
def scene() -> list[Image]:
    """A few images with light of a vehicle."""
    return [frame.image for frame in islice(PVDN(shipped_drive()), 38, 38 + NUM_FRAMES)]


def found_in(path: Path, white_level: int | None = None) -> list[Detections]:
    config = preset("foreglow").model_copy(update={"guard": GuardConfig(white_level=white_level)})
    found = [result.detections for result in Pipeline(config).run(open_source(path))]
    return [each for each in found if each is not None]


@pytest.fixture(scope="module")
def expected(scene: list[Image], tmp_path_factory: pytest.TempPathFactory) -> list[Detections]:
    return found_in(write_images(tmp_path_factory.mktemp("grey"), scene, lambda image: image))


def write_images(
    folder: Path, scene: list[Image], change: Callable[[Image], NDArray[Any]], ending: str = ".png"
) -> Path:
    """The scene as a folder of images."""
    for index, image in enumerate(scene):
        path = folder / f"{index:06d}{ending}"
        if ending == ".npy":
            np.save(path, change(image))
        else:
            cv2.imwrite(str(path), change(image))
    return folder


def write_film(path: Path, scene: list[Image], codec: str, pixels: str, options: dict[str, str]) -> Path:
    """The scene as a video of 18 frames a second without loss."""
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream(codec, rate=18, options=options)
        stream.width, stream.height, stream.pix_fmt = scene[0].shape[1], scene[0].shape[0], pixels
        for image in scene:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(in_colours(image), format="rgb24")))
        container.mux(stream.encode(None))
    return path


def in_colours(image: Image) -> NDArray[Any]:
    return np.repeat(image[..., None], 3, axis=2)


def times(factor: int) -> Callable[[Image], NDArray[Any]]:
    return lambda image: image.astype(np.uint16) * np.uint16(factor)


def check_alike(found: list[Detections], expected: list[Detections], rounding: float) -> None:
    assert len(found) == len(expected) == NUM_FRAMES
    assert sum(int(each.is_accepted.sum()) for each in expected) > 0
    for mine, its in zip(found, expected, strict=True):
        np.testing.assert_array_equal(mine.boxes_xyxy_px, its.boxes_xyxy_px)
        np.testing.assert_allclose(mine.scores, its.scores, atol=rounding)
        np.testing.assert_allclose(mine.light_kinds, its.light_kinds, atol=2 * rounding)


@pytest.mark.parametrize(
    ("change", "ending", "white_level", "rounding"),
    [
        (times(257), ".png", None, ROUNDING),
        (times(64), ".png", 255 * 64, ROUNDING),  # of 14, 12 and 10 bits
        (times(16), ".tif", 255 * 16, ROUNDING),
        (times(4), ".png", 255 * 4, ROUNDING),
        (lambda image: times(16)(image).astype(">u2"), ".npy", 255 * 16, ROUNDING),
        (lambda image: np.asfortranarray(image / 255), ".npy", None, ROUNDING),
        (lambda image: in_colours(times(16)(image)), ".png", 255 * 16, ROUNDING),
        (lambda image: np.dstack([in_colours(image), image // 2]), ".png", None, 0.0),  # with alpha
        (in_colours, ".bmp", None, 0.0),
        (lambda image: image, ".pgm", 4095, 0.0),
    ],
)
def test_images_of_any_kind(
    scene: list[Image],
    expected: list[Detections],
    tmp_path: Path,
    change: Callable[[Image], NDArray[Any]],
    ending: str,
    white_level: int | None,
    rounding: float,
) -> None:
    found = found_in(write_images(tmp_path, scene, change, ending), white_level)
    check_alike(found, expected, rounding)


@pytest.mark.parametrize(
    ("codec", "pixels", "ending", "options"),
    [
        ("ffv1", "gray", "mkv", {}),
        ("ffv1", "bgr0", "mkv", {}),
        ("rawvideo", "bgr24", "avi", {}),
        ("libx264rgb", "rgb24", "mp4", {"qp": "0"}),
    ],
)
def test_videos_of_any_kind(
    scene: list[Image],
    expected: list[Detections],
    tmp_path: Path,
    codec: str,
    pixels: str,
    ending: str,
    options: dict[str, str],
) -> None:
    found = found_in(write_film(tmp_path / f"film.{ending}", scene, codec, pixels, options))
    check_alike(found, expected, 0.0)
