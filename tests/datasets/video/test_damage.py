"""Damage of a video: it is found in the same frames each time, also in the last ones, and never where there is none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from foreglow.datasets import Video
from foreglow.datasets.image_bytes import MAX_SCANS, is_damaged_mjpeg
from foreglow.datasets.source import OnError
from foreglow.datasets.video.h264_numbers import H264Numbers
from tests.bombs import many_scans
from tests.datasets.video.test_video_file import NUM_FRAMES, make_video

GOP = 12


def make_stream(path: Path, *, num_frames: int = 60, codec: str = "mpeg2video", pid: int = 0x100) -> bytes:
    """A transport stream of noise that moves, with a key frame every `GOP` frames and some packets for each frame.

    With the suffix .ogg, an Ogg file with a page for each frame.
    """
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 255, (96, 128 + num_frames, 3), np.uint8)
    is_ogg = path.suffix == ".ogg"
    options = {"page_duration": "1000"} if is_ogg else {"mpegts_start_pid": str(pid)}
    with av.open(str(path), "w", format="ogg" if is_ogg else "mpegts", options=options) as container:
        stream: Any = container.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = 128, 96, "yuv420p"
        stream.bit_rate, stream.gop_size = 1_000_000, GOP
        for index in range(num_frames):
            view = np.ascontiguousarray(noise[:, index : index + 128])
            container.mux(stream.encode(av.VideoFrame.from_ndarray(view, format="rgb24")))
        container.mux(stream.encode(None))
    return path.read_bytes()


def packets_of(path: Path) -> list[tuple[int, int]]:
    """Where the packets of a video are in its file, and their sizes."""
    container: Any = av.open(str(path))
    with container:
        return [(packet.pos, packet.size) for packet in container.demux(container.streams.video[0]) if packet.size]


def damaged_stream(path: Path, frame: int) -> None:
    """The stream with a packet missing from the middle of a frame."""
    data = make_stream(path)
    position, size = packets_of(path)[frame]
    start = (position + size // 2) // 188 * 188
    path.write_bytes(data[:start] + data[start + 188 :])


def test_times_that_begin_anew_begin_a_sequence(tmp_path: Path) -> None:
    """Two recordings that were appended to each other: no track and no command goes on from the one to the other."""
    path = tmp_path / "two.ts"
    path.write_bytes(2 * make_stream(tmp_path / "first.ts"))
    frames = list(Video(path, on_error="mark"))
    sequences = list(dict.fromkeys(frame.sequence for frame in frames))
    second = next(frame for frame in frames if frame.sequence)
    assert sequences == ["", f"frame {second.frame}"]
    for sequence in sequences:
        times_ns = [frame.timestamp_ns for frame in frames if frame.sequence == sequence]
        assert times_ns == sorted(times_ns)


def test_what_goes_on_as_another_stream_is_told(tmp_path: Path) -> None:
    path = tmp_path / "two.ts"
    path.write_bytes(make_stream(tmp_path / "a.ts") + make_stream(tmp_path / "b.ts", pid=0x200))
    with pytest.raises(ValueError, match=r"two\.ts: frame 60: cannot be read: another video stream begins"):
        list(Video(path))
    video = Video(path, on_error="skip")
    assert len(list(video)) == 60
    assert len(video.skipped) == 1


def test_a_second_stream_beside_the_first_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "front_and_rear.mkv"
    with av.open(str(path), "w") as container:
        streams: list[Any] = [container.add_stream("mpeg4", rate=25) for _ in range(2)]
        for number, stream in enumerate(streams):
            stream.width, stream.height, stream.pix_fmt = 64 * (number + 1), 64, "yuv420p"
        for index in range(30):
            for stream in streams if index > 4 else streams[:1]:
                image = np.full((64, stream.width, 3), 10 + index, np.uint8)
                container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        for stream in streams:
            container.mux(stream.encode(None))
    assert [frame.image.shape for frame in Video(path)] == 30 * [(64, 64)]


def test_a_lost_packet_marks_frames_until_the_next_key_frame(tmp_path: Path) -> None:
    path = tmp_path / "stream.ts"
    make_stream(path)
    clean = [frame.image for frame in Video(path)]
    damaged_stream(path, 20)
    with pytest.raises(ValueError, match=r"stream\.ts: frame \d+: expected an undamaged frame"):
        list(Video(path))
    video = Video(path, on_error="mark")
    frames = list(video)
    is_off = [bool((frame.image != image).any()) for frame, image in zip(frames, clean, strict=True)]
    is_damaged = [frame.is_damaged for frame in frames]
    assert any(is_off)
    assert all(marked for marked, off in zip(is_damaged, is_off, strict=True) if off)
    assert not any(is_damaged[:18])  # known early, as packets are read ahead
    assert not any(is_damaged[2 * GOP + 1 :])
    assert video.skipped == []
    kept = list(Video(path, on_error="skip"))
    assert [frame.frame for frame in kept] == [frame.frame for frame in frames if not frame.is_damaged]


def test_a_damaged_key_frame_does_not_end_the_damage(tmp_path: Path) -> None:
    path = tmp_path / "stream.ts"
    damaged_stream(path, 2 * GOP)
    is_damaged = [frame.is_damaged for frame in Video(path, on_error="mark")]
    assert all(is_damaged[2 * GOP : 3 * GOP])
    assert not any(is_damaged[3 * GOP + 1 :])


def test_frames_before_the_first_key_frame_are_damaged(tmp_path: Path) -> None:
    """A stream that is joined between key frames: this decoder takes grey for what it has not seen."""
    path = tmp_path / "joined.ts"
    make_stream(path, num_frames=40, codec="mpeg4")
    whole = [frame.image for frame in Video(path)]
    position, _ = packets_of(path)[GOP // 2]
    path.write_bytes(path.read_bytes()[position // 188 * 188 :])
    frames = list(Video(path, on_error="mark"))
    errors = [
        float(np.abs(frame.image.astype(int) - image).mean())
        for frame, image in zip(frames[::-1], whole[::-1], strict=False)
    ][::-1]
    num_damaged = [frame.is_damaged for frame in frames].index(False)
    assert 0 < num_damaged <= GOP
    assert min(errors[:num_damaged]) > 5
    assert max(errors[num_damaged:]) == 0
    assert not any(frame.is_damaged for frame in frames[num_damaged:])


def test_what_an_edit_list_leaves_out_is_no_damage(tmp_path: Path) -> None:
    """Cutting without coding again: the key frame comes before the first frame that is shown."""
    make_video(tmp_path / "whole.mp4")
    whole: Any = av.open(str(tmp_path / "whole.mp4"))
    with whole, av.open(str(tmp_path / "cut.mp4"), "w") as cut:
        stream = cut.add_stream_from_template(whole.streams.video[0])
        for packet in whole.demux(whole.streams.video[0]):
            if packet.size:
                shift = 10 * packet.duration
                packet.pts, packet.dts, packet.stream = packet.pts - shift, packet.dts - shift, stream
                cut.mux(packet)
    frames = list(Video(tmp_path / "cut.mp4"))
    assert NUM_FRAMES - 12 <= len(frames) < NUM_FRAMES
    assert not any(frame.is_damaged for frame in frames)


def write_h264(path: Path, pixels: str, parameters: str) -> None:
    """A film of noise that moves, with a key frame every `GOP` frames."""
    noise = np.random.default_rng(1).integers(0, 255, (96, 128 + 40), np.uint8)
    with av.open(str(path), "w") as container:
        options = {"preset": "fast", "tune": "zerolatency", "x264-params": parameters}
        stream: Any = container.add_stream("libx264", rate=18, options=options)
        stream.width, stream.height, stream.pix_fmt, stream.gop_size = 128, 96, pixels, GOP
        for index in range(40):
            view = np.ascontiguousarray(noise[:, index : index + 128])
            container.mux(stream.encode(av.VideoFrame.from_ndarray(view, format="gray").reformat(format=pixels)))
        container.mux(stream.encode(None))


def make_coded(path: Path, codec: str, num_frames: int, **options: str) -> Path:
    """Noise that moves, with a key frame every `GOP` frames."""
    noise = np.random.default_rng(1).integers(0, 255, (96, 128 + num_frames), np.uint8)
    pixels = "yuvj420p" if codec == "mjpeg" else "yuv420p"
    with av.open(str(path), "w", options=options) as container:
        coding = {"x265-params": "log-level=none"} if codec == "libx265" else {}
        stream: Any = container.add_stream(codec, rate=25, options=coding)
        stream.width, stream.height, stream.pix_fmt, stream.gop_size = 128, 96, pixels, GOP
        stream.bit_rate = 1_000_000
        for index in range(num_frames):
            view = np.ascontiguousarray(noise[:, index : index + 128])
            container.mux(stream.encode(av.VideoFrame.from_ndarray(view, format="gray").reformat(format=pixels)))
        container.mux(stream.encode(None))
    return path


def leave_out_packet(path: Path, whole: Path, number: int) -> None:
    """Writes `whole` without one of its packets."""
    read: Any = av.open(str(whole))
    with read, av.open(str(path), "w") as written:
        stream: Any = written.add_stream_from_template(read.streams.video[0])
        for index, packet in enumerate(read.demux(read.streams.video[0])):
            if packet.size and index != number:
                packet.stream = stream
                written.mux(packet)


@pytest.mark.parametrize("suffix", [".ts", ".mkv", ".mp4", ".avi"])
@pytest.mark.parametrize(
    ("pixels", "parameters"),
    [
        ("yuv420p", "ref=1"),
        ("yuv420p", "interlaced=1"),
        ("yuv420p", "slices=4:cqm=jvt"),
        ("yuv420p10le", "open-gop=1"),
        ("yuv444p", "cqm=jvt"),
    ],
)
def test_frames_of_h264_after_a_missing_one_are_damaged(
    tmp_path: Path, suffix: str, pixels: str, parameters: str
) -> None:
    """Of a camera that leaves out frames when its network is busy, no packet is broken."""
    whole, path = tmp_path / f"whole{suffix}", tmp_path / f"night{suffix}"
    write_h264(whole, pixels, parameters)
    assert [frame.is_damaged for frame in Video(whole, on_error="mark")] == [False] * 40
    leave_out_packet(path, whole, GOP + 5)
    marked = [frame.is_damaged for frame in Video(path, on_error="mark")]
    assert marked == [False] * (GOP + 5) + [True] * 6 + [False] * 16


@pytest.mark.parametrize("seed", range(20))
def test_numbers_of_any_bytes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    extradata = rng.choice([b"", b"\x01", b"\0\0\1\x67"]) + rng.bytes(60)
    numbers = H264Numbers(extradata)
    for _ in range(100):
        assert numbers.are_broken(b"\0\0\1" + rng.bytes(50)) in (True, False)


def test_what_cannot_be_decoded_at_the_end_is_an_error(tmp_path: Path) -> None:
    path = make_video(tmp_path / "clip.avi", codec="mjpeg", pixels="yuvj420p")
    position, size = packets_of(path)[-1]
    data = bytearray(path.read_bytes())
    data[position + 8 : position + size] = bytes(size - 8)
    path.write_bytes(bytes(data))
    with pytest.raises(ValueError, match="expected an undamaged frame"):
        list(Video(path))
    assert len(list(Video(path, on_error="mark"))) == NUM_FRAMES - 1


def make_noise(path: Path, codec: str, pixels: str = "yuv420p", num_frames: int = 30) -> Path:
    """A film of noise that moves, one key frame at its beginning if the codec has others."""
    noise = np.random.default_rng(1).integers(0, 255, (240, 320 + num_frames), np.uint8)
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream(codec, rate=18)
        stream.width, stream.height, stream.pix_fmt = 320, 240, pixels
        for index in range(num_frames):
            view = np.ascontiguousarray(noise[:, index : index + 320])
            container.mux(stream.encode(av.VideoFrame.from_ndarray(view, format="gray")))
        container.mux(stream.encode(None))
    return path


@pytest.mark.parametrize(
    ("name", "codec", "pixels"),
    [
        *((f"clip{suffix}", "libx264", "yuv420p") for suffix in (".mp4", ".mkv", ".avi", ".ts")),
        *((f"clip{suffix}", "mjpeg", "yuvj420p") for suffix in (".avi", ".mkv", ".mov")),
        *(("clip.mkv", "ffv1", pixels) for pixels in ("gray", "gray10le", "gray16le", "yuv420p", "bgr0")),
        ("clip.avi", "ffv1", "yuv420p"),
        ("clip.webm", "libvpx-vp9", "yuv420p"),
        ("clip.webm", "libvpx", "yuv420p"),
        ("clip.mkv", "mpeg4", "yuv420p"),
        ("clip.ts", "mpeg2video", "yuv420p"),
        ("clip.mov", "prores_ks", "yuv422p10le"),
        ("clip.mp4", "libx265", "yuv420p"),
        ("clip.avi", "huffyuv", "yuv422p"),
        ("clip.mov", "cfhd", "yuv422p10le"),
        ("clip.avi", "msvideo1", "rgb555le"),
        ("clip.mov", "qtrle", "rgb24"),
    ],
)
def test_intact_films_give_no_alarm(tmp_path: Path, name: str, codec: str, pixels: str) -> None:
    video = Video(make_noise(tmp_path / name, codec, pixels), on_error="mark")
    assert [frame.is_damaged for frame in video] == [False] * 30
    assert video.skipped == []


@pytest.mark.slow
@pytest.mark.parametrize("on_error", ["skip", "mark"])
def test_the_same_damage_is_found_each_time(tmp_path: Path, on_error: OnError) -> None:
    """The demultiplexer gives up in the middle; the decoder knows of the damage with the last packet."""
    path = make_noise(tmp_path / "clip.mkv", "libx264")
    position, size = packets_of(path)[14]
    data = np.frombuffer(path.read_bytes(), np.uint8).copy()
    data[position + size // 2 : position + size] ^= 0x55
    data[position + size + 16 : -1] = 0
    path.write_bytes(data.tobytes())
    found = set()
    for _ in range(12):
        video = Video(path, on_error=on_error)
        found.add((tuple((frame.frame, frame.is_damaged) for frame in video), tuple(video.skipped)))
    assert len(found) == 1
    frames, skipped = found.pop()
    if on_error == "mark":
        assert any(is_damaged for _, is_damaged in frames)
    else:
        assert any("expected an undamaged frame" in line for line in skipped)
    assert "expected frames until 1.67 s, the stream ends after" in skipped[-1]


@pytest.mark.parametrize("suffix", [".mkv", ".avi"])
def test_a_wrong_checksum_of_ffv1_is_damage(tmp_path: Path, suffix: str) -> None:
    path = make_noise(tmp_path / f"clip{suffix}", "ffv1", "gray")
    clean = [frame.image for frame in Video(path)]
    position, size = packets_of(path)[10]
    data = bytearray(path.read_bytes())
    data[position + size // 2] ^= 0x10
    path.write_bytes(bytes(data))
    frames = list(Video(path, on_error="mark"))
    assert len(frames) == len(clean)
    is_off = [bool((frame.image != image).any()) for frame, image in zip(frames, clean, strict=True)]
    assert any(is_off)
    assert all(frame.is_damaged for frame, off in zip(frames, is_off, strict=True) if off)
    assert not any(frame.is_damaged for frame in frames[:10])


def test_mjpeg_that_ends_too_early_is_damage(tmp_path: Path) -> None:
    path = make_noise(tmp_path / "clip.avi", "mjpeg", "yuvj420p")
    position, size = packets_of(path)[10]
    data = bytearray(path.read_bytes())
    data[position + 8 + size // 2 : position + size] = bytes(size - 8 - size // 2)
    path.write_bytes(bytes(data))
    frames = list(Video(path, on_error="mark"))
    assert [frame.frame for frame in frames] == list(range(30))  # a lenient decoder fills the picture
    assert frames[10].is_damaged
    assert sum(frame.is_damaged for frame in frames) <= 2


@pytest.mark.parametrize("kind", ["gap", "no end"])
def test_mjpeg_that_libjpeg_finds_wrong_is_damage(tmp_path: Path, kind: str) -> None:
    """FFmpeg, strict as it is, takes a part of such data for whole."""
    path = make_noise(tmp_path / "clip.avi", "mjpeg", "yuvj420p")
    whole = path.read_bytes()
    num_told = 0
    for position, size in packets_of(path)[2:22:2]:
        data = bytearray(whole)
        start, stop = position, position + size
        if kind == "gap":
            data[start + size // 2 : stop] = data[start + size // 2 + 100 : stop] + bytes(100)
        else:  # cut, and the rest of the chunk is of the frame before
            data[start + size // 2 : stop] = data[start + size // 4 : start + size // 4 + stop - start - size // 2]
        path.write_bytes(bytes(data))
        num_told += sum(frame.is_damaged for frame in Video(path, on_error="mark")) > 0
    assert num_told >= 9, num_told


def test_whole_mjpeg_of_cameras_is_no_damage(tmp_path: Path) -> None:
    """Whose frames are filled up to their end, or come without tables."""
    path = make_noise(tmp_path / "clip.avi", "mjpeg", "yuvj420p")
    position, size = packets_of(path)[3]
    frame = path.read_bytes()[position : position + size]
    assert not is_damaged_mjpeg(frame, 1 << 26)
    assert not is_damaged_mjpeg(frame[:-2] + bytes(16) + frame[-2:], 1 << 26)
    table = frame.index(b"\xff\xc4")
    assert not is_damaged_mjpeg(
        frame[:table] + frame[table + 2 + int.from_bytes(frame[table + 2 : table + 4]) :], 1 << 26
    )
    assert not is_damaged_mjpeg(b"", 1 << 26)
    assert not is_damaged_mjpeg(frame[: size // 2], 1000)
    assert is_damaged_mjpeg(frame[: size // 2], 1 << 26)


def test_a_frame_of_mjpeg_with_many_scans_is_not_decoded(tmp_path: Path) -> None:
    """It would take seconds; what is in its place is told, and the frames behind it are read."""
    path = tmp_path / "clip.avi"
    frames = [many_scans(0, 96), many_scans(0, 96), many_scans(MAX_SCANS, 96), *3 * [many_scans(0, 96)]]
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("mjpeg", rate=25)
        stream.width, stream.height, stream.pix_fmt = 96, 96, "yuvj420p"
        for index, data in enumerate(frames):
            packet = av.Packet(data)
            packet.stream, packet.pts, packet.dts, packet.is_keyframe = stream, index, index, True
            container.mux(packet)
    assert [frame.is_damaged for frame in Video(path, on_error="mark")] == [False, False, True, False, False]
    with pytest.raises(ValueError, match=r"clip\.avi: frame 2: expected an undamaged frame"):
        list(Video(path))


def test_the_lost_rest_of_a_matroska_file_is_told(tmp_path: Path) -> None:
    path = make_noise(tmp_path / "clip.mkv", "mjpeg", "yuvj420p")
    position, size = packets_of(path)[14]
    data = bytearray(path.read_bytes())
    data[position + size : -1] = bytes(len(data) - 1 - position - size)
    path.write_bytes(bytes(data))
    video = Video(path, on_error="mark")
    assert len(list(video)) == 15
    assert "expected frames until 1.67 s, the stream ends after 0.83 s" in video.skipped[-1]
    assert video.lost_parts[-1] == video.skipped[-1]
