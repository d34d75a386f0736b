"""Night drives from physics: frames with exact labels, as another source beside the data sets.

A `Scene` says everything about a drive, `simulate` yields its frames, `simulate_dataset` writes many of them in PVDN's
layout, and `read_truth` reads back what was known. Rendering needs the extra `sim`, all else does not.

>>> from foreglow.lab.simulation import Scene, draw_scenes
>>> Scene().num_frames
162
>>> draw_scenes(1, seed=7)[0] == draw_scenes(2, seed=7)[0]
True
"""

from foreglow.lab.simulation.drive import Drive, drive_frames, simulate
from foreglow.lab.simulation.scenes.scenarios import (
    SCENARIOS,
    Split,
    adapted,
    draw_scenes,
    resized,
    scenario,
    with_beam,
    without_traffic,
)
from foreglow.lab.simulation.scenes.scene import EGO_BEAMS, EgoBeam, LabelRule, Scene, read_scene, scene_to_toml
from foreglow.lab.simulation.truth import Artifact, DriveFrame, LampTruth, VehicleTruth
from foreglow.lab.simulation.writing.dataset import DatasetConfig, DatasetSummary, simulate_dataset
from foreglow.lab.simulation.writing.truth_files import SimulatedTruth, read_truth

__all__ = [
    "EGO_BEAMS",
    "SCENARIOS",
    "Artifact",
    "DatasetConfig",
    "DatasetSummary",
    "Drive",
    "DriveFrame",
    "EgoBeam",
    "LabelRule",
    "LampTruth",
    "Scene",
    "SimulatedTruth",
    "Split",
    "VehicleTruth",
    "adapted",
    "draw_scenes",
    "drive_frames",
    "read_scene",
    "read_truth",
    "resized",
    "scenario",
    "scene_to_toml",
    "simulate",
    "simulate_dataset",
    "with_beam",
    "without_traffic",
]
