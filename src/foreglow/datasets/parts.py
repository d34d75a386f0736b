"""The sequences of a source, each a source of its own: what may be run apart."""

from __future__ import annotations

from foreglow.datasets.pvdn import PVDN
from foreglow.datasets.source import FrameSource
from foreglow.datasets.vehicle_data import Equipped


def part_names(source: FrameSource) -> tuple[str, ...]:
    """Names of the sequences in the order of their frames; one empty name where the source is all of a piece."""
    if isinstance(source, Equipped):
        return part_names(source.source)
    return source.directories if isinstance(source, PVDN) else ("",)


def part_of(source: FrameSource, name: str) -> FrameSource:
    """The frames of the sequence that `part_names` calls `name`."""
    if isinstance(source, Equipped):
        return Equipped(part_of(source.source, name), source.data)
    return source.only(name) if isinstance(source, PVDN) else source
