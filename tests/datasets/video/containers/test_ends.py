"""Files that a container lets end early in silence: cut, with a hole between their parts, or two films in one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from foreglow.datasets import Video
from foreglow.datasets.video.containers.ends import hole, missing_bytes
from tests.datasets.video.test_video_file import NUM_FRAMES
from tests.shared_data import shared_file

MEDIA = {
    ".mp4": "libx264",
    ".mov": "mjpeg",
    ".3gp": "mpeg4",
    ".mkv": "libx264",
    ".avi": "rawvideo",
    ".ts": "mpeg2video",
    ".m2ts": "libx264",
    ".flv": "libx264",
    ".wmv": "wmv2",
    ".asf": "msmpeg4",
    ".mpg": "mpeg2video",
    ".vob": "mpeg2video",
    ".y4m": "wrapped_avframe",
    ".mxf": "mpeg2video",
    ".nut": "libx264",
    ".ivf": "libvpx",
    ".h264": "libx264",
    ".m2v": "mpeg2video",
    ".mjpeg": "mjpeg",
}
SOUND = {
    ".mp4": "aac",
    ".mkv": "aac",
    ".avi": "mp2",
    ".ts": "mp2",
    ".flv": "aac",
    ".asf": "mp2",
    ".wmv": "wmav2",
    ".mpg": "mp2",
    ".vob": "ac3",
}


def make_film(
    path: Path,
    pixels: str = "",
    *,
    codec: str = "",
    kind: str | None = None,
    num_b: int = 0,
    bit_rate: int = 0,
    has_sound: bool = False,
    **options: str,
) -> Path:
    """Noise that moves, 130x98, whose sides are no multiples of four; perhaps with silence."""
    codec = codec or MEDIA[path.suffix]
    pixels = pixels or ("yuvj420p" if codec == "mjpeg" else "yuv420p")
    noise = np.random.default_rng(0).integers(0, 255, (98, 130 + NUM_FRAMES), np.uint8)
    if path.suffix == ".m2ts":
        options["mpegts_m2ts_mode"] = "1"
    if path.suffix == ".y4m":
        options["strict"] = "-1"
    kind = kind or {".wmv": "asf", ".m2ts": "mpegts"}.get(path.suffix)
    encoding = ({"bf": str(num_b)} if num_b else {}) | ({"b": str(bit_rate)} if bit_rate else {})
    with av.open(str(path), "w", format=kind, options=options) as container:
        stream: Any = container.add_stream(codec, rate=25, options=encoding)
        stream.width, stream.height, stream.pix_fmt, stream.gop_size = 130, 98, pixels, 12
        # A Video CD has another rate.
        rate = 44100 if kind in ("vcd", "svcd") else 48000
        sound: Any = container.add_stream(SOUND[path.suffix], rate=rate) if has_sound else None
        if sound is not None:
            sound.bit_rate = 128_000
        for index in range(NUM_FRAMES):
            view = np.ascontiguousarray(noise[:, index : index + 130])
            container.mux(stream.encode(av.VideoFrame.from_ndarray(view, format="gray").reformat(format=pixels)))
            if sound is not None:
                silence = av.AudioFrame.from_ndarray(np.zeros((1, 2 * rate // 25), np.int16), layout="stereo")
                silence.sample_rate, silence.pts = rate, rate // 25 * index
                container.mux(sound.encode(silence))
        container.mux(stream.encode(None))
        if sound is not None:
            container.mux(sound.encode(None))
    return path


def told(path: Path, message: str) -> int:
    """How many frames come with `skip`, having checked that the message is told, and is an error with `stop`."""
    with pytest.raises(ValueError, match=message) as caught:
        list(Video(path))
    assert "\n" not in str(caught.value)
    video = Video(path, on_error="skip")
    num_frames = len(list(video))
    assert any(message in line for line in video.lost_parts)
    return num_frames


@pytest.mark.parametrize("pixels", ["yuv420p", "yuv422p", "yuv444p", "yuv411p", "gray", "gray16le", "yuv420p10le"])
@pytest.mark.parametrize("kept", [0.6, -1, -4])
def test_y4m_cut_in_a_frame(tmp_path: Path, pixels: str, kept: float) -> None:
    path = make_film(tmp_path / "clip.y4m", pixels)
    assert missing_bytes(path) == 0
    data = path.read_bytes()
    path.write_bytes(data[: int(kept * len(data)) if kept > 0 else int(kept)])
    assert told(path, "bytes are missing at the end") < NUM_FRAMES


def test_y4m_that_begins_with_parameters(tmp_path: Path) -> None:
    path = tmp_path / "clip.y4m"
    frames = 3 * (b"FRAME Ip\n" + bytes(5 * 3 + 2 * 3 * 2))
    path.write_bytes(b"YUV4MPEG2 W5 H3 F25:1 Ip A1:1 C420jpeg XYSCSS=420JPEG\n" + frames)
    assert missing_bytes(path) == 0
    path.write_bytes(path.read_bytes()[:-5])
    assert missing_bytes(path) == 5


@pytest.mark.parametrize(("suffix", "length"), [(".ts", 188), (".m2ts", 192)])
@pytest.mark.parametrize("kept", [1, 2, 5, 100, 187])
def test_transport_streams_cut_in_a_packet(tmp_path: Path, suffix: str, length: int, kept: int) -> None:
    path = make_film(tmp_path / f"clip{suffix}")
    assert missing_bytes(path) == 0
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 6 // 10 // length * length + kept])
    assert missing_bytes(path) == length - kept
    assert told(path, f"truncated video, {length - kept} bytes are missing at the end") < NUM_FRAMES


def test_a_transport_stream_that_begins_in_a_packet_is_whole(tmp_path: Path) -> None:
    path = make_film(tmp_path / "clip.ts")
    path.write_bytes(path.read_bytes()[100:])
    assert missing_bytes(path) == 0


@pytest.mark.parametrize("kept", [0.3, 0.6, 0.95])
def test_mxf_that_was_cut(tmp_path: Path, kept: float) -> None:
    path = make_film(tmp_path / "clip.mxf")
    data = path.read_bytes()
    assert missing_bytes(path) == 0
    path.write_bytes(data[: int(kept * len(data))])
    assert told(path, "bytes are missing at the end") < NUM_FRAMES


@pytest.mark.parametrize("name", ["clip.avi", "clip.wmv", "clip.asf", "clip.flv", "clip.mxf"])
def test_a_hole_between_parts(tmp_path: Path, name: str) -> None:
    path = make_film(tmp_path / name)
    data = bytearray(path.read_bytes())
    start, length = 2 * len(data) // 5, len(data) // 7
    data[start : start + length] = bytes(length)
    path.write_bytes(bytes(data))
    assert told(path, "found damage; frames may be missing from there on") < NUM_FRAMES


def hit(data: bytes, start: int, length: int = 300) -> bytes:
    return data[:start] + bytes(length) + data[start + length :]


@pytest.mark.parametrize("name", ["clip.wmv", "clip.asf"])
@pytest.mark.parametrize("has_sound", [False, True])
def test_small_holes_in_packets_of_asf(tmp_path: Path, name: str, *, has_sound: bool) -> None:
    """A packet holds several frames, each behind a header of its own."""
    path = make_film(tmp_path / name, has_sound=has_sound)
    data = path.read_bytes()
    num_told = 0
    for start in range(3000, len(data) - 300, 512):
        path.write_bytes(hit(data, start))
        video = Video(path, on_error="skip")
        assert len(list(video)) == NUM_FRAMES or video.skipped, start
        num_told += bool(video.lost_parts)
    assert num_told > 10


@pytest.mark.parametrize("name", ["clip.mpg", "clip.vob"])
@pytest.mark.parametrize("has_sound", [False, True])
@pytest.mark.parametrize("length", [300, 2048, 4096])
def test_holes_at_packs_of_a_program_stream(tmp_path: Path, name: str, length: int, *, has_sound: bool) -> None:
    path = make_film(tmp_path / name, has_sound=has_sound)
    data = path.read_bytes()
    for start in (0, 2048, 10240):
        path.write_bytes(hit(data, start, length))
        told(path, f"byte {start}: expected a packet of an MPEG program stream, found damage")


@pytest.mark.parametrize("name", ["clip.mpg", "clip.vob"])
def test_a_program_stream_cut_in_a_packet(tmp_path: Path, name: str) -> None:
    path = make_film(tmp_path / name)
    data = path.read_bytes()
    for kept in (1, 5, 13, 40, 1000, 2047):
        path.write_bytes(data[: 12288 + kept])
        assert told(path, "bytes are missing at the end") < NUM_FRAMES


@pytest.mark.parametrize("before", [bytes(300), b"junk"])
@pytest.mark.parametrize("name", ["clip.mov", "clip.mjpeg"])
def test_raw_mjpeg_with_something_else_before_it(tmp_path: Path, name: str, before: bytes) -> None:
    """A MOV of which nothing tells the format is taken for raw MJPEG, which has no times."""
    path = make_film(tmp_path / name)
    path.write_bytes(before + path.read_bytes())
    told(path, "byte 0: expected a picture of raw MJPEG, found other data")


def test_raw_mjpeg_whose_first_picture_lost_its_beginning(tmp_path: Path) -> None:
    path = make_film(tmp_path / "clip.mjpeg")
    path.write_bytes(hit(path.read_bytes(), 0))
    assert told(path, "byte 0: expected a picture of raw MJPEG, found other data") < NUM_FRAMES


@pytest.mark.parametrize("before", [b"", b"\r\n", b"\r\n--part\r\nContent-Type: image/jpeg\r\n\r\n"])
def test_raw_mjpeg_of_a_network_camera_gives_no_alarm(tmp_path: Path, before: bytes) -> None:
    path = make_film(tmp_path / "clip.mjpeg")
    path.write_bytes(before + path.read_bytes())
    intact(path)


BEHIND_EACH_OTHER = ["clip.flv", "clip.wmv", "clip.asf", "clip.avi", "clip.mxf", "clip.mkv"]


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        *((name, 1.0) for name in ("clip.mp4", "clip.mov", "clip.3gp", *BEHIND_EACH_OTHER)),
        *((name, 0.6) for name in BEHIND_EACH_OTHER),
    ],
)
def test_a_second_film_behind_the_first(tmp_path: Path, name: str, kept: float) -> None:
    path = make_film(tmp_path / name)
    data = path.read_bytes()
    path.write_bytes(data + data[: int(kept * len(data))])
    assert told(path, "expected one film, found a second") == NUM_FRAMES


def test_fragments_are_no_second_film(tmp_path: Path) -> None:
    path = make_film(tmp_path / "clip.mp4", movflags="frag_keyframe+empty_moov+default_base_moof")
    data = path.read_bytes()
    assert len(list(Video(path))) == NUM_FRAMES
    begin = data.index(b"moof") - 4
    path.write_bytes(data[:begin] + b"\0\0\0\x10stypmsdh\0\0\0\0" + data[begin:])
    assert len(list(Video(path))) == NUM_FRAMES
    path.write_bytes(data + data)  # both are read, and the times of the second go on or begin anew
    assert hole(path) is None


def test_a_header_that_is_there_twice_is_no_second_film(tmp_path: Path) -> None:
    path = make_film(tmp_path / "clip.mp4")
    data = path.read_bytes()
    path.write_bytes(data + data[data.index(b"moov") - 4 :])
    assert len(list(Video(path))) == NUM_FRAMES


def make_h265(path: Path, parameters: str) -> Path:
    noise = np.random.default_rng(0).integers(0, 255, (96, 128 + NUM_FRAMES), np.uint8)
    with av.open(str(path), "w") as container:
        options = {"preset": "ultrafast", "x265-params": f"log-level=none:{parameters}"}
        stream: Any = container.add_stream("libx265", rate=25, options=options)
        stream.width, stream.height, stream.pix_fmt = 128, 96, "yuv420p"
        for index in range(NUM_FRAMES):
            view = np.ascontiguousarray(noise[:, index : index + 128])
            container.mux(stream.encode(av.VideoFrame.from_ndarray(view, format="gray").reformat(format="yuv420p")))
        container.mux(stream.encode(None))
    return path


@pytest.mark.parametrize("name", ["clip.hevc", "clip.ts", "clip.mp4"])
def test_what_a_decoder_of_h265_leaves_out_is_told(tmp_path: Path, name: str) -> None:
    path = make_h265(tmp_path / name, "keyint=8:open-gop=0:bframes=0")
    with av.open(str(path)) as container:
        packets = [(packet.pos or 0, packet.size) for packet in container.demux(video=0) if packet.size]
    data = bytearray(path.read_bytes())
    start, stop = packets[0][0] + packets[0][1] // 2, packets[3][0]
    data[start:stop] = bytes(stop - start)
    path.write_bytes(bytes(data))
    with pytest.raises(ValueError, match="expected an undamaged frame"):
        list(Video(path))
    video = Video(path, on_error="skip")
    assert len(list(video)) < NUM_FRAMES
    assert video.skipped


@pytest.mark.parametrize("suffix", [".hevc", ".ts", ".mp4", ".mkv"])
@pytest.mark.parametrize(
    "parameters",
    [
        "keyint=8:open-gop=1",
        "keyint=8:open-gop=0:bframes=0",
        "keyint=8:open-gop=0:radl=2",
        "keyint=12:bframes=4:b-pyramid=1",
        "keyint=8:slices=2:repeat-headers=1:aud=1",
        "intra-refresh=1",
        "interlace=tff",
    ],
)
def test_whole_films_of_h265_give_no_alarm(tmp_path: Path, suffix: str, parameters: str) -> None:
    intact(make_h265(tmp_path / f"clip{suffix}", parameters))


def test_h265_that_is_joined_between_key_frames_tells_what_comes_before_the_first(tmp_path: Path) -> None:
    """But not the pictures behind the key frame that cannot be decoded in any such stream (RASL)."""
    path = make_h265(tmp_path / "clip.ts", "keyint=8:open-gop=1:bframes=3")
    data = path.read_bytes()
    path.write_bytes(data[len(data) * 4 // 10 // 188 * 188 :])
    video = Video(path, on_error="skip")
    numbers = [frame.frame for frame in video]
    assert 0 < len(numbers) < NUM_FRAMES
    assert 0 < len(video.skipped) < 8
    assert numbers == list(range(len(video.skipped), len(video.skipped) + len(numbers)))


def intact(path: Path) -> None:
    video = Video(path, on_error="mark")
    assert [frame.is_damaged for frame in video] == [False] * NUM_FRAMES
    assert video.skipped == []


@pytest.mark.parametrize("suffix", MEDIA)
def test_whole_films_give_no_alarm(tmp_path: Path, suffix: str) -> None:
    intact(make_film(tmp_path / f"clip{suffix}"))


@pytest.mark.parametrize("suffix", SOUND)
def test_whole_films_with_sound_give_no_alarm(tmp_path: Path, suffix: str) -> None:
    codec = {".flv": "flv", ".avi": "mpeg4"}.get(suffix, MEDIA[suffix])
    intact(make_film(tmp_path / f"clip{suffix}", codec=codec, has_sound=True))


@pytest.mark.parametrize("suffix", [".mp4", ".mov", ".mkv", ".avi", ".ts", ".m2ts", ".flv", ".nut"])
def test_whole_films_whose_frames_refer_to_later_ones_give_no_alarm(tmp_path: Path, suffix: str) -> None:
    intact(make_film(tmp_path / f"clip{suffix}", codec="libx264", num_b=3))


@pytest.mark.parametrize("codec", ["wmv1", "wmv2", "msmpeg4", "mpeg4"])
@pytest.mark.parametrize("bit_rate", [20_000, 8_000_000])
@pytest.mark.parametrize("packet_size", ["500", "3200", "20000"])
def test_whole_films_in_asf_give_no_alarm(tmp_path: Path, codec: str, bit_rate: int, packet_size: str) -> None:
    path = tmp_path / "clip.asf"
    intact(make_film(path, codec=codec, bit_rate=bit_rate, has_sound=True, packet_size=packet_size))


@pytest.mark.parametrize("kind", ["mpeg", "vob", "dvd", "vcd", "svcd"])
@pytest.mark.parametrize("codec", ["mpeg1video", "mpeg2video"])
@pytest.mark.parametrize("bit_rate", [20_000, 8_000_000])
@pytest.mark.parametrize("num_b", [0, 2])
def test_whole_program_streams_give_no_alarm(tmp_path: Path, kind: str, codec: str, bit_rate: int, num_b: int) -> None:
    intact(make_film(tmp_path / "clip.mpg", codec=codec, kind=kind, bit_rate=bit_rate, num_b=num_b, has_sound=True))


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".mp4", ".mov", ".mkv", ".ts", ".m2ts", ".flv", ".asf", ".mpg", ".vob"])
@pytest.mark.parametrize("name", ["night_motorway_640x360.mp4", "night_motorway_2872x1622.mp4"])
def test_real_clips_in_other_containers_give_no_alarm(tmp_path: Path, name: str, suffix: str) -> None:
    path = tmp_path / f"clip{suffix}"
    read: Any = av.open(str(shared_file(f"data/{name}")))
    with read, av.open(str(path), "w", format="mpegts" if suffix == ".m2ts" else None) as written:
        stream: Any = written.add_stream_from_template(read.streams.video[0])
        for packet in read.demux(read.streams.video[0]):
            if packet.size:
                packet.stream = stream
                written.mux(packet)
    assert missing_bytes(path) == 0
    assert hole(path) is None
