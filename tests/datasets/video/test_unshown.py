"""Pictures that a decoder leaves out in silence, because what they need is damaged, are told, each of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import av
import pytest

from foreglow.datasets import Video
from foreglow.datasets.video.decoding import grey_image
from foreglow.datasets.video.h264_numbers import H264Numbers
from foreglow.datasets.video.unshown import Unshown
from foreglow.types import Image
from tests.datasets.video.test_damage import GOP, make_noise, make_stream, packets_of, write_h264

H264 = [
    ("night.h264", "bframes=0"),
    ("night.mkv", "bframes=2"),
    ("night.mp4", ""),
    ("night.flv", ""),
    ("night.avi", ""),
]


@pytest.mark.parametrize(("name", "parameters"), H264)
@pytest.mark.parametrize("frame", [0, GOP])
def test_pictures_after_an_overwritten_key_frame_of_h264(
    tmp_path: Path, name: str, parameters: str, frame: int
) -> None:
    path = tmp_path / name
    write_h264(path, "yuv420p", parameters)
    assert len(list(Video(path))) == 40
    position, size = packets_of(path)[frame]
    data = bytearray(path.read_bytes())
    head = 0 if name.endswith(".h264") else 20  # of the container
    data[position + head : position + size] = b"\xaa" * (size - head)
    path.write_bytes(bytes(data))
    video = Video(path, on_error="mark")
    frames = list(video)
    num_intact = sum(not frame.is_damaged for frame in frames)
    assert num_intact in (40 - GOP, 40 - 2 * GOP)  # the latter if the parameters of the next are damaged, too
    num_parts = 1 if name.endswith((".h264", ".avi")) else 0  # of the frame before: here nothing begins a frame
    assert 40 - num_parts <= len(frames) + len(video.skipped) <= 40


def test_a_joined_stream_of_h265_tells_what_cannot_be_decoded(tmp_path: Path) -> None:
    path = tmp_path / "night.hevc"
    with av.open(str(path), "w") as container:
        parameters = f"log-level=none:keyint={GOP}:min-keyint={GOP}:scenecut=0:bframes=0:open-gop=0"
        stream = container.add_stream("libx265", rate=18, options={"x265-params": parameters})
        stream.width, stream.height, stream.pix_fmt = 128, 96, "yuv420p"
        for _ in range(3 * GOP):
            container.mux(stream.encode(av.VideoFrame(128, 96, "yuv420p")))
        container.mux(stream.encode(None))
    position, _ = packets_of(path)[3]
    path.write_bytes(path.read_bytes()[position:])
    video = Video(path, on_error="mark")
    assert len(list(video)) == 2 * GOP
    assert len(video.skipped) == GOP - 3


@pytest.mark.parametrize(("name", "codec"), [("night.mp4", "libsvtav1"), ("night.webm", "libvpx-vp9")])
def test_a_last_packet_that_gives_nothing_is_told(tmp_path: Path, name: str, codec: str) -> None:
    path = make_noise(tmp_path / name, codec)
    assert len(list(Video(path))) == 30
    position, size = packets_of(path)[-1]
    data = bytearray(path.read_bytes())
    data[position + 5 : position + size] = b"\xff" * (size - 5)
    path.write_bytes(bytes(data))
    video = Video(path, on_error="mark")
    num_given = len(list(video))
    assert num_given < 30
    assert num_given + len(video.skipped) == 30


def test_mpeg_2_that_lacks_its_first_headers_tells_what_it_cannot_decode(tmp_path: Path) -> None:
    path = tmp_path / "night.ts"
    data = make_stream(path)
    position, _ = packets_of(path)[0]
    place = position + 20  # within the first packet of the video; packets begin elsewhere from there on
    path.write_bytes(data[:place] + b"1234" + data[place:])
    video = Video(path, on_error="mark")
    frames = list(video)
    assert len(frames) == 60 - GOP
    assert len(frames) + len(video.skipped) >= 59  # the first packet is none


def test_references_of_vp8_that_are_not_shown_are_not_waited_for() -> None:
    unshown = Unshown("vp8", None)
    for number, data in enumerate([b"\x10\x02", b"\x00\x02", b"\x31"]):
        unshown.await_picture(number, data)
    assert unshown.numbers == [0, 2]


def test_where_units_have_sizes_each_packet_is_a_picture() -> None:
    unshown = Unshown("h264", b"\x01\x64\x00\x1f\xff\xe1\x00\x00\x01\x00")
    unshown.await_picture(0, b"\xaa" * 20)
    unshown.await_picture(1, b"\x00\x00\x00\x01\x65")
    assert unshown.numbers == [0, 1]
    assert unshown.lost_before(1, is_key=True) == [0]


def test_one_of_two_fields_is_known() -> None:
    """The sequence parameters of a camera of fields, and a slice of one: bits by the standard, 7.3.2.1.1 and 7.3.3."""
    sps = bits("01000010 00000000 00011111", "1 1 1 1", "010 0", "0001000 00110", "0 1 1 0 0")
    numbers = H264Numbers(b"\0\0\1\x67" + sps)
    number = "0001"
    field, frame = (bits("1 1 1", number, is_field, "1 1 1 1 1 1 1") for is_field in "10")
    numbers.are_broken(b"\0\0\1\x65" + field)
    assert numbers.is_field
    numbers.are_broken(b"\0\0\1\x65" + frame)
    assert not numbers.is_field


def test_one_frame_that_would_be_shown_at_an_angle_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As after damage of what H.265 says beside its pictures."""
    path = tmp_path / "night.mkv"
    write_h264(path, "yuv420p", "")
    turns = iter([False] * 5 + [True] + [False] * 34)

    def upright(picture: Any) -> Image:
        if next(turns):
            raise ValueError("display matrix: expected quarter turns and mirroring")
        return grey_image(picture)

    monkeypatch.setattr("foreglow.datasets.video.video_file.grey_image", upright)
    video = Video(path, on_error="skip")
    assert [frame.frame for frame in video] == [*range(5), *range(6, 40)]
    assert video.skipped == [f"{path}: frame 5: display matrix: expected quarter turns and mirroring"]


def bits(*parts: str) -> bytes:
    """The bytes of these bits, filled up with ones."""
    text = "".join(parts).replace(" ", "")
    text += "1" * (-len(text) % 8 + 64)
    return bytes(int(text[start : start + 8], 2) for start in range(0, len(text) // 8 * 8, 8))
