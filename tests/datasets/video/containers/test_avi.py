"""AVI files with damage between their frames, behind which FFmpeg gives frames too early times, and whole ones."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from foreglow.datasets import Video
from foreglow.datasets.video.containers import avi
from foreglow.datasets.video.containers.ends import hole
from tests.datasets.video.test_damage import GOP, make_coded, packets_of

NUM_FRAMES = 60


def make_missing(path: Path, codec: str, places: tuple[tuple[int, int], ...]) -> list[bytes]:
    """A film without so many bytes in the middle of these packets; returns the whole one's images."""
    make_coded(path, codec, NUM_FRAMES)
    images = [frame.image.tobytes() for frame in Video(path)]
    data, packets = path.read_bytes(), packets_of(path)
    for number, length in sorted(places, reverse=True):
        start = packets[number][0] + packets[number][1] // 2
        data = data[:start] + data[start + length :]
    path.write_bytes(data)
    return images


def damage(data: bytes) -> list[tuple[int, int]]:
    return avi.walk(io.BytesIO(data), len(data))[0]


@pytest.mark.parametrize("codec", ["libx264", "mpeg4", "mjpeg", "ffv1"])
@pytest.mark.parametrize("length", [1, 2, 60, 700, 3000])
def test_missing_bytes_in_the_middle_are_told_and_marked(tmp_path: Path, codec: str, length: int) -> None:
    """They are missing at the end, too, by the size that the file says it has."""
    path = tmp_path / "clip.avi"
    images = make_missing(path, codec, ((15, length),))
    with pytest.raises(
        ValueError, match=r"byte \d+: expected a chunk .* those behind have too small numbers and times"
    ):
        Video(path)
    video = Video(path, on_error="mark")
    frames = list(video)
    assert [line for line in video.lost_parts if "found damage" in line]
    assert [line for line in video.lost_parts if f"{length} bytes are missing at the end" in line]
    marked = [frame.frame for frame in frames if frame.is_damaged]
    assert marked
    assert set(marked) <= set(range(GOP, 3 * GOP))
    good = [images.index(frame.image.tobytes()) for frame in frames if not frame.is_damaged]
    assert good == sorted(set(good))
    assert good[:GOP] == list(range(GOP))
    assert good[-1] == NUM_FRAMES - 1


def test_each_of_several_places_is_marked(tmp_path: Path) -> None:
    path = tmp_path / "clip.avi"
    images = make_missing(path, "libx264", ((6, 21), (40, 22)))
    frames = list(Video(path, on_error="mark"))
    good = [images.index(frame.image.tobytes()) for frame in frames if not frame.is_damaged]
    assert not {*range(6, GOP), *range(40, 4 * GOP)} & set(good)
    assert set(range(GOP, 3 * GOP)) <= set(good)


@pytest.mark.parametrize("codec", ["libx264", "mjpeg"])
def test_a_cut_file_has_no_damage_in_the_middle(tmp_path: Path, codec: str) -> None:
    data = make_coded(tmp_path / "clip.avi", codec, NUM_FRAMES).read_bytes()
    for end in range(len(data) // 4, len(data), len(data) // 150):
        assert not damage(data[:end])


def test_a_fill_byte_that_only_one_chunk_lacks_is_a_missing_byte() -> None:
    """Of a chunk of odd length, whose fill byte then stands for its last one."""
    frames = [(b"00dc", np.random.default_rng(number).bytes(301)) for number in range(6)]
    data = chunks((b"RIFF", b"AVI " + chunks((b"LIST", b"movi" + chunks(*frames)))))
    assert not damage(data)
    start = data.index(frames[3][1]) - 8
    data = data[: start + 100] + data[start + 101 :]
    assert damage(data) == [(start, start + 8 + 301)]


def chunks(*parts: tuple[bytes, bytes], is_padded: bool = True) -> bytes:
    fill = b"\0" if is_padded else b""
    return b"".join(name + len(data).to_bytes(4, "little") + data + fill * (len(data) % 2) for name, data in parts)


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda data: data[:4] + bytes(4) + data[8:-60], id="killed"),
        pytest.param(lambda data: data + bytes(1000), id="zeros behind its end"),
        pytest.param(lambda data: data + chunks((b"RIFF", b"AVIX" + chunks((b"00dc", b"123")))), id="second list"),
    ],
)
@pytest.mark.parametrize("is_padded", [True, False])
def test_avi_without_damage(tmp_path: Path, change: Callable[[bytes], bytes], *, is_padded: bool) -> None:
    """Chunks of 0 bytes are frames that were left out; some recorders do not fill odd lengths."""
    path = tmp_path / "clip.avi"
    frames = [(b"00dc", bytes(length)) for length in (0, 7, 100, 0, 33, 121)]
    movi = (b"LIST", b"movi" + chunks(*frames, is_padded=is_padded))
    data = chunks((b"RIFF", b"AVI " + chunks((b"JUNK", bytes(10)), movi)))
    path.write_bytes(change(data))
    assert hole(path) is None


def test_no_more_chunks_are_looked_at_than_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "clip.avi"
    make_missing(path, "mjpeg", ((6, 21), (40, 22)))
    data = path.read_bytes()
    assert len(damage(data)) == 2
    monkeypatch.setattr(avi, "MAX_SPANS", 1)
    assert len(damage(data)) == 1
    monkeypatch.setattr(avi, "MAX_CHUNKS", 5)
    assert not damage(data)
