"""Items in this process, or in several processes of this machine.

Every process is an executor of its own (joblib's loky), so that one that dies takes none of the others with it. It is a
new program, not a fork: the threads and devices of a renderer do not survive one. A pipe joins it to the first process;
when that is gone, even by `kill -9`, the pipe breaks, and the process ends at once.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from foreglow.parallel.pool import LostError, hand_out
from foreglow.parallel.workers import Item, Parent, Result, Told, Work

ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
"""Of the processes: as many of them as cores, each with as many threads as cores, are slower than one."""


@dataclass(frozen=True, slots=True)
class Local:
    """This machine: `Workers` with `jobs` processes.

    Attributes:
        jobs: Number of processes; 1 stays in this one, as does a single item.
    """

    jobs: int = 1

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise ValueError(f"jobs: expected at least 1, got {self.jobs}")

    @property
    def num_workers(self) -> int:
        """The processes."""
        return self.jobs

    def each(
        self,
        work: Work[Item, Result],
        items: Mapping[str, Item],
        told: Told,
        *,
        is_stopped: Callable[[], bool] = lambda: False,
        paths: Sequence[Path] = (),  # noqa: ARG002  they are where they are
    ) -> Iterator[tuple[str, Result]]:
        """As `Workers.each`."""
        if self.jobs > 1 and len(items) > 1:
            yield from hand_out(_Processes(min(self.jobs, len(items)), work), items, told, is_stopped)
            return
        here = _Here(told, is_stopped)
        for name, item in items.items():
            if is_stopped():
                return
            yield name, work(item, here)


@dataclass(frozen=True, slots=True)
class _Here:
    """The parent of work in the same process."""

    told: Told
    asked: Callable[[], bool]

    def tell(self, *news: Any) -> None:
        self.told(*news)

    @property
    def is_stopped(self) -> bool:
        return self.asked()


class _Processes:
    """A crew of processes, made as they are needed."""

    def __init__(self, jobs: int, work: Work[Any, Any]) -> None:
        from joblib.externals import loky

        self._jobs, self._work = jobs, work
        self._make_executor = loky.ProcessPoolExecutor
        self._idle: list[_Process] = []
        self._busy: dict[Future[Any], _Process] = {}
        self._last_news: list[tuple[Any, ...]] = []
        self._warnings = contextlib.ExitStack()
        self._warnings.enter_context(warnings.catch_warnings())
        # loky renews a process that has grown between two items, which is as well, and warns of it.
        warnings.filterwarnings("ignore", "A worker stopped while some jobs were given to the executor")

    def num_places(self) -> int:
        return self._jobs

    def begin(self, name: str, item: Any) -> Future[Any]:  # noqa: ARG002
        process = self._idle.pop() if self._idle else _Process.started(self._make_executor)
        future: Future[Any] = process.executor.submit(_call, self._work, item)
        self._busy[future] = process
        return future

    def result_of(self, name: str, future: Future[Any]) -> Any:  # noqa: ARG002
        process = self._busy.pop(future)
        self._last_news += process.news()
        if isinstance(future.exception(), BrokenProcessPool):
            process.end()
            raise LostError from future.exception()
        self._idle.append(process)
        return future.result()

    def news(self) -> Iterable[tuple[Any, ...]]:
        late, self._last_news = self._last_news, []
        return [*late, *(news for process in self._busy.values() for news in process.news())]

    def stop(self) -> None:
        for process in self._busy.values():
            process.stop()

    def end(self) -> None:
        for process in (*self._idle, *self._busy.values()):
            process.end()
        self._warnings.close()


@dataclass(frozen=True, slots=True)
class _Process:
    """One process, and both ends of the pipe to it: loky hands the far one to a process that it renews."""

    executor: Any
    near: Connection
    far: Connection

    @classmethod
    def started(cls, make_executor: Callable[..., Any]) -> _Process:
        near, far = multiprocessing.Pipe()
        return cls(make_executor(1, initializer=_join, initargs=(far,), env=ENVIRONMENT), near, far)

    def news(self) -> Iterator[tuple[Any, ...]]:
        while self.near.poll():
            yield self.near.recv()

    def stop(self) -> None:
        self.near.send(None)

    def end(self) -> None:
        self.executor.shutdown(kill_workers=True)
        self.near.close()
        self.far.close()


@dataclass(slots=True)
class _Pipe:
    """The parent of work in another process."""

    line: Connection
    stop: threading.Event = field(default_factory=threading.Event)

    def tell(self, *news: Any) -> None:
        self.line.send(news)

    @property
    def is_stopped(self) -> bool:
        return self.stop.is_set()

    def listen(self) -> None:
        """Waits for the word to stop; ends the process when nobody is there any more to say it."""
        try:
            while True:
                self.line.recv()
                self.stop.set()
        except (EOFError, OSError):
            os._exit(1)


_PARENT: list[Parent] = []
"""Of a process that works for another one."""


def _join(line: Connection) -> None:
    """The first thing that a process does: Ctrl-C and `kill` are the first process's matter, which tells it to stop."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    parent = _Pipe(line)
    threading.Thread(target=parent.listen, daemon=True).start()
    _PARENT[:] = [parent]


def _call(work: Work[Item, Result], item: Item) -> Result:
    return work(item, _PARENT[0])
