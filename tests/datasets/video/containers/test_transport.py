"""What a transport stream has lost: it is found wherever it was, and never where nothing is lost."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from foreglow.datasets import Video
from foreglow.datasets.video.containers import transport
from foreglow.datasets.video.containers.transport import PACKETS, TransportLosses
from tests.datasets.video.test_damage import GOP, make_noise, make_stream, packets_of

PID = 0x100
EVERYTHING = 1 << 62


def in_packets_of(data: bytes, length: int, offset: int) -> bytes:
    """A transport stream in packets of another size."""
    packets = np.frombuffer(data, np.uint8).reshape(-1, 188)
    return np.pad(packets, ((0, 0), (offset, length - 188 - offset))).tobytes()


def made_packets(counters: list[int], *, seed: int = 0) -> bytearray:
    """Packets of the stream with these counters, with any bytes but 0x47 in them."""
    data = np.random.default_rng(seed).integers(0x48, 0x100, (len(counters), 188), np.uint8)
    for packet, counter in zip(data, counters, strict=True):
        packet[:4] = 0x47, PID >> 8, PID & 0xFF, 0x10 | counter & 0xF
    return bytearray(data.tobytes())


def losses_of(path: Path, data: bytes) -> TransportLosses:
    path.write_bytes(data)
    return TransportLosses(path, PID)


def frame_starts(data: bytes) -> list[int]:
    """Numbers of the packets in which frames of the video begin."""
    packets = np.frombuffer(data, np.uint8).reshape(-1, 188)
    ours = ((packets[:, 1] & 0x1F) == PID >> 8) & (packets[:, 2] == PID & 0xFF)
    return np.flatnonzero(ours & (packets[:, 1] & 0x40 != 0)).tolist()


@pytest.mark.parametrize(("length", "offset"), PACKETS)
@pytest.mark.parametrize("codec", ["mpeg2video", "mpeg4", "libx264", "libx265"])
def test_frames_are_marked_whose_beginning_is_lost(tmp_path: Path, codec: str, length: int, offset: int) -> None:
    """The packet in which a frame begins is filled with zeros from its header on, and so are the next."""
    path = tmp_path / "night.ts"
    data = make_stream(path, num_frames=40, codec=codec)
    starts = frame_starts(data)
    whole = in_packets_of(data, length, offset)
    path.write_bytes(whole)
    clean = {frame.timestamp_ns: frame.image for frame in Video(path)}
    assert len(clean) == 40
    for number in range(4, 36, 4 if length == 188 else 12):
        broken, start = bytearray(whole), starts[number] * length
        broken[start + 20 : start + 5 * length - 100] = bytes(5 * length - 120)
        path.write_bytes(broken)
        video = Video(path, on_error="mark")
        frames = list(video)
        assert any(frame.is_damaged for frame in frames) or video.skipped
        for frame in frames:
            if not frame.is_damaged:
                assert (np.abs(clean[frame.timestamp_ns].astype(int) - frame.image) > 20).mean() < 0.01


@pytest.mark.parametrize("suffix", [".ts", ".m2ts"])
@pytest.mark.parametrize("codec", ["mpeg2video", "mpeg4", "libx264", "libx265"])
def test_intact_streams_give_no_alarm(tmp_path: Path, codec: str, suffix: str) -> None:
    video = Video(make_noise(tmp_path / f"clip{suffix}", codec), on_error="mark")
    assert [frame.is_damaged for frame in video] == [False] * 30
    assert video.skipped == []


@pytest.mark.parametrize("codec", ["mpeg2video", "mpeg4", "libx264"])
def test_only_the_end_of_the_first_of_two_recordings_is_marked(tmp_path: Path, codec: str) -> None:
    """Where two were appended to each other, nobody knows whether the first had another frame; the second is whole."""
    path = tmp_path / "two.ts"
    path.write_bytes(2 * make_stream(tmp_path / "first.ts", num_frames=50, codec=codec))
    frames = list(Video(path, on_error="mark"))
    assert [frame.is_damaged for frame in frames if frame.sequence] == [False] * 50
    assert not any(frame.is_damaged for frame in frames[:46])


@pytest.mark.parametrize("codec", ["mpeg2video", "mpeg4", "libx264", "libx265"])
def test_the_last_frame_of_a_stream_that_was_cut_between_packets_is_marked(tmp_path: Path, codec: str) -> None:
    path = tmp_path / "night.ts"
    data = make_stream(path, num_frames=40, codec=codec)
    assert not any(frame.is_damaged for frame in Video(path))
    starts = frame_starts(data)
    start, stop = max(itertools.pairwise(starts[20:]), key=lambda pair: pair[1] - pair[0])
    path.write_bytes(data[: (start + stop) // 2 * 188])
    video = Video(path, on_error="mark")
    is_damaged = [frame.is_damaged for frame in video]
    assert any(is_damaged[-5:]) or video.skipped  # frames may come in another order than they are coded
    assert not any(is_damaged[:-5])


def test_a_key_frame_right_behind_a_loss_ends_it(tmp_path: Path) -> None:
    path = tmp_path / "night.ts"
    data = bytearray(make_stream(path, num_frames=40))
    start = packets_of(path)[2 * GOP][0]
    data[start - 2 * 188 : start] = bytes(2 * 188)
    path.write_bytes(data)
    marked = [frame.frame for frame in Video(path, on_error="mark") if frame.is_damaged]
    assert marked
    assert set(marked) <= set(range(2 * GOP - 4, 2 * GOP))


@pytest.mark.parametrize("piece", [1000, 5000, 1 << 20])
@pytest.mark.parametrize("seed", range(5))
def test_every_loss_is_found_where_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int, piece: int
) -> None:
    monkeypatch.setattr(transport, "_PIECE", piece)
    rng = np.random.default_rng(seed)
    path = tmp_path / "made.ts"
    for length, offset in PACKETS:
        whole = in_packets_of(bytes(made_packets(list(range(200)), seed=seed)), length, offset)
        assert not losses_of(path, whole).are_between(0, EVERYTHING)
        first, num = int(rng.integers(20, 150)), int(rng.integers(1, 16))
        start, stop = first * length, (first + num) * length
        for broken, end in (
            (whole[:start] + whole[stop:], start),
            (whole[:start] + bytes(stop - start) + whole[stop:], stop),
            (whole[:start] + rng.integers(0x48, 0x100, 77, np.uint8).tobytes() + whole[start:], start + 77),
        ):
            losses = losses_of(path, broken)
            assert not losses.are_between(0, start - length)
            assert losses.are_between(start - length, end)
            assert not losses.are_between(end, EVERYTHING)


def test_what_the_standard_allows_is_no_loss(tmp_path: Path) -> None:
    path = tmp_path / "made.ts"
    whole = bytes(made_packets(list(range(60))))
    packets = [whole[start : start + 188] for start in range(0, len(whole), 188)]
    twice = [*packets[:30], packets[29], *packets[30:]]
    assert not losses_of(path, b"".join(twice)).are_between(0, EVERYTHING)
    stuffing = [*packets[:30], b"\x47\x1f\xff\x13" + bytes(184), *packets[30:]]
    assert not losses_of(path, b"".join(stuffing)).are_between(0, EVERYTHING)
    no_payload = [*packets[:30], bytes([0x47, 1, 0, 0x20 | 13, 183, 0]) + bytes(182), *packets[30:]]
    assert not losses_of(path, b"".join(no_payload)).are_between(0, EVERYTHING)
    anew = [*packets[:30], bytes([0x47, 1, 0, 0x30 | 7, 1, 0x80]) + bytes(182), *packets[40:]]  # 40 follows 7
    assert not losses_of(path, b"".join(anew)).are_between(0, EVERYTHING)


def test_what_the_standard_does_not_allow_is_a_loss(tmp_path: Path) -> None:
    path = tmp_path / "made.ts"
    other = bytes(made_packets([29], seed=1))
    data = made_packets(list(range(60)))
    assert losses_of(path, bytes(data[: 30 * 188] + other + data[30 * 188 :])).are_between(0, EVERYTHING)
    data[30 * 188 + 1] |= 0x80  # the receiver says that it is wrong
    losses = losses_of(path, bytes(data))
    assert losses.are_between(30 * 188, 31 * 188)
    assert not losses.are_between(31 * 188, EVERYTHING)


@pytest.mark.parametrize("seed", range(10))
def test_any_bytes_are_read_to_their_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    monkeypatch.setattr(transport, "_PIECE", 2000)
    rng = np.random.default_rng(seed)
    data = rng.choice([0x47, 0x01, 0x00], int(rng.integers(0, 9000)), p=[0.6, 0.2, 0.2]).astype(np.uint8).tobytes()
    assert losses_of(tmp_path / "any.ts", data).are_between(0, EVERYTHING) in (True, False)


def test_packets_come_before_the_error_of_their_container(tmp_path: Path) -> None:
    class Packet:
        def __init__(self, pos: int | None, size: int) -> None:
            self.pos, self.size = pos, size

    def broken_off() -> Any:
        yield Packet(0, 500)
        yield Packet(None, 500)
        yield Packet(20 * 188, 500)
        raise av.error.InvalidDataError(22, "the end")

    data = made_packets(list(range(40)))
    losses = losses_of(tmp_path / "made.ts", bytes(data[: 10 * 188] + data[12 * 188 :]))
    found: list[bool] = []
    with pytest.raises(av.error.InvalidDataError):
        found.extend(is_lost for _, is_lost in transport.with_losses(broken_off(), losses))
    assert found == [True, True, False]
