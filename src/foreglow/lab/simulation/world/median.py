"""What stands between the two directions of a motorway: a concrete barrier, or two guardrails."""

from __future__ import annotations

import numpy as np

from foreglow.lab.simulation.scenes.surroundings import Span
from foreglow.lab.simulation.world.furniture import rail_run
from foreglow.lab.simulation.world.materials import material_number
from foreglow.lab.simulation.world.mesh import Mesh
from foreglow.lab.simulation.world.noise import Noise
from foreglow.lab.simulation.world.primitives import box, instanced, strip, yaw_rotations
from foreglow.lab.simulation.world.terrain import Terrain

BARRIER_PROFILE_M = np.array([[-0.30, -0.05], [-0.29, 0.07], [-0.16, 0.26], [-0.09, 0.90], [0.09, 0.90]])
"""Offset and height of the left half and the top of a step barrier of 0.9 m, similar to EN 1317's common shapes."""

STEP_M = 1.0
RAIL_APART_M = 0.45
"""Distance of either rail's face from the centre line."""

REFLECTOR_SPACING_M = 50.0
REFLECTOR_SIZE_M = (0.02, 0.09, 0.18)


def build_median(terrain: Terrain, rng: np.random.Generator) -> list[Mesh]:
    """The median of the terrain's road, in the world; nothing for a road without one."""
    road = terrain.road
    span = (0.0, road.length_m)
    if road.spec.median == "barrier":
        return [_barrier(terrain, span), _reflectors(terrain, 0.93)]
    if road.spec.median == "rails":
        wobble = Noise(rng, 6.0)
        rails = [
            rail_run(terrain, span, -side * RAIL_APART_M, side, post_spacing_m=4.0, wobble=wobble)
            for side in (1.0, -1.0)
        ]
        return [*rails[0], *rails[1], _reflectors(terrain, 0.85)]
    return []


def _barrier(terrain: Terrain, span: Span) -> Mesh:
    right = BARRIER_PROFILE_M[:-1][::-1] * [-1.0, 1.0]
    profile = np.concatenate([BARRIER_PROFILE_M[:-1], right])
    s = np.arange(span[0], span[1] + STEP_M / 2, STEP_M)
    points = terrain.road.points(s[:, None], profile[:, 0], profile[:, 1])
    return strip(points, material_number("concrete"))


def _reflectors(terrain: Terrain, height_m: float) -> Mesh:
    """Reflectors to both directions on top of the median."""
    s = np.arange(0.5 * REFLECTOR_SPACING_M, terrain.road.length_m, REFLECTOR_SPACING_M)
    plate = box((0.0, 0.0, 0.0), REFLECTOR_SIZE_M, material_number("reflector"))
    feet = terrain.road.points(s, 0.0, height_m + REFLECTOR_SIZE_M[2] / 2)
    return instanced(plate, feet, yaw_rotations(terrain.road.heading_rad(s)))
