"""Memory that is free goes back to the system."""

from __future__ import annotations

import sys

import pytest

from benchmarks.memory import resident_mib
from foreglow.runtime.memory import release_memory


@pytest.mark.skipif(sys.platform != "linux", reason="needs glibc")
def test_free_memory_between_blocks_in_use_is_released() -> None:
    blocks = [bytes(2000) for _ in range(50_000)]
    kept = blocks[::100]
    del blocks
    before_mib = resident_mib()
    release_memory()
    after_mib = resident_mib()
    assert before_mib is not None
    assert after_mib is not None
    assert after_mib < before_mib - 50
    assert len(kept) == 500
