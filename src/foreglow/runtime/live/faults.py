"""What goes wrong around the pipeline, since when and until when."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable
from enum import StrEnum

from foreglow.runs.summary import FaultEvent

MAX_EVENTS = 1000
"""So many of the latest events are kept; all are counted."""


class LiveFault(StrEnum):
    """What the live loop may find; the texts stand in `BeamCommand.faults`, before those of the guard."""

    CAMERA_GONE = "camera_gone"
    """No frame came in time, or the source cannot be opened."""
    CAMERA_SLOW = "camera_slow"
    """Frames come too rarely."""
    OUT_OF_ORDER = "frame_out_of_order"
    """A frame that is not newer than the one before; it is not used."""
    STAGE_FAILED = "stage_failed"
    """A stage raised an error."""
    STAGE_HANGS = "stage_hangs"
    """A stage keeps a frame for too long."""
    NO_PIPELINE = "no_pipeline"
    """After a fault the pipeline could not be made again yet."""
    BUS = "bus_failed"
    """A command could not be sent: the lamps go to low beam by themselves."""
    NOT_RECORDED = "not_recorded"
    """A recording, a view or a result failed or fell behind; the beam goes on."""


class FaultBook:
    """Keeps what is wrong now, from several threads, and what was.

    Every origin, such as `camera`, says which of its faults there are now; an event lasts from when a fault is first
    among them until it no longer is.

    Attributes:
        events: The latest ones, in the order of their beginning.
        counts: How often each fault began.
    """

    def __init__(self, now_ns: Callable[[], int], low_beam_origins: Collection[str]) -> None:
        """An empty book.

        Args:
            now_ns: The frames' clock.
            low_beam_origins: Faults of these mean low beam for the next command, however short they were.
        """
        self._now_ns = now_ns
        self._low_beam_origins = low_beam_origins
        self._active: dict[str, dict[str, FaultEvent]] = {}
        self._unheeded: dict[str, None] = {}
        self._lock = threading.Lock()
        self.events: deque[FaultEvent] = deque(maxlen=MAX_EVENTS)
        self.counts: Counter[str] = Counter()

    def note(self, origin: str, faults: Iterable[str] = (), detail: str = "") -> None:
        """These are the faults of `origin` now, none left out."""
        names = dict.fromkeys(str(fault) for fault in faults)
        with self._lock:
            known = self._active.get(origin, {})
            if not names and not known:
                return
            now_ns = self._now_ns()
            for name in [name for name in known if name not in names]:
                known.pop(name).until_ns = now_ns
            for name in names:
                if name not in known:
                    known[name] = FaultEvent(name, now_ns, detail=detail)
                    self.events.append(known[name])
                    self.counts[name] += 1
            self._active[origin] = known
            if origin in self._low_beam_origins:
                self._unheeded |= names

    @property
    def active(self) -> tuple[str, ...]:
        """All that is wrong now."""
        with self._lock:
            return tuple(dict.fromkeys(name for faults in self._active.values() for name in faults))

    @property
    def unheeded(self) -> tuple[str, ...]:
        """What means low beam and began, or was said again, since `heeded` was last asked, also if it is over."""
        with self._lock:
            return tuple(self._unheeded)

    def heeded(self) -> tuple[str, ...]:
        """What means low beam for the next command: what is wrong now, and what was since this was last asked."""
        with self._lock:
            lasting = [name for origin in self._low_beam_origins for name in self._active.get(origin, ())]
            names = tuple(dict.fromkeys([*self._unheeded, *lasting]))
            self._unheeded.clear()
            return names
