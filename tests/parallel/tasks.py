"""Work for the tests of the workers, in a module that other processes can import."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import cv2

from foreglow.parallel import Parent

PATIENCE_S = 120.0
"""How long to wait for another process: it only matters when a test fails, and a busy machine takes its time."""


def wait_until(is_so: Callable[[], bool]) -> None:
    """Returns as soon as it is so, or when patience ends."""
    until_s = time.monotonic() + PATIENCE_S
    while not is_so() and time.monotonic() < until_s:
        time.sleep(0.01)


def square(item: int, parent: Parent) -> int:
    parent.report_progress("squared", item)
    return item * item


def threads_of_opencv(_item: object, _parent: Parent) -> int:
    return cv2.getNumThreads()


def process_of(item: float, parent: Parent) -> int:  # noqa: ARG001
    time.sleep(item)
    return os.getpid()


def fail_at(item: tuple[bool, Path], parent: Parent) -> str:  # noqa: ARG001
    """Fails at once where it is told to, and else takes until that must be known."""
    is_bad, folder = item
    failed = folder.parent / "failed"
    if is_bad:
        failed.touch()
        raise ValueError(f"{folder}: bad item")
    wait_until(failed.exists)
    time.sleep(1.5)
    (folder / "finished").touch()
    return "good"


def die_once(item: Path, parent: Parent) -> int:
    """Notes each attempt in a folder; the first of an item called `fatal` ends its process as the kernel would."""
    (item / f"{time.monotonic_ns()}").touch()
    num_attempts = len(list(item.iterdir()))
    parent.report_progress(item.name, num_attempts)
    if item.name == "fatal" and num_attempts == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.3)
    return num_attempts


def die(item: str, parent: Parent) -> None:  # noqa: ARG001
    if item == "fatal":
        os.kill(os.getpid(), signal.SIGKILL)


def wait_for_stop(item: Path, parent: Parent) -> str:
    """Notes its process in a file, works until it is told to stop, and notes that, too."""
    item.with_suffix(".started").write_text(str(os.getpid()))
    parent.report_progress("started", item.name)
    until_s = time.monotonic() + 2.0 * PATIENCE_S  # longer than a test waits for it
    while not parent.is_stopped and time.monotonic() < until_s:
        time.sleep(0.01)
        item.with_suffix(".working").touch()
    item.with_suffix(".stopped").touch()
    return "stopped" if parent.is_stopped else "late"


def read_here(item: str, parent: Parent) -> str:  # noqa: ARG001
    """The text of a file whose path is relative to the folder of the first process."""
    return Path(item).read_text()


def freeze(path: Path, parent: Parent) -> None:
    """Writes the number of its process, tells, and stops the process as a whole."""
    path.write_text(str(os.getpid()))
    parent.report_progress()
    time.sleep(0.5)  # the report is sent by another thread
    os.kill(os.getpid(), signal.SIGSTOP)


def is_frozen(number: str) -> bool:
    """Whether a process is stopped; Linux."""
    return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] in ("t", "T")
