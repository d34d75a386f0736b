"""Beam commands as CAN frames: written to a log file with the times of their images, or sent on a live bus."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import ipaddress
import time
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foreglow.beam.messages import RAMP_S, CanFrame, CommandEncoder
from foreglow.datasets.vehicle_logs.can_writing import keep_times
from foreglow.datasets.vehicle_logs.log_frames import CanKey
from foreglow.files import checked_path
from foreglow.plugins import described, words_of
from foreglow.runtime.time_axis import TimeAxis
from foreglow.types import BeamCommand, Frame, FrameResult
from foreglow.whole_files import AtomicFile, naming

if TYPE_CHECKING:
    import can

LOG_SUFFIXES = (".asc", ".blf", ".log")
"""Vector's text and binary logs, and candump's."""

SEND_TIMEOUT_S = 0.02
"""Longest wait for the bus to accept a frame."""

REOPEN_S = 1.0
"""A bus that has failed for so long is opened again, and again after as long."""

MAX_SEND_S = 0.15
"""After this time the rest of a command is not sent: its driver hung, and low beam was decided meanwhile. It is more
than all of a command's waits, and less than `live.outlet.LIMIT_S`."""


class CanLogSink:
    """Writes the commands into a log, with the times of their images; the log appears complete, or not at all.

    An .asc log counts time from its first frame. Sequences follow each other as on a `TimeAxis`, in the log and in the
    messages: time never goes back.

    Attributes:
        gap_light: Which commands the gaps alone could say.
    """

    def __init__(
        self, path: Path | str, *, suffix: str | None = None, ramp_s: float = RAMP_S, has_levels: bool = True
    ) -> None:
        """Opens the log.

        Args:
            path: The file.
            suffix: The format, .asc, .blf or .log; None for the path's own.
            ramp_s: Time in which lamps of cars that take gaps shall brighten.
            has_levels: False leaves out the levels of the LEDs.

        Raises:
            ModuleNotFoundError: If python-can is not installed (extra `can`).
            ValueError: If there is no such format.
            OSError: If it cannot be written; the message names the path.
        """
        path = checked_path(path)
        import can

        kind = path.suffix.lower() if suffix is None else suffix
        if isinstance(kind, str) and kind.lower() in LOG_SUFFIXES:
            kind = kind.lower()
        else:
            raise ValueError(f"{path}: expected a CAN log that ends in {', '.join(LOG_SUFFIXES)}, got {kind!r:.80}")
        self._path = path
        self._axis, self._has_frames = TimeAxis(), False
        self._encoder = CommandEncoder(ramp_s, has_levels=has_levels)
        self.gap_light = self._encoder.gap_light
        self._written = AtomicFile(path)
        file: Any = self._written.file
        try:
            if kind == ".blf":
                self._log: Any = can.BLFWriter(file)
            else:
                text = io.TextIOWrapper(file, encoding="latin-1", newline="\n")
                self._log = can.ASCWriter(text) if kind == ".asc" else can.CanutilsLogWriter(text)
        except BaseException:
            self._written.discard()
            raise

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Adds the frames of the result's command, if it has one.

        Raises:
            OSError: If the disk is full; the message names the path.
            ValueError: If the command is not for lamps of `NUM_LEDS` LEDs.
        """
        if result.beam is not None:
            time_ns = self._axis.time_ns(frame)
            beam = dataclasses.replace(result.beam, timestamp_ns=time_ns)
            with naming(self._path):
                if not self._has_frames:
                    keep_times(self._log, time_ns / 1e9)
                    self._has_frames = True
                for message in _messages(self._encoder.frames(beam), time_ns):
                    self._log(message)

    def close(self) -> None:
        """Completes the log.

        Raises:
            OSError: If the disk is full; the message names the path.
        """
        with naming(self._path):
            self._log.stop()
            self._written.close()

    def discard(self) -> None:
        """Deletes what was written, unless it was completed before."""
        with contextlib.suppress(OSError, ValueError):  # a full disk, or closed before
            self._log.stop()
        self._written.discard()


class LastingBus:
    """A live bus, which is opened again once it has failed for `REOPEN_S`, as an adapter that was unplugged needs it.

    Attributes:
        failure: Why it failed, the last time; empty if it never did.
        num_opened_again: How often it was opened again.
    """

    def __init__(self, channel: str, ids: Collection[CanKey]) -> None:
        """Opens it, as `open_bus` does, and raises what the driver raises."""
        interface, colon, rest = channel.partition(":")
        self._interface, self._channel = (interface, rest) if colon else ("socketcan", channel)
        self._ids = ids
        self.failure, self.num_opened_again = "", 0
        self._failed_s: float | None = None
        self._bus: can.BusABC | None = self._opened()

    def send(self, message: can.Message, timeout: float) -> None:
        """Sends a message; raises what the driver raises."""
        with self._watched():
            self._ready().send(message, timeout=timeout)
            self._failed_s = None

    def recv(self, timeout: float) -> can.Message | None:
        """The next message, None if none comes; raises what the driver raises."""
        with self._watched():
            message = self._ready().recv(timeout)
            if message is not None:  # a socket whose interface is gone says so once, and is silent then
                self._failed_s = None
            return message

    def shutdown(self) -> None:
        """Closes it."""
        if self._bus is not None:
            self._bus.shutdown()

    @contextlib.contextmanager
    def _watched(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            self.failure = words_of(error) or type(error).__name__
            self._failed_s = self._failed_s or time.monotonic()
            raise

    def _ready(self) -> can.BusABC:
        if self._failed_s is not None and time.monotonic() - self._failed_s >= REOPEN_S:
            with contextlib.suppress(Exception):
                self.shutdown()
            self._bus, self._failed_s = None, time.monotonic()
            self._bus, self._failed_s = self._opened(), None
            self.num_opened_again += 1
        if self._bus is None:
            raise OSError(self.failure)
        return self._bus

    def _opened(self) -> can.BusABC:
        import can

        bus = can.Bus(interface=self._interface, channel=self._channel, fd=True)
        masks = {False: 0x7FF, True: 0x1FFF_FFFF}  # all bits of an identifier, by whether it is extended
        if self._ids:
            bus.set_filters(
                [{"can_id": one, "can_mask": masks[is_long], "extended": is_long} for one, is_long in self._ids]
            )
        return bus


def open_bus(channel: str, ids: Collection[CanKey] = ()) -> LastingBus:
    """The bus that a user names: `interface:channel` of python-can, or a channel of SocketCAN such as `can0`.

    Args:
        channel: What the user names.
        ids: The identifiers to receive; none for all. A car may send thousands of others a second.

    Raises:
        ModuleNotFoundError: If python-can is not installed (extra `can`).
        ValueError: If there is no such interface, or the group of `udp_multicast` is none.
        OSError: If the bus cannot be opened.
    """
    import can

    if not isinstance(channel, str) or not channel:
        raise ValueError(f"channel: expected the name of a bus, such as can0 or virtual:name, got {channel!r:.80}")
    interface, colon, group = channel.partition(":")
    if interface == "udp_multicast" and not _is_multicast(group):
        wanted = "the address of a multicast group, from 224.0.0.0 to 239.255.255.255 or in ff00::/8"
        raise ValueError(f"{channel}: expected {wanted}, got {group!r}")
    if colon and not group:
        raise ValueError(f"{channel}: expected the name of a channel behind the colon, such as {interface}:0")
    try:
        return LastingBus(channel, ids)
    except can.CanInterfaceNotImplementedError as error:
        raise ValueError(f"{channel}: expected an interface of python-can: {error}") from None
    except (can.CanError, OSError) as error:
        expected = "" if colon else "; expected a bus of SocketCAN, or INTERFACE:CHANNEL of python-can"
        raise OSError(f"{channel}: {error}{expected}") from error
    except Exception as error:  # a driver that is missing, or that fails in its own way without one
        raise ValueError(
            f"{channel}: expected a bus whose driver is installed and works: {described(error)}"
        ) from error


def _is_multicast(address: str) -> bool:
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(address).is_multicast
    return False


class CanBus:
    """Sends commands onto a live bus."""

    def __init__(self, channel: str, *, ramp_s: float = RAMP_S, has_levels: bool = True) -> None:
        """Opens the bus.

        Args:
            channel: As for `open_bus`.
            ramp_s: Time in which lamps of cars that take gaps shall brighten.
            has_levels: False leaves out the levels of the LEDs.

        Raises:
            ModuleNotFoundError: If python-can is not installed (extra `can`).
            ValueError: If there is no such interface.
            OSError: If the bus cannot be opened.
        """
        self._name = channel
        self._encoder = CommandEncoder(ramp_s, has_levels=has_levels)
        self._bus = open_bus(channel)

    def send(self, command: BeamCommand) -> None:
        """Sends the frames of a command.

        Raises:
            OSError: If the bus does not accept one within `SEND_TIMEOUT_S`, or all of them within `MAX_SEND_S`; what
                is left of the command is not sent, and the lamps go to low beam by themselves.
            ValueError: If the command is not for lamps of `NUM_LEDS` LEDs.
        """
        begun_s = time.monotonic()
        for message in _messages(self._encoder.frames(command), command.timestamp_ns):
            if time.monotonic() - begun_s > MAX_SEND_S:
                raise OSError(f"{self._name}: expected a bus that accepts a command within {MAX_SEND_S:g} s")
            try:
                self._bus.send(message, timeout=SEND_TIMEOUT_S)
            except Exception as error:  # drivers raise what they like
                raise OSError(f"{self._name}: {error}") from error

    def close(self) -> None:
        """Closes the bus."""
        self._bus.shutdown()


def _messages(frames: tuple[CanFrame, ...], timestamp_ns: int) -> Iterator[can.Message]:
    import can

    for frame in frames:
        yield can.Message(
            timestamp=timestamp_ns / 1e9,
            arbitration_id=frame.frame_id,
            is_extended_id=False,
            is_fd=True,
            is_rx=False,
            bitrate_switch=True,
            data=frame.data,
        )
