"""The libraries that train and run YOLOs, by name."""

from __future__ import annotations

from foreglow.lab.learning.yolo.interface import Backend
from foreglow.lab.learning.yolo.libre import LibreBackend
from foreglow.lab.learning.yolo.ultralytics import UltralyticsBackend

BACKENDS: dict[str, type[LibreBackend] | type[UltralyticsBackend]] = {
    "libreyolo": LibreBackend,
    "ultralytics": UltralyticsBackend,
}


def make_backend(name: str) -> Backend:
    """The back end called `name`.

    Raises:
        ValueError: If there is none; the message lists those that exist.
    """
    if name not in BACKENDS:
        raise ValueError(f"backend: expected one of {', '.join(BACKENDS)}, got {name!r}")
    return BACKENDS[name]()
