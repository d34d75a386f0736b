"""Live faults at moments of their own: low beam within two frames, and light again when all is well."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.soak import ALL_FAULTS

NUM_FRAMES = 200
"""Four drives: the first is without a fault, the last, too. A stuck part is known after the first second of a drive."""

FAULT_PROBES = tuple(f"{fault}, {k}" for fault in ALL_FAULTS for k in range(2))


def live_fault(name: str, folder: Path) -> Callable[[], int]:  # noqa: ARG001
    """A function that plays the drive that ships with the fault in it, and says whether low beam came in time."""
    fault, again = name.rsplit(", ", 1)
    return functools.partial(_played, fault, int(again))


def _played(fault: str, again: int) -> int:
    from benchmarks.soak import measure

    first = 20 + int(np.random.default_rng([again, len(fault)]).integers(10))
    figures = measure(NUM_FRAMES, 1, faults=[fault], first=first)
    print(figures["first_low"], figures["wrong"])
    return 0 if fault in figures["first_low"] and not figures["wrong"] else 1
