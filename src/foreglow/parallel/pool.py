"""Work and its workers, and the loop that starts items, collects results, and repeats the items of lost processes."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Protocol, TypeAlias, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

ProgressCallback: TypeAlias = Callable[..., None]
"""Called in the first process with the values that the work passed to `Parent.report_progress`."""


class Parent(Protocol):
    """The process that started the work, as seen from the work."""

    def report_progress(self, *values: Any) -> None:
        """Says how far the work is, in numbers and short texts; an item that is worked on again reports again."""
        ...

    @property
    def is_stopped(self) -> bool:
        """Whether the work should end soon: it checks often, and returns what it has or raises KeyboardInterrupt."""
        ...


Work: TypeAlias = Callable[[Item, Parent], Result]
"""A module-level function, or a `functools.partial` of one; what it takes and returns can be pickled."""


class Workers(Protocol):
    """Where items are worked on: in this process, in several processes of this machine, or on a cluster."""

    @property
    def num_workers(self) -> int:
        """How many items are worked on at once."""
        ...

    def each(
        self,
        work: Work[Item, Result],
        items: Mapping[str, Item],
        progress: ProgressCallback,
        *,
        is_stopped: Callable[[], bool] = lambda: False,
        paths: Sequence[Path | str] = (),
    ) -> Iterator[tuple[str, Result]]:
        """Calls `work` with every item, starting them in order, and yields each name and result as it is done.

        If a process dies, its item alone is worked on again, so the work must cope with what a first attempt left
        behind. After an error in `work`, the items under way are finished and no more are started. If the caller stops
        iterating early, as on Ctrl-C, the items under way are first asked to stop, then killed.

        Args:
            work: What is done with each item.
            items: The items, by the names used in messages.
            progress: Called between results, in the iterating thread, with what the work reports.
            is_stopped: Checked often; once true, no more items are started, and those under way are asked to stop.
            paths: What the work reads and writes; on a cluster, every machine must have it at the same path.

        Raises:
            ChildProcessError: If an item lost `MAX_DEATHS` processes; the message names it.
            Exception: The first one that `work` raised.
            FileNotFoundError: If a worker of a cluster lacks one of `paths`.
            ModuleNotFoundError: If dask.distributed is needed and not installed.
            ValueError: If the cluster cannot be used.
        """
        ...


MAX_DEATHS = 4
"""An item is given up once this many processes died working on it; dask.distributed has the same default."""

POLL_S = 0.05
"""How often progress is passed on."""

GRACE_S = 5.0
"""How long work that was asked to stop has to do so."""


class LostProcessError(Exception):
    """The process that worked on an item is gone."""


class Task(Protocol):
    """A call under way elsewhere: the future of an executor, or of dask."""

    def add_done_callback(self, fn: Callable[[Any], Any]) -> Any:
        """Has `fn` called once the task is done, from some thread."""
        ...


class Pool(Protocol):
    """Processes that wait for work."""

    def num_slots(self) -> int:
        """How many items can be worked on at once."""
        ...

    def submit(self, name: str, item: Any) -> Task:
        """Starts work on an item."""
        ...

    def result(self, name: str, task: Any) -> Any:
        """The result of a task that is done.

        Raises:
            LostProcessError: If its process is gone.
            Exception: What the work raised.
        """
        ...

    def reports(self) -> Iterable[tuple[Any, ...]]:
        """What the work has reported since the last call."""
        ...

    def stop(self) -> None:
        """Asks the work under way to stop."""
        ...

    def close(self) -> None:
        """Ends all processes, whatever they are doing."""
        ...


def schedule(
    pool: Pool, items: Mapping[str, Item], progress: ProgressCallback, is_stopped: Callable[[], bool]
) -> Iterator[tuple[str, Any]]:
    """`Workers.each` with the processes of `pool`, which is closed at the end."""
    waiting = deque(items)
    running: set[str] = set()
    done: SimpleQueue[tuple[str, Any]] = SimpleQueue()
    deaths: Counter[str] = Counter()
    error: Exception | None = None
    is_stopping = False
    try:
        while waiting or running:
            if is_stopped() and not is_stopping:
                pool.stop()
                is_stopping = True
            if is_stopping or error is not None:
                waiting.clear()
            while waiting and len(running) < pool.num_slots():
                name = waiting.popleft()
                running.add(name)
                _submit(pool, name, items[name], done)
            finished = _next_of(done) if running else None
            for values in pool.reports():
                progress(*values)
            if finished is None:
                continue
            name, task = finished
            running.remove(name)
            try:
                result = pool.result(name, task)
            except LostProcessError:
                deaths[name] += 1
                if deaths[name] < MAX_DEATHS:
                    waiting.appendleft(name)
                else:
                    error = error or given_up(name)
            except Exception as raised:
                error = error or raised
            else:
                yield name, result
        if error is not None:
            raise error
    finally:
        try:
            if running:
                pool.stop()
                _wait_for(pool, running, done)
        finally:
            pool.close()


def given_up(name: str) -> ChildProcessError:
    """The error about an item that too many processes died of."""
    return ChildProcessError(
        f"{name}: {MAX_DEATHS} processes that worked on it ended unexpectedly, perhaps for lack of memory: run again "
        "with fewer at once"
    )


def _submit(pool: Pool, name: str, item: Any, done: SimpleQueue[tuple[str, Any]]) -> None:
    pool.submit(name, item).add_done_callback(lambda task: done.put((name, task)))


def _next_of(done: SimpleQueue[tuple[str, Any]]) -> tuple[str, Any] | None:
    try:
        return done.get(timeout=POLL_S)
    except Empty:
        return None


def _wait_for(pool: Pool, running: set[str], done: SimpleQueue[tuple[str, Any]]) -> None:
    """Waits until all work has stopped or its time is up, and empties the pipes, so that no process blocks on one."""
    until_s = time.monotonic() + GRACE_S
    while running and time.monotonic() < until_s:
        for _ in pool.reports():
            pass
        finished = _next_of(done)
        if finished is not None:
            running.discard(finished[0])
