"""A small drive for closed loops: a car comes towards us, another drives ahead of us."""

from __future__ import annotations

import functools
from pathlib import Path

from foreglow.lab.simulation import Drive, DriveFrame, Scene, with_beam
from foreglow.lab.simulation.scenes.scene import CameraSpec, EgoSpec, RoadSpec, VehicleSpec
from foreglow.lab.simulation.scenes.surroundings import SurroundingsSpec, Verge
from foreglow.lab.simulation.writing.lidar import LidarConfig
from foreglow.lab.simulation.writing.scene_files import Making, SceneFile, write_scenes
from foreglow.lab.simulation.writing.street_data import StreetDataError

BARE = Verge(grass_per_m2=0.0, bank_m=0.0, ditch_m=0.0)
ONCOMING = VehicleSpec(timetable=((0.0, 150.0), (10.0, -50.0)))
AHEAD = VehicleSpec(lane="own", timetable=((0.0, 60.0), (10.0, 260.0)))


def scene(duration_s: float = 3 / 18, **changes: object) -> Scene:
    """A car comes towards us, another drives ahead of us; 160x120 pixels."""
    fields: dict[str, object] = {
        "duration_s": duration_s,
        "road": RoadSpec(length_m=300.0),
        "surroundings": SurroundingsSpec(left=BARE, right=BARE, delineator_spacing_m=0.0),
        "vehicles": (ONCOMING, AHEAD),
        "ego": EgoSpec(
            timetable=((0.0, 20.0), (10.0, 220.0)), brightness=1.2, yaw_aim_deg=0.4, pitch_aim_deg=-0.2, body_motion=1.0
        ),
        "camera": CameraSpec(width_px=160, height_px=120, focal_px=164.0),
    }
    return Scene(**(fields | changes))  # type: ignore[arg-type]


@functools.cache
def first_frame() -> DriveFrame:
    return next(iter(Drive(with_beam(scene(), "matrix"), "fast").frames()))


def write_scenes_of(folder: Path, *scenes: Scene) -> Path:
    """The `scenes.jsonl` in a folder of a split that has these scenes."""
    folder.mkdir(exist_ok=True)
    making = Making(generator="test", lidar=LidarConfig(), street=StreetDataError())
    files = [SceneFile(sequence=place, made_with=making, scene=one) for place, one in enumerate(scenes, start=1)]
    write_scenes(folder, files)
    return folder / "scenes.jsonl"
