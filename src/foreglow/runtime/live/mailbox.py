"""Where the reader puts frames and the computer takes them: one place, and the newest wins."""

from __future__ import annotations

import threading
from dataclasses import dataclass

from foreglow.types import Frame


@dataclass(frozen=True, slots=True)
class Arrival:
    """A frame that was read.

    Attributes:
        frame: The frame.
        arrived_ns: When it was there, by the frames' clock.
    """

    frame: Frame
    arrived_ns: int


class Mailbox:
    """Room for one frame.

    Attributes:
        num_put: Frames that were left in it.
        num_dropped: Frames that were never taken, because a newer one came.
    """

    def __init__(self, *, is_lossless: bool = False) -> None:
        """An empty one; a lossless one makes whoever puts a frame wait until the one before was taken."""
        self._is_lossless = is_lossless
        self._waiting: Arrival | None = None
        self._changed = threading.Condition()
        self._is_closed = False
        self.num_put = self.num_dropped = 0

    def put(self, arrival: Arrival) -> None:
        """Leaves a frame, in place of one that was not taken yet; does nothing when closed."""
        with self._changed:
            if self._is_lossless:
                self._changed.wait_for(lambda: self._waiting is None or self._is_closed)
            if self._is_closed:
                return
            self.num_put += 1
            self.num_dropped += self._waiting is not None
            self._waiting = arrival
            self._changed.notify_all()

    def take(self, timeout_s: float) -> Arrival | None:
        """The newest frame, waited for at most so long; None where none came, or the box is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting is not None or self._is_closed, timeout_s)
            taken, self._waiting = self._waiting, None
            self._changed.notify_all()
            return None if self._is_closed else taken

    def close(self) -> None:
        """Nobody waits any longer."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
