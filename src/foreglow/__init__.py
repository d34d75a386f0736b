"""Foreglow: provident vehicle detection at night.

The names below are what a user needs; each is imported when it is first used, so that `import foreglow` is quick.

>>> import foreglow
>>> foreglow.preset("paper").proposals.gap_px
4
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from foreglow.config import PipelineConfig, preset, read_config
    from foreglow.datasets import PVDN, open_source
    from foreglow.lab.evaluation import BoxQuality, evaluate_boxes, evaluate_split
    from foreglow.pipeline import Pipeline
    from foreglow.types import Detections, Frame, FrameResult, Proposals

    __version__: str

__all__ = [
    "PVDN",
    "BoxQuality",
    "Detections",
    "Frame",
    "FrameResult",
    "Pipeline",
    "PipelineConfig",
    "Proposals",
    "__version__",
    "evaluate_boxes",
    "evaluate_split",
    "open_source",
    "preset",
    "propose",
    "read_config",
]

_HOMES = {
    "BoxQuality": "foreglow.lab.evaluation",
    "Detections": "foreglow.types",
    "Frame": "foreglow.types",
    "FrameResult": "foreglow.types",
    "Pipeline": "foreglow.pipeline",
    "PipelineConfig": "foreglow.config",
    "PVDN": "foreglow.datasets",
    "Proposals": "foreglow.types",
    "evaluate_boxes": "foreglow.lab.evaluation",
    "evaluate_split": "foreglow.lab.evaluation",
    "open_source": "foreglow.datasets",
    "preset": "foreglow.config",
    "read_config": "foreglow.config",
}


def propose(image: NDArray[Any], preset: str = "foreglow") -> NDArray[np.int32]:
    """Boxes in `image` that may hold a light artifact, sorted by y1, x1, y2, x2; (0, 4) where nothing stands out.

    Args:
        image: Grey (height, width) or colour R, G, B (height, width, 3): uint8, uint16, or float in [0, 1].
        preset: Name of the parameter set.

    Returns:
        Shape (N, 4), int32, half-open x1, y1, x2, y2 in pixels of `image`.

    Raises:
        ValueError: If the image is none of these, or there is no such preset.

    >>> import numpy as np
    >>> propose(np.zeros((96, 128), np.uint8)).shape
    (0, 4)
    """
    from foreglow import config
    from foreglow.datasets import to_grey
    from foreglow.proposals import make_proposer

    return make_proposer(config.preset(preset).proposals).propose(to_grey(image)).boxes_xyxy_px


def __getattr__(name: str) -> Any:
    """Imports `name` from where it lives (PEP 562)."""
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version("foreglow")
    if name not in _HOMES:
        raise AttributeError(f"module 'foreglow' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
