"""Starts the nodes as processes, and restarts those that die."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence

from foreglow.runtime.ros2.environment import NUM_PARTICIPANTS, PARTICIPANT

PAUSES_S = (0.0, 0.5, 1.0, 2.0, 5.0)
"""Pauses before a process is started again: longer after each failure, and the first one again once the process has
lived for `SOUND_S`."""
SOUND_S = 10.0
END_S = 5.0
"""A process that has not ended this long after it was asked to is killed."""
BAD_INPUT = 2
"""Exit code of a command whose input or configuration cannot be used."""

_starts = itertools.count(os.getpid())


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
