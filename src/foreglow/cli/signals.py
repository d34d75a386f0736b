"""How the process begins and ends: standard streams are there, and a plain `kill` counts as Ctrl-C."""

from __future__ import annotations

import atexit
import contextlib
import io
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from types import FrameType

from foreglow.whole_files import ENDINGS

PATIENCE_S = 2.0
"""Further signals within this time mean the same wish: they don't disturb the tidying up after the first."""

AGAIN_S = 0.01
"""A signal that was dropped in a callback comes again after this time, when the callback has mostly ended."""

INTERRUPTED = 130
"""Exit code of shells for a program that was interrupted."""


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """SIGTERM and SIGHUP raise KeyboardInterrupt in the `with` block, and one that leaves it ends the program.

    One that Python drops comes again, and a block that would end well after one is interrupted, too. A signal that is
    ignored, as SIGHUP under `nohup`, stays so. Outside the main thread, where Python delivers no signals, they are as
    they were.
    """
    handler = _Handler()
    with contextlib.ExitStack() as restoring:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGTERM, signal.SIGHUP):
                if signal.getsignal(number) is signal.SIG_DFL:
                    restoring.callback(_restore, number, handler)
                    signal.signal(number, handler)
            restoring.enter_context(handler.persistent())
        try:
            with handler.remembered():
                yield
        except KeyboardInterrupt:
            end_at_once()  # before the handler is taken away: a second signal would kill the process
            with contextlib.suppress(OSError):  # a terminal that is gone
                sys.stderr.write("foreglow: interrupted\n")
            sys.exit(INTERRUPTED)


def _restore(number: int, handler: _Handler) -> None:
    if signal.getsignal(number) is handler:  # not that of `end_at_once`
        signal.signal(number, signal.SIG_DFL)


def end_at_once() -> None:
    """Has a signal end the process without a word and with `INTERRUPTED` from now on: a command has ended.

    When the interpreter has called the exit functions, it delivers no more signals, and would die of one; none has an
    effect then, and the exit code is that of the command. A signal that is ignored stays so.
    """
    if threading.current_thread() is threading.main_thread():
        for number in ENDINGS:
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, _end)


def _end(*_: object) -> None:
    with contextlib.suppress(OSError, ValueError, RuntimeError):  # closed, full, or just being written to
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(INTERRUPTED)


def _end_in_peace() -> None:
    """The last exit function."""
    for number in ENDINGS:
        if signal.getsignal(number) is _end:
            signal.signal(number, signal.SIG_IGN)


atexit.register(_end_in_peace)  # before those of other modules, which are called first


def fill_standard_streams() -> None:
    """Lets nothing be read from, or written to, standard streams that were closed by who started the process.

    Otherwise a file that is opened later would get such a stream's number, and what libraries print would go into it.
    What a stream's encoding lacks, such as a file's name that is not UTF-8, is written with backslashes.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        if getattr(sys, name) is not None:
            continue
        nothing = os.open(os.devnull, os.O_RDWR)
        if nothing > number and _is_closed(number):
            os.dup2(nothing, number)
            os.close(nothing)
            nothing = number
        setattr(sys, name, open(nothing, mode, encoding="utf-8", closefd=False))  # noqa: SIM115


def check_environment() -> None:
    """Ends the process with a line, if OpenCV cannot be used with the environment's variables for it.

    It aborts, when it is loaded or used, for a number or a switch that it cannot read, even for an empty one: a copy of
    this process tries. matplotlib would not load for windows that it does not know; our figures are files.
    """
    os.environ["MPLBACKEND"] = "agg"
    given = sorted(name for name in os.environ if name.startswith("OPENCV_"))
    if given and not _can_use_opencv():
        values = ", ".join(f"{name}={os.environ[name][:40]!r}" for name in given[:10])
        sys.stderr.write(f"foreglow: {values}: expected variables with which OpenCV can be used\n")
        sys.exit(2)


def _can_use_opencv() -> bool:
    child = os.fork()
    if child:
        return os.waitpid(child, 0)[1] == 0
    code = 1
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        import cv2
        import numpy as np

        cv2.GaussianBlur(np.zeros((64, 64), np.uint8), (5, 5), 1.0)
        code = 0
    finally:
        os._exit(code)


def _is_closed(descriptor: int) -> bool:
    try:
        os.fstat(descriptor)
    except OSError:
        return True
    return False


def end_despite_hanging(code: object) -> None:
    """Ends the process now if something of it hangs, for which the interpreter would wait, or of which it would abort.

    That is a thread of the live loop, or a thread, or a process of `multiprocessing`, that a plug-in began and that has
    not ended within `PATIENCE_S`. Such processes are ended, too.
    """
    deadline_s = time.monotonic() + PATIENCE_S
    threads = [each for each in threading.enumerate() if each is not threading.main_thread()]
    children = sys.modules["multiprocessing"].active_children() if "multiprocessing" in sys.modules else []
    awaited = [each for each in (*threads, *children) if not each.daemon]
    for each in awaited:
        each.join(max(0.0, deadline_s - time.monotonic()))
    if any(thread.name.startswith("live ") for thread in threads) or any(each.is_alive() for each in awaited):
        for child in children:
            child.kill()
        with contextlib.suppress(OSError, ValueError):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code if isinstance(code, int) else 0)


class _Handler:
    """Raises KeyboardInterrupt in this process; one that was forked from it ends, as without a handler."""

    def __init__(self) -> None:
        self._process = os.getpid()
        self._raised_s = float("-inf")
        self._last: int | None = None

    def __call__(self, number: int, _frame: FrameType | None) -> None:
        if os.getpid() != self._process:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        elif time.monotonic() - self._raised_s > PATIENCE_S:
            self._raised_s = time.monotonic()
            self._last = number
            raise KeyboardInterrupt

    @contextlib.contextmanager
    def remembered(self) -> Iterator[None]:
        """Raises KeyboardInterrupt where the `with` block would end well although a signal has come."""
        try:
            yield
        except SystemExit as ending:
            if ending.code or not self._is_noted:
                raise
        if self._is_noted:
            raise KeyboardInterrupt

    @contextlib.contextmanager
    def persistent(self) -> Iterator[None]:
        """Sends a signal again, without a traceback, whose KeyboardInterrupt Python drops in the `with` block.

        It drops what is raised in `__del__` and in callbacks of weak references, such as those of imports.
        """
        others = sys.unraisablehook

        def hook(dropped: sys.UnraisableHookArgs) -> None:
            is_main = threading.current_thread() is threading.main_thread()
            if not (issubclass(dropped.exc_type, KeyboardInterrupt) and is_main and os.getpid() == self._process):
                others(dropped)
                return
            self._last = self._last or signal.SIGINT
            while True:
                try:
                    self._begin_to_send_again()
                    return
                except KeyboardInterrupt:  # it came before the hook had ended, where it would be dropped, too
                    pass

        sys.unraisablehook = hook
        try:
            yield
        finally:
            sys.unraisablehook = others

    def _begin_to_send_again(self) -> None:
        again = threading.Timer(AGAIN_S, self._send_again)
        again.daemon = True
        with contextlib.suppress(RuntimeError):  # no thread is to be had: it is remembered until the end
            again.start()

    def _send_again(self) -> None:
        if self._last is not None and signal.getsignal(self._last) is not signal.SIG_DFL:  # the block has not ended
            self._raised_s = float("-inf")
            os.kill(self._process, self._last)

    @property
    def _is_noted(self) -> bool:
        return self._last is not None and os.getpid() == self._process
