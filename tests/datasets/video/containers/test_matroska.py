"""Matroska files with damage between their frames, which FFmpeg passes over in silence, and whole ones of all kinds."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from foreglow.datasets import Video
from foreglow.datasets.video.containers import matroska
from foreglow.datasets.video.containers.matroska import walk
from tests.datasets.video.test_damage import GOP, make_coded, packets_of

NUM_FRAMES = 60
STEADY = tuple(40 * index for index in range(NUM_FRAMES))
UNEVEN = tuple(40 * index + 7 * (index % 3) + 900 * (index // 20) for index in range(NUM_FRAMES))


def make(path: Path, times_ms: tuple[int, ...] = STEADY, *, has_sound: bool = False, **options: str) -> Path:
    """Noise of 96x72 pixels as MJPEG at these times, and perhaps silence beside it; a cluster holds half a second."""
    options = {"cluster_time_limit": "500", **options}
    rng = np.random.default_rng(3)
    with av.open(str(path), "w", options=options) as container:
        stream: Any = container.add_stream("mjpeg", rate=25)
        stream.width, stream.height, stream.pix_fmt = 96, 72, "yuvj420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        sound: Any = container.add_stream("pcm_s16le", rate=8000) if has_sound else None
        for number, time in enumerate(times_ms):
            picture = av.VideoFrame.from_ndarray(rng.integers(0, 255, (72, 96, 3), np.uint8), format="rgb24")
            picture.pts, picture.time_base = time, Fraction(1, 1000)
            container.mux(stream.encode(picture))
            if sound is not None:
                silence = av.AudioFrame.from_ndarray(np.zeros((1, 320), np.int16), layout="mono")
                silence.sample_rate, silence.pts = 8000, 320 * number
                container.mux(sound.encode(silence))
        container.mux(stream.encode(None))
    return path


def block(path: Path, number: int) -> int:
    """Where the data of this frame's block begins: a byte for the track, two for the time, one for flags, the JPEG."""
    with av.open(str(path)) as container:
        packets = [packet for packet in container.demux(video=0) if packet.size]
    return path.read_bytes().index(bytes(packets[number])) - 4


def spans(path: Path) -> list[tuple[int, int]]:
    with path.open("rb") as file:
        return walk(file, path.stat().st_size).spans


def overwrite(path: Path, position: int, data: bytes) -> None:
    whole = bytearray(path.read_bytes())
    whole[position : position + len(data)] = data
    path.write_bytes(bytes(whole))


@pytest.mark.parametrize(
    "damage",
    [
        pytest.param(lambda start: (start, b"\x85"), id="track"),
        pytest.param(lambda start: (start - 4, bytes(4)), id="block"),
        pytest.param(lambda start: (start - 3000, bytes(9000)), id="blocks"),
        pytest.param(lambda start: (start - 2, b"\x41\x00"), id="size"),
    ],
)
def test_a_hole_is_told(tmp_path: Path, damage: Callable[[int], tuple[int, bytes]]) -> None:
    path = make(tmp_path / "clip.mkv")
    assert len(list(Video(path))) == NUM_FRAMES
    position, data = damage(block(path, 20))
    overwrite(path, position, data)
    expected = r"clip\.mkv: byte \d+: expected an element of a Matroska file, found damage; frames may be missing"
    with pytest.raises(ValueError, match=expected):
        Video(path)
    video = Video(path, on_error="skip")
    assert 20 < len(list(video)) < NUM_FRAMES
    assert len(video.lost_parts) == 1
    assert video.lost_parts[0] in video.skipped


@pytest.mark.parametrize(
    ("times_ms", "has_sound", "options"),
    [
        (STEADY, False, {}),
        (UNEVEN, False, {}),  # as of a phone: the rate varies, and where nothing moved it has no frames
        (STEADY, True, {}),
        (STEADY, False, {"live": "1"}),
        (STEADY, False, {"reserve_index_space": "20000"}),
        (STEADY, False, {"dash": "1"}),
    ],
)
def test_whole_files(tmp_path: Path, times_ms: tuple[int, ...], has_sound: bool, options: dict[str, str]) -> None:
    video = Video(make(tmp_path / "clip.mkv", times_ms, has_sound=has_sound, **options), on_error="skip")
    assert [frame.timestamp_ns // 1_000_000 for frame in video] == list(times_ms)
    assert not video.skipped


@pytest.mark.parametrize("number", [20, 59])
def test_what_a_killed_recorder_left_is_no_damage(tmp_path: Path, number: int) -> None:
    path = make(tmp_path / "clip.mkv", live="1")
    data, start = path.read_bytes(), block(path, number)
    for end in range(start - 6, start + 40, 5):
        path.write_bytes(data[:end])
        assert not spans(path)


def test_a_size_beyond_the_end_of_a_stream_is_damage(tmp_path: Path) -> None:
    path = make(tmp_path / "clip.mkv", live="1")
    start = block(path, 20)
    overwrite(path, start - 2, b"\x10\xff")
    assert spans(path)


def test_no_more_elements_are_looked_at_than_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = make(tmp_path / "clip.mkv")
    overwrite(path, block(path, 20), b"\x85")
    assert spans(path)
    monkeypatch.setattr(matroska, "MAX_ELEMENTS", 15)
    assert not spans(path)


def make_clustered(path: Path, codec: str, live: str = "0") -> Path:
    """A cluster holds half a second."""
    return make_coded(path, codec, NUM_FRAMES, cluster_time_limit="500", live=live)


CODED = [("clip.mkv", "libx264"), ("clip.mkv", "libx265"), ("clip.mkv", "mpeg4"), ("clip.webm", "libvpx")]


@pytest.mark.parametrize(("name", "codec"), CODED)
@pytest.mark.parametrize("length", [1, 60, 3000])
@pytest.mark.parametrize("live", ["0", "1"])
def test_missing_bytes_in_the_middle_are_told_and_marked(
    tmp_path: Path, name: str, codec: str, length: int, live: str
) -> None:
    """Of a file that says how long it is, they are missing at the end, too."""
    path = make_clustered(tmp_path / name, codec, live)
    whole = {frame.timestamp_ns: frame.image for frame in Video(path)}
    position, size = packets_of(path)[15]
    data = path.read_bytes()
    path.write_bytes(data[: position + size // 2] + data[position + size // 2 + length :])
    with pytest.raises(ValueError, match=r"byte \d+: expected an element .* found damage; frames may be missing"):
        Video(path)
    video = Video(path, on_error="mark")
    frames = list(video)
    assert 0 < len(frames) < NUM_FRAMES
    assert any("found damage; frames may be missing from there on" in line for line in video.lost_parts)
    assert any("bytes are missing at the end" in line for line in video.lost_parts) == (live == "0")
    assert any(frame.is_damaged for frame in frames)
    for frame in frames:
        assert frame.is_damaged or np.array_equal(frame.image, whole[frame.timestamp_ns])


@pytest.mark.parametrize("live", ["0", "1"])
def test_each_of_several_places_is_marked(tmp_path: Path, live: str) -> None:
    path = make_clustered(tmp_path / "clip.mkv", "libx264", live)
    packets, data = packets_of(path), path.read_bytes()
    for number in (40, 6):
        start = packets[number][0] + packets[number][1] // 2
        data = data[:start] + data[start + 20 :]
    path.write_bytes(data)
    frames = list(Video(path, on_error="mark"))
    marked = {round(frame.timestamp_ns / 40_000_000) for frame in frames if frame.is_damaged}
    assert any(number < 2 * GOP for number in marked)
    assert any(number >= 3 * GOP for number in marked)
    assert not marked & set(range(2 * GOP, 3 * GOP))


@pytest.mark.parametrize("live", ["0", "1"])
@pytest.mark.parametrize("kept", [0.2, 0.55, 0.9, 0.99])
def test_a_cut_file_has_no_damage_in_the_middle(tmp_path: Path, live: str, kept: float) -> None:
    path = make_clustered(tmp_path / "clip.mkv", "libx264", live)
    data = path.read_bytes()
    for end in range(int(kept * len(data)), int(kept * len(data)) + 60, 3):
        path.write_bytes(data[:end])
        assert not spans(path)


@pytest.mark.parametrize(("name", "codec"), CODED)
@pytest.mark.parametrize("live", ["0", "1"])
@pytest.mark.parametrize("kept", [0.5, 1.0])
def test_a_second_film_behind_the_first_is_told_and_not_read(
    tmp_path: Path, name: str, codec: str, live: str, kept: float
) -> None:
    """FFmpeg would read it as if the first went on."""
    path = make_clustered(tmp_path / name, codec, live)
    data, num_packets = path.read_bytes(), len(packets_of(path))
    path.write_bytes(data + data[: int(kept * len(data))])
    assert len(packets_of(path)) > num_packets
    with pytest.raises(ValueError, match=rf"byte {len(data)}: expected one film, found a second header; .* not read"):
        Video(path)
    video = Video(path, on_error="mark")
    frames = list(video)
    assert [round(frame.timestamp_ns / 40_000_000) for frame in frames] == list(range(NUM_FRAMES))
    assert not any(frame.is_damaged for frame in frames)
    assert len(video.lost_parts) == 1


def test_a_second_film_is_found_behind_damage_and_without_its_header(tmp_path: Path) -> None:
    path = make_clustered(tmp_path / "clip.mkv", "libx264")
    data = path.read_bytes()
    start = len(data) // 2
    path.write_bytes(data[:start] + data[start + 50 :] + data)
    video = Video(path, on_error="mark")
    assert max(frame.timestamp_ns for frame in video) < NUM_FRAMES * 40_000_000
    assert len(video.lost_parts) == 2
    path.write_bytes(data + bytes(100) + data[100:])
    video = Video(path, on_error="mark")
    assert len(list(video)) == NUM_FRAMES
    assert "expected one film" in video.lost_parts[0]


def test_other_data_behind_the_end_are_no_second_film(tmp_path: Path) -> None:
    path = make_clustered(tmp_path / "clip.mkv", "libx264")
    path.write_bytes(path.read_bytes() + np.random.default_rng(0).bytes(5000))
    video = Video(path, on_error="mark")
    assert len(list(video)) == NUM_FRAMES
    assert not video.skipped
