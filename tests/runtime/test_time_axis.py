"""One axis for the times of several sequences."""

from __future__ import annotations

import numpy as np

from foreglow.datasets.bags import PAUSE_NS
from foreglow.runtime.time_axis import TimeAxis
from foreglow.types import Frame

IMAGE = np.zeros((2, 2), np.uint8)


def test_sequences_follow_each_other() -> None:
    axis = TimeAxis()
    times = {"A": (7, 50), "B": (0, 50), "C": (10 * PAUSE_NS,)}
    found = [axis.time_ns(Frame(IMAGE, each, sequence=name)) for name, its in times.items() for each in its]
    assert found == [7, 50, 50 + PAUSE_NS, 100 + PAUSE_NS, 10 * PAUSE_NS]


def test_another_time_of_the_same_sequence() -> None:
    axis = TimeAxis()
    assert axis.within_sequence_ns(5) == 5
    for name in ("A", "B"):
        axis.time_ns(Frame(IMAGE, 100, sequence=name))
    assert axis.within_sequence_ns(130) == 130 + PAUSE_NS
