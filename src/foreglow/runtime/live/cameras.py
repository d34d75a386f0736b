"""Cameras and streams: frames are stamped on arrival, by the machine's steady clock."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

import av
import cv2
from av.error import ExitError, FFmpegError

from foreglow.datasets import VehicleData, to_grey
from foreglow.datasets.images import Chroma, check_size, quiet_opencv, red_chroma
from foreglow.datasets.vehicle_data import equip
from foreglow.datasets.video.decoding import CODEC_OPTIONS, decoded, grey_image, picture_chroma, video_stream
from foreglow.numbers import checked_number, checked_whole
from foreglow.types import Frame, Image
from foreglow.types.arrays import check_kind, check_members
from foreglow.wording import shortened, without_password

OPEN_S, READ_S = 5.0, 1.0
"""Longest time that a network stream may take to open, and to deliver its next packet."""

PICTURE_S = 30.0
"""Longest time until packets of a network stream become a picture: encoders send a key frame more often."""

MAX_DELAY_S = 1.0
"""Longest time from the exposure until the frame arrives."""

STREAM_SCHEMES = (
    *("rtsp", "rtsps", "rtmp", "rtmps", "rtmpt", "http", "https", "tcp", "tls", "udp", "rtp", "srtp", "srt"),
    *("sctp", "mmsh", "mmst"),
)
"""Of FFmpeg's protocols, those that a camera or a server on the network may speak."""

MAX_DIGITS = 3
"""Of a camera's number."""

GREY_16 = cv2.VideoWriter.fourcc(*"Y16 ")
"""V4L2's name of grey with 16 bits, of which OpenCV would keep the upper 8 alone: of 10 or 12 bits, next to nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraOptions:
    """How a live source is read.

    Attributes:
        size_px: Width and height to request from a camera, which is lost with others; None for its own.
        rate_hz: Frame rate to request from a camera and to expect; None for its own.
        delay_s: From the middle of the exposure until the frame arrives; subtracted from the time of arrival.
        data: The car's own data for each frame, with a camera no log or poses of an earlier drive; None without.
        seed: The seed of a simulated drive.
        quality: How finely a simulated drive is rendered.

    Raises:
        ValueError: If size, rate or delay is none that a camera can have, or another value is of another kind.
    """

    size_px: tuple[int, int] | None = None
    rate_hz: float | None = None
    delay_s: float = 0.0
    data: VehicleData | None = None
    seed: int = 0
    quality: str = "training"

    def __post_init__(self) -> None:
        plain: dict[str, Any] = {"seed": checked_whole("seed", self.seed)}
        if self.size_px is not None:
            if not isinstance(self.size_px, tuple | list) or len(self.size_px) != 2:
                raise ValueError(f"size_px: expected width and height, got {shortened(self.size_px)}")
            plain["size_px"] = tuple(checked_whole("size_px", side, 1) for side in self.size_px)
        if self.rate_hz is not None:
            plain["rate_hz"] = checked_number("rate_hz", self.rate_hz)
            if not 0 < plain["rate_hz"] < math.inf:
                raise ValueError(f"rate_hz: expected a positive number or None, got {self.rate_hz}")
        plain["delay_s"] = checked_number("delay_s", self.delay_s)
        if not 0 <= plain["delay_s"] <= MAX_DELAY_S:
            raise ValueError(f"delay_s: expected 0 to {MAX_DELAY_S:g} seconds, got {self.delay_s}")
        if self.data is not None:
            check_members("data", self.data, "vehicle data", "camera", "motion", "road", "of_one_drive")
        check_kind("quality", self.quality, str)
        for name, value in plain.items():
            object.__setattr__(self, name, value)


class LiveCamera(ABC):
    """The base of live cameras: the clock, a name `without_password`, and frames that are numbered from 0 on.

    Iterating opens the camera; it is released when the iteration ends. A camera that ends or raises is lost, and is
    opened again by iterating again.
    """

    max_silence_s: float | None = None
    speed = 1.0
    is_lossless = False
    is_endless = True
    num_frames: int | None = None
    skipped: Sequence[str] = ()

    def __init__(self, name: str, options: CameraOptions) -> None:
        """A camera that is not opened yet.

        Raises:
            ValueError: If the car's data are those of a drive that is over, whose speed would pass for today's.
        """
        self.name = without_password(name)
        of_a_drive = () if options.data is None else options.data.of_one_drive
        if of_a_drive:
            raise ValueError(
                f"{self.name}: expected no {' or '.join(of_a_drive)} with a camera: it is of a drive that is over, and "
                "says nothing of what the car does now, which comes by --can-in"
            )
        self.rate_hz = options.rate_hz
        self._options = options
        self._number = 0

    @abstractmethod
    def __iter__(self) -> Iterator[Frame]:
        """The frames, each made by `arrived`."""

    def now_ns(self) -> int:
        """The machine's steady clock."""
        return time.monotonic_ns()

    def arrived(self, image: Image, *, is_damaged: bool = False, red_chroma: Chroma | None = None) -> Frame:
        """The next frame: a grey image that has just arrived, and its colour, if there is any."""
        timestamp_ns = self.now_ns() - round(self._options.delay_s * 1e9)
        check_size(image.shape[0], image.shape[1], self.name)
        path = f"{self.name}, frame {self._number}"
        frame = Frame(image, timestamp_ns, self._number, path=path, is_damaged=is_damaged, red_chroma=red_chroma)
        self._number += 1
        return frame if self._options.data is None else equip(frame, self._options.data)


class CaptureCamera(LiveCamera):
    """A camera of this machine, through OpenCV: a V4L2 device, or a GStreamer pipeline."""

    def __init__(self, name: str, device: int | str, backend: int, options: CameraOptions) -> None:
        """A camera that is not opened yet.

        Args:
            name: Its name in messages.
            device: Number, path, or pipeline.
            backend: OpenCV's backend, such as `cv2.CAP_V4L2`.
            options: How it is read.
        """
        super().__init__(name, options)
        self._device, self._backend = device, backend

    def __iter__(self) -> Iterator[Frame]:
        with quiet_opencv():
            capture = cv2.VideoCapture(self._device, self._backend)
        try:
            if not capture.isOpened():
                raise OSError(f"{self.name}: cannot be opened")
            if self._options.size_px is not None:
                capture.set(cv2.CAP_PROP_FRAME_WIDTH, self._options.size_px[0])
                capture.set(cv2.CAP_PROP_FRAME_HEIGHT, self._options.size_px[1])
            if self._options.rate_hz is not None:
                capture.set(cv2.CAP_PROP_FPS, self._options.rate_hz)
            capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # frames that wait in the driver are old
            if self._backend == cv2.CAP_V4L2 and capture.get(cv2.CAP_PROP_FOURCC) == GREY_16:
                capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
            while True:
                is_read, image = capture.read()
                if not is_read:
                    raise OSError(f"{self.name}: brings no more frames")
                chroma, grey = red_chroma(image, order="bgr"), to_grey(image, self.name, order="bgr")
                size_px = grey.shape[1], grey.shape[0]
                if self._options.size_px not in (None, size_px):
                    wanted = "{}x{}".format(*self._options.size_px)
                    raise OSError(
                        f"{self.name}: size: expected images of {wanted}, as asked for, got {size_px[0]}x{size_px[1]}"
                    )
                yield self.arrived(grey, red_chroma=chroma)
        finally:
            capture.release()


def open_v4l2(device: str, options: CameraOptions) -> CaptureCamera:
    """The V4L2 device with this number or path.

    Raises:
        ValueError: If it is neither.
    """
    is_number = device.isascii() and device.isdecimal() and len(device) <= MAX_DIGITS
    if not (is_number or device.startswith("/")):
        raise ValueError(f"camera:{device}: expected a number, or a path such as /dev/video0, got {device!r}")
    number_or_path = int(device) if is_number else device
    return CaptureCamera(f"camera:{device}", number_or_path, cv2.CAP_V4L2, options)


def open_gstreamer(pipeline: str, options: CameraOptions) -> CaptureCamera:
    """A GStreamer pipeline that ends in an appsink.

    Raises:
        ValueError: If it is empty.
    """
    if not pipeline.strip():
        raise ValueError("gstreamer: expected a pipeline that ends in an appsink, got none")
    return CaptureCamera(f"gstreamer:{pipeline}", pipeline, cv2.CAP_GSTREAMER, options)


def open_stream(address: str, options: CameraOptions) -> StreamCamera:
    """The network stream at an address, which is not looked for yet: it may come later.

    Raises:
        ValueError: If no stream can ever be there: for its scheme, host or port.
    """
    scheme, shown = address.partition("://")[0], without_password(address)
    if scheme.lower() not in STREAM_SCHEMES:
        raise ValueError(f"{shown}: expected an address with one of {', '.join(STREAM_SCHEMES)}, or a path")
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise ValueError(f"{shown}: expected an address such as {scheme}://HOST:PORT: {error}") from None
    if host is None and port is None:  # udp://:5000 listens
        raise ValueError(f"{shown}: expected an address such as {scheme}://HOST:PORT, got no host")
    return StreamCamera(address, options)


class StreamCamera(LiveCamera):
    """A network stream, such as RTSP, through FFmpeg; its size and rate are its own."""

    def __init__(self, address: str, options: CameraOptions) -> None:
        """The stream at `address`, which is not opened yet."""
        super().__init__(address, options)
        self._address = address

    def __iter__(self) -> Iterator[Frame]:
        options = {"rtsp_transport": "tcp", "fflags": "nobuffer", "flags": "low_delay", **CODEC_OPTIONS}
        try:
            scheme, colon, rest = self._address.partition(":")  # of which FFmpeg knows no capitals
            url, limits_s = scheme.lower() + colon + rest, (OPEN_S, READ_S)
            container: Any = av.open(url, options=options, timeout=limits_s, metadata_errors="replace")
        except (FFmpegError, ValueError) as error:
            raise OSError(f"{self.name}: cannot be opened: {_reason(error, OPEN_S)}") from error
        with closing(container):
            awaited = _Awaited(container, self.name)
            try:
                for picture, is_damaged in decoded(awaited, video_stream(container, self.name)):
                    if picture is not None:
                        awaited.seen_s = time.monotonic()
                        image, chroma = grey_image(picture), picture_chroma(picture)
                        yield self.arrived(image, is_damaged=is_damaged, red_chroma=chroma)
            except FFmpegError as error:
                raise OSError(f"{self.name}: {_reason(error, READ_S)}") from error


class _Awaited:
    """A stream's container that is given up where packets come but no pictures of them, as after a change of codec.

    Attributes:
        seen_s: When the latest picture was decoded, by the machine's steady clock.
    """

    def __init__(self, container: Any, name: str) -> None:
        self._container, self._name = container, name
        self.seen_s = time.monotonic()

    def demux(self, stream: Any) -> Iterator[Any]:
        """The packets of `stream`.

        Raises:
            OSError: If there was no picture for `PICTURE_S`.
        """
        for packet in self._container.demux():
            if time.monotonic() - self.seen_s > PICTURE_S:
                raise OSError(f"{self._name}: no picture for {PICTURE_S:g} s")
            if packet.stream is stream:
                yield packet


def _reason(error: Exception, limit_s: float) -> str:
    """Why a stream could not be opened or read, where it had so much time."""
    return f"nothing came for {limit_s:g} s" if isinstance(error, ExitError) else getattr(error, "strerror", str(error))
