"""Billboards and traffic lights."""

from __future__ import annotations

import numpy as np

from foreglow.geometry import Pose, rotation
from foreglow.lab.simulation.scenes.surroundings import Panel, Signal
from foreglow.lab.simulation.world.fixed_light import FixedLight, screen, screen_light
from foreglow.lab.simulation.world.furniture import BURIED_M, SIDE_SIGNS
from foreglow.lab.simulation.world.materials import material_number
from foreglow.lab.simulation.world.mesh import Mesh, joined
from foreglow.lab.simulation.world.primitives import box, tubes
from foreglow.lab.simulation.world.terrain import Terrain

HOUSING_M = (0.22, 0.32, 0.94)
"""Depth, width and height of a traffic light with three lenses of 0.2 m."""

LENS_M = 0.2
LENS_HEIGHTS_M = {"red": 0.77, "amber": 0.47, "green": 0.17}
"""Heights of the lenses above the lower edge of the housing."""


def build_panels(panels: tuple[Panel, ...], terrain: Terrain) -> tuple[list[Mesh], list[FixedLight]]:
    """The billboards in the world, and their light."""
    meshes: list[Mesh] = []
    lights: list[FixedLight] = []
    for panel in panels:
        side, (width, height) = SIDE_SIGNS[panel.side], panel.size_m
        t = side * (terrain.road.half_width_m + panel.offset_m + width / 2)
        facing = float(terrain.road.heading_rad(panel.s_m)) + np.pi + side * float(np.radians(panel.yaw_deg))
        foot = Pose(terrain.points(panel.s_m, t), rotation(facing))
        middle = np.array([0.0, 0.0, panel.height_m + height / 2])
        frame = box(middle - [0.12, 0.0, 0.0], (0.2, width + 0.15, height + 0.15), material_number("sign_back"))
        feet = np.array([[-0.12, y, -BURIED_M] for y in (-0.35 * width, 0.35 * width)])
        posts = tubes(
            feet, feet + np.array([0.0, 0.0, panel.height_m + BURIED_M]), 0.08, 0.08, 10, material_number("pole")
        )
        meshes.append(joined([frame, posts]).moved(foot))
        if panel.screen_cd_m2 > 0:
            pose = foot @ Pose(middle, rotation())
            picture = joined([screen(panel.size_m, panel.screen_cd_m2, picture=0.8), *_print(panel.size_m)])
            meshes.append(picture.moved(pose))
            lights.append(screen_light(pose, panel.size_m, panel.screen_cd_m2))
    return meshes, lights


def build_signals(signals: tuple[Signal, ...], terrain: Terrain) -> tuple[list[Mesh], list[FixedLight]]:
    """The traffic lights in the world, and the light of their lenses."""
    meshes: list[Mesh] = []
    lights: list[FixedLight] = []
    for signal in signals:
        side = SIDE_SIGNS[signal.side]
        t = side * (terrain.road.half_width_m + signal.offset_m)
        facing = float(terrain.road.heading_rad(signal.s_m)) + (0.0 if signal.faces_oncoming else np.pi)
        foot = Pose(terrain.points(signal.s_m, t), rotation(facing))
        # Seen from the housing's front, the road is to the left of a mast on the reader's right.
        inwards = side * (-1.0 if signal.faces_oncoming else 1.0)
        across = inwards * signal.arm_m
        meshes.append(_signal_mesh(signal.height_m, across).moved(foot))
        if signal.intensity_cd > 0:
            lens = np.array([HOUSING_M[0] / 2 + 0.02, across, signal.height_m + LENS_HEIGHTS_M[signal.lit]])
            pose = foot @ Pose(lens, rotation())
            lights.append(FixedLight(pose, "signal", signal.intensity_cd, (LENS_M, LENS_M)))
    return meshes, lights


def _print(size_m: tuple[float, float]) -> list[Mesh]:
    """Lines of large letters on a billboard, as bars."""
    width, height = size_m
    lines = ((0.0, 0.3, 0.8, 0.1), (-0.14, 0.14, 0.52, 0.06), (0.1, -0.38, 0.6, 0.08))
    return [
        box((0.02, y * width, z * height), (0.02, length * width, size * height), material_number("sign_black"))
        for y, z, length, size in lines
    ]


def _signal_mesh(height_m: float, across_m: float) -> Mesh:
    """Mast, arm and housing; x towards the reader, the foot of the mast at the origin."""
    depth, _, size = HOUSING_M
    top = height_m + size / 2
    behind = -depth / 2 - 0.06
    starts = np.array([[behind, 0.0, -BURIED_M], [behind, 0.0, top]])
    ends = np.array([[behind, 0.0, top], [behind, across_m, top + 0.1]])
    masts = tubes(starts, ends, np.array([0.07, 0.06]), np.array([0.06, 0.04]), 10, material_number("pole"))
    housing = box((0.0, across_m, top), HOUSING_M, material_number("sign_black"))
    return joined([masts, housing])
