"""Drives like those of PVDN's real frames, one frame of each: `python -m benchmarks.pvdn_scenes FOLDER`.

Nine frames of the long exposure on a wet road through a wood, in snowfall, go into `FOLDER/night`, as the camera
profile `pvdn_night` has them, and three of the short one on a dry road into `FOLDER/day`, as `pvdn_day` has them. Each
is drawn from its number alone, and is what the camera sees two seconds into the drive.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import cv2

from benchmarks.timing import CONSOLE
from foreglow.lab.simulation.camera.profile import read_profile
from foreglow.lab.simulation.drive import drive_exposures
from foreglow.lab.simulation.scenes.courses import Course
from foreglow.lab.simulation.scenes.draw import Draw, draw_camera, draw_sensor
from foreglow.lab.simulation.scenes.planning import draw_road
from foreglow.lab.simulation.scenes.scene import EgoSpec, Scene, VehicleSpec, WeatherSpec
from foreglow.lab.simulation.scenes.surroundings import Rail, Sign, SurroundingsSpec, Verge, Wall, Woods
from foreglow.whole_files import write_atomic

NUM_NIGHT, NUM_DAY = 9, 3
TIME_S = 2.0
LENGTH_M = 520.0
START_M = 20.0
SNOW_STREAM, DRY_STREAM = 77, 78


def snowfall(number: int) -> Scene:
    """A drive on a wet road through a wood in snowfall, with snow on the verges and on our own lamps."""
    draw = Draw(number, SNOW_STREAM)
    speed_mps = draw.uniform(12.0, 17.0)
    focus_m = START_M + 3.0 * speed_mps + draw.uniform(50.0, 140.0)
    kind = draw.choice(["crest", "bend", "straight"])
    rise_m = draw.uniform(1.5, 3.5) if kind == "crest" else draw.uniform(-1.5, 3.0)
    beyond_m = draw.uniform(-1.0, 1.0) if kind == "crest" else rise_m + draw.uniform(-1.0, 1.0)
    radius_m = draw.log_uniform(120.0, 400.0) if kind == "bend" else draw.log_uniform(500.0, 1500.0)
    bend = (focus_m - 60.0, focus_m + 100.0, draw.choice([-1.0, -1.0, 1.0]) / radius_m)
    course = Course(
        bends=() if kind == "straight" else (bend,),
        elevation_m=((0.0, 0.0), (focus_m - 100.0, 0.0), (focus_m, rise_m), (focus_m + 110.0, beyond_m)),
    )
    woods = tuple(
        Woods(
            side=side,
            span_m=(0.0 if draw.chance(0.7) else draw.uniform(20.0, 120.0), LENGTH_M),
            leaves=0.0,
            offset_m=draw.uniform(3.0, 9.0),
            spacing_m=draw.uniform(3.0, 4.5),
            height_m=draw.uniform(14.0, 24.0),
            has_undergrowth=draw.chance(0.6),
        )
        for side in ("left", "right")
        if draw.chance(0.85)
    )
    rail = Rail(side="right", span_m=(0.0, focus_m + draw.uniform(0.0, 80.0)), offset_m=draw.uniform(0.6, 1.0))
    sign = Sign(
        side=draw.choice(["left", "right"]),
        s_m=draw.uniform(70.0, 200.0),
        kind=draw.choice(["rectangle", "rectangle", "triangle", "round"]),
        size_m=draw.uniform(0.6, 1.0),
    )
    road = draw_road(draw, course, LENGTH_M, draw.uniform(0.9, 1.0))
    return Scene(
        name="snowfall",
        seed=number,
        duration_s=2.0 * TIME_S,
        rate_hz=1.0 / TIME_S,
        road=road.model_copy(update={"has_edge_marking": True, "wear": draw.uniform(0.1, 0.5)}),
        surroundings=SurroundingsSpec(
            left=_snowy_verge(draw, draw.uniform(0.5, 3.0)),
            right=_snowy_verge(draw, draw.uniform(-1.5, 0.6)),
            rails=(rail,) if draw.chance(0.6) else (),
            woods=woods,
            signs=(sign,) if draw.chance(0.5) else (),
            delineator_spacing_m=draw.choice([25.0, 50.0]),
        ),
        vehicles=_oncoming(draw, speed_mps) if draw.chance(0.85) else (),
        ego=EgoSpec(
            timetable=((0.0, START_M), (10.0, START_M + 10.0 * speed_mps)),
            brightness=draw.log_uniform(0.2, 0.28),
            stray=draw.log_uniform(30.0, 45.0),
            yaw_aim_deg=draw.normal(4.0, 0.4),
            pitch_aim_deg=draw.normal(0.1, 0.2),
        ),
        weather=WeatherSpec(
            scattering_per_m=draw.log_uniform(3e-3, 6e-3),
            asymmetry=0.6,
            snow_mm_h=draw.log_uniform(0.8, 3.0),
            sky_cd_m2=draw.log_uniform(2e-2, 4e-2),
        ),
        camera=draw_camera(draw).model_copy(update={"pitch_deg": draw.normal(1.2, 0.4)}),
        sensor=draw_sensor(draw).model_copy(
            update={
                "grey_per_cd_m2": 50.0,
                "night_gain": draw.log_uniform(7.5, 9.5),
                "black_level": draw.normal(8.5, 0.5),
                "column_noise": draw.uniform(0.6, 0.75),
            }
        ),
    )


def dry_bend(number: int) -> Scene:
    """A drive into a bend to the right on a worn, dry road, with a chevron on its outer side."""
    draw = Draw(number, DRY_STREAM)
    speed_mps = draw.uniform(12.0, 20.0)
    focus_m = START_M + TIME_S * speed_mps + draw.uniform(5.0, 30.0)
    bend = (focus_m - 30.0, focus_m + 160.0, -1.0 / draw.log_uniform(70.0, 160.0))
    course = Course(bends=(bend,), elevation_m=((0.0, 0.0), (focus_m + 60.0, draw.uniform(-1.0, 1.5))))
    road = draw_road(draw, course, LENGTH_M, 0.0)
    rail = Rail(side="right", span_m=(focus_m + 5.0, focus_m + 160.0), offset_m=draw.uniform(0.7, 1.2))
    wall_m = focus_m + draw.uniform(-30.0, 10.0)
    wall = Wall(side="left", span_m=(wall_m, wall_m + 60.0), offset_m=draw.uniform(2.0, 5.0), height_m=1.2)
    chevron = Sign(side="left", s_m=focus_m + draw.uniform(0.0, 30.0), kind="chevron_right", height_m=1.0, size_m=0.8)
    # The black of three real frames, and of the lossless one.
    black_grey = 7.6 if number % NUM_DAY == 0 else draw.normal(2.8, 0.2)
    verge = Verge(bank_m=draw.uniform(-0.5, 0.5), grass_per_m2=draw.uniform(10.0, 30.0))
    return Scene(
        name="dry_bend",
        seed=number,
        duration_s=2.0 * TIME_S,
        rate_hz=1.0 / TIME_S,
        road=road.model_copy(
            update={"centre_marking": "dashed", "has_edge_marking": True, "wear": draw.uniform(0.7, 1.0)}
        ),
        surroundings=SurroundingsSpec(
            left=verge,
            right=verge,
            rails=(rail,) if draw.chance(0.7) else (),
            walls=(wall,) if draw.chance(0.4) else (),
            signs=(chevron,),
        ),
        vehicles=_oncoming(draw, speed_mps) if draw.chance(0.5) else (),
        ego=EgoSpec(
            timetable=((0.0, START_M), (10.0, START_M + 10.0 * speed_mps)),
            brightness=draw.uniform(1.5, 1.8),
            carpet=0.86,
        ),
        camera=draw_camera(draw).model_copy(update={"pitch_deg": draw.normal(1.2, 0.4)}),
        sensor=draw_sensor(draw).model_copy(update={"grey_per_cd_m2": 50.0, "black_level": black_grey}),
    )


def _snowy_verge(draw: Draw, bank_m: float) -> Verge:
    return Verge(
        bank_m=bank_m,
        bank_offset_m=draw.uniform(1.0, 2.5),
        ditch_m=draw.choice([0.0, 0.2]),
        snow=draw.choice([1.0, 1.0, 0.9]),
        grass_per_m2=60.0,
    )


def _oncoming(draw: Draw, speed_mps: float) -> tuple[VehicleSpec, ...]:
    """A car that meets us four to eight seconds after the begin."""
    meeting_s, other_mps = draw.uniform(4.0, 8.0), draw.uniform(14.0, 22.0)
    begin_m = START_M + meeting_s * (speed_mps + other_mps)
    timetable = ((0.0, begin_m), (10.0, begin_m - 10.0 * other_mps))
    aim_deg = draw.normal(-0.3, 0.2)
    return (VehicleSpec(timetable=timetable, brightness=draw.log_uniform(0.6, 1.2), pitch_aim_deg=aim_deg),)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--first", type=int, default=1, help="number of the first drive of either kind")
    given = parser.parse_args(arguments)
    for cycle, drawn, num in (("night", snowfall, NUM_NIGHT), ("day", dry_bend, NUM_DAY)):
        folder = given.folder / cycle
        folder.mkdir(parents=True, exist_ok=True)
        for number in range(given.first, given.first + num):
            _, (shown,) = drive_exposures(drawn(number), [read_profile(f"pvdn_{cycle}")])
            path = folder / f"{number:04d}.png"
            write_atomic(path, cv2.imencode(".png", shown.frame.image)[1].tobytes())
            CONSOLE.print(str(path))


if __name__ == "__main__":
    main()
