"""The faults of a live run: which there are, and when each began and ended."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable
from enum import StrEnum

from foreglow.runs.summary_file import FaultEvent
from foreglow.runs.tally import FaultCounts

MAX_EVENTS = 1000
"""Events that are kept, the latest ones; `FaultBook.counts` counts all."""


class LiveFault(StrEnum):
    """The faults that the live loop detects; in `BeamCommand.faults` they precede the guard's."""

    CAMERA_GONE = "camera_gone"
    """No frame arrived in time, or the source cannot be opened."""
    CAMERA_SLOW = "camera_slow"
    """Frames arrive too rarely."""
    FRAME_LOST = "frame_lost"
    """By the times, a frame is missing before this one; noted alone, as the next one is there."""
    OUT_OF_ORDER = "frame_out_of_order"
    """A frame is not newer than the previous one; it is not used."""
    RESIZED = "sequence_resized"
    """A sequence has images of another size or type than the one before, until 40 of them are known."""
    STAGE_FAILED = "stage_failed"
    """A stage raised an error."""
    STAGE_HANGS = "stage_hangs"
    """A stage takes too long for a frame."""
    NO_PIPELINE = "no_pipeline"
    """The pipeline could not be made again yet after a fault."""
    BUS = "bus_failed"
    """A command could not be sent: the lamps go to low beam by themselves."""
    NOT_RECORDED = "not_recorded"
    """A sink, such as a recording or the viewer, failed or is too slow; the beam goes on."""


class FaultBook:
    """Keeps the faults that are present, and a record of past ones; thread-safe.

    Every origin, such as `camera`, reports which of its faults are present now. An event begins when a fault is first
    reported, and ends when its origin reports without it.

    Attributes:
        events: The latest events, in the order in which they began.
        counts: How often each fault began.
    """

    def __init__(self, now_ns: Callable[[], int], low_beam_origins: Collection[str]) -> None:
        """An empty book.

        Args:
            now_ns: The frames' clock.
            low_beam_origins: A fault of one of these means low beam for the next command, however briefly it lasted.
        """
        self._now_ns = now_ns
        self._low_beam_origins = low_beam_origins
        self._active: dict[str, dict[str, FaultEvent]] = {}
        self._begun_s: dict[int, float] = {}  # by the id of an active event
        self._unheeded: dict[str, None] = {}
        self._lock = threading.Lock()
        self.events: deque[FaultEvent] = deque(maxlen=MAX_EVENTS)
        self.counts = FaultCounts()

    def note(self, origin: str, faults: Iterable[str] = (), detail: str = "", *, at_ns: int | None = None) -> None:
        """Reports all faults of `origin` that are present at `at_ns` by the frames' clock, None for now."""
        names = dict.fromkeys(str(fault) for fault in faults)
        with self._lock:
            known = self._active.get(origin, {})
            if not names and not known:
                return
            now_ns = self._now_ns() if at_ns is None else at_ns
            for name in [name for name in known if name not in names]:
                event = known.pop(name)
                event.until_ns = max(event.from_ns, now_ns)
                del self._begun_s[id(event)]
            for name in names:
                if name not in known:
                    known[name] = FaultEvent(name, now_ns, detail=detail)
                    self._begun_s[id(known[name])] = time.monotonic()
                    self.events.append(known[name])
                    self.counts.add(name)
                known[name].detail = known[name].detail or detail
            self._active[origin] = known
            if origin in self._low_beam_origins:
                self._unheeded |= names

    def begin_clock(self, speed: float) -> None:
        """The frames' clock has another zero from now on, as with the first frame of a sequence.

        What is present began as long before as it has lasted by the wall clock, at `speed`; at infinite speed, where
        the frames' clock stands still between frames, it begins now.
        """
        with self._lock:
            now_ns, now_s = self._now_ns(), time.monotonic()
            for event in (event for faults in self._active.values() for event in faults.values()):
                lasted_s = 0.0 if math.isinf(speed) else (now_s - self._begun_s[id(event)]) * speed
                event.from_ns = now_ns - round(lasted_s * 1e9)

    @property
    def active(self) -> tuple[str, ...]:
        """All faults that are present now."""
        return self.present[0]

    @property
    def present(self) -> tuple[tuple[str, ...], str]:
        """All faults that are present now, and what is known about them."""
        with self._lock:
            events = [event for faults in self._active.values() for event in faults.values()]
        names = dict.fromkeys(event.fault for event in events)
        return tuple(names), "; ".join(dict.fromkeys(event.detail for event in events if event.detail))

    @property
    def unheeded(self) -> tuple[str, ...]:
        """The low-beam faults that were reported since the last `heeded`, also those that are over."""
        with self._lock:
            return tuple(self._unheeded)

    def heeded(self) -> tuple[str, ...]:
        """The low-beam faults that count for the next command: present ones, and those since the last call of this."""
        with self._lock:
            lasting = [name for origin in self._low_beam_origins for name in self._active.get(origin, ())]
            names = tuple(dict.fromkeys([*self._unheeded, *lasting]))
            self._unheeded.clear()
            return names
