"""Annotated videos and pictures: what is written can be read by others."""

from __future__ import annotations

import dataclasses
from fractions import Fraction
from pathlib import Path
from typing import NoReturn

import av
import cv2
import numpy as np
import pytest

from foreglow.display.overlay import annotate
from foreglow.display.video import PictureSink, VideoSink
from foreglow.types import Frame
from tests.linux import needs_full_disk
from tests.stand_ins import night_frames, night_image, result_of


def write_video(path: Path, frames: list[Frame], fps: float | None = None) -> None:
    sink = VideoSink(path, fps)
    for frame in frames:
        sink.write(frame, result_of(frame, [[10, 10, 30, 30]], [0.8]))
    sink.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fps", "rate"), [(None, Fraction(18)), (25.0, Fraction(25)), (30000 / 1001, Fraction(30000, 1001))]
)
def test_video_is_h264_of_all_frames(tmp_path: Path, fps: float | None, rate: Fraction) -> None:
    frames = night_frames(5)
    write_video(tmp_path / "overlay.mp4.partial", frames, fps)
    with av.open(str(tmp_path / "overlay.mp4.partial")) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.pix_fmt) == ("h264", "yuv420p")
        assert stream.average_rate == rate
        pictures = [picture.to_ndarray(format="bgr24") for picture in container.decode(stream)]
    assert len(pictures) == 5
    expected = annotate(frames[0], result_of(frames[0], [[10, 10, 30, 30]], [0.8]))
    assert pictures[0].shape == expected.shape
    assert np.abs(pictures[0].astype(int) - expected).mean() < 4


def test_frames_of_other_sizes_are_fitted_in(tmp_path: Path) -> None:
    frames = [Frame(night_image(0, h, w), 0) for h, w in ((96, 128), (65, 301), (301, 65), (96, 128))]
    write_video(tmp_path / "overlay.mp4", frames)
    with av.open(str(tmp_path / "overlay.mp4")) as container:
        shapes = {picture.to_ndarray(format="bgr24").shape for picture in container.decode(video=0)}
    assert len(shapes) == 1


def test_no_frames_leave_no_video(tmp_path: Path) -> None:
    write_video(tmp_path / "overlay.mp4", [])
    assert list(tmp_path.iterdir()) == []


def test_unwritable_video_names_its_path(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No such file") as caught:
        write_video(tmp_path / "absent" / "overlay.mp4", night_frames(1))
    assert caught.value.filename == str(tmp_path / "absent" / "overlay.mp4")


@needs_full_disk
def test_full_disk_names_the_video() -> None:
    sink = VideoSink(Path("/dev/full"))
    frame = night_frames(1)[0]
    with pytest.raises(OSError, match="No space left"):  # noqa: PT012 - the encoder may notice at either place
        sink.write(frame, result_of(frame, []))
        sink.close()
    sink.discard()


@pytest.mark.parametrize("fps", [0.0, -1.0, float("nan"), float("inf")])
def test_unfit_rate_is_refused(fps: float) -> None:
    with pytest.raises(ValueError, match="fps: expected a positive number"):
        VideoSink(Path("overlay.mp4"), fps)


def test_picture_is_a_png_of_the_frame(tmp_path: Path) -> None:
    frame = night_frames(1)[0]
    result = result_of(frame, [[10, 10, 30, 30]])
    sink = PictureSink(tmp_path / "overlay.png")
    sink.write(frame, result)
    sink.close()
    picture = cv2.imread(str(tmp_path / "overlay.png"))
    assert picture is not None
    assert (picture == annotate(frame, result)).all()


def test_discarded_picture_is_not_written(tmp_path: Path) -> None:
    frame = night_frames(1)[0]
    sink = PictureSink(tmp_path / "overlay.png")
    sink.write(frame, result_of(frame, []))
    sink.discard()
    sink.close()
    assert list(tmp_path.iterdir()) == []


def test_a_picture_that_cannot_be_drawn_ends_the_run(tmp_path: Path) -> None:
    def draw(frame: Frame, *_: object) -> NoReturn:
        raise ValueError(f"frame {frame.frame}")

    sink = VideoSink(tmp_path / "overlay.mp4", draw=draw)
    (frame,) = night_frames(1)
    sink.write(frame, result_of(frame, [[10, 10, 30, 30]]))
    with pytest.raises(ValueError, match="frame 0"):
        sink.close()
    sink.discard()
    assert list(tmp_path.iterdir()) == []


def test_frames_of_another_depth_have_a_curve_of_their_own(tmp_path: Path) -> None:
    shallow, deep = night_frames(2)
    deep = dataclasses.replace(deep, image=deep.image.astype(np.uint16) * 257)
    write_video(tmp_path / "overlay.mp4", [shallow, deep, shallow])
    with av.open(str(tmp_path / "overlay.mp4")) as container:
        assert len(list(container.decode(video=0))) == 3
