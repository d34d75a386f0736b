"""The specification of each scene beside its images: `scene.json`, `scenes.jsonl` and the road that follows from it.

`foreglow.datasets.simulated` lists all files; those here are the files that only the simulator understands.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from foreglow.config import FrozenModel
from foreglow.datasets.json_files import read_json, read_json_lines
from foreglow.datasets.pvdn.schema import Id
from foreglow.datasets.simulated import SequenceTruth
from foreglow.datasets.simulated.files import RoadFile
from foreglow.files import write_atomic
from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.lab.simulation.world.road import Road
from foreglow.lab.simulation.writing.lidar import LidarConfig
from foreglow.lab.simulation.writing.street_data import StreetDataError


class Making(FrozenModel):
    """What a scene's files depend on, beside the scene itself.

    Attributes:
        generator: Name and version of the program; part of it must change when the same scene gives other bytes.
        lidar: The scanner of the depth images.
        street: How wrong the street messages are.
    """

    generator: str
    lidar: LidarConfig = LidarConfig()
    street: StreetDataError = StreetDataError()


class SceneFile(FrozenModel):
    """`scene.json`."""

    sequence: Id
    made_with: Making
    scene: Scene


class _SceneLine(FrozenModel):
    """A line of `scenes.jsonl`."""

    sequence: Id
    scene: Scene


def scene_of(truth: SequenceTruth) -> Scene:
    """The scene from which a sequence was driven.

    Raises:
        ValueError: If its `scene.json` is broken.
    """
    return read_json(truth.root / "scene.json", SceneFile).scene


def write_scenes(root: Path, files: list[SceneFile]) -> None:
    """Writes `scenes.jsonl`: number and specification of each scene, a line each.

    Raises:
        OSError: If that fails.
    """
    lines = [json.dumps({"sequence": file.sequence, "scene": file.scene.model_dump(mode="json")}) for file in files]
    write_atomic(root / "scenes.jsonl", ("\n".join(lines) + "\n").encode())


def read_scenes(path: Path) -> tuple[tuple[int, Scene], ...]:
    """Numbers and specifications of the scenes in a `scenes.jsonl`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it holds no scene or a line is broken; the message names path, line and field.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; expected the scenes.jsonl of a simulated split")
    scenes = tuple((line.sequence, line.scene) for _, line in read_json_lines(path, _SceneLine))
    if not scenes:
        raise ValueError(f"{path}: expected at least one scene, found none")
    return scenes


def road_file(scene: Scene) -> RoadFile:
    """The main road's centre line, each metre."""
    road = Road(scene.road)
    arc_lengths_m = np.arange(0.0, road.length_m + 0.5)
    return RoadFile(
        lane_width_m=scene.road.lane_width_m,
        s_m=tuple(arc_lengths_m.tolist()),
        points_world_m=tuple((x, y, z) for x, y, z in road.points(arc_lengths_m).round(4).tolist()),
    )
