"""Keeps Python's garbage collector from interrupting a real-time loop, and memory from growing over days."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def settled_memory() -> Iterator[None]:
    """While entered, garbage collection skips all objects that existed before, which would take longer than a frame."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def release_memory() -> None:
    """Gives memory that is free back to the system; takes milliseconds.

    The C library keeps it for later, in pieces, for each thread: a hundred pipelines, one after the other, leave tens
    of MiB.
    """
    gc.collect()
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # of glibc
        if trim is not None:
            trim(0)
