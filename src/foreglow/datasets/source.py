"""The interface of every source of frames, and the treatment of bad frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Literal, Protocol, TypeAlias

from foreglow.files import checked_path
from foreglow.numbers import checked_number
from foreglow.types import Frame
from foreglow.types.arrays import check_members
from foreglow.wording import check_one_of, exact_seconds, shortened

OnError: TypeAlias = Literal["stop", "skip", "mark"]
"""What a bad frame does: `stop` raises, `skip` leaves it out and notes one line in `FrameSource.skipped`. `mark` does
the same, but a frame that could be decoded although its stream is damaged comes with `Frame.is_damaged`."""


def also_left_out(skipped: Iterable[str], known: Collection[str] = ()) -> str:
    """What to add to a message about frames that are missing: the first part of a source that was left out.

    Args:
        skipped: `FrameSource.skipped`.
        known: Lines of it that are not meant, as nothing is missing for them.

    >>> also_left_out(["a.png: damaged", "b.png: damaged"], ["a.png: damaged"]), also_left_out([])
    ('; b.png: damaged', '')
    """
    return next((f"; {line}" for line in skipped if line not in known), "")


RESTART_NS = 1_000_000_000
"""Where times go back by more than this, another recording begins; by less, a frame is late."""


class TimeOrder:
    """Sees to the order of time of a file's frames.

    Attributes:
        sequence: The frames' sequence: empty, or named after the frame at which times began anew.
        latest: Index and time of the latest frame that was taken; zeros before the first.
    """

    def __init__(self) -> None:
        self.sequence, self.latest, self._has_begun = "", (0, 0), False

    def take(self, index: int, timestamp_ns: int) -> None:
        """Takes the next frame.

        Raises:
            ValueError: If it is late.
        """
        latest_ns = self.latest[1] if self._has_begun else timestamp_ns
        if timestamp_ns < latest_ns - RESTART_NS:
            self.sequence = f"frame {index}"
        elif timestamp_ns < latest_ns:
            expected = f"expected a time from {exact_seconds(latest_ns)} s on, that of the frame before"
            raise ValueError(f"{expected}, got {exact_seconds(timestamp_ns)} s")
        self.latest, self._has_begun = (index, timestamp_ns), True


class FrameSource(Protocol):
    """Frames in the order of time; iterating again starts again from the first."""

    @property
    def name(self) -> str:
        """Short name for messages and results, such as `day/val/S00121`."""
        ...

    @property
    def rate_hz(self) -> float | None:
        """Nominal frames a second; None if unknown."""
        ...

    @property
    def num_frames(self) -> int | None:
        """Number of frames if none is bad; by a video's header it may be wrong by a few. None if unknown."""
        ...

    @property
    def skipped(self) -> Sequence[str]:
        """A line for each frame that the latest iteration left out so far; empty with `stop`."""
        ...

    def __iter__(self) -> Iterator[Frame]: ...


def check_source(field: str, source: object, *further: str) -> None:
    """Checks that `source` is what `FrameSource` describes, as Python callers may give anything, and write their own.

    Args:
        field: What it was given as, for the message.
        source: Anything.
        further: Names of what else it has to have.

    Raises:
        ValueError: If it lacks something, is no object over which one can iterate, or has a rate that is no positive
            number; the message begins with `field`.

    >>> check_source("source", [])
    Traceback (most recent call last):
    ValueError: source: expected frames, as of foreglow.open_source(path), got list, which lacks name, rate_hz, skipped
    """
    expected = "frames, as of foreglow.open_source(path)"
    check_members(field, source, expected, "__iter__", *further, "name", "rate_hz", "skipped")
    rate_hz = source.rate_hz  # type: ignore[attr-defined]
    if rate_hz is not None and not 0.0 < checked_number(f"{field}: rate_hz", rate_hz) < math.inf:
        raise ValueError(f"{field}: rate_hz: expected a positive number or None, got {shortened(rate_hz)}")


class FileSource:
    """A source of frames from files, some of which may be bad.

    Attributes:
        origin: The file or folder, as it was given.
        skipped: A line for each part that the latest iteration left out so far.
        lost_parts: Those lines of `skipped` that are about a part of the file in which there may be any number of
            frames.
        on_error: What a bad frame does.
        topic: The topic of a recording that is read; None of other sources.
        lack: A line about what was to be in it and is not, as it says itself or shows: a recording that was
            interrupted, that was never finished, or whose end is missing. Empty of all others.
        unread_end: Those lines of `skipped` that are about the latest images of the latest iteration, where none could
            be read since: at its end the source ended before its last image, as where its folder was removed.
    """

    origin: Path
    skipped: list[str]
    lost_parts: list[str]
    unread_end: list[str]
    on_error: OnError
    topic: str | None
    lack: str

    def __init__(self, origin: Path | str, on_error: OnError) -> None:
        """Takes where the frames are, and what a bad one does.

        Raises:
            ValueError: If it is none of `OnError`, as Python callers may pass any string.
        """
        check_one_of(on_error, OnError, "on_error")
        self.origin = checked_path(origin)
        self.skipped, self.lost_parts, self.unread_end = [], [], []
        self.on_error, self.topic, self.lack = on_error, None, ""

    def _refuse(self, message: str) -> None:
        """Notes what is left out; with `stop`, raises it."""
        if self.on_error == "stop":
            raise ValueError(message)
        self.skipped.append(message)

    def _lose(self, message: str) -> None:
        """As `_refuse`, for a part of the file in which there may be any number of frames."""
        self._refuse(message)
        self.lost_parts.append(message)

    def _read_each(self, reads: Iterable[Callable[[], Frame]]) -> Iterator[Frame]:
        """The frames that `reads` return; a read that raises is noted instead, unless `stop` lets it raise."""
        skipped, unread = self.skipped, list[str]()  # of this iteration, should another begin
        self.unread_end = unread
        for read in reads:
            try:
                frame = read()
            except (ValueError, FileNotFoundError) as error:
                if self.on_error == "stop":
                    raise
                line = " ".join(str(error).split())
                skipped.append(line)
                unread.append(line)
                continue
            unread.clear()
            yield frame
