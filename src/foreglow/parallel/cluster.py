"""Items on the workers of a dask cluster: many machines that see the same files at the same paths."""

from __future__ import annotations

import contextlib
import functools
import math
import socket
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foreglow.parallel.pool import given_up, hand_out
from foreglow.parallel.workers import Item, Result, Told, Work

if TYPE_CHECKING:
    from distributed import Client

CONNECT_S = 10.0
"""A scheduler that does not answer for so long is taken for absent, and so is one whose workers do not come."""

COUNT_S = 1.0
"""How often workers are counted; those that join get their share."""

LOST_S = 60.0
"""A cluster that has been without workers for so long gets none any more; nannies start theirs again in seconds."""


@dataclass(frozen=True, slots=True)
class Cluster:
    """A dask cluster: `Workers` at a scheduler's address, such as `tcp://127.0.0.1:8786`.

    Its workers run one task at a time (`dask worker --nthreads 1`), have this version of Foreglow, and work in the
    folder that this process runs in, so that a path means the same everywhere. Scheduler, workers and we trust each
    other: dask sends Python's pickles between them. Encryption and authentication are those of dask's configuration.
    """

    address: str

    @property
    def num_workers(self) -> int:
        """The workers that are there now."""
        with contextlib.closing(_connected(self.address)) as client:
            return len(client.nthreads())

    def each(
        self,
        work: Work[Item, Result],
        items: Mapping[str, Item],
        told: Told,
        *,
        is_stopped: Callable[[], bool] = lambda: False,
        paths: Sequence[Path] = (),
    ) -> Iterator[tuple[str, Result]]:
        """As `Workers.each`."""
        if items:
            yield from hand_out(_DaskWorkers(self.address, work, paths), items, told, is_stopped)


def _connected(address: str) -> Client:
    """A client of the scheduler at `address`, which has workers."""
    from distributed import Client

    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except OSError as error:
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
    """What a worker has to know beside the item.

    Attributes:
        token: Of this call of `each`.
        key: Of the task.
        version: Foreglow's.
        folder: Where the first process runs.
        paths: What must be there.
    """

    token: str
    key: str
    version: str
    folder: Path
    paths: tuple[Path, ...]


class _DaskWorkers:
    """A crew: whoever is at the scheduler."""

    def __init__(self, address: str, work: Work[Any, Any], paths: Sequence[Path]) -> None:
        self._address, self._work = address, work
        self._client = _connected(address)
        self._token = uuid.uuid4().hex
        self._make_order = functools.partial(
            _Order, self._token, version=version("foreglow"), folder=Path.cwd(), paths=tuple(paths)
        )
        self._news: deque[tuple[Any, ...]] = deque()
        self._client.subscribe_topic(self._token, lambda event: self._news.append(tuple(event[1])))
        self._num_workers, self._asked_s, self._seen_s = 0, -math.inf, time.monotonic()

    def num_places(self) -> int:
        now_s = time.monotonic()
        if now_s - self._asked_s > COUNT_S:
            self._num_workers, self._asked_s = len(self._client.nthreads()), now_s
        if self._num_workers:
            self._seen_s = now_s
        elif now_s - self._seen_s > LOST_S:
            raise ChildProcessError(f"--cluster {self._address}: all workers are gone, and none came back")
        return self._num_workers

    def begin(self, name: str, item: Any) -> Any:
        key = f"foreglow-{name}-{uuid.uuid4().hex}"
        return self._client.submit(_call, self._work, item, self._make_order(key=key), key=key, pure=False)

    def result_of(self, name: str, task: Any) -> Any:
        from distributed import CancelledError, KilledWorker

        try:
            result = task.result()
        except KilledWorker as error:
            raise given_up(name) from error
        except CancelledError as error:
            raise ConnectionError(f"--cluster {self._address}: the scheduler is gone") from error
        task.release()  # or it would be worked out again when the worker dies that has the result
        return result

    def news(self) -> Iterable[tuple[Any, ...]]:
        return [self._news.popleft() for _ in range(len(self._news))]

    def stop(self) -> None:
        self._client.run(_stop, self._token, on_error="ignore")

    def end(self) -> None:
        self._client.close()  # and the scheduler forgets our tasks


_STOPPED: set[str] = set()
"""Tokens of the calls whose work shall stop, in a worker's process."""


def _stop(token: str) -> None:
    _STOPPED.add(token)


@dataclass(frozen=True, slots=True)
class _Scheduler:
    """The parent of work on a worker."""

    worker: Any
    order: _Order

    def tell(self, *news: Any) -> None:
        self.worker.log_event(self.order.token, news)

    @property
    def is_stopped(self) -> bool:
        """Also where nobody waits for the result any more, as when the first process was killed."""
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
    with contextlib.chdir(order.folder):
        return work(item, _Scheduler(worker, order))
