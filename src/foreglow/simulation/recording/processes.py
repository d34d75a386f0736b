"""Scenes in several processes, each with a renderer of its own; all of them tell one place how far they are."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from queue import Empty, Queue
from typing import Any, TypeAlias, TypeVar

Progress: TypeAlias = Callable[[int, int, int], None]
"""Called with a scene's number, how many of its frames are done, and how many it has."""

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class _QueuedProgress:
    """Progress as another process tells it."""

    queue: Queue[tuple[int, int, int]]

    def __call__(self, number: int, num_done: int, num_frames: int) -> None:
        self.queue.put((number, num_done, num_frames))


def in_processes(work: Callable[[Item, Progress], None], items: Sequence[Item], jobs: int, report: Progress) -> None:
    """Calls `work` with every item and something to report to, in `jobs` processes; 1 stays in this one.

    After an error those under way are finished and no more are begun.

    Args:
        work: A function of a module, or a `functools.partial` of one.
        items: What to work on.
        jobs: Number of processes; more than one start anew, so that a script needs `if __name__ == "__main__":`.
        report: Told of everything, from this process.

    Raises:
        ChildProcessError: If a process died.
        Exception: The first one of `work`.
    """
    if jobs == 1 or len(items) < 2:
        for item in items:
            work(item, report)
        return
    # A renderer's threads and device do not survive a fork.
    context = multiprocessing.get_context("spawn")
    with context.Manager() as manager, ProcessPoolExecutor(min(jobs, len(items)), context) as pool:
        told: Queue[tuple[int, int, int]] = manager.Queue()
        futures = [pool.submit(work, item, _QueuedProgress(told)) for item in items]
        try:
            pending: set[Future[None]] = set(futures)
            while pending:
                done, pending = wait(pending, timeout=0.1, return_when=FIRST_EXCEPTION)
                _pass_on(told, report)
                if any(future.exception() is not None for future in done):
                    break
        finally:
            pool.shutdown(cancel_futures=True)
        _pass_on(told, report)
        for future in futures:
            if not future.cancelled():
                _raise_error_of(future)


def _pass_on(told: Queue[tuple[int, int, int]], report: Progress) -> None:
    while True:
        try:
            report(*told.get_nowait())
        except Empty:
            return


def _raise_error_of(future: Future[Any]) -> None:
    try:
        future.result()
    except BrokenProcessPool as error:
        raise ChildProcessError(
            "a process ended unexpectedly, perhaps for lack of memory; finished scenes are kept, run again with fewer "
            "jobs"
        ) from error
