"""Runs each connection to the lamps in a thread of its own, so that a driver that hangs never stops the loop."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from typing import Protocol

from foreglow.plugins import words_of
from foreglow.runtime.live.worker import THREADS
from foreglow.types import BeamCommand

LIMIT_S = 0.2
"""A driver that takes longer for a command hangs: by then the lamps have gone to low beam by themselves."""


class BeamOutput(Protocol):
    """A connection to the lamps."""

    def send(self, command: BeamCommand) -> None:
        """Sends a command.

        Raises:
            OSError: If it cannot be sent now.
        """
        ...

    def close(self) -> None:
        """Ends the connection."""
        ...


class _Call:
    """A call of an output's method: whether it has ended, and then why it failed, empty if it did not."""

    def __init__(self, method: Callable[[], None]) -> None:
        self.method = method
        self.has_ended = threading.Event()
        self.failure = ""


class Outlet:
    """An output in a thread of its own; the caller waits for it, but never for long."""

    def __init__(self, output: BeamOutput, limit_s: float = LIMIT_S) -> None:
        """Starts the thread.

        Args:
            output: Its methods are called in that thread only.
            limit_s: A call that takes longer has failed; until it ends, every further call fails at once.
        """
        self._output, self._limit_s = output, limit_s
        self._calls: queue.SimpleQueue[_Call | None] = queue.SimpleQueue()
        self._latest: _Call | None = None
        self._is_refused, self._due_s = False, 0.0
        self._thread = threading.Thread(target=self._run, name=f"{THREADS}output {type(output).__name__}", daemon=True)
        self._thread.start()

    def begin(self, command: BeamCommand) -> None:
        """Has a command sent, which goes to several outlets at once if each begins before the first `outcome`."""
        self._begin(lambda: self._output.send(command))

    def outcome(self) -> str:
        """Waits for what was begun, `limit_s` from then on at most; returns why it failed, empty if it did not."""
        call = self._latest
        if call is not None and not self._is_refused and call.has_ended.wait(max(0.0, self._due_s - time.monotonic())):
            return call.failure
        return f"{type(self._output).__name__} takes longer than {self._limit_s:g} s"

    def send(self, command: BeamCommand) -> str:
        """Sends a command; returns why that failed, empty if it did not."""
        self.begin(command)
        return self.outcome()

    def close(self) -> str:
        """Ends the connection and the thread; returns why that failed, empty if it did not."""
        self._begin(self._output.close)
        failure = self.outcome()
        self._calls.put(None)
        self._thread.join(self._limit_s)
        return failure

    def _begin(self, method: Callable[[], None]) -> None:
        self._is_refused = self._latest is not None and not self._latest.has_ended.is_set()
        if not self._is_refused:
            self._latest, self._due_s = _Call(method), time.monotonic() + self._limit_s
            self._calls.put(self._latest)

    def _run(self) -> None:
        while (call := self._calls.get()) is not None:
            try:
                call.method()
            except BaseException as error:  # whatever a driver raises; no signal's, as this is not the main thread
                call.failure = words_of(error) or type(error).__name__
            call.has_ended.set()
