"""Sources of frames for the tests of the workers, apart from `tasks`, whose processes then start in no time."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator

from foreglow.datasets import PVDN
from foreglow.types import Frame


class DeadlySplit(PVDN):
    """A split that notes which sequences are begun, and whose second one ends the process that reads it first."""

    def __iter__(self) -> Iterator[Frame]:
        (name,) = self.directories
        notes = self.root / "begun"
        notes.mkdir(exist_ok=True)
        (notes / f"{name}-{time.monotonic_ns()}").touch()
        is_fatal = name == "S00002" and len(list(notes.glob(f"{name}-*"))) == 1
        for index, frame in enumerate(super().__iter__()):
            if is_fatal and index == 2:
                os.kill(os.getpid(), signal.SIGKILL)
            yield frame


class SlowSplit(PVDN):
    """A split whose frames take their time."""

    def __iter__(self) -> Iterator[Frame]:
        for frame in super().__iter__():
            yield frame
            time.sleep(0.2)
