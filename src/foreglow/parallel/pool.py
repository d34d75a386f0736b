"""The loop that hands items out, takes results in, and has the items of lost processes done again."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from queue import Empty, SimpleQueue
from typing import Any, Protocol, TypeVar

from foreglow.parallel.workers import Told

Item = TypeVar("Item")

MAX_DEATHS = 4
"""An item that lost so many processes is given up; what dask.distributed does, too, unless told otherwise."""

POLL_S = 0.05
"""How often news are passed on."""

GRACE_S = 5.0
"""Work that was asked to stop has this long to do so."""


class LostError(Exception):
    """The process that worked on an item is gone."""


class Task(Protocol):
    """A call under way elsewhere: the future of an executor, or of dask."""

    def add_done_callback(self, fn: Callable[[Any], Any]) -> Any:
        """Has `fn` called once the task is done, from some thread."""
        ...


class Crew(Protocol):
    """Processes that wait for work."""

    def num_places(self) -> int:
        """How many items it takes at once."""
        ...

    def begin(self, name: str, item: Any) -> Task:
        """Has an item worked on."""
        ...

    def result_of(self, name: str, task: Any) -> Any:
        """What came of a task that is done; LostError if its process is gone, and else the error of the work."""
        ...

    def news(self) -> Iterable[tuple[Any, ...]]:
        """What the work told since the last call."""
        ...

    def stop(self) -> None:
        """Asks those under way to stop."""
        ...

    def end(self) -> None:
        """Lets all go, whatever they do."""
        ...


def hand_out(
    crew: Crew, items: Mapping[str, Item], told: Told, is_stopped: Callable[[], bool]
) -> Iterator[tuple[str, Any]]:
    """`Workers.each` with the processes of `crew`, which end with it."""
    waiting = deque(items)
    running: set[str] = set()
    done: SimpleQueue[tuple[str, Any]] = SimpleQueue()
    deaths: Counter[str] = Counter()
    error: Exception | None = None
    is_stopping = False
    try:
        while waiting or running:
            if is_stopped() and not is_stopping:
                crew.stop()
                is_stopping = True
            if is_stopping or error is not None:
                waiting.clear()
            while waiting and len(running) < crew.num_places():
                running.add(waiting[0])
                _begin(crew, waiting.popleft(), items, done)
            finished = _next_of(done) if running else None
            for news in crew.news():
                told(*news)
            if finished is None:
                continue
            name, task = finished
            running.remove(name)
            try:
                result = crew.result_of(name, task)
            except LostError:
                deaths[name] += 1
                if deaths[name] < MAX_DEATHS:
                    waiting.appendleft(name)
                else:
                    error = error or given_up(name)
            except Exception as one:
                error = error or one
            else:
                yield name, result
        if error is not None:
            raise error
    finally:
        try:
            if running:
                crew.stop()
                _wait_for(crew, running, done)
        finally:
            crew.end()


def given_up(name: str) -> ChildProcessError:
    """The error about an item that cost too many processes."""
    return ChildProcessError(
        f"{name}: {MAX_DEATHS} processes that worked on it ended unexpectedly, perhaps for lack of memory: run again "
        "with fewer at once"
    )


def _begin(crew: Crew, name: str, items: Mapping[str, Item], done: SimpleQueue[tuple[str, Any]]) -> None:
    crew.begin(name, items[name]).add_done_callback(lambda task: done.put((name, task)))


def _next_of(done: SimpleQueue[tuple[str, Any]]) -> tuple[str, Any] | None:
    try:
        return done.get(timeout=POLL_S)
    except Empty:
        return None


def _wait_for(crew: Crew, running: set[str], done: SimpleQueue[tuple[str, Any]]) -> None:
    """Until those under way have stopped, or their time is up; who tells much is not kept waiting for a reader."""
    until_s = time.monotonic() + GRACE_S
    while running and time.monotonic() < until_s:
        for _ in crew.news():
            pass
        finished = _next_of(done)
        if finished is not None:
            running.discard(finished[0])
