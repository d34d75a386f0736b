"""What a video says of how its pictures are shown: turned, mirrored, not square, beside a cover."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from av.stream import Disposition

from foreglow.datasets import Video
from foreglow.datasets.images import read_image
from tests.datasets.test_images import with_orientation
from tests.datasets.video.test_video_file import make_video


def test_pixels_that_are_not_square_are_told(tmp_path: Path) -> None:
    path = make_video(tmp_path / "hdv.mp4", pixel_aspect=Fraction(4, 3))
    (note,) = Video(path).notes
    assert note.startswith(f"{path}: its pixels are 1.33 times as wide as high (`ffmpeg ")
    assert next(iter(Video(path))).image.shape == (72, 96)
    assert not Video(make_video(tmp_path / "rounded.mp4", pixel_aspect=Fraction(200, 199))).notes


def test_a_second_video_stream_is_told(tmp_path: Path) -> None:
    """Cars' recorders put the cameras before and behind into one file."""
    path = tmp_path / "both.mp4"
    with av.open(str(path), "w") as container:
        streams: list[Any] = [container.add_stream("mpeg4", rate=25) for _ in range(2)]
        for stream in streams:
            stream.width, stream.height, stream.pix_fmt = 96, 72, "yuv420p"
        for index in range(6):
            for number, stream in enumerate(streams):
                picture = av.VideoFrame.from_ndarray(np.full((72, 96, 3), 50 + 100 * number, np.uint8), format="rgb24")
                picture.pts, picture.time_base = index, Fraction(1, 25)
                container.mux(stream.encode(picture))
        for stream in streams:
            container.mux(stream.encode(None))
    video = Video(path)
    (note,) = video.notes
    assert note.startswith(f"{path}: has 2 video streams, as of several cameras: the first one is read")
    assert [round(float(frame.image.mean()), -1) for frame in video] == [50.0] * 6


@pytest.mark.parametrize("orientation", range(1, 9))
def test_the_orientation_in_exif_is_applied(tmp_path: Path, orientation: int) -> None:
    stored = np.zeros((72, 96), np.uint8)
    stored[:30, :40] = 220
    photo = tmp_path / "photo.jpg"
    cv2.imwrite(str(photo), cv2.merge([stored] * 3))
    with_orientation(photo, orientation)
    with av.open(str(tmp_path / "clip.avi"), "w") as container:
        stream: Any = container.add_stream("mjpeg", rate=10)
        stream.width, stream.height, stream.pix_fmt = 96, 72, "yuvj420p"
        for number in range(3):
            packet = av.Packet(photo.read_bytes())
            packet.pts = packet.dts = number
            packet.time_base, packet.stream, packet.is_keyframe = Fraction(1, 10), stream, True
            container.mux(packet)
    expected = read_image(photo)
    for frame in Video(tmp_path / "clip.avi"):
        assert frame.image.shape == expected.shape
        assert np.abs(frame.image.astype(int) - expected).mean() < 3


def make_shown(path: Path, *, turned_deg: int, is_mirrored: bool) -> Path:
    """A film with a bright quarter at the upper left, and a display matrix."""
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = 128, 96, "yuv420p"
        stream.set_display_rotation(turned_deg, hflip=is_mirrored)
        image = np.zeros((96, 128, 3), np.uint8)
        image[:48, :64] = (250, 180, 180)  # grey 200, and reddish
        for _ in range(3):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode(None))
    return path


@pytest.mark.parametrize("turned_deg", [0, 90, 180, 270])
@pytest.mark.parametrize("is_mirrored", [False, True])
def test_a_display_matrix_is_applied(tmp_path: Path, turned_deg: int, is_mirrored: bool) -> None:
    path = make_shown(tmp_path / "clip.mp4", turned_deg=turned_deg, is_mirrored=is_mirrored)
    stored = np.zeros((96, 128))
    stored[:48, :64] = 200
    turned = np.rot90(stored, turned_deg // 90)
    expected = np.fliplr(turned) if is_mirrored else turned
    for frame in Video(path):
        assert frame.image.shape == expected.shape
        assert np.abs(frame.image - expected).mean() < 10
        assert frame.red_chroma is not None
        assert np.abs(frame.red_chroma - np.where(expected[::2, ::2] > 0, 128 + 29, 128)).mean() < 4


def test_other_turns_are_refused(tmp_path: Path) -> None:
    video = Video(make_shown(tmp_path / "clip.mp4", turned_deg=30, is_mirrored=False), on_error="skip")
    with pytest.raises(ValueError, match=r"clip\.mp4: frame 0: display matrix: expected quarter turns"):
        list(video)


def make_covered(path: Path, *, has_film: bool) -> Path:
    """An MP4 with a cover picture, which is its first stream."""
    with av.open(str(path), "w") as container:
        cover: Any = container.add_stream("mjpeg", rate=25)
        cover.width, cover.height, cover.pix_fmt = 200, 200, "yuvj420p"
        cover.disposition = Disposition.attached_pic
        film: Any = container.add_stream("mpeg4", rate=25)
        film.width, film.height, film.pix_fmt = 96, 72, "yuv420p"
        white = np.full((200, 200, 3), 255, np.uint8)
        container.mux(cover.encode(av.VideoFrame.from_ndarray(white, format="rgb24")))
        container.mux(cover.encode(None))
        for _ in range(5):
            dark = np.zeros((72, 96, 3), np.uint8)
            container.mux(film.encode(av.VideoFrame.from_ndarray(dark, format="rgb24")))
        container.mux(film.encode(None))
    data = path.read_bytes()
    header, tracks, user_data = (data.index(name) - 4 for name in (b"moov", b"trak", b"udta"))
    end = header + int.from_bytes(data[header : header + 4], "big")
    track = data[tracks:user_data] if has_film else data[tracks:user_data].replace(b"trak", b"free")
    path.write_bytes(data[:tracks] + data[user_data:end] + track + data[end:])
    return path


def test_a_cover_picture_is_not_the_video(tmp_path: Path) -> None:
    frames = list(Video(make_covered(tmp_path / "clip.mp4", has_film=True)))
    assert [frame.image.shape for frame in frames] == [(72, 96)] * 5
    assert max(frame.image.max() for frame in frames) < 20


def test_a_cover_picture_alone_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="expected a video stream, it has none"):
        Video(make_covered(tmp_path / "song.mp4", has_film=False))
