"""Does the resident memory grow from frame to frame?"""

from __future__ import annotations

import gc
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from foreglow.types import Image

WARM_UP_FRAMES = 200


def resident_mib() -> float | None:
    """Memory that this process holds now, in MiB; None where the system does not tell."""
    statm = Path("/proc/self/statm")
    if not statm.is_file():
        return None
    pages = int(statm.read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def memory_growth(call: Callable[[Image], Any], image: Image, num_frames: int) -> dict[str, float | int | None]:
    """Resident memory before and after `num_frames` calls, once scratch memory has found its size.

    The frames are `image` shifted and mirrored eight ways, so that the numbers of blobs and boxes differ.
    """
    frames = [np.roll(turned, shift, axis=1) for turned in (image, image[::-1]) for shift in (0, 101, 402, 803)]
    for index in range(WARM_UP_FRAMES):
        call(frames[index % len(frames)])
    gc.collect()
    before = resident_mib()
    for index in range(num_frames):
        call(frames[index % len(frames)])
    gc.collect()
    after = resident_mib()
    growth = after - before if before is not None and after is not None else None
    return {"num_frames": num_frames, "before_mib": before, "after_mib": after, "growth_mib": growth}
