"""What work, and those who have it done, know of each other."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeAlias, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

Told: TypeAlias = Callable[..., None]
"""Called in the first process with whatever the work told, in pieces of any number."""


class Parent(Protocol):
    """Who handed out the work, as the work sees it."""

    def tell(self, *news: Any) -> None:
        """Tells how far the work is, in numbers and short texts; a lost process may tell of the same things twice."""
        ...

    @property
    def is_stopped(self) -> bool:
        """Whether the work shall end soon; it asks often and returns what it has, or raises KeyboardInterrupt."""
        ...


Work: TypeAlias = Callable[[Item, Parent], Result]
"""A function of a module, or a `functools.partial` of one; what it takes and returns can be pickled."""


class Workers(Protocol):
    """Has items worked on: in this process, in others of this machine, or on a cluster."""

    @property
    def num_workers(self) -> int:
        """How many items are worked on at once."""
        ...

    def each(
        self,
        work: Work[Item, Result],
        items: Mapping[str, Item],
        told: Told,
        *,
        is_stopped: Callable[[], bool] = lambda: False,
        paths: Sequence[Path] = (),
    ) -> Iterator[tuple[str, Result]]:
        """Calls `work` with every item, begun in their order, and yields names with results as they are done.

        The item of a process that died is worked on again, the others are left alone; so work must not mind what a
        first attempt left behind. After an error of `work` those under way are finished, and no more are begun. Where
        the caller leaves early, as on Ctrl-C, those under way are asked to stop and then made to.

        Args:
            work: What is done.
            items: By the name that messages call them.
            told: Takes what the work tells; it is called between results, by who iterates.
            is_stopped: Asked often; once true, no more are begun and those under way are asked to stop and return.
            paths: What the work reads and writes; on a cluster every machine must have it at the same place.

        Raises:
            ChildProcessError: If an item lost `MAX_DEATHS` processes; the message names it.
            Exception: The first one of `work`.
            FileNotFoundError: If a worker of a cluster lacks one of `paths`.
            ModuleNotFoundError: If dask.distributed is needed and not installed.
            ValueError: If the cluster cannot be used.
        """
        ...


def workers_at(jobs: int, cluster: str | None) -> Workers:
    """The workers of the cluster at that address, or `jobs` processes of this machine; 1 stays in this one.

    Raises:
        ValueError: If both are asked for, or `jobs` is below 1.
    """
    from foreglow.parallel.cluster import Cluster
    from foreglow.parallel.local import Local

    if cluster is None:
        return Local(jobs)
    if jobs != 1:
        raise ValueError(f"expected --jobs or --cluster, got both: the workers of {cluster} are counted there")
    return Cluster(cluster)
