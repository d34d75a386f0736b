"""Work in this process, or in several processes of this machine.

Each process is an executor of its own (joblib's loky), so one that dies does not take the others with it. It is a new
program, not a fork, because the threads and devices of a renderer do not survive a fork. A pipe connects it to the
first process; when that is gone, even by `kill -9`, the pipe breaks and the process ends at once.
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

from foreglow.numbers import checked_whole
from foreglow.parallel.pool import Item, LostProcessError, Parent, ProgressCallback, Result, Work, schedule
from foreglow.plugins import traced

SAFE_PATH = {"PYTHONSAFEPATH": "1"}
"""Environment of a Python that does not look into the working folder first: a `json.py` there is no standard module."""

ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "OPENCV_FOR_THREADS_NUM": "1",
    **SAFE_PATH,
}
"""Environment of the processes: with one process per core, several threads in each only slow each other down. They
begin without the working folder, and get the first process's `sys.path`, which may have it."""


@dataclass(frozen=True, slots=True)
class Local:
    """This machine: `Workers` with `jobs` processes.

    Attributes:
        jobs: Number of processes; 1 stays in this process, as does a single item.
    """

    jobs: int = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "jobs", checked_whole("jobs", self.jobs, 1))

    @property
    def num_workers(self) -> int:
        """The processes."""
        return self.jobs

    def each(
        self,
        work: Work[Item, Result],
        items: Mapping[str, Item],
        progress: ProgressCallback,
        *,
        is_stopped: Callable[[], bool] = lambda: False,
        paths: Sequence[Path | str] = (),  # noqa: ARG002  this machine has them
    ) -> Iterator[tuple[str, Result]]:
        """As `Workers.each`."""
        if self.jobs > 1 and len(items) > 1:
            yield from schedule(_Processes(min(self.jobs, len(items)), work), items, progress, is_stopped)
            return
        here = _Here(progress, is_stopped)
        for name, item in items.items():
            if is_stopped():
                return
            yield name, work(item, here)


@dataclass(frozen=True, slots=True)
class _Here:
    """The parent of work in the same process."""

    progress: ProgressCallback
    check: Callable[[], bool]

    def report_progress(self, *values: Any) -> None:
        self.progress(*values)

    @property
    def is_stopped(self) -> bool:
        return self.check()


class _Processes:
    """A pool of processes, started as they are needed."""

    def __init__(self, jobs: int, work: Work[Any, Any]) -> None:
        from joblib.externals import loky

        self._jobs, self._work = jobs, work
        from joblib.externals.loky.backend import resource_tracker

        self._make_executor = loky.ProcessPoolExecutor
        with safe_path(), _deaf_to_hangups():  # it ignores Ctrl-C and SIGTERM by itself
            resource_tracker.ensure_running()
        self._idle: list[_Process] = []
        self._busy: dict[Future[Any], _Process] = {}
        self._last_reports: list[tuple[Any, ...]] = []
        self._warnings = contextlib.ExitStack()
        self._warnings.enter_context(warnings.catch_warnings())
        # loky replaces a process that has grown between two items, which is fine, and warns about it.
        warnings.filterwarnings("ignore", "A worker stopped while some jobs were given to the executor")

    def num_slots(self) -> int:
        return self._jobs

    def submit(self, name: str, item: Any) -> Future[Any]:  # noqa: ARG002
        with safe_path():  # loky starts processes of its own, too, which watch what is left behind
            process = self._idle.pop() if self._idle else _Process.start(self._make_executor)
            future: Future[Any] = process.executor.submit(_call, self._work, item)
        self._busy[future] = process
        return future

    def result(self, name: str, future: Future[Any]) -> Any:  # noqa: ARG002
        process = self._busy.pop(future)
        self._last_reports += process.reports()
        if isinstance(future.exception(), BrokenProcessPool):
            process.close()
            raise LostProcessError from future.exception()
        self._idle.append(process)
        return future.result()

    def reports(self) -> Iterable[tuple[Any, ...]]:
        last, self._last_reports = self._last_reports, []
        return [*last, *(values for process in self._busy.values() for values in process.reports())]

    def stop(self) -> None:
        for process in self._busy.values():
            process.stop()

    def close(self) -> None:
        for process in (*self._idle, *self._busy.values()):
            process.close()
        self._warnings.close()


@dataclass(frozen=True, slots=True)
class _Process:
    """One process, and both ends of the pipe to it: loky passes the far end to a process that it starts anew."""

    executor: Any
    near: Connection
    far: Connection

    @classmethod
    def start(cls, make_executor: Callable[..., Any]) -> _Process:
        near, far = multiprocessing.Pipe()
        return cls(make_executor(1, initializer=_join, initargs=(far,), env=ENVIRONMENT), near, far)

    def reports(self) -> Iterator[tuple[Any, ...]]:
        while self.near.poll():
            yield self.near.recv()

    def stop(self) -> None:
        self.near.send(None)

    def close(self) -> None:
        self.executor.shutdown(kill_workers=True)
        self.near.close()
        self.far.close()


@dataclass(slots=True)
class _Pipe:
    """The parent of work in another process."""

    connection: Connection
    stop: threading.Event = field(default_factory=threading.Event)

    def report_progress(self, *values: Any) -> None:
        self.connection.send(values)

    @property
    def is_stopped(self) -> bool:
        return self.stop.is_set()

    def listen(self) -> None:
        """Waits for the request to stop; ends this process when the first process is gone."""
        try:
            while True:
                self.connection.recv()
                self.stop.set()
        except (EOFError, OSError):
            os._exit(1)


@contextlib.contextmanager
def _deaf_to_hangups() -> Iterator[None]:
    """A process that is started while the block lasts never gets SIGHUP, as when a terminal closes; we get it later."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def safe_path() -> Iterator[None]:
    """While the block lasts, a Python that is started does not look into the working folder first."""
    earlier = {name: os.environ.get(name) for name in SAFE_PATH}
    os.environ.update(SAFE_PATH)
    try:
        yield
    finally:
        for name, value in earlier.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


_PARENT: list[Parent] = []
"""The parent of this process, if it works for another one."""


def _join(connection: Connection) -> None:
    """Sets up a process: it leaves Ctrl-C and `kill` to the first process, which asks it to stop."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    parent = _Pipe(connection)
    threading.Thread(target=parent.listen, daemon=True).start()
    _PARENT[:] = [parent]


def _call(work: Work[Item, Result], item: Item) -> Result:
    with traced():
        return work(item, _PARENT[0])
