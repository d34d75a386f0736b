"""Annotated videos and pictures: what is written can be read by others."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from fractions import Fraction
from pathlib import Path
from typing import NoReturn

import av
import cv2
import numpy as np
import pytest

from foreglow.datasets.video import Video
from foreglow.display.overlay import annotate
from foreglow.display.video import DEFAULT_FPS, PictureSink, VideoSink
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
    period_ns = 1e9 / (fps or DEFAULT_FPS)
    frames = [dataclasses.replace(frame, timestamp_ns=round(k * period_ns)) for k, frame in enumerate(night_frames(5))]
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


def shown_at_s(path: Path) -> list[float]:
    """When another program shows each picture, and when the film ends; our own reader must agree."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        times_s = [float(picture.time) for picture in container.decode(stream)]
        assert stream.duration is not None
        assert stream.time_base is not None
        end_s = float(stream.duration * stream.time_base)
    assert [frame.timestamp_ns / 1e9 for frame in Video(path)] == pytest.approx(times_s)
    return [*times_s, end_s]


def written_at_s(path: Path, *moments: tuple[float, str]) -> list[float]:
    """As `shown_at_s`, of a video of frames at these times, s, in these sequences, at usually 20 Hz."""
    write_video(
        path, [Frame(night_image(k), round(1e9 * t), sequence=name) for k, (t, name) in enumerate(moments)], 20.0
    )
    return shown_at_s(path)


def test_video_keeps_uneven_times(tmp_path: Path) -> None:
    times_s = [1e6, 1e6 + 0.013, 1e6 + 0.4, 1e6 + 0.433367, 1e6 + 75.2]
    shown = written_at_s(tmp_path / "overlay.mp4", *((time_s, "") for time_s in times_s))
    assert shown == pytest.approx([0.0, 0.013, 0.4, 0.433367, 75.2, 75.25], abs=6e-6)


def test_each_sequence_of_a_video_follows_the_one_before(tmp_path: Path) -> None:
    moments = [(0.0, "one"), (0.1, "one"), (9000.0, "two"), (9000.2, "two"), (0.0, "three"), (0.3, "three")]
    shown = written_at_s(tmp_path / "overlay.mp4", *moments)
    assert shown == pytest.approx([0.0, 0.1, 0.15, 0.35, 0.4, 0.7, 0.75], abs=6e-6)


@pytest.mark.parametrize(
    ("times_s", "expected"),
    [
        pytest.param([0.0, 0.0, 0.0], [0.0, 0.05, 0.1, 0.15], id="all the same"),
        pytest.param([0.0, 0.1, 0.05, 0.3], [0.0, 0.1, 0.15, 0.3, 0.35], id="late frame"),
        pytest.param([5.0, 5.1, 0.0, 0.2], [0.0, 0.1, 0.15, 0.35, 0.4], id="begins anew"),
        pytest.param([0.0, 1e9, 1e9 + 0.2], [0.0, 0.05, 0.25, 0.3], id="set clock"),
    ],
)
def test_pictures_without_a_usable_time_are_shown_for_a_frame(
    tmp_path: Path, times_s: list[float], expected: list[float]
) -> None:
    assert written_at_s(tmp_path / "overlay.mp4", *((t, "") for t in times_s)) == pytest.approx(expected, abs=6e-6)


@pytest.mark.parametrize("fps", [1e-9, 1e9])
def test_a_rate_that_is_no_rate_leaves_a_video(tmp_path: Path, fps: float) -> None:
    write_video(tmp_path / "overlay.mp4", night_frames(3), fps)
    assert shown_at_s(tmp_path / "overlay.mp4")[:3] == pytest.approx([0.0, 0.05, 0.1])


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


FILLING = """
import resource, signal, sys
from pathlib import Path
import numpy as np
from foreglow.display.video import VideoSink
from foreglow.types import Frame
from tests.stand_ins import result_of

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # as Python does itself
path, hard = Path(sys.argv[1]), resource.getrlimit(resource.RLIMIT_FSIZE)[1]
noise = np.random.default_rng(0).integers(0, 255, (8, 64, 96), np.uint8)
for limit in [*range(0, 3_000, 300), *range(3_000, 20_000, 1_700), *range(20_000, 200_000, 40_000), 5_000_000]:
    sink = VideoSink(path)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    try:
        for number, image in enumerate(noise):
            frame = Frame(image, 50_000_000 * number)
            sink.write(frame, result_of(frame, []))
        sink.close()
    except OSError as error:
        assert error.filename == str(path)
        print("refused", limit)
    else:
        print("whole", limit)
    for _ in range(2):
        sink.discard()
    assert not [each for each in Path("/proc/self/fd").glob("*") if each.resolve() == path.resolve()], limit
"""
"""Writes a film under many limits of a file's size; pictures wait in the sink when the first one fails."""


@pytest.mark.process
@pytest.mark.slow
def test_a_disk_that_fills_at_any_byte_is_an_error_and_no_signal(tmp_path: Path) -> None:
    program = [sys.executable, "-c", FILLING, str(tmp_path / "overlay.mp4")]
    ended = subprocess.run(program, capture_output=True, text=True, check=False, cwd=Path(__file__).parents[2])
    assert ended.returncode == 0, (ended.returncode, ended.stdout, ended.stderr)
    assert ended.stderr == ""
    words = [line.split()[0] for line in ended.stdout.splitlines()]
    assert words == sorted(words)
    assert set(words) == {"refused", "whole"}


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
