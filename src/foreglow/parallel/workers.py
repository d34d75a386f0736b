"""The interface between work and the workers that do it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
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
        paths: Sequence[Path] = (),
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
