"""What spans a motorway: gantries with guide signs, and bridges."""

from __future__ import annotations

import numpy as np

from foreglow.geometry import Floats, Pose, rotation
from foreglow.lab.simulation.scenes.surroundings import Bridge, Gantry
from foreglow.lab.simulation.world.furniture import BURIED_M, SIDE_SIGNS
from foreglow.lab.simulation.world.materials import material_number
from foreglow.lab.simulation.world.mesh import Mesh, box, joined, polygon, tubes
from foreglow.lab.simulation.world.signs import LAYER_M, guide_picture
from foreglow.lab.simulation.world.terrain import Terrain

SIGN_ASPECTS = (0.55, 0.7, 0.9)
"""Height over width of signs on gantries."""

BESIDE_M = 1.2
"""Distance of a gantry's outer post from the edge of the carriageway."""

BEAM_M = (0.5, 0.6)
"""Depth and height of a gantry's beam."""

DECK_M, PARAPET_M = 1.1, 0.9
"""Height of a bridge's deck, and of the parapet above it."""

ABUTMENT_M = 2.5
"""Distance of a bridge's abutments from the edge of the carriageway."""


def build_gantries(gantries: tuple[Gantry, ...], terrain: Terrain, rng: np.random.Generator) -> list[Mesh]:
    """The gantries in the world, each with words of its own."""
    return [_gantry(gantry, terrain, rng) for gantry in gantries]


def _gantry(gantry: Gantry, terrain: Terrain, rng: np.random.Generator) -> Mesh:
    """Posts at the median and at the edge, a beam, and signs that face the traffic of its side."""
    road = terrain.road
    outwards = SIDE_SIGNS[gantry.side]
    # Traffic drives away from the reader on the side to which it keeps.
    is_ours = (outwards < 0) == (road.spec.mirror > 0)
    facing = float(road.heading_rad(gantry.s_m)) + (np.pi if is_ours else 0.0)
    inner, outer = 0.0, road.half_width_m + BESIDE_M
    foot = Pose(road.points(gantry.s_m, 0.0), rotation(facing))
    left = outwards * (-1.0 if is_ours else 1.0)  # of the reader's y, which is our right
    heights = [float(terrain.ground_height_m(gantry.s_m, outwards * t)) - foot.position_m[2] for t in (inner, outer)]
    top = gantry.height_m + 1.6
    pole = material_number("pole")
    feet = np.array([[-0.3, left * t, z - BURIED_M] for t, z in zip((inner, outer), heights, strict=True)])
    ends = feet * [1.0, 1.0, 0.0] + [0.0, 0.0, top]
    middle = (-0.3, left * (inner + outer) / 2, top)
    parts = [tubes(feet, ends, 0.2, 0.2, 10, pole), box(middle, (BEAM_M[0], outer - inner, BEAM_M[1]), pole)]
    at = outer - BESIDE_M - 0.5
    for width in gantry.signs_m:
        if at - width < inner + 0.5:
            break
        parts.append(_plate(width, (left * (at - width / 2), gantry.height_m), rng))
        at -= width + 0.6
    return joined(parts).moved(foot)


def _plate(width_m: float, at_m: tuple[float, float], rng: np.random.Generator) -> Mesh:
    """A guide sign whose lower edge has its middle at y and z; x towards the reader."""
    aspect = SIGN_ASPECTS[int(rng.integers(len(SIGN_ASPECTS)))]
    outline, layers = guide_picture(aspect, int(rng.integers(2, 5)), int(rng.integers(1_000_000)))
    height = at_m[1] + width_m * aspect / 2

    def upright(corners: Floats, x_m: float) -> Floats:
        return np.stack(
            [np.full(len(corners), x_m), at_m[0] + corners[:, 0] * width_m, height + corners[:, 1] * width_m], -1
        )

    back = polygon(upright(outline, -0.05), material_number("sign_back"))
    face = polygon(upright(outline, 0.0), material_number("sign_colour"))
    pictures = [
        polygon(upright(corners, LAYER_M * level), material_number(material)) for corners, material, level in layers
    ]
    return joined([back, face, *pictures])


def build_bridges(bridges: tuple[Bridge, ...], terrain: Terrain) -> list[Mesh]:
    """The bridges in the world: a deck with parapets on abutments and a row of columns in the median."""
    return [_bridge(bridge, terrain) for bridge in bridges]


def _bridge(bridge: Bridge, terrain: Terrain) -> Mesh:
    road, concrete = terrain.road, material_number("concrete")
    foot = Pose(road.points(bridge.s_m, 0.0), rotation(float(road.heading_rad(bridge.s_m))))
    reach = road.half_width_m + ABUTMENT_M
    low, width = bridge.height_m, bridge.width_m
    parts = [box((0.0, 0.0, low + DECK_M / 2), (width, 2 * reach + 40.0, DECK_M), concrete)]
    parts += [
        box(
            (side * (width / 2 - 0.15), 0.0, low + DECK_M + PARAPET_M / 2), (0.3, 2 * reach + 40.0, PARAPET_M), concrete
        )
        for side in (-1.0, 1.0)
    ]
    parts += [
        box((0.0, side * (reach + 10.0), (low - 2.0) / 2), (width, 20.0, low + 2.0), concrete) for side in (-1.0, 1.0)
    ]
    if road.spec.median_m > 0:
        columns = np.array([[x, 0.0, -0.5] for x in np.arange(-width / 2 + 1.0, width / 2, 3.5)])
        tops = columns + np.array([0.0, 0.0, low + 0.5])
        parts.append(tubes(columns, tops, 0.35, 0.35, 16, concrete))
    return joined(parts).moved(foot)
