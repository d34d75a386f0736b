"""Where the viewer's data go: into a file, or to a window of Rerun's viewer."""

from __future__ import annotations

import contextlib
import os
import queue
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol, TypeAlias

import numpy as np
import rerun as rr
from rerun.blueprint import Blueprint

from foreglow.files import checked_path
from foreglow.whole_files import AtomicFile, naming

APPLICATION = "foreglow"

Entities: TypeAlias = Sequence[tuple[str, Any]]
"""Paths of entities, and what is logged there: Rerun's archetypes."""

PARCEL_BYTES = 1 << 16
"""What a pipe of Linux holds."""

NUM_WAITING = 16
"""Parcels of 0.2 s that may wait for the window."""

FIRST_DATE_NS = 10**17
"""Frames' times from here on, in the year 1973, are dates; lower ones count from somewhere."""

LOCAL = "127.0.0.1"

MEMORY_LIMIT = "25%"
"""Of the machine's, for a window; then it drops what is oldest. By itself it takes three quarters, and a live run of an
hour beside it may have too little."""

OFFLINE: Mapping[str, str] = MappingProxyType(
    {
        "CI": "1",
        **dict.fromkeys(("NO_PROXY", "no_proxy"), ""),
        **dict.fromkeys(("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"), f"http://{LOCAL}:9"),
        **dict.fromkeys(("http_proxy", "https_proxy", "all_proxy"), f"http://{LOCAL}:9"),
    }
)
"""What the viewer's process is started with: its usage statistics are off where `CI` is set, and its question to the
network whether there is a newer version ends at a closed port of this machine."""


class Output(Protocol):
    """Takes what is logged at each time."""

    def log_static(self, entities: Entities) -> None:
        """Takes what is valid at all times."""
        ...

    def log(self, time_ns: int, frame: int | None, entities: Entities) -> None:
        """Takes what is logged at one time, with the number of the frame if it is about one."""
        ...

    def close(self) -> None:
        """Completes it."""
        ...

    def discard(self) -> None:
        """Lets go of it."""
        ...


SUFFIX = ".rrd"


class RrdFile:
    """A recording as a file, which appears whole at the end, or not at all.

    Rerun writes into a pipe, and a thread from there into the file: once a full disk has ended Rerun's own writer,
    whoever flushes or ends the recording waits for ever.
    """

    def __init__(self, path: Path | str, blueprint: Blueprint) -> None:
        """Opens the file.

        Raises:
            OSError: If it cannot be written; the message names the path.
            ValueError: If the path does not end in `.rrd`.
        """
        path = checked_path(path)
        if path.suffix.lower() != SUFFIX:
            raise ValueError(f"{path}: expected a recording that ends in {SUFFIX}")
        self._path = path
        self._error: OSError | None = None
        self._stream = _stream()
        self._written = AtomicFile(path)
        with contextlib.ExitStack() as discarding:
            discarding.callback(self._written.discard)
            with tempfile.TemporaryDirectory(prefix="foreglow_") as folder:
                pipe = Path(folder) / "pipe"
                os.mkfifo(pipe)
                self._pipe = os.fdopen(os.open(pipe, os.O_RDONLY | os.O_NONBLOCK), "rb", buffering=0)
                with pipe.open("wb"):  # it has a writer until Rerun is one
                    os.set_blocking(self._pipe.fileno(), True)
                    self._thread = threading.Thread(target=self._write, name="recording", daemon=True)
                    self._thread.start()
                    self._stream.save(pipe, default_blueprint=blueprint)
            discarding.pop_all()

    def log_static(self, entities: Entities) -> None:
        """Takes what is valid at all times."""
        _log(self._stream, entities, static=True)

    def log(self, time_ns: int, frame: int | None, entities: Entities) -> None:
        """Takes what is logged at one time.

        Raises:
            OSError: If the disk is full; the message names the path.
        """
        _set_times(self._stream, time_ns, frame)
        _log(self._stream, entities)
        self._check()

    def close(self) -> None:
        """Completes the file.

        Raises:
            OSError: If the disk is full; the message names the path.
        """
        self._end()
        self._check()
        self._written.close()

    def discard(self) -> None:
        """Removes what was written, unless it was completed before."""
        self._end()
        self._written.discard()

    def _end(self) -> None:
        self._stream.disconnect()  # closes its end of the pipe
        self._thread.join()

    def _check(self) -> None:
        if self._error is not None:
            with naming(self._path):
                raise self._error

    def _write(self) -> None:
        """Empties the pipe until it is closed, also after an error, and writes what comes before one."""
        with self._pipe:
            while parcel := self._pipe.read(PARCEL_BYTES):
                if self._error is None:
                    try:
                        self._written.file.write(parcel)
                    except OSError as error:
                        self._error = error


class ViewerWindow:
    """A window of Rerun's viewer, a program of its own that is fed through a pipe and stays open after the run.

    A window that was closed, or that takes nothing, never stops the run: that is noted once, and what it cannot take
    is left out. It listens on this machine alone, and asks nobody else for anything; see `OFFLINE`.
    """

    def __init__(
        self,
        blueprint: Blueprint,
        note: Callable[[str], None],
        *,
        command: Sequence[str] | None = None,
        patience_s: float = 1.0,
    ) -> None:
        """Opens the window.

        Args:
            blueprint: How it is arranged.
            note: Told once, in words, when nothing more is shown.
            command: What to start, which reads a recording from its standard input; None is Rerun's viewer.
            patience_s: How long a run may wait for a window that is behind.

        Raises:
            ValueError: If there is no display.
            OSError: If the program cannot be started.
        """
        if command is None:
            check_display()
            command = viewer_command()
        self._note = note
        self._patience_s = patience_s
        self._is_gone = False
        self._is_behind = False
        self._has_noted_delay = False
        self._waiting: queue.Queue[bytes | None] = queue.Queue(NUM_WAITING)
        self._process = subprocess.Popen(
            command,
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **OFFLINE},
            start_new_session=True,  # Ctrl-C ends the run, not the window
        )
        self._stream = _stream()
        self._parcels = self._stream.binary_stream()  # type: ignore[misc]  # its own annotation is broken
        self._stream.send_blueprint(blueprint)
        self._thread = threading.Thread(target=self._feed, name="viewer", daemon=True)
        self._thread.start()

    def log_static(self, entities: Entities) -> None:
        """Takes what is valid at all times."""
        _log(self._stream, entities, static=True)

    def log(self, time_ns: int, frame: int | None, entities: Entities) -> None:
        """Shows what is logged at one time; waits for the window where it is behind, but only once for long."""
        if self._is_gone:
            return
        _set_times(self._stream, time_ns, frame)
        _log(self._stream, entities)
        parcel = self._parcels.read(flush=False)
        if parcel:
            self._hand_over(parcel)

    def close(self) -> None:
        """Hands over what is left; the window stays."""
        if not self._is_gone:
            parcel = self._parcels.read(flush=True)
            if parcel:
                self._hand_over(parcel)
        self._end(self._patience_s)

    def discard(self) -> None:
        """Hands over nothing more; the window stays."""
        self._end(0.0)

    def _hand_over(self, parcel: bytes) -> None:
        try:
            self._waiting.put(parcel, timeout=0.0 if self._is_behind else self._patience_s)
            self._is_behind = False
        except queue.Full:
            self._is_behind = True
            if not self._has_noted_delay:
                self._has_noted_delay = True
                self._note("the viewer does not keep up: what it cannot take is not shown")

    def _feed(self) -> None:
        """Writes parcels to the window until it is gone; only here anything waits for it."""
        pipe = self._process.stdin
        assert pipe is not None
        try:
            while (parcel := self._waiting.get()) is not None:
                rest = memoryview(parcel)
                while rest:
                    rest = rest[pipe.write(rest) :]
        except OSError:
            self._is_gone = True
            self._note("the viewer is closed: the run goes on without it")
        finally:
            with contextlib.suppress(OSError):
                pipe.close()

    def _end(self, patience_s: float) -> None:
        with contextlib.suppress(queue.Full):
            self._waiting.put(None, timeout=patience_s)
        self._thread.join(patience_s)
        self._stream.disconnect()
        if self._process.poll() is None:
            self._process.returncode = 0  # it is the user's now: nobody waits for it


def viewer_command() -> list[str]:
    """How Rerun's viewer is started to read a recording from its standard input and to listen on this machine alone."""
    limits = ["--bind", LOCAL, "--port", "auto", "--memory-limit", MEMORY_LIMIT]
    return [sys.executable, "-m", "rerun_cli", "-", *limits, "--hide-welcome-screen"]


def check_display() -> None:
    """Sees to it that a window can be opened.

    Raises:
        ValueError: If there is no display.
    """
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ValueError(
            "--view: expected a display, there is none here; keep the run with --save FILE.rrd and open it where there "
            "is one: rerun FILE.rrd"
        )


def _stream() -> rr.RecordingStream:
    stream = rr.RecordingStream(APPLICATION)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    return stream


def _set_times(stream: rr.RecordingStream, time_ns: int, frame: int | None) -> None:
    if time_ns >= FIRST_DATE_NS:
        stream.set_time("time", timestamp=np.datetime64(time_ns, "ns"))
    else:
        stream.set_time("time", duration=np.timedelta64(time_ns, "ns"))
    if frame is not None:
        stream.set_time("frame", sequence=frame)


def _log(stream: rr.RecordingStream, entities: Entities, *, static: bool = False) -> None:
    for path, archetype in entities:
        stream.log(path, archetype, static=static)
