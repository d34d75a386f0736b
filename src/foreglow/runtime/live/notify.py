"""Notifies systemd that the program is ready and alive, so that it restarts the program when it is not.

A socket that is missing, is gone, or is never read loses messages; it never delays or ends the program.
"""

from __future__ import annotations

import contextlib
import os
import socket
import time

CLOSING_S = 120.0
"""Time for completing what was recorded, as on a slow disk; then a program that has not ended may be killed."""


class ServiceNotifier:
    """Speaks sd_notify's protocol where `NOTIFY_SOCKET` names a socket, and does nothing elsewhere."""

    def __init__(self) -> None:
        """Reads the environment; a watchdog for another process is none for this one."""
        self._address = os.environ.get("NOTIFY_SOCKET", "")
        interval_us = os.environ.get("WATCHDOG_USEC", "")
        is_ours = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        is_number = interval_us.isascii() and interval_us.isdecimal() and len(interval_us) < 20
        self._interval_s = int(interval_us) / 2e6 if is_number and is_ours else 0.0
        self._beat_s: float | None = None

    def beat(self) -> None:
        """Sends READY at the first call, and WATCHDOG twice per watchdog interval."""
        now_s = time.monotonic()
        if self._beat_s is None:
            self._send("READY=1")
        elif now_s - self._beat_s < self._interval_s:
            return
        self._beat_s = now_s
        if self._interval_s:
            self._send("WATCHDOG=1")

    def close(self) -> None:
        """Asks for `CLOSING_S`, in which no WATCHDOG comes; does nothing without a watchdog."""
        if self._interval_s:
            self._send(f"WATCHDOG_USEC={round(CLOSING_S * 1e6)}")

    def stop(self) -> None:
        """Sends STOPPING."""
        self._send("STOPPING=1")

    def _send(self, message: str) -> None:
        if self._address:
            address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
            with (
                contextlib.suppress(OSError, ValueError),
                socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as notify,
            ):
                notify.sendto(message.encode(), address)
