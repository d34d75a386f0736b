"""Annotated pictures of a run: an H.264 video of many frames, or a PNG of one."""

from __future__ import annotations

import contextlib
import io
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import av
import cv2
import numpy as np
from av.container import OutputContainer
from av.video.stream import VideoStream

from foreglow.datasets.source import RESTART_NS
from foreglow.display.overlay import Picture, annotate
from foreglow.display.tone import Tone
from foreglow.files import checked_path
from foreglow.numbers import checked_number
from foreglow.types import Frame, FrameResult
from foreglow.whole_files import naming

if TYPE_CHECKING:
    from typing_extensions import Buffer

Drawing: TypeAlias = Callable[[Frame, FrameResult, Tone | None], Picture]
"""Makes the picture of a frame, such as `annotate`; the tone is None where it shall suit this frame alone."""

DEFAULT_FPS = 18.0
"""Frame rate of a video whose source has none, Hz: that of one exposure cycle of PVDN."""

MIN_FPS, MAX_FPS = 0.1, 1000.0
"""Frame rates that a video can state; other rates of a source are a mistake of its clock."""

TIME_BASE = Fraction(1, 90_000)
"""Unit of a video's times, s: that of MPEG, which every player knows; pictures are at most 6 us from their times."""

MAX_PAUSE_NS = 3_600_000_000_000
"""Longer pauses are left out of a video; an MP4 file cannot hold one of 13 hours."""

ENCODING = {"crf": "23", "preset": "ultrafast"}
"""Of x264. Of a brightened, noisy night the preset `veryfast` at a factor of 20 makes as large a file and as small an
error, in four times the processor's time."""

MAX_WAITING = 4
"""Pictures that wait to be drawn, each with its frame, before a run waits for them."""


class FilmTimes:
    """When the pictures of a video are shown: as far apart as they were taken.

    A sequence, and what follows a pause of more than `MAX_PAUSE_NS`, begins a frame's time after the picture before. So
    does a picture whose time stands still or goes back; those after it keep theirs.
    """

    def __init__(self, period_ns: float) -> None:
        """Times that begin at 0; `period_ns` is a frame's time."""
        self._period = max(1, round(Fraction(period_ns) / 1_000_000_000 / TIME_BASE))
        self._sequence, self._latest_ns, self._latest = "", 0, -1
        self._first_ns, self._first = 0, 0

    def next(self, timestamp_ns: int, sequence: str) -> int:
        """When the next picture is shown, in units of `TIME_BASE`; each is later than the one before."""
        step_ns = timestamp_ns - self._latest_ns
        is_first = self._latest < 0
        if is_first or sequence != self._sequence or not -RESTART_NS <= step_ns <= MAX_PAUSE_NS:
            self._first_ns, self._first = timestamp_ns, 0 if is_first else self._latest + self._period
        own = self._first + round(Fraction(timestamp_ns - self._first_ns, 1_000_000_000) / TIME_BASE)
        if own <= self._latest:
            own = self._latest + (1 if step_ns > 0 else self._period)
        self._latest = own
        self._sequence, self._latest_ns = sequence, timestamp_ns
        return self._latest


class _FilmFile(io.FileIO):
    """A file for PyAV, which would not close one of its own whose header it could not write."""

    def write(self, data: Buffer) -> int:
        """Writes all of `data`, at once, since FFmpeg reads the file as well to put the index at its front."""
        view, done = memoryview(data), 0
        while done < len(view):
            done += super().write(view[done:])
        return done


class Movie:
    """Pictures as an MP4 file (H.264, yuv420p, even sizes), one after the other, at the times of `FilmTimes`.

    A picture of another size than the first is fitted into the first one's. The file is a valid video once `close` has
    returned; without a picture there is none. The first error, such as a full disk, is the last: FFmpeg writes a header
    that failed once more, from memory that it has given back, so it is never called again.
    """

    def __init__(self, path: Path | str, fps: float | None = None) -> None:
        """A movie in the file `path`, whatever its suffix.

        Args:
            path: Where the video goes; nothing is written before the first picture.
            fps: Usual number of frames in a second; None means `DEFAULT_FPS`.

        Raises:
            ValueError: If `fps` is not a positive number.
        """
        path = checked_path(path)
        rate_hz = checked_number(f"{path}: fps", DEFAULT_FPS if fps is None else fps)
        if not 0.0 < rate_hz < float("inf"):
            raise ValueError(f"{path}: fps: expected a positive number, got {fps}")
        self._path = path
        self._rate = Fraction(min(max(rate_hz, MIN_FPS), MAX_FPS)).limit_denominator(1001)
        self._times = FilmTimes(float(1_000_000_000 / self._rate))
        self._file: _FilmFile | None = None
        self._container: OutputContainer | None = None
        self._stream: VideoStream | None = None
        self._failure: OSError | None = None

    def add(self, picture: Picture, timestamp_ns: int, sequence: str = "") -> None:
        """Appends `picture`, which was taken at `timestamp_ns`; sequences share no time axis.

        Raises:
            OSError: If the file cannot be written, now or earlier; the message names the path.
        """
        with self._writing():
            if self._container is None or self._stream is None:
                self._open(picture)
            assert self._container is not None
            assert self._stream is not None
            fitted = _fitted(picture, self._stream.width, self._stream.height)
            # Much quicker than FFmpeg's conversion.
            planes = np.asarray(cv2.cvtColor(fitted, cv2.COLOR_BGR2YUV_I420), np.uint8)
            frame = av.VideoFrame.from_ndarray(planes, format="yuv420p")
            frame.pts, frame.time_base = self._times.next(timestamp_ns, sequence), TIME_BASE
            for packet in self._stream.encode(frame):
                self._container.mux(packet)

    def close(self) -> None:
        """Completes the video.

        Raises:
            OSError: If the file cannot be written, now or earlier; the message names the path.
        """
        with self._writing():
            if self._container is None or self._stream is None:
                return
            for packet in self._stream.encode(None):
                self._container.mux(packet)
            self._container.close()
            self._close_file()
        self._container = None

    def discard(self) -> None:
        """Closes the file, whatever it may hold by then."""
        if self._container is not None:
            with contextlib.suppress(av.error.FFmpegError, OSError):
                self._container.close()
            self._container = None
        with contextlib.suppress(OSError):
            self._close_file()

    def _close_file(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            file.close()

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """Keeps the first error, after which the file is closed and nothing is done any more but raise it again."""
        if self._failure is not None:
            raise self._failure
        try:
            yield
        except (av.error.FFmpegError, OSError) as error:
            self._failure = OSError(error.errno, error.strerror, str(self._path))
            Movie.discard(self)
            raise self._failure from error

    def _open(self, picture: Picture) -> None:
        self._file = _FilmFile(str(self._path), "w")
        self._container = av.open(self._file, "w", format="mp4", options={"movflags": "+faststart"})
        self._stream = self._container.add_stream("libx264", rate=self._rate, options=dict(ENCODING))
        self._stream.height, self._stream.width = picture.shape[:2]
        self._stream.pix_fmt = "yuv420p"
        self._stream.codec_context.time_base = TIME_BASE


class VideoSink(Movie):
    """A result sink that writes pictures of the frames as a `Movie`, annotated ones unless another drawing is given.

    The brightening curve is that of the first frame of a depth, so that the video does not flicker. Pictures are drawn
    and encoded in a thread of their own, while the run goes on.
    """

    def __init__(self, path: Path | str, fps: float | None = None, draw: Drawing = annotate) -> None:
        """A sink for the file `path`, as `Movie` takes them."""
        super().__init__(path, fps)
        self._draw = draw
        self._tone: Tone | None = None
        self._painter = ThreadPoolExecutor(max_workers=1, thread_name_prefix="video")
        self._waiting: deque[Future[None]] = deque()

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Has the picture of `frame` added.

        Raises:
            OSError: If the file cannot be written, perhaps for an earlier frame; the message names the path.
        """
        self._waiting.append(self._painter.submit(self._paint, frame, result))
        self._await(MAX_WAITING)

    def close(self) -> None:
        """As `Movie.close`."""
        self._await(0)
        self._painter.shutdown()
        super().close()

    def discard(self) -> None:
        """As `Movie.discard`; pictures that wait are not drawn."""
        self._painter.shutdown(cancel_futures=True)
        super().discard()

    def _await(self, num_waiting: int) -> None:
        while len(self._waiting) > num_waiting:
            self._waiting.popleft().result()

    def _paint(self, frame: Frame, result: FrameResult) -> None:
        if self._tone is None or not self._tone.fits(frame.image):
            self._tone = Tone.of(frame.image)
        self.add(self._draw(frame, result, self._tone), frame.timestamp_ns, frame.sequence)


class PictureSink:
    """A result sink that writes the picture of the last frame it gets as PNG; for a single image."""

    def __init__(self, path: Path | str, draw: Drawing = annotate) -> None:
        self._path = checked_path(path)
        self._draw = draw
        self._picture: Picture | None = None

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Keeps the picture of `frame`."""
        self._picture = self._draw(frame, result, None)

    def close(self) -> None:
        """Writes the picture, if there was a frame.

        Raises:
            OSError: If the file cannot be written; the message names the path.
        """
        if self._picture is not None:
            with naming(self._path):
                png = cv2.imencode(".png", self._picture, [cv2.IMWRITE_PNG_COMPRESSION, 6])[1]
                self._path.write_bytes(png.tobytes())

    def discard(self) -> None:
        """Lets go of the picture."""
        self._picture = None


def _fitted(picture: Picture, width_px: int, height_px: int) -> Picture:
    """`picture` scaled and centred on black to `width_px` x `height_px`; itself where it has that size."""
    height, width = picture.shape[:2]
    if (width, height) == (width_px, height_px):
        return picture
    scale = min(width_px / width, height_px / height)
    size_px = (max(1, min(width_px, round(width * scale))), max(1, min(height_px, round(height * scale))))
    canvas = np.zeros((height_px, width_px, 3), np.uint8)
    left_px, top_px = (width_px - size_px[0]) // 2, (height_px - size_px[1]) // 2
    smaller = cv2.resize(picture, size_px, interpolation=cv2.INTER_AREA)
    canvas[top_px : top_px + size_px[1], left_px : left_px + size_px[0]] = smaller
    return canvas
