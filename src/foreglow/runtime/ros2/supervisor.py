"""Starts the nodes as processes, restarts those that die, and has one die that hangs."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Self

from foreglow.runtime.live.faults import LiveFault
from foreglow.runtime.live.loop import ASLEEP_S
from foreglow.runtime.ros2.environment import NUM_PARTICIPANTS, PARTICIPANT

PAUSES_S = (0.0, 0.5, 1.0, 2.0, 5.0)
"""Pauses before a process is started again: longer after each failure, and the first one again once the process has
lived for `SOUND_S`."""
SOUND_S = 10.0
END_S = 5.0
"""A process that has not ended this long after it was asked to is killed."""
BAD_INPUT = 2
"""Exit code of a command whose input or configuration cannot be used."""
HUNG = 75
"""Exit code of a node in which something hangs: EX_TEMPFAIL of sysexits.h, as a new process is all that helps."""
LOOK_S = 0.05
"""Between two looks whether something hangs."""

_starts = itertools.count(os.getpid())


class HangWatch:
    """While entered, a thread ends this process with `HUNG` when its work hangs: whoever started it starts it again.

    Time in which the whole process was stopped does not count. What keeps all other Python threads from running, as a
    foreign extension may, hides that it hangs.
    """

    def __init__(self, limit_s: float, work: Callable[[], str]) -> None:
        """A watch for work of which each round takes at most `limit_s`; `work` says what is under way."""
        self._limit_s, self._work = limit_s, work
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._look, name="hang watch", daemon=True)

    def __enter__(self) -> Self:
        self.begin()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self._thread.join()

    def begin(self) -> None:
        """A new round of the work begins."""
        self._begun_s = time.monotonic()

    def _look(self) -> None:
        woken_s = looked_s = time.monotonic()
        while not self._is_over.wait(LOOK_S):
            now_s = time.monotonic()
            if now_s - looked_s > LOOK_S + ASLEEP_S:
                woken_s = now_s
            looked_s = now_s
            if now_s - max(self._begun_s, woken_s) > self._limit_s:
                with contextlib.suppress(OSError):  # whoever read it is gone
                    os.write(2, f"foreglow: {LiveFault.STAGE_HANGS}: {self._work()}; start again\n".encode())
                os._exit(HUNG)


class Process:
    """One node's process."""

    def __init__(self, name: str, arguments: Sequence[str], environment: Mapping[str, str] | None = None) -> None:
        """Starts `foreglow ros2` with `arguments`."""
        self.name = name
        self._command = [sys.executable, "-m", "foreglow.cli", "ros2", *arguments]
        self._environment = environment
        self._num_failures = 0
        self._due_s: float | None = None
        self.start()

    def start(self) -> None:
        """Starts the process; it ends when this one does, even if this one is killed."""
        self._began_s = time.monotonic()
        self._due_s = None
        known = os.environ if self._environment is None else self._environment
        number = {PARTICIPANT: str(next(_starts) % NUM_PARTICIPANTS)}
        # A process group of its own: Ctrl-C in the terminal reaches this process alone, which passes it on.
        self.popen = subprocess.Popen(
            [*self._command, "--parent", str(os.getpid())], env={**known, **number}, start_new_session=True
        )

    def update(self) -> int | None:
        """The exit code if the process has just ended, else None; starts it again when its pause is over."""
        now_s, code = time.monotonic(), self.popen.poll()
        if code is None:
            return None
        if self._due_s is None:
            self._num_failures = 0 if now_s - self._began_s > SOUND_S else self._num_failures + 1
            self._due_s = now_s + PAUSES_S[min(max(self._num_failures - 1, 0), len(PAUSES_S) - 1)]
            return code
        if now_s >= self._due_s:
            self.start()
        return None

    def end(self) -> None:
        """Asks the process to end."""
        if self.popen.poll() is None:
            self.popen.send_signal(signal.SIGINT)

    def wait(self) -> None:
        """Waits until the process has ended, and kills it after `END_S`."""
        try:
            self.popen.wait(END_S)
        except subprocess.TimeoutExpired:
            self.popen.kill()
            self.popen.wait()


def supervise(
    nodes: Mapping[str, Sequence[str]],
    source: Sequence[str],
    should_stop: Callable[[], bool],
    say: Callable[[str], None],
    wait: Callable[[float], None] = time.sleep,
) -> int:
    """Runs the nodes until the source ends; returns the exit code.

    A node that dies is started again. All end when the source fails, or when a node's input or configuration cannot be
    used.

    Args:
        nodes: The arguments of `foreglow ros2` for each compute node, by name.
        source: The arguments for the source.
        should_stop: Whether to end.
        say: Takes a line for the user.
        wait: Lets so many seconds pass.
    """
    processes = [Process(name, arguments) for name, arguments in nodes.items()]
    player = Process("source", source)
    try:
        while not should_stop():
            if (code := player.popen.poll()) is not None:
                if code < 0:
                    say(f"{player.name} was ended by signal {-code}, and the network with it")
                return code if code >= 0 else 128 - code
            for process in processes:
                code = process.update()
                if code == BAD_INPUT:
                    return code
                if code is not None:
                    say(f"{process.name} has ended ({code}) and is started again")
            wait(0.02)
        return 130
    finally:
        everyone = (player, *processes)
        for process in everyone:
            process.end()
        for process in everyone:
            process.wait()
