"""Night drives from physics: frames with exact labels, as another source beside the data sets.

A `Scene` says everything about a drive, `simulate` yields its frames, `simulate_dataset` writes many of them in PVDN's
layout, and `foreglow.datasets.simulated.read_truth` reads the truth beside it. Rendering needs the extra `sim`,
everything else does not.

>>> from foreglow.lab.simulation import Scene, draw_scenes
>>> Scene().num_frames
162
>>> draw_scenes(1, seed=7)[0] == draw_scenes(2, seed=7)[0]
True
"""

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
from foreglow.lab.simulation.scenes.scene import EGO_BEAMS, EgoBeam, LabelRule, Scene, read_scene, scene_to_toml
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
