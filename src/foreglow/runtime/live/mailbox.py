"""Passes frames from the reading to the computing thread; a newer frame replaces one that was not taken yet."""

from __future__ import annotations

import threading
from dataclasses import dataclass

from foreglow.types import Frame


@dataclass(frozen=True, slots=True)
class Arrival:
    """A frame that was read.

    Attributes:
        frame: The frame.
        arrived_ns: When it had been read, by the frames' clock.
    """

    frame: Frame
    arrived_ns: int


class Mailbox:
    """Holds one frame.

    Attributes:
        num_put: Frames that were put into it.
        num_dropped: Frames that were replaced by a newer one before they were taken.
    """

    def __init__(self, *, is_lossless: bool = False) -> None:
        """An empty mailbox; in a lossless one, `put` waits until the previous frame was taken."""
        self._is_lossless = is_lossless
        self._waiting: Arrival | None = None
        self._changed = threading.Condition()
        self._is_closed = False
        self.num_put = self.num_dropped = 0

    def put(self, arrival: Arrival) -> None:
        """Puts a frame in place of one that was not taken yet; does nothing once the mailbox is closed."""
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
        """The newest frame; None if none comes within the timeout, or the mailbox is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting is not None or self._is_closed, timeout_s)
            taken, self._waiting = self._waiting, None
            self._changed.notify_all()
            return None if self._is_closed else taken

    def close(self) -> None:
        """Ends all waiting."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
