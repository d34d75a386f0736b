"""Receives our car's speed, yaw rate and the road ahead from its CAN bus."""

from __future__ import annotations

import contextlib
import threading
import time
from pathlib import Path

from foreglow.datasets.vehicle_logs import CanDecoder, CanLog
from foreglow.plugins import words_of
from foreglow.runtime.can_output import open_bus
from foreglow.runtime.live.worker import THREADS

KEEP_S = 10.0
"""Messages are kept for this long: older ones are of no use to any frame."""

WAIT_S = 0.2

HANGING_S = 2.0
"""A driver that takes longer to end is left; the thread's name tells the program not to wait for it."""


class VehicleBus:
    """Listens to a bus in a thread of its own; times are by the machine's steady clock, like those of live cameras.

    Attributes:
        log: The car's data of the last seconds.
        num_broken: CAN frames that did not match the DBC.
    """

    def __init__(self, channel: str, dbc: Path | str | None = None, mapping: Path | str | None = None) -> None:
        """Opens the bus and begins to listen.

        Args:
            channel: As for `open_bus`.
            dbc: The DBC that describes the CAN frames; None for our own.
            mapping: The mapping of the DBC's signals; needed with `dbc`.

        Raises:
            FileNotFoundError: If there is no such file.
            ModuleNotFoundError: If the extra `can` is not installed.
            ValueError: If a file is broken, or there is no such interface.
            OSError: If the bus cannot be opened.
        """
        self._decoder = CanDecoder(dbc, mapping, keep_s=KEEP_S)
        self._channel = channel
        self._bus = open_bus(channel, self._decoder.keys)
        self.num_broken, self._first_broken = 0, ""
        self._is_closed = threading.Event()
        self._thread = threading.Thread(target=self._listen, name=f"{THREADS}vehicle bus", daemon=True)
        self._thread.start()

    @property
    def log(self) -> CanLog:
        """The car's data of the last seconds."""
        return self._decoder.log

    @property
    def lines(self) -> list[str]:
        """What is to be said of the bus at the end: what failed, and why the motion may have been unknown."""
        lines = []
        if self._bus.failure:
            num_again = self._bus.num_opened_again
            lines.append(f"{self._channel}: failed: {self._bus.failure} (times it was opened again: {num_again})")
        if self.num_broken:
            lines.append(f"{self._first_broken} (messages left out: {self.num_broken})")
        if self.log.is_empty:
            names = ", ".join(self._decoder.message_names)
            lines.append(f"{self._channel}: expected messages of {names}, with values, got none")
        return lines

    def close(self) -> None:
        """Stops listening."""
        self._is_closed.set()
        self._thread.join(HANGING_S)

    def _listen(self) -> None:
        """Receives frames until closed. While the bus fails, the speed becomes stale, which the guard notices."""
        while not self._is_closed.is_set():
            try:
                message = self._bus.recv(WAIT_S)
            except Exception:  # drivers raise what they like
                self._is_closed.wait(WAIT_S)
                continue
            if message is None or message.is_error_frame or message.is_remote_frame:
                continue
            key = message.arbitration_id, bool(message.is_extended_id)
            if key in self._decoder.keys:
                try:
                    self._decoder.take(time.monotonic_ns(), key, bytes(message.data), self._channel)
                except ValueError as error:
                    self.num_broken += 1
                    self._first_broken = self._first_broken or words_of(error)
        with contextlib.suppress(Exception):
            self._bus.shutdown()
