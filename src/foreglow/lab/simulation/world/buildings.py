"""Houses with windows and shops, and street lamps, and the light of all."""

from __future__ import annotations

import numpy as np

from foreglow.geometry import Floats, Pose, rotation
from foreglow.lab.simulation.scenes.surroundings import House, StreetLamp
from foreglow.lab.simulation.world.furniture import BURIED_M, SIDE_SIGNS, FixedLight, screen, screen_light
from foreglow.lab.simulation.world.materials import material_number
from foreglow.lab.simulation.world.mesh import Mesh, box, flat, joined, triangulated, tubes
from foreglow.lab.simulation.world.terrain import Terrain

STOREY_M = 2.7
WINDOW_SIZE_M = (1.0, 1.25)
WINDOW_SPACING_M = 2.2
PANE_SIZE_M = (0.94, 1.2)
PANE_POSE = Pose(np.array([0.02, 0.0, 0.0]), rotation())
"""A lit pane, just in front of the dark one and behind the frame."""

FOUNDATION_M = 2.0
"""Depth of the walls below the ground at the middle of a house."""

ROOF_PITCH = 0.75
EAVES_M = 0.5
SHOP_M = (0.45, 2.55)
"""Heights of the lower and the upper edge of shop windows."""

SHOP_PANE_M = 1.9
SHOP_MARGIN_M = 0.8
"""Width of the wall, or of the door, beside a shop window."""

ARM_M = 1.2
REACH_PER_HEIGHT = 15.0
"""Reach of a street lamp's light over its height: at 4 degrees above the ground, it is dark beyond."""
HEAD_SIZE_M = (0.28, 0.55, 0.10)


def build_houses(
    houses: tuple[House, ...], terrain: Terrain, rng: np.random.Generator
) -> tuple[list[Mesh], list[FixedLight]]:
    """The houses in the world, and their lit windows."""
    meshes: list[Mesh] = []
    lights: list[FixedLight] = []
    for house in houses:
        side = SIDE_SIGNS[house.side]
        t = side * (terrain.road.half_width_m + house.offset_m)
        heading = float(terrain.road.heading_rad(house.s_m))
        # A house's x points out of its front, at the road; its origin is on the ground in the middle of the front.
        pose = Pose(
            terrain.points(house.s_m, t), rotation(heading - side * np.pi / 2 + float(np.radians(house.yaw_deg)))
        )
        wall = str(rng.choice(["plaster", "plaster", "plaster", "brick"]))
        windows = _windows(house)
        is_lit = np.zeros(len(windows), bool)
        is_lit[rng.permutation(len(windows))[: house.num_lit_windows]] = True
        meshes.append(house_mesh(house, wall, windows).moved(pose))
        if house.shop_cd_m2 > 0:
            for pane in _shop_panes(house):
                shine = screen(_shop_size_m(house), house.shop_cd_m2, picture=0.7)
                meshes.append(joined([shine, *_shop_frame(_shop_size_m(house))]).moved(pose @ pane))
                lights.append(screen_light(pose @ pane, _shop_size_m(house), house.shop_cd_m2))
        area = WINDOW_SIZE_M[0] * WINDOW_SIZE_M[1]
        for window, is_window_lit in zip(windows, is_lit, strict=True):
            if is_window_lit and house.window_cd_m2 > 0:
                if house.has_panes:
                    meshes.append(screen(PANE_SIZE_M, house.window_cd_m2, picture=0.5).moved(pose @ window @ PANE_POSE))
                    continue
                out = Pose(window.to_outer([0.05, 0.0, 0.0]), window.rotation)
                lights.append(FixedLight(pose @ out, "window", house.window_cd_m2 * area, WINDOW_SIZE_M))
    return meshes, lights


def house_mesh(house: House, wall: str, windows: list[Pose]) -> Mesh:
    """A house with a gable roof; x out of the front, the origin on the ground in the middle of the front."""
    length, depth, height = house.size_m
    x, y, ridge = depth, length / 2, height + ROOF_PITCH * depth / 2
    number, roof = material_number(wall), material_number("roof")
    outline = np.array([[0, -y], [0, y], [-x, y], [-x, -y]])
    rims = [np.column_stack([outline, np.full(4, z)]) for z in (-FOUNDATION_M, height)]
    corners = np.concatenate([*rims, [[-x / 2, -y, ridge], [-x / 2, y, ridge]]])
    sides = np.array([[0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])
    gables = [[4, 7, 8], [5, 6, 9]]
    # The roof overhangs the walls, along its own slope.
    low = height - ROOF_PITCH * EAVES_M
    roofs = []
    for front in (EAVES_M, -x - EAVES_M):
        slope = np.array(
            [[front, -y - 0.3, low], [front, y + 0.3, low], [-x / 2, y + 0.3, ridge], [-x / 2, -y - 0.3, ridge]]
        )
        roofs += [flat(slope + np.array([0, 0, lift]), np.array([[0, 1, 2], [0, 2, 3]]), roof) for lift in (0.06, 0.2)]
    chimney = box((-x / 2 - 0.8, 0.25 * length, ridge), (0.6, 0.6, 1.6), material_number("brick"))
    door = box((0.0, 0.0, 1.0), (0.06, 1.0, 2.1), material_number("sign_back"))
    panes = [_window().moved(window) for window in windows]
    walls = flat(corners, np.concatenate([triangulated(sides), gables]), number)
    return joined([walls, *roofs, chimney, door, *panes])


def _window() -> Mesh:
    """A dark pane in a light frame, x out of the wall, the origin in the middle of the pane on the wall."""
    width, height = WINDOW_SIZE_M
    pane = box((0.0, 0.0, 0.0), (0.03, width, height), material_number("window"))
    sill = box((0.04, 0.0, -height / 2 - 0.05), (0.16, width + 0.2, 0.06), material_number("concrete"))
    frame = [box((0.0, y, 0.0), (0.05, 0.06, height), material_number("plaster")) for y in (-width / 2, 0.0, width / 2)]
    return joined([pane, sill, *frame])


def _windows(house: House) -> list[Pose]:
    """Poses of all windows in the house's frame: rows on the front and on both gables, but none at the door."""
    length, depth, height = house.size_m
    levels = STOREY_M * np.arange(max(1, int(height // STOREY_M))) + min(1.5, 0.6 * height)
    poses = []
    for level in levels:
        has_door = level < STOREY_M
        front = [y for y in _row(length) if not has_door or (abs(y) > 1.1 and not house.shop_cd_m2)]
        poses += [Pose(np.array([0.0, y, level]), rotation()) for y in front]
        for x in _row(depth):
            poses += [
                Pose(np.array([x - depth / 2, side * length / 2, level]), rotation(side * np.pi / 2))
                for side in (-1.0, 1.0)
            ]
    return poses


def _shop_panes(house: House) -> list[Pose]:
    """Poses of the shop windows left and right of the door, in the house's frame."""
    middle = house.size_m[0] / 4
    height = sum(SHOP_M) / 2
    return [Pose(np.array([0.06, side * middle, height]), rotation()) for side in (-1.0, 1.0)]


def _shop_size_m(house: House) -> tuple[float, float]:
    return house.size_m[0] / 2 - 2 * SHOP_MARGIN_M, SHOP_M[1] - SHOP_M[0]


def _shop_frame(size_m: tuple[float, float]) -> list[Mesh]:
    """Bars between the panes of a shop window, and the dark goods at its foot."""
    (width, height), dark = size_m, material_number("sign_black")
    num_panes = max(1, round(width / SHOP_PANE_M))
    bars = [box((0.02, y, 0.0), (0.04, 0.07, height), dark) for y in np.linspace(-width / 2, width / 2, num_panes + 1)]
    goods = np.linspace(-width / 2, width / 2, 2 * num_panes + 2)[1:-1]
    sizes = 0.25 + 0.3 * np.abs(np.sin(7.0 * goods))
    bars += [
        box((0.02, y, (size - height) / 2), (0.02, 0.45, size), dark) for y, size in zip(goods, sizes, strict=True)
    ]
    return [*bars, box((0.02, 0.0, 0.28 * height), (0.04, width, 0.05), dark)]


def _row(length_m: float) -> Floats:
    num = max(1, int((length_m - 1.0) // WINDOW_SPACING_M))
    return np.asarray((np.arange(num) - (num - 1) / 2) * WINDOW_SPACING_M, np.float64)


def build_street_lamps(lamps: tuple[StreetLamp, ...], terrain: Terrain) -> tuple[list[Mesh], list[FixedLight]]:
    """The poles with arms and heads in the world, and the lights of those that are on."""
    meshes: list[Mesh] = []
    lights: list[FixedLight] = []
    for lamp in lamps:
        side = SIDE_SIGNS[lamp.side]
        t = side * (terrain.road.half_width_m + lamp.offset_m)
        heading = float(terrain.road.heading_rad(lamp.s_m))
        # A lamp post's x points across the road.
        foot = Pose(terrain.points(lamp.s_m, t), rotation(heading - side * np.pi / 2))
        arm = min(ARM_M, 0.25 * lamp.height_m)
        meshes.append(_lamp_post(lamp.height_m, arm).moved(foot))
        if lamp.intensity_cd > 0:
            down = Pose(np.array([arm, 0.0, lamp.height_m]), rotation(pitch_rad=-np.pi / 2))
            reach_m = max(REACH_PER_HEIGHT * lamp.height_m, 120.0)
            face = (HEAD_SIZE_M[0], HEAD_SIZE_M[1])
            lights.append(FixedLight(foot @ down, "street_lamp", lamp.intensity_cd, face, reach_m))
    return meshes, lights


def _lamp_post(height_m: float, arm_m: float) -> Mesh:
    """A post with an arm along x and a head whose lower face is slightly above the light."""
    pole = material_number("pole")
    top = height_m + 0.06
    bend = np.array(
        [[0, 0, -BURIED_M], [0, 0, height_m - 0.5], [0.15 * arm_m, 0, height_m - 0.05], [arm_m, 0, top + 0.04]]
    )
    posts = tubes(bend[:-1], bend[1:], np.array([0.08, 0.06, 0.04]), np.array([0.06, 0.05, 0.035]), 10, pole)
    head = box((arm_m, 0.0, top + HEAD_SIZE_M[2] / 2), (HEAD_SIZE_M[1], *HEAD_SIZE_M[::2]), pole)
    return joined([posts, head])
