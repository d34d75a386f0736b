"""Vehicles' bodies: shapes with lamps, in the vehicle's frame (x forward, y left, z up, origin under the rear axle)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np

from foreglow.geometry import Floats
from foreglow.lab.simulation.world.materials import material_number
from foreglow.lab.simulation.world.mesh import Mesh, joined
from foreglow.lab.simulation.world.primitives import box, loft, tubes

LampFunction: TypeAlias = Literal["low", "high", "rear"]

NUM_CORNERS = 32
"""Points around a body's cross-section."""

LAMP_GAP_M = 0.02
"""From the body's shell to the middle of a lamp's disc, so that the shell does not hide it."""


@dataclass(frozen=True, slots=True)
class LampMount:
    """Where a lamp sits; its axis points along x, backwards for rear lamps.

    Attributes:
        name: Such as `low_left`.
        function: Which beam it is part of.
        position_m: In the vehicle's frame, just outside the body.
        radius_m: Of its disc.
    """

    name: str
    function: LampFunction
    position_m: tuple[float, float, float]
    radius_m: float


@dataclass(frozen=True, eq=False)
class Body:
    """A kind of vehicle.

    Attributes:
        kind: car, van, lorry or motorcycle.
        mesh: In the vehicle's frame, with dark paint.
        lamps: Where its lamps sit.
        size_m: Length, width, height of the box around it.
        box_centre_m: Middle of that box in the vehicle's frame.
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


def _shell(stations: list[tuple[float, float, float, float]], material: str, roundness: float = 5.0) -> Mesh:
    return loft(_sections(np.array(stations), roundness), material_number(material))


def _cabin(stations: list[tuple[float, float, float, float]], has_roof: bool) -> Mesh:
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
    # A cell is painted if its corners are, or it would have teeth.
    cells = is_painted[:-1] & is_painted[1:]
    cells &= np.roll(cells, -1, axis=1)
    materials = mesh.materials.copy()
    materials[: 2 * cells.size] = np.where(np.repeat(cells.ravel(), 2), material_number("paint_dark"), materials[0])
    return replace(mesh, materials=materials)


def _wheels(axles_m: tuple[float, ...], half_track_m: float, radius_m: float, width_m: float) -> list[Mesh]:
    """Tyres with dull hubs at both ends of every axle."""
    centres = np.array([[x, side * half_track_m, radius_m] for x in axles_m for side in (-1, 1)])
    half = np.array([0.0, width_m / 2, 0.0])
    bulge = np.array([0.0, 0.004, 0.0])
    tyre, hub = material_number("tyre"), material_number("metal_post")
    lids = [
        tubes(
            centres + side * (half + level * bulge),
            centres + side * (half + (level + 1) * bulge),
            one,
            0.02,
            20,
            number,
        )
        for side in (-1, 1)
        for level, one, number in ((0, radius_m, tyre), (1, 0.6 * radius_m, hub))
    ]
    return [tubes(centres - half, centres + half, radius_m, radius_m, 20, tyre), *lids]


def _plate(x_m: float, z_m: float, width_m: float = 0.52, y_m: float = 0.0) -> Mesh:
    """A number plate upright at x, with its retroreflective face on both sides."""
    return box((x_m, y_m, z_m), (0.012, width_m, 0.11), material_number("plate"))


def _patches(material: str, x_m: float, places_m: list[tuple[float, float]], size_m: tuple[float, float]) -> Mesh:
    """Small upright plates across the vehicle at x, one at each (y, z)."""
    number = material_number(material)
    return joined(box((x_m, y, z), (0.012, *size_m), number) for y, z in places_m)


def _pairs(name: str, function: LampFunction, x: float, y: float, z: float, radius: float) -> tuple[LampMount, ...]:
    return tuple(
        LampMount(f"{name}_{side}", function, (x, sign * y, z), radius) for side, sign in (("left", 1), ("right", -1))
    )


def _body(
    kind: str, parts: list[Mesh], lamps: tuple[LampMount, ...], wheelbase_m: float, eye_m: tuple[float, float, float]
) -> Body:
    mesh = joined(parts)
    low, high = mesh.vertices_m.min(0), mesh.vertices_m.max(0)
    low[2] = 0.0
    length, width, height = (float(one) for one in high - low)
    x, y, z = (float(one) for one in (low + high) / 2)
    return Body(kind, mesh, lamps, (length, width, height), (x, y, z), wheelbase_m, eye_m)


def _car() -> Body:
    front, rear = 3.46, -0.90
    shell = _shell(
        [
            (rear, 0.70, 0.42, 0.80),
            (rear + 0.05, 0.80, 0.32, 0.94),
            (rear + 0.20, 0.86, 0.25, 1.00),
            (-0.40, 0.89, 0.20, 1.01),
            (0.40, 0.90, 0.18, 0.97),
            (1.60, 0.90, 0.18, 0.95),
            (2.15, 0.90, 0.18, 0.95),
            (2.60, 0.89, 0.20, 0.91),
            (3.00, 0.87, 0.22, 0.84),
            (front - 0.18, 0.82, 0.25, 0.76),
            (front - 0.05, 0.76, 0.30, 0.70),
            (front, 0.68, 0.36, 0.62),
        ],
        "paint_dark",
    )
    cabin = _cabin(
        [
            (-0.72, 0.74, 0.90, 1.00),
            (-0.45, 0.78, 0.88, 1.24),
            (-0.15, 0.80, 0.88, 1.40),
            (0.30, 0.82, 0.88, 1.46),
            (0.90, 0.83, 0.88, 1.48),
            (1.30, 0.83, 0.88, 1.44),
            (1.60, 0.82, 0.88, 1.33),
            (1.95, 0.80, 0.88, 1.14),
            (2.30, 0.76, 0.88, 0.95),
        ],
        has_roof=True,
    )
    parts = [
        shell,
        cabin,
        *_wheels((0.0, 2.65), 0.78, 0.32, 0.21),
        _plate(front + 0.006, 0.42),
        _plate(rear - 0.006, 0.62),
        _patches("rear_reflector", rear - 0.004, [(-0.60, 0.50), (0.60, 0.50)], (0.10, 0.035)),
        _patches("lamp_glass", front - 0.01, [(-0.60, 0.65), (0.60, 0.65)], (0.28, 0.13)),
        _patches("sign_black", front - 0.004, [(0.0, 0.56)], (0.80, 0.10)),
    ]
    lamps = (
        *_pairs("low", "low", front + LAMP_GAP_M, 0.66, 0.65, 0.07),
        *_pairs("high", "high", front + LAMP_GAP_M, 0.50, 0.65, 0.06),
        *_pairs("rear", "rear", rear - LAMP_GAP_M, 0.66, 0.80, 0.06),
    )
    return _body("car", parts, lamps, 2.65, (1.15, 0.37, 1.17))


def _van() -> Body:
    front, rear = 4.15, -0.98
    shell = _shell(
        [
            (rear, 0.90, 0.38, 2.25),
            (rear + 0.06, 0.95, 0.30, 2.34),
            (0.60, 0.98, 0.24, 2.38),
            (2.10, 0.98, 0.24, 2.36),
            (2.50, 0.98, 0.24, 2.22),
            (2.90, 0.97, 0.24, 1.30),
            (3.50, 0.95, 0.26, 1.14),
            (front - 0.15, 0.88, 0.30, 0.98),
            (front, 0.74, 0.40, 0.82),
        ],
        "paint_dark",
        8.0,
    )
    screen = _cabin(
        [(1.50, 0.93, 1.25, 2.20), (2.35, 0.95, 1.25, 2.20), (2.58, 0.93, 1.25, 2.05), (3.02, 0.88, 1.20, 1.32)],
        has_roof=False,
    )
    parts = [
        shell,
        screen,
        *_wheels((0.0, 3.25), 0.86, 0.34, 0.23),
        _plate(front + 0.006, 0.50),
        _plate(rear - 0.006, 0.75, y_m=0.3),
        _patches("glass", rear - 0.004, [(-0.44, 1.60), (0.44, 1.60)], (0.70, 0.60)),
        _patches("rear_reflector", rear - 0.004, [(-0.80, 0.50), (0.80, 0.50)], (0.10, 0.05)),
        _patches("lamp_glass", front - 0.01, [(-0.64, 0.78), (0.64, 0.78)], (0.24, 0.20)),
    ]
    lamps = (
        *_pairs("low", "low", front + LAMP_GAP_M, 0.70, 0.75, 0.08),
        *_pairs("high", "high", front + LAMP_GAP_M, 0.56, 0.75, 0.06),
        *_pairs("rear", "rear", rear - LAMP_GAP_M, 0.86, 1.00, 0.07),
    )
    return _body("van", parts, lamps, 3.25, (2.05, 0.45, 1.75))


def _lorry() -> Body:
    front, rear, load = 6.45, -2.10, 4.45
    paint, dark = material_number("paint_dark"), material_number("sign_black")
    cab = _shell(
        [
            (4.60, 1.22, 0.55, 2.95),
            (4.70, 1.24, 0.50, 3.00),
            (5.90, 1.24, 0.45, 2.98),
            (6.20, 1.23, 0.42, 2.75),
            (front - 0.08, 1.21, 0.40, 1.75),
            (front, 1.15, 0.42, 1.45),
        ],
        "paint_dark",
        9.0,
    )
    screen = _shell([(6.00, 1.10, 1.72, 2.70), (6.24, 1.10, 1.72, 2.64), (6.43, 1.06, 1.68, 1.76)], "glass", 9.0)
    middle = (load + rear) / 2
    length, tape = load - rear, 0.05
    sides = [
        box((middle, side * 1.256, z), (length - 0.2, 0.012, tape), material_number("contour_tape"))
        for side in (-1, 1)
        for z in (1.15,)
    ]
    outline = [((0.0, 3.58), (2.40, tape)), ((0.0, 1.12), (2.40, tape))]
    outline += [((side * 1.2, 2.35), (tape, 2.40)) for side in (-1, 1)]
    parts = [
        cab,
        screen,
        box((middle, 0.0, 2.35), (length, 2.5, 2.6), paint),
        box(((load + rear) / 2, 0.0, 0.85), (length, 0.9, 0.35), dark),
        box((rear + 0.05, 0.0, 0.50), (0.1, 2.3, 0.14), material_number("metal_post")),
        box((rear + 0.05, 0.0, 0.98), (0.1, 2.3, 0.14), dark),
        *(box((rear + 0.08, y, 0.74), (0.08, 0.12, 0.50), dark) for y in (-0.6, 0.6)),
        *(box((2.2, side * 1.15, 0.75), (2.6, 0.05, 0.5), dark) for side in (-1, 1)),
        *_wheels((0.0, 5.0), 1.05, 0.50, 0.32),
        *sides,
        *(_patches("contour_tape", rear - 0.006, [place], size) for place, size in outline),
        _plate(front + 0.006, 0.62),
        _plate(rear - 0.006, 0.97),
        _patches("rear_reflector", rear - 0.006, [(-1.05, 0.50), (1.05, 0.50)], (0.15, 0.10)),
        _patches("lamp_glass", front - 0.005, [(-0.92, 0.88), (0.92, 0.88)], (0.36, 0.22)),
    ]
    lamps = (
        *_pairs("low", "low", front + LAMP_GAP_M, 0.98, 0.90, 0.09),
        *_pairs("high", "high", front + LAMP_GAP_M, 0.80, 0.90, 0.08),
        *_pairs("rear", "rear", rear - LAMP_GAP_M, 0.98, 0.98, 0.07),
    )
    return _body("lorry", parts, lamps, 5.0, (5.75, 0.55, 2.35))


def _motorcycle() -> Body:
    def bars(
        ends: list[tuple[tuple[float, float, float], tuple[float, float, float]]], radius: float, material: str
    ) -> Mesh:
        points = np.array(ends, np.float64)
        return tubes(points[:, 0], points[:, 1], radius, 0.85 * radius, 10, material_number(material))

    tank = _shell(
        [
            (-0.35, 0.08, 0.80, 0.90),
            (0.00, 0.14, 0.66, 0.86),
            (0.45, 0.18, 0.45, 0.90),
            (0.75, 0.19, 0.40, 1.02),
            (1.05, 0.16, 0.45, 1.04),
            (1.30, 0.17, 0.62, 1.16),
            (1.42, 0.12, 0.70, 1.05),
        ],
        "paint_dark",
        3.0,
    )
    torso = _shell(
        [(0.30, 0.16, 0.82, 1.10), (0.42, 0.21, 0.85, 1.38), (0.58, 0.23, 0.98, 1.48), (0.70, 0.17, 1.10, 1.42)],
        "clothing",
        2.5,
    )
    turns = np.linspace(0.05, np.pi - 0.05, 9)
    helmet = _shell(
        [(0.68 - 0.15 * np.cos(a), 0.12 * np.sin(a), 1.56 - 0.14 * np.sin(a), 1.56 + 0.14 * np.sin(a)) for a in turns],
        "sign_black",
        2.0,
    )
    legs = [((0.35, s * 0.14, 0.85), (0.78, s * 0.24, 0.72)) for s in (-1, 1)] + [
        ((0.78, s * 0.24, 0.72), (0.40, s * 0.20, 0.30)) for s in (-1, 1)
    ]
    arms = [((0.58, s * 0.22, 1.36), (0.80, s * 0.33, 1.12)) for s in (-1, 1)] + [
        ((0.80, s * 0.33, 1.12), (1.12, s * 0.36, 1.08)) for s in (-1, 1)
    ]
    fork = [((1.10, s * 0.10, 0.95), (1.45, s * 0.10, 0.31)) for s in (-1, 1)]
    parts = [
        tank,
        torso,
        helmet,
        bars(legs, 0.075, "clothing"),
        bars(arms, 0.055, "clothing"),
        bars(
            [*fork, ((0.45, 0.0, 0.45), (0.0, 0.10, 0.31)), ((1.10, -0.38, 1.08), (1.10, 0.38, 1.08))],
            0.025,
            "metal_post",
        ),
        *_wheels((0.0, 1.45), 0.0, 0.31, 0.14),
        _plate(-0.36, 0.62, 0.20),
        _patches("rear_reflector", -0.362, [(0.0, 0.74)], (0.08, 0.05)),
        _patches("lamp_glass", 1.425, [(0.0, 0.88)], (0.18, 0.18)),
    ]
    lamps = (
        LampMount("low", "low", (1.43 + LAMP_GAP_M, 0.0, 0.86), 0.07),
        LampMount("high", "high", (1.43 + LAMP_GAP_M, 0.0, 0.94), 0.06),
        LampMount("rear", "rear", (-0.37 - LAMP_GAP_M, 0.0, 0.84), 0.04),
    )
    return _body("motorcycle", parts, lamps, 1.45, (0.80, 0.0, 1.56))


BODIES: dict[str, Body] = {body.kind: body for body in (_car(), _van(), _lorry(), _motorcycle())}
"""Every kind of vehicle by its name."""
