"""Zeros in the middle of a frame of H.264 or H.265 are damage: the decoders make a wrong picture of them, and go on."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest

from foreglow.datasets import Video
from foreglow.datasets.video.coded_units import has_forbidden_bytes
from tests.datasets.video.test_damage import GOP, packets_of, write_h264


@pytest.mark.parametrize("name", ["night.mp4", "night.mkv", "night.flv", "night.avi", "night.h264"])
@pytest.mark.parametrize("frame", [0, GOP, GOP + 3])
def test_zeros_within_a_frame_of_h264(tmp_path: Path, name: str, frame: int) -> None:
    path = tmp_path / name
    write_h264(path, "yuv420p", "slices=1")
    whole = [frame.image for frame in Video(path)]
    position, size = packets_of(path)[frame]
    data = bytearray(path.read_bytes())
    data[position + size // 2 : position + size * 3 // 4] = bytes(size * 3 // 4 - size // 2)
    path.write_bytes(bytes(data))
    frames = list(Video(path, on_error="mark"))
    assert any(frame.is_damaged for frame in frames)
    for found in frames:
        assert found.is_damaged or min(np.abs(found.image.astype(int) - image).max() for image in whole) == 0


def test_zeros_within_a_frame_of_h265(tmp_path: Path) -> None:
    path = tmp_path / "night.mkv"
    noise = np.random.default_rng(1).integers(0, 255, (96, 128 + 24), np.uint8)
    with av.open(str(path), "w") as container:
        options = {"x265-params": "log-level=none:keyint=8:bframes=0"}
        stream = container.add_stream("libx265", rate=18, options=options)
        stream.width, stream.height, stream.pix_fmt = 128, 96, "yuv420p"
        for index in range(24):
            view = np.ascontiguousarray(noise[:, index : index + 128])
            container.mux(stream.encode(av.VideoFrame.from_ndarray(view, format="gray").reformat(format="yuv420p")))
        container.mux(stream.encode(None))
    assert not any(frame.is_damaged for frame in Video(path, on_error="mark"))
    position, size = packets_of(path)[10]
    data = bytearray(path.read_bytes())
    data[position + size // 2 : position + size // 2 + 40] = bytes(40)
    path.write_bytes(bytes(data))
    video = Video(path, on_error="mark")
    assert any(frame.is_damaged for frame in video) or video.skipped


@pytest.mark.parametrize(
    ("data", "size_bytes", "is_wrong"),
    [
        (b"\0\0\0\1\x65\x80\0\0\3\0\0\3\1\x80\0\0\0\1\x41\x80\0\0", 0, False),
        (b"\0\0\0\1\x65\x80\0\0\0\0\x80", 0, True),
        (b"\0\0\0\1\x65\x80\0\0\2", 0, True),
        (b"\0\0\0\6\x65\x80\0\0\3\1\0\0\0\5\x41\x80\0\0\0", 4, False),
        (b"\0\0\0\7\x65\x80\0\0\1\1\1", 4, True),
        (b"\0\0\0\7\x65\x80\0\0\0\0\1", 4, True),
    ],
)
def test_bytes_that_may_not_be_there(data: bytes, size_bytes: int, is_wrong: bool) -> None:
    assert has_forbidden_bytes(data, size_bytes) is is_wrong
