"""Work on a dask cluster: many machines that see the same files at the same paths."""

from __future__ import annotations

import contextlib
import functools
import math
import socket
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foreglow.parallel.pool import GRACE_S, Item, ProgressCallback, Result, Work, given_up, schedule
from foreglow.plugins import traced

if TYPE_CHECKING:
    from distributed import Client

CONNECT_S = 10.0
"""How long to wait for the scheduler to answer, and for its first worker."""

COUNT_S = 1.0
"""How often the workers are counted; those that join later are given work, too."""

LOST_S = 60.0
"""How long a cluster may be without workers; dask's nannies restart theirs in seconds."""


@dataclass(frozen=True, slots=True)
class Cluster:
    """A dask cluster: `Workers` at a scheduler's address, such as `tcp://127.0.0.1:8786`.

    Its workers run one task at a time (`dask worker --nthreads 1`), have this version of Foreglow, and work in the
    folder that this process runs in, so that a path means the same everywhere. Scheduler, workers and this process
    trust each other, since dask sends pickles between them. Encryption and authentication are set up in dask's
    configuration.
    """

    address: str

    @property
    def num_workers(self) -> int:
        """The number of workers now."""
        with contextlib.closing(_connected(self.address)) as client:
            return len(client.nthreads())

    def each(
        self,
        work: Work[Item, Result],
        items: Mapping[str, Item],
        progress: ProgressCallback,
        *,
        is_stopped: Callable[[], bool] = lambda: False,
        paths: Sequence[Path | str] = (),
    ) -> Iterator[tuple[str, Result]]:
        """As `Workers.each`."""
        if items:
            yield from schedule(_DaskWorkers(self.address, work, paths), items, progress, is_stopped)


def _connected(address: str) -> Client:
    """A client of the scheduler at `address`, once it has a worker."""
    import asyncio

    from distributed import Client

    from foreglow.parallel.scheduler import check_scheduler

    asyncio.run(check_scheduler(address, CONNECT_S))
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except OSError as error:  # it answered before
        raise ConnectionError(f"--cluster {address}: expected a dask scheduler, nothing answers there") from error
    try:
        client.wait_for_workers(1, timeout=CONNECT_S)
    except TimeoutError as error:
        client.close()
        raise ConnectionError(
            f"--cluster {address}: expected workers at this scheduler, found none; start some with "
            f"dask worker {address} --nthreads 1"
        ) from error
    return client


@dataclass(frozen=True, slots=True)
class _Order:
    """What a worker has to know besides the item.

    Attributes:
        token: Names this call of `each`.
        key: Names the task.
        version: Version of Foreglow.
        folder: Working folder of the first process.
        paths: Files and folders that must be there.
    """

    token: str
    key: str
    version: str
    folder: Path
    paths: tuple[Path, ...]


class _DaskWorkers:
    """The pool of a scheduler's workers."""

    def __init__(self, address: str, work: Work[Any, Any], paths: Sequence[Path | str]) -> None:
        self._address, self._work = address, work
        self._client = _connected(address)
        self._token = uuid.uuid4().hex
        self._make_order = functools.partial(
            _Order, self._token, version=version("foreglow"), folder=Path.cwd(), paths=tuple(map(Path, paths))
        )
        self._reports: deque[tuple[Any, ...]] = deque()
        self._client.subscribe_topic(self._token, lambda event: self._reports.append(tuple(event[1])))
        self._num_workers, self._counted_s, self._seen_s = 0, -math.inf, time.monotonic()

    def num_slots(self) -> int:
        now_s = time.monotonic()
        if now_s - self._counted_s > COUNT_S:
            self._num_workers, self._counted_s = len(self._client.nthreads()), now_s
        if self._num_workers:
            self._seen_s = now_s
        elif now_s - self._seen_s > LOST_S:
            raise ChildProcessError(f"--cluster {self._address}: all workers are gone, and none came back")
        return self._num_workers

    def submit(self, name: str, item: Any) -> Any:
        key = f"foreglow-{name}-{uuid.uuid4().hex}"
        return self._client.submit(_call, self._work, item, self._make_order(key=key), key=key, pure=False)

    def result(self, name: str, task: Any) -> Any:
        from distributed import CancelledError, KilledWorker

        try:
            result = task.result()
        except KilledWorker as error:
            raise given_up(name) from error
        except CancelledError as error:
            raise ConnectionError(f"--cluster {self._address}: the scheduler is gone") from error
        task.release()  # else dask would compute it again if the worker that holds the result died
        return result

    def reports(self) -> Iterable[tuple[Any, ...]]:
        return [self._reports.popleft() for _ in range(len(self._reports))]

    def stop(self) -> None:
        """Asks the workers to stop, and leaves it at that after `GRACE_S`: one that is frozen never answers."""
        asking = threading.Thread(target=self._ask_to_stop, name="ask dask's workers to stop", daemon=True)
        asking.start()
        asking.join(GRACE_S)

    def _ask_to_stop(self) -> None:
        with contextlib.suppress(Exception):  # it may go on while the client is closed
            self._client.run(_stop, self._token, on_error="ignore")

    def close(self) -> None:
        self._client.close()  # the scheduler then forgets our tasks


_STOPPED: set[str] = set()
"""In a worker's process: tokens of the calls that should stop."""


def _stop(token: str) -> None:
    _STOPPED.add(token)


@dataclass(frozen=True, slots=True)
class _Scheduler:
    """The parent of work on a dask worker."""

    worker: Any
    order: _Order

    def report_progress(self, *values: Any) -> None:
        self.worker.log_event(self.order.token, values)

    @property
    def is_stopped(self) -> bool:
        """True, too, when nobody waits for the result any more, as after the first process was killed."""
        task = self.worker.state.tasks.get(self.order.key)
        return self.order.token in _STOPPED or task is None or task.state == "cancelled"


def _call(work: Work[Item, Result], item: Item, order: _Order) -> Result:
    """Does the work on a worker, in the folder of the first process."""
    from distributed import get_worker

    worker = get_worker()
    where = f"worker {worker.address} on {socket.gethostname()}"
    if worker.state.nthreads != 1:
        raise ValueError(f"{where}: expected one thread (dask worker --nthreads 1), it has {worker.state.nthreads}")
    if version("foreglow") != order.version:
        raise ValueError(f"{where}: expected foreglow {order.version}, it has {version('foreglow')}")
    for path in (order.folder, *order.paths):
        if not (order.folder / path).exists():
            raise FileNotFoundError(
                f"{path}: no such file or folder at {where}: expected the same files at the same paths on every machine"
            )
    with contextlib.chdir(order.folder), traced():
        return work(item, _Scheduler(worker, order))
