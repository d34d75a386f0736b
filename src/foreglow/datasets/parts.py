"""The sequences of a source, each as a source that can be run separately."""

from __future__ import annotations

from foreglow.datasets.labelled import LabelledSource
from foreglow.datasets.source import FrameSource
from foreglow.datasets.vehicle_data import Equipped


def part_names(source: FrameSource) -> tuple[str, ...]:
    """Names of the sequences in the order of their frames; a single empty name for a source without sequences."""
    if isinstance(source, Equipped):
        return part_names(source.source)
    return source.directories if isinstance(source, LabelledSource) else ("",)


def part_of(source: FrameSource, name: str) -> FrameSource:
    """The frames of the sequence that `part_names` calls `name`."""
    if isinstance(source, Equipped):
        return Equipped(part_of(source.source, name), source.data)
    return source.only(name) if isinstance(source, LabelledSource) else source
