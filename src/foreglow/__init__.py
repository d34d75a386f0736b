"""Foreglow: provident vehicle detection at night.

The names below are what a user needs; each is imported when it is first used, so that `import foreglow` is quick.

>>> import foreglow
>>> foreglow.preset("paper").proposals.gap_px
4
"""

from __future__ import annotations

import functools
import importlib
import threading
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from foreglow.beam import BeamPolicy
    from foreglow.config import PipelineConfig, preset, read_config
    from foreglow.datasets import PVDN, open_source, read_image, red_chroma, to_grey
    from foreglow.distance import RangeEstimator
    from foreglow.geometry import Camera
    from foreglow.lab import simulation
    from foreglow.lab.evaluation import BoxQuality, evaluate_boxes, evaluate_split
    from foreglow.lab.simulation import simulate
    from foreglow.pipeline import Pipeline
    from foreglow.proposals import Proposer
    from foreglow.runs.predictions import Predictions
    from foreglow.runs.recorded_run import RecordedRun, read_run
    from foreglow.tracking import Tracker
    from foreglow.types import (
        BeamCommand,
        BeamMode,
        Detections,
        EgoMotion,
        Frame,
        FrameResult,
        Proposals,
        Ranges,
        RoadAhead,
        Tracks,
        TrackState,
        Vehicles,
    )

    __version__: str

__all__ = [
    "PVDN",
    "BeamCommand",
    "BeamMode",
    "BeamPolicy",
    "BoxQuality",
    "Camera",
    "Detections",
    "EgoMotion",
    "Frame",
    "FrameResult",
    "Pipeline",
    "PipelineConfig",
    "Predictions",
    "Proposals",
    "RangeEstimator",
    "Ranges",
    "RecordedRun",
    "RoadAhead",
    "TrackState",
    "Tracker",
    "Tracks",
    "Vehicles",
    "__version__",
    "evaluate_boxes",
    "evaluate_split",
    "open_source",
    "preset",
    "propose",
    "read_config",
    "read_image",
    "read_run",
    "red_chroma",
    "simulate",
    "simulation",
    "to_grey",
]

_NAMES = {
    "beam": "BeamPolicy",
    "config": "PipelineConfig preset read_config",
    "datasets": "PVDN open_source read_image red_chroma to_grey",
    "distance": "RangeEstimator",
    "geometry": "Camera",
    "lab.evaluation": "BoxQuality evaluate_boxes evaluate_split",
    "lab.simulation": "simulate",
    "pipeline": "Pipeline",
    "runs.predictions": "Predictions",
    "runs.recorded_run": "RecordedRun read_run",
    "tracking": "Tracker",
    "types": (
        "BeamCommand BeamMode Detections EgoMotion Frame FrameResult Proposals Ranges RoadAhead Tracks TrackState "
        "Vehicles"
    ),
}
"""The public names by the module that they are imported from."""

_HOMES = {name: f"foreglow.{module}" for module, names in _NAMES.items() for name in names.split()}


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
    from foreglow.config import PRESETS
    from foreglow.datasets import to_grey
    from foreglow.wording import check_one_of

    check_one_of(preset, PRESETS, "preset")
    return _proposer(preset, threading.get_ident()).propose(to_grey(image)).boxes_xyxy_px


@functools.lru_cache(maxsize=16)
def _proposer(preset: str, thread: int) -> Proposer:  # noqa: ARG001 - each thread has its own
    """The proposer of a preset, kept from call to call with its scratch memory."""
    from foreglow import config
    from foreglow.proposals import make_proposer

    return make_proposer(config.preset(preset).proposals)


def __getattr__(name: str) -> Any:
    """Imports `name` from where it lives (PEP 562)."""
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version("foreglow")
    if name == "simulation":  # where the package was in 0.1.0
        return importlib.import_module("foreglow.lab.simulation")
    if name not in _HOMES:
        raise AttributeError(f"module 'foreglow' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
