"""Traffic signs, chevrons and post markers: retroreflective plates on poles."""

from __future__ import annotations

import numpy as np

from foreglow.geometry import Floats, Pose, rotation
from foreglow.lab.simulation.scenes.surroundings import Sign, SignKind
from foreglow.lab.simulation.world.furniture import BURIED_M, SIDE_SIGNS
from foreglow.lab.simulation.world.materials import material_number
from foreglow.lab.simulation.world.mesh import Mesh, joined, polygon, tubes
from foreglow.lab.simulation.world.terrain import Terrain

LAYER_M = 0.008
"""Distance of the picture from its plate, enough for rays to separate them."""

_CIRCLE = np.stack([np.cos(np.arange(24) * np.pi / 12), np.sin(np.arange(24) * np.pi / 12)], -1) / 2
_TRIANGLE = np.array([[-0.5, 0.0], [0.5, 0.0], [0.0, 0.866]])
_ARROW = np.array([[[0.08, 0.5], [0.36, 0.5], [-0.08, 0.0], [-0.36, 0.0]]])
"""Upper arm of a chevron that points to the reader's left, in units of the plate's width."""

ASPECTS: dict[SignKind, float] = {
    "chevron_left": 1.0,
    "chevron_right": 1.0,
    "round": 1.0,
    "triangle": 0.866,
    "rectangle": 0.6,
    "guide": 0.6,
    "post_marker": 3.0,
}
"""Height over width."""


def build_signs(signs: tuple[Sign, ...], terrain: Terrain, rng: np.random.Generator) -> list[Mesh]:
    """The signs in the world, each turned slightly away from the road, as in reality."""
    return [_placed(sign, terrain, float(rng.normal(0.05, 0.04)), int(rng.integers(0, 3))) for sign in signs]


def _placed(sign: Sign, terrain: Terrain, turn_rad: float, num_lines: int) -> Mesh:
    side = SIDE_SIGNS[sign.side]
    t = side * (terrain.road.half_width_m + sign.offset_m + sign.size_m / 2)
    heading = float(terrain.road.heading_rad(sign.s_m))
    # A sign's x points at the reader: back along the road, or forward.
    facing = heading + (0.0 if sign.faces_oncoming else np.pi)
    away = -side * turn_rad * (-1.0 if sign.faces_oncoming else 1.0)
    return sign_mesh(sign, num_lines).moved(Pose(terrain.points(sign.s_m, t), rotation(facing + away)))


def sign_mesh(sign: Sign, num_lines: int = 2) -> Mesh:
    """The sign with its foot at the origin, facing along x; a rectangle has `num_lines` of text."""
    width, height = sign.size_m, sign.size_m * ASPECTS[sign.kind]
    outline, layers = _picture(sign.kind, num_lines)
    centre = sign.height_m + height / 2
    if sign.kind == "triangle":
        centre = sign.height_m
    plates = [
        polygon(_plate(outline, width, 0.0, centre), material_number(_FACES[sign.kind])),
        polygon(_plate(outline, width, -0.012, centre), material_number("sign_back")),
    ]
    pictures = [
        polygon(_plate(corners, width, LAYER_M * level, centre), material_number(material))
        for corners, material, level in layers
    ]
    top = sign.height_m + 0.9 * height
    # Two poles carry a wide plate.
    spread = [0.0] if width < 1.0 else [-0.35 * width, 0.35 * width]
    feet = np.array([[-0.05, y, -BURIED_M] for y in spread])
    heads = np.array([[-0.05, y, top] for y in spread])
    return joined([*plates, *pictures, tubes(feet, heads, 0.03, 0.03, 8, material_number("pole"))])


_FACES: dict[SignKind, str] = {
    "chevron_left": "sign_white",
    "chevron_right": "sign_white",
    "round": "sign_colour",
    "triangle": "sign_colour",
    "rectangle": "sign_white",
    "guide": "sign_colour",
    "post_marker": "sign_white",
}

_Layer = tuple[Floats, str, int]


def _picture(kind: SignKind, num_lines: int) -> tuple[Floats, list[_Layer]]:
    """Outline of the plate and the shapes on it, in units of its width; x to the reader's right, y up."""
    if kind == "round":
        digits = [(_rectangle(x, 0.0, 0.14, 0.34), "sign_black", 2) for x in (-0.12, 0.12)]
        return _CIRCLE, [(_CIRCLE * 0.76, "sign_white", 1), *digits]
    if kind == "triangle":
        middle = np.array([0.0, 0.289])
        inner = (_TRIANGLE - middle) * 0.66 + middle
        return _TRIANGLE, [(inner, "sign_white", 1), (_rectangle(0.0, 0.32, 0.07, 0.24), "sign_black", 2)]
    if kind == "rectangle":
        aspect = ASPECTS[kind]
        rows = np.linspace(-0.25, 0.25, num_lines) * aspect if num_lines > 1 else np.zeros(num_lines)
        lines = [(_rectangle(0.0, y, 0.7, 0.1), "sign_black", 1) for y in rows]
        return _rectangle(0.0, 0.0, 1.0, aspect), lines
    if kind == "guide":
        return guide_picture(ASPECTS[kind], num_lines + 2, num_lines)
    if kind == "post_marker":
        aspect = ASPECTS[kind]
        stripes = [np.array([[-0.5, y], [0.5, y + 0.5], [0.5, y + 0.9], [-0.5, y + 0.4]]) for y in (-1.4, -0.5, 0.4)]
        return _rectangle(0.0, 0.0, 1.0, aspect), [(stripe, "sign_colour", 1) for stripe in stripes]
    mirror = np.array([1.0, 1.0]) if kind == "chevron_left" else np.array([-1.0, 1.0])
    arms = [_ARROW[0] * mirror, _ARROW[0] * mirror * [1.0, -1.0]]
    return _rectangle(0.0, 0.0, 1.0, 1.0), [(arm, "sign_dark", 1) for arm in arms]


def guide_picture(aspect: float, num_lines: int, seed: int) -> tuple[Floats, list[_Layer]]:
    """Outline and picture of a guide sign: a frame, and lines of words of different lengths, white on a colour.

    Both are in units of its width; the height is `aspect`.
    """
    rng = np.random.default_rng([seed, num_lines])
    frame = [(_rectangle(0.0, side * 0.47 * aspect, 0.97, 0.012), "sign_white", 1) for side in (-1, 1)]
    frame += [(_rectangle(side * 0.48, 0.0, 0.012, 0.94 * aspect), "sign_white", 1) for side in (-1, 1)]
    words: list[_Layer] = []
    letter = 0.42 * aspect / num_lines
    for y in (np.arange(num_lines) - (num_lines - 1) / 2) * 0.85 * aspect / num_lines:
        x, end = -0.42, float(rng.uniform(-0.05, 0.42))
        while x < end:
            word = float(rng.uniform(0.25, 0.9)) * letter  # one or two strokes of a letter
            words.append((_rectangle(x + word / 2, float(y), word, letter), "sign_white", 1))
            x += word + (0.15 if rng.random() < 0.8 else 0.6) * letter
    return _rectangle(0.0, 0.0, 1.0, aspect), [*frame, *words]


def _rectangle(x: float, y: float, width: float, height: float) -> Floats:
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    return np.asarray(corners * [width, height] + [x, y])


def _plate(corners: Floats, width_m: float, x_m: float, centre_m: float) -> Floats:
    """Corners of a picture, shape (N, 3), upright at x; the reader's right is the sign's +y."""
    return np.stack([np.full(len(corners), x_m), corners[:, 0] * width_m, centre_m + corners[:, 1] * width_m], -1)
