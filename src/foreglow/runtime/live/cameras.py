"""Cameras and streams: frames stamped when they arrive, by the machine's steady clock."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import av
import cv2
from av.error import FFmpegError

from foreglow.datasets import VehicleData, to_grey
from foreglow.datasets.images import check_size, quiet_opencv
from foreglow.datasets.vehicle_data import equip
from foreglow.types import Frame, Image

OPEN_S, READ_S = 5.0, 1.0
"""A network stream may take so long to open, and to bring the next packet."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraOptions:
    """How a camera is read.

    Attributes:
        size_px: Width and height to ask it for; None for its own.
        rate_hz: Frames a second to ask it for and to expect; None where it knows itself.
        delay_s: From the middle of the exposure until the frame is here; taken off the time of arrival.
        data: What the car knows of each frame; None for nothing.
    """

    size_px: tuple[int, int] | None = None
    rate_hz: float | None = None
    delay_s: float = 0.0
    data: VehicleData | None = None


class _Arriving:
    """What all live cameras have in common: the clock, and frames numbered from 0 on."""

    max_silence_s: float | None = None
    speed = 1.0
    is_lossless = False
    is_endless = True
    num_frames: int | None = None
    skipped: Sequence[str] = ()

    def __init__(self, name: str, options: CameraOptions) -> None:
        self.name = name
        self.rate_hz = options.rate_hz
        self._options = options
        self._number = 0

    def now_ns(self) -> int:
        """The machine's steady clock."""
        return time.monotonic_ns()

    def _frame(self, image: Image) -> Frame:
        """The next frame, which has just arrived."""
        timestamp_ns = self.now_ns() - round(self._options.delay_s * 1e9)
        check_size(image.shape[0], image.shape[1], self.name)
        frame = Frame(image, timestamp_ns, self._number, path=f"{self.name}, frame {self._number}")
        self._number += 1
        return frame if self._options.data is None else equip(frame, self._options.data)


class CaptureCamera(_Arriving):
    """A camera of this machine, through OpenCV: V4L2 by number or device, or a GStreamer pipeline.

    Iterating opens it; it is released when the iteration ends.
    """

    def __init__(self, name: str, device: int | str, backend: int, options: CameraOptions) -> None:
        """Takes what to open.

        Args:
            name: What messages call it.
            device: Number, path, or pipeline.
            backend: OpenCV's, such as `cv2.CAP_V4L2`.
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
            capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # what waits in the driver is old
            while True:
                is_read, image = capture.read()
                if not is_read:
                    raise OSError(f"{self.name}: brings no more frames")
                yield self._frame(to_grey(image, self.name, order="bgr"))
        finally:
            capture.release()


class StreamCamera(_Arriving):
    """A network stream, such as RTSP, through FFmpeg. Iterating opens it; it is closed when the iteration ends."""

    def __init__(self, url: str, options: CameraOptions) -> None:
        """Takes the address, and how it is read; a stream's size and rate are its own."""
        super().__init__(url, options)

    def __iter__(self) -> Iterator[Frame]:
        options = {"rtsp_transport": "tcp", "fflags": "nobuffer", "flags": "low_delay"}
        try:
            container: Any = av.open(self.name, options=options, timeout=(OPEN_S, READ_S))
        except (FFmpegError, ValueError) as error:
            raise OSError(f"{self.name}: cannot be opened: {getattr(error, 'strerror', error)}") from error
        with closing(container):
            if not container.streams.video:
                raise OSError(f"{self.name}: expected a video stream, it has none")
            try:
                for picture in container.decode(container.streams.video[0]):
                    yield self._frame(picture.to_ndarray(format="gray"))
            except FFmpegError as error:
                raise OSError(f"{self.name}: {error.strerror}") from error
