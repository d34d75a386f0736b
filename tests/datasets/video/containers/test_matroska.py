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
from foreglow.datasets.video.containers.matroska import first_damage

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
        assert first_damage(path) is None


def test_a_size_beyond_the_end_of_a_stream_is_damage(tmp_path: Path) -> None:
    path = make(tmp_path / "clip.mkv", live="1")
    start = block(path, 20)
    overwrite(path, start - 2, b"\x10\xff")
    assert first_damage(path) is not None


def test_no_more_elements_are_looked_at_than_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = make(tmp_path / "clip.mkv")
    overwrite(path, block(path, 20), b"\x85")
    assert first_damage(path) is not None
    monkeypatch.setattr(matroska, "MAX_ELEMENTS", 15)
    assert first_damage(path) is None
