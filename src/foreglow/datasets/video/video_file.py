"""Frames from a video file."""

from __future__ import annotations

import dataclasses
import errno
from collections import Counter, deque
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

from foreglow.datasets.file_state import FileStates
from foreglow.datasets.images import MAX_SIDE_PX, check_size
from foreglow.datasets.source import FileSource, OnError, TimeOrder
from foreglow.datasets.video.containers.ends import hole, missing_bytes
from foreglow.datasets.video.containers.transport import Losses, TransportLosses
from foreglow.datasets.video.decoding import (
    CODEC_OPTIONS,
    FILM_FORMATS,
    decoded,
    grey_image,
    picture_chroma,
    video_stream,
    video_streams,
)
from foreglow.files import check_file
from foreglow.types import Frame

_LEAST_SHARE = 0.95
"""An MP4 that yields less than this share of its stated number of frames counts as damaged."""

_FEW_FRAMES = 4
"""A Matroska file may end so many frames' times before its stated end."""

_LAST_PACKETS = 2
"""So many of a transport stream's video may come at the end of the file only, after another stream began."""

RAW_STREAMS = frozenset({"h264", "hevc", "m4v", "mpegvideo", "mjpeg", "obu", "av1"})
"""FFmpeg's names of streams without a container: they have no times, and FFmpeg takes them all for 25 Hz."""

MAX_RATE_HZ = 1000
"""A raw stream that says more of itself has no rate that a camera has."""

_SQUARE = Fraction(1, 100)
"""Pixels that are so much wider than high, or less, are square: some recorders round."""

_CONTAINER_OPTIONS = {"format_whitelist": ",".join(FILM_FORMATS)}

_VAGUE = (errno.EINVAL, errno.EBUSY)
"""What FFmpeg says of a format that is not allowed, and of a picture that is too large."""


class Video(FileSource):
    """The frames of a file's first video stream, decoded as they are asked for, grey and upright.

    A cover picture is no video stream. A display matrix, with which a camera says how it was held, is applied.
    Streams of up to 8 bits give uint8, deeper ones uint16 (10 or 12 bits stretched to 16). Timestamps are the
    stream's own presentation times; a frame without one follows the frame before at the stream's rate, and so does each
    of a raw stream (`RAW_STREAMS`), at the rate that it says itself, else at 25 Hz. Where times begin anew, as in files
    that were appended to each other, so does a sequence, which is named after its first frame.
    A cut file is an error, and so is one with damage between its parts, so that frames may be missing and those behind
    have too small numbers, one with a second film behind the first (see `containers.ends`), and a Matroska file that
    ends before its stated time. So is a file that changes after it was opened, as is found at its end. So are frames
    that are `damaged` (see `decoding`): with `skip` they are left out, with `mark` they are marked.

    Attributes:
        path: The file.
        rate_hz: Average frames a second by the container; None if unknown.
        num_frames: Number of frames by the container, which may be wrong by a few; None if unknown.
        pixel_aspect: Width of a pixel over its height, as the file says it, before any display matrix; 1 if it is
            square to a hundredth, or nobody says it.
        notes: Lines for people, if need be: what is assumed of the times, that pixels are not square, and that
            there are further video streams.
    """

    def __init__(self, path: Path | str, *, on_error: OnError = "stop") -> None:
        """Opens the file, reads its header and closes it again.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If it is empty, not a video, has no video stream or a size that is not accepted; with `stop`
                also if the file is shorter than its container says, or frames may be missing.
        """
        super().__init__(path, on_error)
        self.path = self.origin
        if not self.path.exists():
            raise FileNotFoundError(f"{self.path}: no such video")
        check_file(self.path)
        if self.path.stat().st_size == 0:
            raise ValueError(f"{self.path}: expected a video, the file is empty")
        self._states = FileStates([self.path])
        missing = missing_bytes(self.path)
        cut = f"{self.path}: truncated video, {missing} bytes are missing at the end, or a size that it states is wrong"
        self._truncation = cut if missing else ""
        with self._opened() as (container, stream):
            self._is_raw = container.format.name in RAW_STREAMS
            stated: Fraction | None = stream.codec_context.framerate if self._is_raw else None
            is_stated = stated is not None and 1 <= stated <= MAX_RATE_HZ
            rate: Fraction | None = stated if is_stated else stream.average_rate
            if rate and rate > MAX_RATE_HZ:  # as of raw DV
                rate = stream.guessed_rate
            self._rate = rate if rate else None
            self.num_frames = _num_frames(stream)
            self._is_counted = "mp4" in container.format.name
            # AVI and ASF state when pictures are decoded, not when they are shown; FFmpeg guesses, and guesses wrong.
            self._is_reordered = container.format.name in ("avi", "asf") and bool(stream.codec_context.has_b_frames)
            self._stated_end_ns = _stated_end_ns(container)
            self._hole = hole(self.path, container.format.name)
            self.pixel_aspect = _pixel_aspect(stream)
            check_size(stream.codec_context.height, stream.codec_context.width, str(self.path))
            num_others = len(video_streams(container)) - 1
        self.rate_hz = float(self._rate) if self._rate else None
        self.notes: list[str] = []
        if self.pixel_aspect != 1:
            self.notes.append(f"{self.path}: {self.words_on_pixels}, and are taken as they are stored")
        if self._is_raw and self._rate is not None:
            why = "as the stream says itself" if is_stated else "as nothing says another rate"
            self.notes.append(
                f"{self.path}: a raw stream has no times: taken for {self.rate_hz:g} frames a second, {why}; speeds, "
                "leads and delays follow from it (`ffmpeg -r RATE -i FILE -c copy OUT.mp4` gives it another)"
            )
        if num_others:
            self.notes.append(
                f"{self.path}: has {num_others + 1} video streams, as of several cameras: the first one is read "
                "(`ffmpeg -i FILE -map 0:v:1 -c copy OUT.mp4` makes a file of the second)"
            )
        # Where bytes are missing in the middle, the container misses them at the end, too.
        self._lost = [*(self._hole.lines if self._hole else ()), *([self._truncation] if missing else [])]
        if self._lost and on_error == "stop":
            raise ValueError(self._lost[0])

    @property
    def name(self) -> str:
        """Name of the file."""
        return self.path.name

    @property
    def words_on_pixels(self) -> str:
        """That its pixels are not square, and what can be done about it."""
        shape = f"its pixels are {float(self.pixel_aspect):.3g} times as wide as high"
        return f"{shape} (`ffmpeg -i FILE -vf scale=iw*sar:ih,setsar=1 OUT.mp4` makes them square)"

    def __iter__(self) -> Iterator[Frame]:
        self.lost_parts = [*self._lost]
        self.skipped = [*self.lost_parts]
        return self._frames()

    def _frames(self) -> Iterator[Frame]:
        """All frames, up to where the container cannot be read."""
        from av.error import FFmpegError

        index, order, reached_ns, has_begun, failure = -1, TimeOrder(), 0, False, ""
        try:
            with self._opened() as (container, stream):
                whole = _Whole(container, self._hole.film if self._hole else None)
                is_transport = container.format.name == "mpegts"
                losses: Losses | None = self._hole
                if is_transport:  # only the decoder of H.265 does not say that the end of a frame is missing
                    must_be_filled = stream.codec_context.name == "hevc"
                    losses = TransportLosses(self.path, stream.id, must_be_filled=must_be_filled)
                for picture, is_damaged in decoded(whole, stream, losses):
                    index += 1
                    time = whole.times.popleft() if whole.times else None
                    if picture is not None and self._is_reordered and time is not None:
                        picture.pts = time
                    if picture is not None and picture.pts is not None and picture.time_base:
                        end = (int(picture.pts) + (picture.duration or 0)) * Fraction(picture.time_base)
                        reached_ns = max(reached_ns, round(end * 1_000_000_000))
                    if is_damaged and (picture is None or self.on_error != "mark"):
                        self._refuse(f"{self.path}: frame {index}: expected an undamaged frame, decoder reports damage")
                        continue
                    timestamp_ns = self._timestamp_ns(index, picture, order.latest)
                    try:
                        order.take(index, timestamp_ns)
                    except ValueError as error:
                        self._refuse(f"{self.path}: frame {index}: {error}")
                        continue
                    try:
                        frame = self._frame(index, picture, timestamp_ns, is_damaged=is_damaged)
                    except ValueError as error:
                        if not has_begun:
                            raise
                        self._refuse(str(error))  # damage can change what one frame says of how it is shown
                        continue
                    has_begun = True
                    yield dataclasses.replace(frame, sequence=order.sequence)
        except FFmpegError as error:
            failure = f"{self.path}: frame {index + 1}: cannot be read: {error.strerror}"
        change = self._states.change()
        if change or failure:
            self._lose(change or failure)
        if not change:
            self._check_end(reached_ns, index + 1)
        if self.skipped:
            return
        if index < 0:
            self._refuse(f"{self.path}: expected a video with at least one frame, none could be decoded")
        # An MP4's sample table is exact; if it is damaged, the demuxer ends early and silently.
        elif self._is_counted and self.num_frames and index + 1 < _LEAST_SHARE * self.num_frames - 2:
            self._lose(f"{self.path}: expected about {self.num_frames} frames, the stream ends after {index + 1}")

    def _check_end(self, reached_ns: int, num_frames: int) -> None:
        """Refuses a file whose frames end long before the time that it states; its demultiplexer gave up silently."""
        period_ns = max(1_000_000_000 / self._rate if self._rate else 0, reached_ns / max(num_frames, 1))
        if num_frames and not self._truncation and self._stated_end_ns - reached_ns > _FEW_FRAMES * period_ns:
            stated_s, reached_s = self._stated_end_ns / 1e9, reached_ns / 1e9
            self._lose(f"{self.path}: expected frames until {stated_s:.2f} s, the stream ends after {reached_s:.2f} s")

    def _frame(self, index: int, picture: Any, timestamp_ns: int, *, is_damaged: bool) -> Frame:
        try:
            image, chroma = grey_image(picture), picture_chroma(picture)
        except ValueError as error:
            raise ValueError(f"{self.path}: frame {index}: {error}") from None
        check_size(image.shape[0], image.shape[1], f"{self.path}: frame {index}")
        path = f"{self.path}, frame {index}"
        return Frame(image, timestamp_ns, frame=index, path=path, is_damaged=is_damaged, red_chroma=chroma)

    def _timestamp_ns(self, index: int, picture: Any, latest: tuple[int, int]) -> int:
        """The picture's own time; without one, what the rate makes of number and time of the `latest` frame."""
        if picture.pts is not None and not self._is_raw and picture.time_base:
            return round(int(picture.pts) * Fraction(picture.time_base) * 1_000_000_000)
        if self._rate is None:
            raise ValueError(f"{self.path}: frame {index}: expected a timestamp, the file has neither times nor a rate")
        return latest[1] + round((index - latest[0]) * 1_000_000_000 / self._rate)

    @contextmanager
    def _opened(self) -> Iterator[tuple[Any, Any]]:
        import av  # only here: most commands read no video, and start sooner without
        from av.error import FFmpegError

        try:
            # Without a protocol, a name with a colon would be an address.
            container: Any = av.open(
                f"file:{self.path}",
                options=CODEC_OPTIONS,
                container_options=_CONTAINER_OPTIONS,
                metadata_errors="replace",  # such as a title that is not UTF-8
            )
        except (FFmpegError, ValueError) as error:
            expected = f"expected a video (such as MP4, MKV or AVI) of at most {MAX_SIDE_PX} px a side"
            reason = "" if getattr(error, "errno", 0) in _VAGUE else f": {getattr(error, 'strerror', error)}"
            raise ValueError(self._truncation or f"{self.path}: {expected}, cannot be opened{reason}") from error
        with container:
            yield container, video_stream(container, str(self.path))


class _Whole:
    """A container that notices where its video goes on as another stream, as after a restart of the recorder.

    Attributes:
        times: When each picture is decoded that has been read, in units of the stream, None if not stated. Pictures are
            shown at these times, too, in another order; who takes a picture takes the first of them.
    """

    def __init__(self, container: Any, film: int | None) -> None:
        """Of a container whose second film, which is not read, begins at byte `film`; None for no such film."""
        self._container = container
        self._film = film
        self.times: deque[int | None] = deque()

    def demux(self, stream: Any) -> Iterator[Any]:
        """The packets of `stream`.

        Raises:
            FFmpegError: If the container cannot be read any further, or another video stream begins where it ends.
        """
        from av import Packet
        from av.error import InvalidDataError

        num_others: Counter[int] = Counter()  # packets of other video streams
        num_ours: Counter[int] = Counter()  # packets of this one since each of those began
        for packet in self._container.demux(video_streams(self._container)):
            if self._film is not None and packet.size and packet.pos is not None and packet.pos >= self._film:
                last: Any = Packet()
                last.stream = stream  # an empty one, for which the decoder gives its last pictures
                yield last
                break
            if packet.stream is stream:
                num_ours.update(num_others.keys() if packet.size else ())
                if packet.size:
                    self.times.append(packet.dts)
                yield packet
            elif packet.size:
                num_others[packet.stream.index] += 1
        if any(num > _LAST_PACKETS and num_ours[index] <= _LAST_PACKETS for index, num in num_others.items()):
            raise InvalidDataError(errno.EINVAL, "another video stream begins where this one ends")


def _pixel_aspect(stream: Any) -> Fraction:
    """Width of a pixel over its height; 1 if that is unknown, or hardly another."""
    found = Fraction(stream.sample_aspect_ratio or 1)
    return found if abs(found - 1) > _SQUARE else Fraction(1)


def _stated_end_ns(container: Any) -> int:
    """When a Matroska file ends that holds nothing but a video, by its header; 0 if unknown."""
    is_stated = "matroska" in container.format.name and len(container.streams) == 1
    return int(container.duration) * 1000 if is_stated and container.duration else 0


def _num_frames(stream: Any) -> int | None:
    """Number of frames by the stream's header; an edit list can hide some, which shows in the duration."""
    num_frames: int | None = stream.frames or None
    if num_frames and stream.duration and stream.time_base and stream.average_rate:
        return min(num_frames, round(int(stream.duration) * Fraction(stream.time_base) * Fraction(stream.average_rate)))
    return num_frames
