"""How a study says how far it is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TypeAlias, TypeVar

Item = TypeVar("Item")

Progress: TypeAlias = Callable[[str, int, int], None]
"""Called with the step under way, how much of it is done, and how much there is."""


def counted(items: Iterable[Item], step: str, num_all: int, progress: Progress | None) -> Iterator[Item]:
    """The items one by one; `progress` is called once each of them is dealt with."""
    for num_done, item in enumerate(items, start=1):
        yield item
        if progress is not None:
            progress(step, num_done, num_all)
