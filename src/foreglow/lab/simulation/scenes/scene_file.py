"""Scenes as TOML files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import tomli_w

from foreglow.config import read_toml, validated
from foreglow.files import checked_path
from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.types.arrays import check_kind


def read_scene(path: Path | str) -> Scene:
    """The scene in the TOML file `path`; fields that it does not mention have their defaults.

    Names of files in it are relative to its folder, and become absolute: what is written of the scene is read anywhere.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not TOML, a field is unknown or out of range, or a low beam is changed that the scene
            does not show, as of lamps in high beam; the message names path and field.
    """
    path = checked_path(path)
    scene = validated(Scene, read_toml(path), str(path))
    ego = scene.ego
    if ego.beam != "low":
        for name in ego.changed_low_beam:
            lamps = {"matrix": "the matrix lamps have a low beam of their own", "high": "the high beam has its own"}
            raise ValueError(
                f'{path}: ego.{name}: expected only with beam = "low": {lamps[ego.beam]}, got {getattr(ego, name)!r} '
                f'with beam = "{ego.beam}"'
            )
    for number, vehicle in enumerate(scene.vehicles):
        if vehicle.low_beam_file is not None and (vehicle.beam != "low" or vehicle.kind == "bicycle"):
            its = "a bicycle" if vehicle.kind == "bicycle" else f'beam = "{vehicle.beam}"'
            raise ValueError(
                f'{path}: vehicles.{number}.low_beam_file: expected only with beam = "low" of a vehicle that is no '
                f"bicycle, got {vehicle.low_beam_file!r} with {its}"
            )
    folder = path.parent.resolve()
    vehicles = tuple(vehicle.model_copy(update=_found(vehicle.low_beam_file, folder)) for vehicle in scene.vehicles)
    return scene.model_copy(
        update={"ego": ego.model_copy(update=_found(ego.low_beam_file, folder)), "vehicles": vehicles}
    )


def scene_to_toml(scene: Scene) -> str:
    """`scene` as TOML text that `read_scene` reads back equal; fields that are None are left out.

    Raises:
        ValueError: If the scene is none.
    """
    check_kind("scene", scene, Scene)
    fields: dict[str, Any] = scene.model_dump(exclude_none=True)
    return tomli_w.dumps(fields)


def _found(low_beam_file: str | None, folder: Path) -> dict[str, str]:
    return {} if low_beam_file is None else {"low_beam_file": str(folder / low_beam_file)}
