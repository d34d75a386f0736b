"""Scenes as TOML files."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import tomli_w

from foreglow.config import read_toml, validated
from foreglow.files import checked_path
from foreglow.lab.simulation.scenes.scene import Scene, VehicleSpec
from foreglow.lab.simulation.scenes.surroundings import SpecModel
from foreglow.types.arrays import check_kind


def read_scene(path: Path | str) -> Scene:
    """The scene in the TOML file `path`; fields that it does not mention have their defaults.

    Names of files in it are relative to its folder, and become absolute: what is written of the scene is read anywhere.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not TOML, a field is unknown or out of range, or one has a value that is not seen in the
            scene, such as the low beam of lamps in high beam; the message names path and field.
    """
    path = checked_path(path)
    scene = validated(Scene, read_toml(path), str(path))
    for unused in _without_effect(scene):
        with_what = f" with {unused.beside}" if unused.beside else ""
        raise ValueError(f"{path}: {unused.field}: expected {unused.expected}, got {unused.value!r}{with_what}")
    ego = scene.ego
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


class _Unused(NamedTuple):
    """A field that says something of which nothing is seen, when it would be seen, and beside what it is not."""

    field: str
    value: object
    expected: str
    beside: str = ""


def _without_effect(scene: Scene) -> Iterator[_Unused]:
    road, ego = scene.road, scene.ego
    if road.median == "none" and _is_changed(road, "barrier_m"):
        yield _Unused("road.barrier_m", road.barrier_m, 'only with median = "barrier"', 'median = "none"')
    if road.median_m == 0 and _is_changed(road, "edge_line_m"):
        yield _Unused("road.edge_line_m", road.edge_line_m, "only with a median_m above 0", "median_m = 0")
    for kind in ("rails", "walls", "woods"):
        for number, thing in enumerate(getattr(scene.surroundings, kind)):
            if thing.span_m[0] >= road.length_m or thing.span_m[1] <= 0:
                field = f"surroundings.{kind}.{number}.span_m"
                yield _Unused(field, thing.span_m, f"a part of the road, 0 to {road.length_m:g} m")
    if ego.beam != "low":
        lamps = {"matrix": "the matrix lamps have a low beam of their own", "high": "the high beam has its own"}
        for name in ego.changed_low_beam:
            expected = f'only with beam = "low": {lamps[ego.beam]}'
            yield _Unused(f"ego.{name}", getattr(ego, name), expected, f'beam = "{ego.beam}"')
    for number, vehicle in enumerate(scene.vehicles):
        for name, expected, beside in _without_effect_of(vehicle):
            yield _Unused(f"vehicles.{number}.{name}", getattr(vehicle, name), expected, beside)


def _without_effect_of(vehicle: VehicleSpec) -> Iterator[tuple[str, str, str]]:
    """As `_without_effect`, without the values."""
    is_parked, lane = vehicle.lane.startswith("parked"), f'lane = "{vehicle.lane}"'
    is_bicycle, beam = vehicle.kind == "bicycle", f'beam = "{vehicle.beam}"'
    its = "a bicycle" if is_bicycle else beam
    steps_m = [after_m - before_m for (_, before_m), (_, after_m) in itertools.pairwise(vehicle.timetable)]
    if vehicle.lane != "branch" and vehicle.branch:
        yield "branch", 'only with lane = "branch"', lane
    if vehicle.lane in ("oncoming", "own") and not vehicle.is_towards:
        yield "is_towards", "only of a vehicle that is parked or on a branch", lane
    if vehicle.lane_number is not None and (is_parked or vehicle.lateral_m is not None):
        yield "lane_number", "only in a lane, and without lateral_m", lane if is_parked else "lateral_m"
    if is_bicycle and vehicle.beam == "high":
        yield "beam", "low or off", its
    if vehicle.brakes_s and (is_bicycle or vehicle.beam == "off"):
        yield "brakes_s", "only of a vehicle with brake lamps that has its lamps on", its
    if vehicle.low_beam_file is not None and (is_bicycle or vehicle.beam != "low"):
        yield "low_beam_file", 'only with beam = "low" of a vehicle that is no bicycle', its
    if is_parked and any(steps_m):
        yield "timetable", "a single place, such as [[0.0, 80.0]]", lane
    if vehicle.lane == "oncoming" and any(step_m > 0 for step_m in steps_m):
        yield "timetable", "falling arc lengths, as it comes towards us", lane
    if vehicle.lane == "own" and any(step_m < 0 for step_m in steps_m):
        yield "timetable", "growing arc lengths, as it drives in our direction", lane


def _is_changed(part: SpecModel, name: str) -> bool:
    return bool(getattr(part, name) != type(part).model_fields[name].default)


def _found(low_beam_file: str | None, folder: Path) -> dict[str, str]:
    return {} if low_beam_file is None else {"low_beam_file": str(folder / low_beam_file)}
