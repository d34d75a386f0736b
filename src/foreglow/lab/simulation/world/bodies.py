"""Vehicles' bodies: shapes with lamps, in the vehicle's frame (x forward, y left, z up, origin under the rear axle).

`bodies.toml` describes each kind of vehicle as a list of parts; here is how each shape of a part becomes triangles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from foreglow.config import read_toml
from foreglow.geometry import Floats
from foreglow.lab.simulation.world.materials import material_number
from foreglow.lab.simulation.world.mesh import Mesh, box, joined, loft, tubes

SHIPPED = Path(__file__).with_name("bodies.toml")

LampFunction: TypeAlias = Literal[
    "low", "high", "front_marker", "side_marker", "rear", "rear_marker", "brake", "centre_brake"
]

REAR_FUNCTIONS: frozenset[LampFunction] = frozenset({"rear", "rear_marker", "brake", "centre_brake"})
"""Lamps that shine backwards."""

BRAKE_FUNCTIONS: frozenset[LampFunction] = frozenset({"brake", "centre_brake"})
MARKER_FUNCTIONS: frozenset[LampFunction] = frozenset({"front_marker", "side_marker", "rear_marker"})
"""Lamps of a few candela that show how wide, high and long a vehicle is; what they light is too dark to be seen."""

Rows: TypeAlias = list[list[float]]

NUM_CORNERS = 32
"""Points around a body's cross-section."""

LAMP_GAP_M = 0.02
"""Distance from the body's shell to a lamp's disc, so that the shell does not hide the lamp."""


@dataclass(frozen=True, slots=True)
class LampMount:
    """The mount of a lamp, whose axis points along x, backwards for rear lamps, or outwards for side markers.

    Attributes:
        name: A name such as `low_left`.
        function: The beam that it belongs to, or what else it is for.
        position_m: Position in the vehicle's frame, just outside the body.
        radius_m: Radius of its disc.
        face_m: Width and height of a face that shines evenly, in which the disc is; (0, 0) for the disc alone.
    """

    name: str
    function: LampFunction
    position_m: tuple[float, float, float]
    radius_m: float
    face_m: tuple[float, float] = (0.0, 0.0)

    @property
    def yaw_rad(self) -> float:
        """Direction of its axis, to the left of the vehicle's x."""
        if self.function == "side_marker":
            return float(np.copysign(np.pi / 2, self.position_m[1]))
        return np.pi if self.function in REAR_FUNCTIONS else 0.0


@dataclass(frozen=True, eq=False)
class Body:
    """A kind of vehicle.

    Attributes:
        kind: A kind of vehicle, as scenes call it.
        mesh: Mesh in the vehicle's frame, with dark paint.
        lamps: Mounts of its lamps.
        size_m: Length, width and height of the box around it.
        box_centre_m: Centre of that box in the vehicle's frame.
        wheelbase_m: From the rear axle to the front axle.
        eye_m: The driver's eye in the vehicle's frame.
    """

    kind: str
    mesh: Mesh
    lamps: tuple[LampMount, ...]
    size_m: tuple[float, float, float]
    box_centre_m: tuple[float, float, float]
    wheelbase_m: float
    eye_m: tuple[float, float, float]

    def painted(self, is_light: bool) -> Mesh:
        """The mesh with light or dark paint."""
        return self._light_mesh if is_light else self.mesh

    @cached_property
    def _light_mesh(self) -> Mesh:
        is_paint = self.mesh.materials == material_number("paint_dark")
        paint = np.where(is_paint, material_number("paint_light"), self.mesh.materials)
        return replace(self.mesh, materials=paint.astype(np.uint8))


def _sections(stations: Floats, roundness: float) -> Floats:
    """Closed rounded sections, shape (S, NUM_CORNERS, 3), from rows of (x, half width, lower z, upper z).

    The sections are superellipses of the exponent `roundness`: 2 is an ellipse, more is more of a box.
    """
    angles = (np.arange(NUM_CORNERS) + 0.5) * (2 * np.pi / NUM_CORNERS)
    cosine, sine = np.cos(angles), np.sin(angles)
    across = np.sign(cosine) * np.abs(cosine) ** (2 / roundness)
    up = np.sign(sine) * np.abs(sine) ** (2 / roundness)
    x, width, low, high = (column[:, None] for column in stations.T)
    return np.stack(np.broadcast_arrays(x, width * across, (low + high) / 2 + (high - low) / 2 * up), -1)


def _shell(stations: Rows, material: str, roundness: float) -> Mesh:
    return loft(_sections(np.array(stations), roundness), material_number(material))


def _cabin(stations: Rows, has_roof: bool) -> Mesh:
    """A greenhouse of glass whose sides lean in towards the roof; the roof and the rear pillars are painted."""
    table = np.array(stations)
    sections = _sections(table, 7.0)
    low, high = table[:, 2, None], table[:, 3, None]
    height = (sections[..., 2] - low) / np.maximum(high - low, 1e-6)
    sections[..., 1] *= 1.0 - 0.24 * np.clip(height, 0, 1) ** 1.5
    mesh = loft(sections, material_number("glass"))
    if not has_roof:
        return mesh
    is_top = table[:, 3] > 0.93 * table[:, 3].max()
    is_roof = (height > 0.8) & is_top[:, None]
    is_rear = np.arange(len(table)) <= np.flatnonzero(is_top)[0]
    is_pillar = (np.abs(sections[..., 1]) > 0.75 * table[:, 1, None] * (1 - 0.2 * height)) & is_rear[:, None]
    is_painted = is_roof | is_pillar
    # A cell is painted if all its corners are; otherwise the edge of the paint would be jagged.
    cells = is_painted[:-1] & is_painted[1:]
    cells &= np.roll(cells, -1, axis=1)
    materials = mesh.materials.copy()
    materials[: 2 * cells.size] = np.where(np.repeat(cells.ravel(), 2), material_number("paint_dark"), materials[0])
    return replace(mesh, materials=materials)


def _ball(centre_m: list[float], radii_m: list[float], material: str) -> Mesh:
    """An ellipsoid, open by a hair at both ends of x."""
    (x, _, z), (along, across, up) = centre_m, radii_m
    turns = np.linspace(0.05, np.pi - 0.05, 9)
    stations = [[x - along * np.cos(a), across * np.sin(a), z - up * np.sin(a), z + up * np.sin(a)] for a in turns]
    return _shell(stations, material, 2.0)


def _wheels(axles_m: list[float], half_track_m: float, radius_m: float, width_m: float) -> Mesh:
    """Tyres with dull hubs at both ends of every axle."""
    centres = np.array([[x, side * half_track_m, radius_m] for x in axles_m for side in (-1, 1)])
    half = np.array([0.0, width_m / 2, 0.0])
    bulge = np.array([0.0, 0.004, 0.0])
    tyre, hub = material_number("tyre"), material_number("metal_post")
    parts = [tubes(centres - half, centres + half, radius_m, radius_m, 20, tyre)]
    for side in (-1, 1):
        for level, radius, number in ((0, radius_m, tyre), (1, 0.6 * radius_m, hub)):
            inner, outer = (centres + side * (half + step * bulge) for step in (level, level + 1))
            parts.append(tubes(inner, outer, radius, 0.02, 20, number))
    return joined(parts)


def _boxes(material: str, size_m: list[float], centres_m: Rows) -> Mesh:
    return joined(box(centre, size_m, material_number(material)) for centre in centres_m)


def _bars(material: str, radius_m: float, ends_m: list[Rows]) -> Mesh:
    """Sticks that taper a little, from the first to the second of each pair of ends."""
    points = np.array(ends_m, np.float64)
    return tubes(points[:, 0], points[:, 1], radius_m, 0.85 * radius_m, 10, material_number(material))


_SHAPES: dict[str, Callable[..., Mesh]] = {
    "shell": _shell,
    "cabin": _cabin,
    "ball": _ball,
    "wheels": _wheels,
    "boxes": _boxes,
    "bars": _bars,
}


def _mounts(
    function: LampFunction,
    is_pair: bool,
    position_m: list[float],
    radius_m: float,
    number: int | None = None,
    face_m: list[float] | None = None,
) -> list[LampMount]:
    """One lamp, or a left and a right one, just outside the body's shell; a number tells those of a row apart."""
    x, y, z = position_m
    if function == "side_marker":
        y += LAMP_GAP_M
    else:
        x += -LAMP_GAP_M if function in REAR_FUNCTIONS else LAMP_GAP_M
    name = function if number is None else f"{function}_{number}"
    width, height = face_m or (0.0, 0.0)
    if not is_pair:
        return [LampMount(name, function, (x, y, z), radius_m, (width, height))]
    return [
        LampMount(f"{name}_{side}", function, (x, s * y, z), radius_m, (width, height))
        for side, s in (("left", 1), ("right", -1))
    ]


def _body(
    kind: str, wheelbase_m: float, eye_m: list[float], parts: list[dict[str, Any]], lamps: list[dict[str, Any]]
) -> Body:
    mesh = joined(_SHAPES[part["shape"]](**{name: part[name] for name in part if name != "shape"}) for part in parts)
    low, high = mesh.vertices_m.min(0), mesh.vertices_m.max(0)
    low[2] = 0.0
    length, width, height = (high - low).tolist()
    x, y, z = ((low + high) / 2).tolist()
    mounts = tuple(mount for lamp in lamps for mount in _mounts(**lamp))
    return Body(kind, mesh, mounts, (length, width, height), (x, y, z), wheelbase_m, (eye_m[0], eye_m[1], eye_m[2]))


BODIES: dict[str, Body] = {kind: _body(kind, **fields) for kind, fields in read_toml(SHIPPED).items()}
"""Every kind of vehicle by its name."""
