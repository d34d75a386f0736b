"""Videos as sources: times, depths, damage, and what is no video."""

from __future__ import annotations

import gc
import itertools
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from foreglow.datasets import Video
from foreglow.datasets.video.decoding import decoded
from tests.shared_data import shared_file

NUM_FRAMES = 24


def make_video(
    path: Path,
    *,
    codec: str = "mpeg4",
    pixels: str = "yuv420p",
    num_frames: int = NUM_FRAMES,
    rate_hz: int = 25,
    pixel_aspect: Fraction | None = None,
    times: Sequence[int] | None = None,
) -> Path:
    """A grey ramp that brightens by 8 levels a frame, 96x72; the header lies at the front of an MP4."""
    options = {"movflags": "faststart"} if path.suffix == ".mp4" else {}
    with av.open(str(path), "w", options=options) as container:
        stream: Any = container.add_stream(codec, rate=rate_hz)
        stream.width, stream.height, stream.pix_fmt = 96, 72, pixels
        stream.bit_rate = 2_000_000
        if pixel_aspect is not None:
            stream.codec_context.sample_aspect_ratio = pixel_aspect
        for index in range(num_frames if times is None else len(times)):
            image = np.full((72, 96, 3), 8 * index, np.uint8)
            image[:, :48] += 16
            picture = av.VideoFrame.from_ndarray(image, format="rgb24")
            picture.pts = index if times is None else times[index]
            picture.time_base = Fraction(1, rate_hz)
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    return path


def make_titled(path: Path) -> Path:
    """Three pictures with a title in Latin-1."""
    with av.open(str(path), "w") as container:
        container.metadata["title"] = "Nachtfahrt"
        stream: Any = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = 96, 72, "yuv420p"
        for _ in range(3):
            container.mux(stream.encode(av.VideoFrame(96, 72, "yuv420p")))
        container.mux(stream.encode(None))
    data = path.read_bytes()
    assert b"Nachtfahrt" in data
    path.write_bytes(data.replace(b"Nachtfahrt", "Nächtliche".encode("latin-1")))
    return path


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_video(tmp_path_factory.mktemp("video") / "clip.mp4")


def test_frames_and_true_times(clip: Path) -> None:
    video = Video(clip)
    assert (video.name, video.rate_hz, video.num_frames) == ("clip.mp4", 25.0, NUM_FRAMES)
    for _ in range(2):
        frames = list(video)
        assert [frame.timestamp_ns for frame in frames] == [40_000_000 * index for index in range(NUM_FRAMES)]
        assert [frame.frame for frame in frames] == list(range(NUM_FRAMES))
        for index, frame in enumerate(frames):
            assert frame.image.dtype == np.uint8
            assert frame.image.shape == (72, 96)
            assert abs(float(frame.image[:, 60:].mean()) - 8 * index) < 4
            assert abs(float(frame.image[:, :36].mean()) - 8 * index - 16) < 4


@pytest.mark.parametrize("suffix", [".mkv", ".avi", ".mov"])
def test_other_containers(tmp_path: Path, suffix: str) -> None:
    frames = list(Video(make_video(tmp_path / f"clip{suffix}")))
    assert len(frames) == NUM_FRAMES
    assert frames[-1].timestamp_ns - frames[0].timestamp_ns == 40_000_000 * (NUM_FRAMES - 1)


@pytest.mark.parametrize(
    ("name", "codec", "pixels", "rate_hz", "why"),
    [
        ("clip.h264", "libx264", "yuv420p", 50, "as the stream says itself"),
        ("clip.h265", "libx265", "yuv420p", 50, "as the stream says itself"),
        ("clip.m2v", "mpeg2video", "yuv420p", 50, "as the stream says itself"),
        ("clip.mjpeg", "mjpeg", "yuvj420p", 25, "as nothing says another rate"),
    ],
)
def test_raw_streams_say_what_rate_they_are_taken_for(
    name: str, codec: str, pixels: str, rate_hz: int, why: str, tmp_path: Path
) -> None:
    path = make_video(tmp_path / name, codec=codec, pixels=pixels, num_frames=8, rate_hz=50)
    video = Video(path)
    assert video.rate_hz == rate_hz
    assert video.notes[0].startswith(f"{path}: a raw stream has no times: taken for {rate_hz} frames a second, {why}")
    assert [frame.timestamp_ns for frame in video] == [index * 1_000_000_000 // rate_hz for index in range(8)]


def test_a_container_has_times_of_its_own(clip: Path) -> None:
    assert not Video(clip).notes


def test_more_than_eight_bits_become_sixteen(tmp_path: Path) -> None:
    path = make_video(tmp_path / "deep.mkv", codec="ffv1", pixels="yuv420p10le")
    frames = list(Video(path))
    assert frames[0].image.dtype == np.uint16
    assert abs(float(frames[10].image[:, 60:].mean()) / 257 - 80) < 4


def test_frames_come_one_at_a_time(clip: Path) -> None:
    frames = iter(Video(clip))
    assert [next(frames).frame for _ in range(3)] == [0, 1, 2]


@pytest.mark.parametrize("suffix", [".avi", ".mkv", ".mp4", ".asf"])
@pytest.mark.parametrize("codec", ["libx264", "mpeg2video", "mpeg4"])
def test_pictures_that_are_decoded_in_another_order(tmp_path: Path, codec: str, suffix: str) -> None:
    path = tmp_path / f"clip{suffix}"
    with av.open(str(path), "w") as container:
        choice = {"b_strategy": "0"} if codec == "libx264" else {}
        stream: Any = container.add_stream(codec, rate=25, options={"bf": "3", **choice})
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = 96, 72, "yuv420p", 2_000_000
        for index in range(NUM_FRAMES):
            picture = av.VideoFrame.from_ndarray(np.full((72, 96, 3), 8 * index, np.uint8), format="rgb24")
            picture.pts, picture.time_base = index, Fraction(1, 25)
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    frames = list(Video(path))
    assert [round(float(frame.image.mean()) / 8) for frame in frames] == list(range(NUM_FRAMES))
    begin_ns = frames[0].timestamp_ns
    assert [frame.timestamp_ns - begin_ns for frame in frames] == [40_000_000 * index for index in range(NUM_FRAMES)]


def test_times_that_go_back_a_little_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "clip.mkv"
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("mjpeg", rate=25)
        stream.width, stream.height, stream.pix_fmt = 96, 72, "yuvj420p"
        packets = []
        for index in range(6):
            picture = av.VideoFrame.from_ndarray(np.full((72, 96, 3), 8 * index, np.uint8), format="rgb24")
            picture.pts, picture.time_base = index, Fraction(1, 25)
            packets += stream.encode(picture)
        for number, (packet, time) in enumerate(zip(packets, (0, 1, 3, 2, 4, 5), strict=True)):
            packet.pts, packet.dts = time, number - 3
            container.mux(packet)
    with pytest.raises(ValueError, match=r"clip\.mkv: frame 3: expected a time from 0\.12 s on, .*, got 0\.08 s"):
        list(Video(path))
    video = Video(path, on_error="skip")
    assert [frame.frame for frame in video] == [0, 1, 2, 4, 5]
    assert len(video.skipped) == 1


def test_pictures_with_data_of_a_kind_that_the_decoder_does_not_name(tmp_path: Path) -> None:
    """Exif, in TIFF."""
    path = make_video(tmp_path / "clip.mov", codec="tiff", pixels="rgb24", num_frames=3)
    assert [int(frame.image.mean()) for frame in Video(path)] == [8, 16, 24]


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".avi"])
def test_a_file_cut_in_the_middle(tmp_path: Path, suffix: str) -> None:
    data = make_video(tmp_path / f"whole{suffix}").read_bytes()
    cut = tmp_path / f"cut{suffix}"
    cut.write_bytes(data[: len(data) * 2 // 3])
    with pytest.raises(ValueError, match=r"truncated video, \d+ bytes are missing at the end"):
        Video(cut)
    video = Video(cut, on_error="skip")
    frames = list(video)
    assert 4 < len(frames) < NUM_FRAMES
    assert "truncated video" in video.skipped[0]
    assert all(line.startswith(str(cut)) for line in video.skipped)


def test_damage_inside_is_an_error_or_skipped(clip: Path, tmp_path: Path) -> None:
    data = bytearray(clip.read_bytes())
    start = data.find(b"mdat") + 400
    data[start : len(data) - 200] = b"\xa5" * (len(data) - 200 - start)
    damaged = tmp_path / "damaged.mp4"
    damaged.write_bytes(bytes(data))
    with pytest.raises(ValueError, match=r"damaged\.mp4: "):
        list(Video(damaged))
    video = Video(damaged, on_error="skip")
    assert len(list(video)) < NUM_FRAMES
    assert video.skipped


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "expected a video, the file is empty"),
        (b"this is text\n" * 50, "expected a video .* cannot be opened"),
        (b"YUV4MPEG2 W60000 H60000 F25:1 C420jpeg\nFRAME\n", "of at most 8192 px a side, cannot be opened$"),
        (b"\0\0\0\x18ftypisom" + bytes(12), "expected a video .* cannot be opened: Invalid data found"),
        (
            b"\0\0\0\x18ftypisom" + bytes(6),
            "truncated video, 6 bytes are missing at the end, or a size that it states ",
        ),
    ],
)
def test_what_is_no_video(tmp_path: Path, data: bytes, message: str) -> None:
    path = tmp_path / "clip.mp4"
    path.write_bytes(data)
    for on_error in ("stop", "skip"):
        with pytest.raises(ValueError, match=message) as caught:
            Video(path, on_error="skip" if on_error == "skip" else "stop")
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", [".mkv", ".avi"])
def test_a_title_that_is_not_utf_8(tmp_path: Path, suffix: str) -> None:
    assert len(list(Video(make_titled(tmp_path / f"clip{suffix}")))) == 3


@pytest.mark.parametrize("name", ["notes.txt", "notes", "notes.nfo", "notes.md"])
def test_prose_is_no_video(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_text("A car that comes round a bend lights the road before it can be seen. " * 500)
    with pytest.raises(ValueError, match=r"expected a video .* cannot be opened"):
        Video(path)


def test_a_play_list_opens_no_other_file(clip: Path, tmp_path: Path) -> None:
    path = tmp_path / "list.m3u8"
    path.write_text(f"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{clip}\n#EXT-X-ENDLIST\n")
    with pytest.raises(ValueError, match=r"expected a video .* cannot be opened"):
        Video(path)


def test_a_name_with_a_colon_is_no_address(clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("tcp:22.mp4").write_bytes(clip.read_bytes())
    assert len(list(Video("tcp:22.mp4"))) == NUM_FRAMES


def test_sound_without_pictures(tmp_path: Path) -> None:
    path = tmp_path / "sound.mp4"
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("aac", rate=48000)
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 4096), np.float32), format="fltp", layout="mono")
        sound.sample_rate = 48000
        container.mux(stream.encode(sound))
        container.mux(stream.encode(None))
    with pytest.raises(ValueError, match="expected a video stream, it has none"):
        Video(path)


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no such video"):
        Video(tmp_path / "absent.mp4")
    with pytest.raises(ValueError, match="expected a file, is a folder"):
        Video(tmp_path)


@pytest.mark.parametrize("seed", range(12))
def test_random_damage_is_read_or_refused(clip: Path, tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    data = np.frombuffer(clip.read_bytes(), np.uint8).copy()
    places = rng.integers(0, len(data), 20)
    data[places] ^= rng.integers(1, 256, 20).astype(np.uint8)
    path = tmp_path / "damaged.mp4"
    path.write_bytes(data.tobytes())
    message = str(path)
    try:
        video = Video(path, on_error="skip")
        list(video)
    except ValueError as error:
        message = str(error)
    assert message.startswith(str(path))


@pytest.mark.slow
def test_a_real_clip() -> None:
    video = Video(shared_file("data/night_motorway_640x360.mp4"))
    times = [frame.timestamp_ns for frame in video]
    assert len(times) == 1079
    assert times == sorted(times)
    assert times[30] == 1_001_000_000
    assert video.num_frames is not None
    assert abs(video.num_frames - len(times)) <= 1


MAX_PICTURES = 4
"""Of a video at a time: one that is looked at, and a few that the decoder gives at once."""


def test_pictures_go_as_soon_as_the_next_one_comes(tmp_path: Path) -> None:
    path = make_video(tmp_path / "clip.mp4")
    gc.collect()
    gc.disable()  # what refers to itself would stay
    try:
        for _ in Video(path):
            assert sum(type(each) is av.VideoFrame for each in gc.get_objects()) <= MAX_PICTURES
    finally:
        gc.enable()


def test_frames_without_a_time_follow_at_the_rate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = make_video(tmp_path / "clip.mp4")

    def untimed(container: Any, stream: Any, losses: Any) -> Any:
        for number, (picture, is_damaged) in enumerate(decoded(container, stream, losses)):
            if picture is not None and number in (5, 6):
                picture.pts = None
            yield picture, is_damaged

    monkeypatch.setattr("foreglow.datasets.video.video_file.decoded", untimed)
    assert [frame.timestamp_ns for frame in Video(path)] == [40_000_000 * index for index in range(NUM_FRAMES)]


@pytest.mark.parametrize(("size_px", "rate_hz", "frame_bytes"), [((720, 576), 25, 144_000), ((720, 480), 30, 120_000)])
def test_raw_dv(tmp_path: Path, size_px: tuple[int, int], rate_hz: int, frame_bytes: int) -> None:
    """FFmpeg takes it for 60,000 Hz, and makes a whole picture of the beginning of one."""
    path = tmp_path / "night.dv"
    with av.open(str(path), "w", format="dv") as container:
        stream: Any = container.add_stream("dvvideo", rate=Fraction(30_000, 1001) if rate_hz == 30 else rate_hz)
        stream.width, stream.height = size_px
        stream.pix_fmt = "yuv420p" if rate_hz == 25 else "yuv411p"
        for index in range(4):
            image = np.full((size_px[1], size_px[0]), 20 * index, np.uint8)
            container.mux(
                stream.encode(av.VideoFrame.from_ndarray(image, format="gray").reformat(format=stream.pix_fmt))
            )
        container.mux(stream.encode(None))
    whole = path.read_bytes()
    assert len(whole) == 4 * frame_bytes
    video = Video(path)
    assert video.rate_hz == pytest.approx(rate_hz, rel=0.01)
    assert len(list(video)) == 4
    for num_bytes in (1, frame_bytes // 2, frame_bytes - 1):
        path.write_bytes(whole + whole[:num_bytes])
        with pytest.raises(ValueError, match=f"night.dv: truncated video, {frame_bytes - num_bytes} bytes are missing"):
            list(Video(path))


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".ts"])
def test_two_videos_that_are_read_at_once_are_whole(tmp_path: Path, suffix: str) -> None:
    """PyAV gave the pictures of one the numbers of the other, which looked as if some were missing."""
    path = make_video(tmp_path / f"clip{suffix}", codec="libx264", num_frames=12)
    first, second = iter(Video(path)), iter(Video(path))
    numbers = [next(first).frame for _ in range(3)]
    pairs = list(itertools.zip_longest(first, second))
    assert numbers + [frame.frame for frame, _ in pairs if frame is not None] == list(range(12))
    assert [frame.frame for _, frame in pairs] == list(range(12))
