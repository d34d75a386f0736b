"""The specification of each scene beside its images: `scene.json`, `scenes.jsonl` and the road that follows from it.

`foreglow.datasets.simulated` lists all files; those here are the files that only the simulator understands.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, SerializerFunctionWrapHandler, field_validator, model_serializer

from foreglow.config import FrozenModel
from foreglow.datasets.json_files import read_json, read_json_lines
from foreglow.datasets.pvdn.schema import Id
from foreglow.datasets.simulated import SequenceTruth
from foreglow.datasets.simulated.files import RoadFile
from foreglow.lab.simulation.camera.profile import CameraProfile
from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.lab.simulation.variants import Variant
from foreglow.lab.simulation.world.road import Road
from foreglow.lab.simulation.writing.lidar import LidarConfig
from foreglow.lab.simulation.writing.street_data import StreetDataError
from foreglow.whole_files import write_atomic


class Making(FrozenModel):
    """What a scene's files depend on, beside the scene itself.

    Attributes:
        generator: Name and version of the program; part of it must change when the same scene gives other bytes.
        lidar: The scanner of the depth images.
        street: How wrong the street messages are.
        camera: The profile of the camera; None, and left out, for the scene's own.
        presets: Presets in whose proposals the light is told apart; left out if there are none.
    """

    generator: str
    lidar: LidarConfig = LidarConfig()
    street: StreetDataError = StreetDataError()
    camera: CameraProfile | None = None
    presets: tuple[str, ...] = ()

    @model_serializer(mode="wrap")
    def _without_none(self, written: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return _without(written(self), "camera", "presets")

    @field_validator("presets", mode="before")
    @classmethod
    def _as_tuple(cls, presets: Any) -> Any:
        return tuple(presets) if isinstance(presets, list) else presets


class SceneFile(FrozenModel):
    """`scene.json`.

    Attributes:
        variant: Left out for the scene as it is.
        lamps: SHA-256 of the files that the scene names, by field; left out if there are none, as in earlier files.
    """

    sequence: Id
    made_with: Making
    scene: Scene
    variant: Variant | None = None
    lamps: dict[str, str] = Field(default_factory=dict)

    @model_serializer(mode="wrap")
    def _without_none(self, written: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return _without(written(self), "variant", "lamps")


def _without(fields: dict[str, Any], *names: str) -> dict[str, Any]:
    """`fields` without those called `names` that say nothing, as files were before there were such fields."""
    return {key: value for key, value in fields.items() if key not in names or value}


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
