"""Streams over the network."""

from __future__ import annotations

import contextlib
import io
import itertools
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from foreglow.runtime.live import cameras
from foreglow.runtime.live.cameras import CameraOptions, StreamCamera
from foreglow.runtime.live.opening import open_live
from foreglow.types import Frame
from tests.datasets.video.test_shown_pictures import make_shown
from tests.datasets.video.test_video_file import make_titled
from tests.runtime.live.test_sources import damaged_clip
from tests.stand_ins import night_image


def mpeg_stream(num_frames: int, codec: str = "mpeg2video", pid: int = 0x100) -> bytes:
    """A short stream as a network camera sends it."""
    file = io.BytesIO()
    with av.open(file, "w", format="mpegts", options={"mpegts_start_pid": str(pid)}) as container:
        stream: Any = container.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = 128, 96, "yuv420p"
        for number in range(num_frames):
            grey = np.repeat(night_image(number)[:, :, np.newaxis], 3, axis=2).astype(np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(grey, format="rgb24")))
        container.mux(stream.encode())
    return file.getvalue()


def test_stream_over_a_network() -> None:
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        connection, _ = server.accept()
        with connection, contextlib.suppress(ConnectionError):
            for _ in range(40):  # what is sent while the stream is examined is not seen
                connection.sendall(mpeg_stream(12))
                time.sleep(0.05)

    thread = threading.Thread(target=serve)
    thread.start()
    camera = open_live(f"tcp://127.0.0.1:{server.getsockname()[1]}", CameraOptions())
    assert isinstance(camera, StreamCamera)
    frames = list(itertools.islice(camera, 10))
    thread.join()
    server.close()
    assert len(frames) == 10
    assert frames[0].image.shape == (96, 128)
    times_ns = [frame.timestamp_ns for frame in frames]
    assert times_ns == sorted(set(times_ns))


@contextlib.contextmanager
def served(*parts: bytes | threading.Event) -> Iterator[StreamCamera]:
    """A stream of these parts, each 50 ms after the one before it; where an event is among them, it is waited for."""
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with contextlib.suppress(OSError):
            connection, _ = server.accept()
            with connection:
                for part in parts:
                    if isinstance(part, threading.Event):
                        part.wait(10.0)
                        continue
                    connection.sendall(part)
                    time.sleep(0.05)

    thread = threading.Thread(target=serve)
    thread.start()
    camera = open_live(f"tcp://127.0.0.1:{server.getsockname()[1]}", CameraOptions())
    assert isinstance(camera, StreamCamera)
    try:
        yield camera
    finally:
        server.close()
        thread.join()


def test_a_stream_that_is_joined_between_key_frames() -> None:
    """Some decoders show grey in place of what they have not seen, which is no image."""
    data = mpeg_stream(12, "mpeg4")
    with served(data[len(data) // 2 // 188 * 188 :], *[data] * 10) as camera:
        frames = list(itertools.islice(camera, 40))
    assert frames[0].is_damaged
    assert not frames[-1].is_damaged


def test_a_stream_that_changes_its_codec_is_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its packets come, and nothing can be made of them."""
    monkeypatch.setattr(cameras, "PICTURE_S", 0.5)
    with (
        served(*[mpeg_stream(12)] * 20, *[mpeg_stream(12, "mpeg4")] * 60) as camera,
        pytest.raises(OSError, match=r"tcp://127.0.0.1:\d+: no picture for 0.5 s"),
    ):
        list(camera)


def test_a_stream_that_goes_on_elsewhere_is_opened_again() -> None:
    """As where an encoder was restarted with other settings."""
    has_begun = threading.Event()  # what comes before would belong to the stream from the first

    def play(camera: StreamCamera) -> None:
        for _ in camera:
            has_begun.set()

    with (
        served(*[mpeg_stream(12)] * 20, has_begun, *[mpeg_stream(12, pid=0x140)] * 20) as camera,
        pytest.raises(OSError, match=r"tcp://127.0.0.1:\d+: another stream begins"),
    ):
        play(camera)


def test_a_stream_that_is_silent_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cameras, "OPEN_S", 0.3)
    silent = [b""] * 20
    with (
        served(*silent) as camera,
        pytest.raises(OSError, match=r"tcp://127.0.0.1:\d+: cannot be opened: nothing came for 0.3 s"),
    ):
        list(camera)


def test_a_stream_is_shown_upright(tmp_path: Path) -> None:
    film = make_shown(tmp_path / "clip.mp4", turned_deg=90, is_mirrored=False)
    shown = next(iter(StreamCamera(f"file://{film}", CameraOptions())))
    assert shown.image.shape == (128, 96)
    assert shown.is_damaged  # its key frame was taken to examine the stream


def test_incomplete_images_of_a_stream_of_jpegs() -> None:
    """As cameras send them over HTTP; of some images, the end is missing."""
    images = [cv2.imencode(".jpg", night_image(number))[1].tobytes() for number in range(8)]
    images[4:6] = [data[: len(data) // 2] for data in images[4:6]]
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        connection, _ = server.accept()
        with connection, contextlib.suppress(OSError):
            connection.recv(4096)
            connection.sendall(b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=b\r\n\r\n")
            for data in images:
                connection.sendall(b"--b\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(data))
                connection.sendall(data + b"\r\n")

    thread = threading.Thread(target=serve)
    thread.start()
    camera = open_live(f"http://127.0.0.1:{server.getsockname()[1]}/", CameraOptions())
    frames = list(itertools.islice(camera, 7))
    thread.join()
    server.close()
    is_black = [not frame.image[-20:].any() for frame in frames]  # below, where nothing came
    assert sum(is_black) == 2
    assert all(frame.is_damaged for frame, black in zip(frames, is_black, strict=True) if black)
    assert [frame.is_damaged for frame in frames].count(True) <= 3  # the next one is not trusted yet


def test_stream_that_is_not_there() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(OSError, match=rf"tcp://127.0.0.1:{port}: cannot be opened"):
        next(iter(open_live(f"tcp://127.0.0.1:{port}", CameraOptions())))


def test_a_stream_whose_title_is_not_utf_8(tmp_path: Path) -> None:
    film = make_titled(tmp_path / "clip.mkv")
    assert next(iter(StreamCamera(f"file://{film}", CameraOptions()))).image.shape == (72, 96)


@pytest.mark.slow
def test_a_damaged_stream_goes_on_with_marked_frames(tmp_path: Path) -> None:
    data = damaged_clip(tmp_path / "night.ts").read_bytes()
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        connection, _ = server.accept()
        with connection, contextlib.suppress(ConnectionError):
            connection.sendall(data)

    thread = threading.Thread(target=serve)
    thread.start()
    camera = open_live(f"tcp://127.0.0.1:{server.getsockname()[1]}", CameraOptions())
    frames: list[Frame] = []
    with contextlib.suppress(OSError):
        frames.extend(camera)
    thread.join()
    server.close()
    is_damaged = [frame.is_damaged for frame in frames]
    assert any(is_damaged)
    assert not is_damaged[-1]


def test_a_scheme_in_capitals_is_opened_all_the_same() -> None:
    with served(*[mpeg_stream(12)] * 20) as camera:
        assert next(iter(open_live(camera.name.replace("tcp://", "TCP://"), CameraOptions()))).timestamp_ns > 0
