"""Kinds of light by colour: red boxes are of rear lamps, whatever camera brought them, and nothing else changes."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

import foreglow
from foreglow.classifier.colour import EVEN_REDNESS, kinds_by_colour, redness
from foreglow.datasets import Video, open_source, to_grey
from foreglow.datasets.images import red_chroma
from foreglow.types import LIGHT_KINDS, Frame
from foreglow.types.white import full_scale
from tests.shared_data import shared_file

REAR = [name.startswith("rear") for name in LIGHT_KINDS]
kinds = arrays(np.float32, (3, 4), elements=st.floats(1 / 64, 1, width=32)).map(lambda k: k / k.sum(1, keepdims=True))


def frame(colours: NDArray[Any]) -> Frame:
    """A frame of R, G, B."""
    return Frame(to_grey(colours), 0, red_chroma=red_chroma(colours))


def lamps() -> NDArray[np.uint8]:
    """A red and a white lamp, and a yellowish one, on black, R, G, B."""
    colours = np.zeros((64, 96, 3), np.uint8)
    colours[20:30, 10:20] = (220, 30, 20)
    colours[20:30, 40:50] = (230, 230, 230)
    colours[20:30, 70:80] = (230, 205, 170)
    return colours


BOXES = np.array([[10, 20, 20, 30], [40, 20, 50, 30], [70, 20, 80, 30], [0, 0, 5, 5]], np.int32)


def test_red_is_told_from_white_of_any_temperature() -> None:
    red, white, yellowish, black = redness(frame(lamps()), BOXES)
    assert red > 5 * EVEN_REDNESS
    assert abs(white) < 0.01
    assert yellowish < EVEN_REDNESS
    assert np.isnan(black)


@pytest.mark.parametrize("dtype", [np.uint16, np.float64])
def test_depth_does_not_matter(dtype: type) -> None:
    deep: NDArray[Any] = lamps().astype(dtype) * np.array(257 if dtype is np.uint16 else 1 / 255, dtype)
    np.testing.assert_allclose(redness(frame(deep), BOXES), redness(frame(lamps()), BOXES), atol=0.01)


def test_grey_has_no_colour() -> None:
    grey = frame(np.repeat(lamps()[..., :1], 3, axis=2))
    assert grey.red_chroma is None
    assert np.isnan(redness(grey, BOXES)).all()


@given(kinds, arrays(np.float64, 3, elements=st.floats(-5, 5)))
def test_only_front_and_rear_change(before: NDArray[np.float32], reds: NDArray[np.float64]) -> None:
    after = kinds_by_colour(before, reds)
    np.testing.assert_allclose(after.sum(1), 1, atol=1e-5)
    rear_before, rear_after = before[:, REAR].sum(1), after[:, REAR].sum(1)
    assert ((rear_after >= rear_before - 1e-6) == (reds >= EVEN_REDNESS)).all() or np.allclose(rear_after, rear_before)
    # Lamps in sight to light on something, of either end.
    np.testing.assert_allclose(after[:, 0] * before[:, 2], after[:, 2] * before[:, 0], atol=1e-5)
    np.testing.assert_allclose(after[:, 1] * before[:, 3], after[:, 3] * before[:, 1], atol=1e-5)


@pytest.mark.parametrize("white", [1020, 4080])
def test_bits_do_not_matter(white: int) -> None:
    """Lamps that show a 16th of their light are as red, also those that are hardly red at all."""
    colours = lamps() // 8 + np.uint8(20)
    few = full_scale(frame(colours.astype(np.uint16) * np.uint16(white // 255)), white)
    np.testing.assert_allclose(redness(few, BOXES), redness(frame(colours), BOXES), atol=0.02)


def write_video(
    path: Path, codec: str = "libx264", pixels: str = "yuv420p", colours: NDArray[np.uint8] | None = None
) -> Path:
    """A few frames of the lamps."""
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = 96, 64, pixels
        stream.options = {"crf": "4"}
        for index in range(3):
            picture = av.VideoFrame.from_ndarray(lamps() if colours is None else colours, format="rgb24")
            picture.pts = index
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    return path


def test_images_and_videos_bring_their_colour(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "lamps.png"), lamps()[..., ::-1])
    by_image = redness(next(iter(open_source(tmp_path / "lamps.png"))), BOXES)
    by_video = redness(next(iter(Video(write_video(tmp_path / "lamps.mp4")))), BOXES)
    np.testing.assert_allclose(by_image, redness(frame(lamps()), BOXES))
    np.testing.assert_allclose(by_video[:3], by_image[:3], atol=0.1)


CODED = [
    ("rawvideo", "bgr24", "avi"),
    ("png", "rgb24", "mov"),
    ("ffv1", "gbrp16le", "mkv"),
    ("mjpeg", "yuvj420p", "avi"),
]


@pytest.mark.parametrize(("codec", "pixels", "ending"), CODED)
def test_a_grey_camera_stays_grey_in_a_video_of_colours(tmp_path: Path, codec: str, pixels: str, ending: str) -> None:
    grey = np.repeat(lamps()[..., :1], 3, axis=2)
    (brought, *_) = Video(write_video(tmp_path / f"grey.{ending}", codec, pixels, grey))
    assert brought.red_chroma is None


@pytest.mark.parametrize(("codec", "pixels", "ending"), CODED[:3])
def test_videos_of_red_green_and_blue_are_as_images(tmp_path: Path, codec: str, pixels: str, ending: str) -> None:
    (brought, *_) = Video(write_video(tmp_path / f"lamps.{ending}", codec, pixels))
    np.testing.assert_allclose(redness(brought, BOXES), redness(frame(lamps()), BOXES), atol=0.01)


def test_scores_do_not_depend_on_colour_and_kinds_do() -> None:
    colours = lamps()
    with_colour, grey = frame(colours), Frame(to_grey(colours), 0)
    config = foreglow.preset("foreglow")
    plain = config.model_copy(update={"classifier": config.classifier.model_copy(update={"colour": False})})
    found = [foreglow.Pipeline(each).step(of).detections for each, of in ((config, with_colour), (config, grey))]
    switched_off = foreglow.Pipeline(plain).step(with_colour).detections
    assert found[0] is not None
    assert found[1] is not None
    assert switched_off is not None
    np.testing.assert_array_equal(found[0].scores, found[1].scores)
    np.testing.assert_array_equal(switched_off.light_kinds, found[1].light_kinds)
    assert (found[0].light_kinds != found[1].light_kinds).any()


@pytest.mark.parametrize(
    "chroma", [np.zeros((32, 47), np.uint8), np.zeros((64, 96), np.uint8), np.zeros((32, 48), np.int16)]
)
def test_a_chroma_that_does_not_fit(chroma: NDArray[np.uint8]) -> None:
    with pytest.raises(ValueError, match=r"Frame\.red_chroma: expected shape \(32, 48\), uint8 or uint16, got"):
        Frame(np.zeros((64, 96), np.uint8), 0, red_chroma=chroma)


@pytest.mark.slow
def test_kinds_in_a_real_clip() -> None:
    """Four of five accepted boxes around sorted lamps are told to be of the right end; without colour two of five."""
    video, marks = shared_file("data/night_motorway_640x360.mp4"), shared_file("data/real_marks/m640")
    spots = json.loads((marks / "candidates.json").read_text())["frames"]
    labels = json.loads((marks / "labels.json").read_text())
    ends = {"headlamp": False, "reflection": False, "tail": True}
    right: Counter[bool] = Counter()
    pipeline = foreglow.Pipeline()
    is_needed = {number - before for number in map(int, labels) for before in range(9)}  # the model looks .25 s back
    for number, each in enumerate(Video(video)):
        if number > max(is_needed):
            break
        if number not in is_needed:
            continue
        detections = pipeline.step(each).detections
        if str(number) not in labels:
            continue
        assert detections is not None
        classes = labels[str(number)]["classes"]
        marked = [(x, y, classes[str(index)]) for index, (x, y) in enumerate(spots[str(number)])]
        is_rear = detections.light_kinds[:, REAR].sum(1) > 0.5
        for box, rear, is_accepted in zip(detections.boxes_xyxy_px, is_rear, detections.is_accepted, strict=True):
            inside = {what for x, y, what in marked if box[0] <= x <= box[2] and box[1] <= y <= box[3]} & ends.keys()
            if is_accepted and len(inside) == 1:
                right[bool(rear) == ends[inside.pop()]] += 1
    assert right.total() > 50
    assert right[True] > 0.8 * right.total()
