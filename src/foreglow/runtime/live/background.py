"""Runs sinks in threads of their own, so that a sink that is slow or fails never delays a beam command."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable

from foreglow.plugins import words_of
from foreglow.runtime.health import Health, LiveSink
from foreglow.runtime.live.worker import THREADS
from foreglow.runtime.run import KeepingSink
from foreglow.types import Frame, FrameResult
from foreglow.whole_files import output_words

NUM_WAITING = 64
"""Frames that may wait for a sink, 3.6 s at 18 Hz; further ones are lost to it."""

STUCK_S = 60.0
"""A sink that takes longer for a frame, or for its end, is left at the end of the run."""


class Background:
    """A sink in a thread of its own.

    Attributes:
        sink: The sink.
        error: Why it failed; None while it works.
    """

    def __init__(self, sink: LiveSink, *, is_lossless: bool = False) -> None:
        """Starts the thread.

        Args:
            sink: The sink; it is called from that thread only.
            is_lossless: Whether `write` waits until there is room, for sources that wait, too.
        """
        self.sink = sink
        self._num_given = self._num_refused = self._num_written = 0
        self._has_ended = False
        self.error: BaseException | None = None
        self._is_lossless = is_lossless
        self._num_done = 0
        self._waiting: queue.Queue[Callable[[], None] | None] = queue.Queue(NUM_WAITING)
        self._thread = threading.Thread(target=self._run, name=f"{THREADS}sink {type(sink).__name__}", daemon=True)
        self._thread.start()

    @property
    def words(self) -> str:
        """Why it failed: what the error says of its file, or else what kind of sink and error it is."""
        if isinstance(self.error, OSError) and self.error.filename is not None:
            return output_words(self.error)
        return f"{type(self.sink).__name__}: {words_of(self.error) if self.error is not None else 'behind'}"

    @property
    def is_behind(self) -> bool:
        """Whether it has failed, or has no room for another frame."""
        return self.error is not None or self._waiting.full()

    @property
    def num_lost(self) -> int:
        """Frames that it was too slow for, or that came after it had failed; at the end all that it does not keep."""
        if not self._has_ended:
            return self._num_refused
        num_kept = self.sink.num_kept if isinstance(self.sink, KeepingSink) else self._num_written
        return self._num_given - num_kept

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Passes a frame on, or counts it as lost."""
        self._num_given += 1
        if not self._put(lambda: self._write(frame, result), is_waiting=self._is_lossless):
            self._num_refused += 1

    def write_health(self, health: Health) -> None:
        """Passes the health on, if there is room."""
        self._put(lambda: self.sink.write_health(health), is_waiting=False)

    def close(self, *, is_complete: bool = True) -> None:
        """Waits until everything is written and the sink is closed, unless it is stuck.

        Args:
            is_complete: As in `KeepingSink`, of the frames that were given.
        """
        if isinstance(self.sink, KeepingSink):
            self.sink.is_complete = is_complete and self._num_refused == 0
        self._finish(self.sink.close)

    def discard(self) -> None:
        """Ends the thread, and discards what the sink has written."""
        self._finish(self.sink.discard)

    def _write(self, frame: Frame, result: FrameResult) -> None:
        self.sink.write(frame, result)
        self._num_written += 1

    def _finish(self, end: Callable[[], None]) -> None:
        self._end = end
        is_told, num_done = False, -1
        while self._thread.is_alive() and num_done != self._num_done:
            num_done = self._num_done
            with contextlib.suppress(queue.Full):
                if not is_told:
                    self._waiting.put(None, timeout=STUCK_S)
                    is_told = True
            self._thread.join(STUCK_S)
        if self._thread.is_alive():
            self.error = self.error or TimeoutError(f"it has been stuck for {STUCK_S:g} s")
        self._has_ended = True

    def _put(self, call: Callable[[], None], *, is_waiting: bool) -> bool:
        if self.error is not None:
            return False
        try:
            self._waiting.put(call, block=is_waiting)
        except queue.Full:
            return False
        return True

    def _run(self) -> None:
        while (call := self._waiting.get()) is not None:
            if self.error is None:
                self._try(call)
        self._try(self._end)

    def _try(self, call: Callable[[], None]) -> None:
        try:
            call()
        except BaseException as error:  # no error of a sink may stop the beam, or keep the other sinks from their end
            self.error = self.error or error
        self._num_done += 1
