"""Night drives from physics: frames with exact labels, as another source beside the data sets.

A `Scene` says everything about a drive, `simulate` yields its frames, `simulate_dataset` writes many of them in PVDN's
layout, and `foreglow.datasets.simulated.read_truth` reads the truth beside it. Rendering needs the extra `sim`,
everything else does not. Each name below is imported when it is first used, so that a command that needs only a part,
such as `run`, which looks up what camera its frames resemble, does not load the whole simulator.

>>> from foreglow.lab.simulation import Scene, draw_scenes
>>> Scene().num_frames
162
>>> draw_scenes(1, seed=7)[0] == draw_scenes(2, seed=7)[0]
True
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from foreglow.lab.simulation.drive import Drive, drive_exposures, drive_frames, side_by_side, simulate
    from foreglow.lab.simulation.drive_frame import DriveFrame
    from foreglow.lab.simulation.scenes.scenarios import (
        SCENARIOS,
        Split,
        adapted,
        draw_scenes,
        long_drives,
        resized,
        scenario,
        with_beam,
        without_traffic,
    )
    from foreglow.lab.simulation.scenes.scene import EGO_BEAMS, EgoBeam, LabelRule, Scene
    from foreglow.lab.simulation.scenes.scene_file import read_scene, scene_to_toml
    from foreglow.lab.simulation.writing.dataset import (
        DatasetConfig,
        DatasetSummary,
        Target,
        simulate_dataset,
        simulate_datasets,
    )

__all__ = [
    "EGO_BEAMS",
    "SCENARIOS",
    "DatasetConfig",
    "DatasetSummary",
    "Drive",
    "DriveFrame",
    "EgoBeam",
    "LabelRule",
    "Scene",
    "Split",
    "Target",
    "adapted",
    "draw_scenes",
    "drive_exposures",
    "drive_frames",
    "long_drives",
    "read_scene",
    "resized",
    "scenario",
    "scene_to_toml",
    "side_by_side",
    "simulate",
    "simulate_dataset",
    "simulate_datasets",
    "with_beam",
    "without_traffic",
]

_NAMES = {
    "drive": "Drive drive_exposures drive_frames side_by_side simulate",
    "drive_frame": "DriveFrame",
    "scenes.scenarios": "SCENARIOS Split adapted draw_scenes long_drives resized scenario with_beam without_traffic",
    "scenes.scene": "EGO_BEAMS EgoBeam LabelRule Scene",
    "scenes.scene_file": "read_scene scene_to_toml",
    "writing.dataset": "DatasetConfig DatasetSummary Target simulate_dataset simulate_datasets",
}
"""The names by the module that they are imported from."""

_HOMES = {name: f"{__name__}.{module}" for module, names in _NAMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    """Imports `name` from where it lives (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
