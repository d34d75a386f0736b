"""Scene files of the user, checked as a whole: our drive is on the map, others on their roads, and not in our place."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from foreglow.lab.simulation.scenes.assembly import is_in_ours
from foreglow.lab.simulation.scenes.lamp_files import lamp_files
from foreglow.lab.simulation.scenes.scenarios import with_beam
from foreglow.lab.simulation.scenes.scene import EgoBeam, Scene
from foreglow.lab.simulation.scenes.scene_file import read_scene
from foreglow.lab.simulation.world.road import interpolated
from foreglow.lab.simulation.writing.street_data import check_ego_on_map
from foreglow.photometry import read_ies
from foreglow.wording import UnusedWarning


def read_drivable(path: Path) -> Scene:
    """The scene in the TOML file `path`, in which each vehicle is on its road for a part of the drive at least.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is no scene, our own drive leaves the map, another vehicle is never on its road or is where we
            are, or the file of a low beam is missing or broken; the message names path and field.
    """
    scene = read_scene(path)
    check_ego_on_map(scene, str(path))
    _check_low_beams(scene, path)
    times_s = np.array([scene.time_s(number) for number in range(scene.num_frames)])
    for index, vehicle in enumerate(scene.vehicles):
        road = scene.road.branches[vehicle.branch] if vehicle.lane == "branch" else scene.road
        arc_lengths_m, _ = interpolated(vehicle.timetable, times_s)
        if not ((arc_lengths_m > 0.0) & (arc_lengths_m < road.length_m)).any():
            raise ValueError(
                f"{path}: vehicles.{index}.timetable: expected arc lengths on its road, 0 to {road.length_m:g} m, at "
                f"some time of the drive, got {arc_lengths_m.min():g} to {arc_lengths_m.max():g} m"
            )
        if vehicle.lane != "branch" and (hits := is_in_ours(vehicle, scene.ego, scene.road, times_s)).any():
            raise ValueError(
                f"{path}: vehicles.{index}: expected a vehicle beside ours, before or behind it, but at "
                f"{times_s[hits.argmax()]:.4g} s both are at {arc_lengths_m[hits.argmax()]:.4g} m along the road"
            )
    return scene


def with_beam_of(scene: Scene, beam: EgoBeam, path: Path) -> Scene:
    """As `with_beam`, with a warning if the scene at `path` says of our low beam what is not seen with `beam`.

    Raises:
        ValueError: If there is no such beam.
    """
    changed = with_beam(scene, beam)
    lost = [name for name in scene.ego.changed_low_beam if name not in changed.ego.changed_low_beam]
    if lost:
        fields = ", ".join(f"ego.{name}" for name in lost)
        words = f'{path}: {fields}: left out, as only beam = "low" shows it, and the beam is {beam} here'
        warnings.warn(UnusedWarning(words), stacklevel=2)
    return changed


def _check_low_beams(scene: Scene, path: Path) -> None:
    for field, file in lamp_files(scene).items():
        try:
            read_ies(file)
        except (OSError, ValueError) as error:
            raise ValueError(f"{path}: {field}: {error}") from error
