"""Small worlds, cameras and lamps for the tests of the renderer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foreglow.geometry import Camera, Floats, Pose, rotation
from foreglow.lab.simulation.light.lamps import PlacedLamp
from foreglow.lab.simulation.light.render import Renderer, RenderSettings
from foreglow.lab.simulation.scenes.scene import RoadSpec, WeatherSpec
from foreglow.lab.simulation.world.materials import material_number
from foreglow.lab.simulation.world.mesh import Mesh, joined, surface
from foreglow.photometry import IntensityTable

LAMBERT, LAMBERT_ALBEDO = "tyre", 0.04
"""A material that is diffuse and nothing else."""

NO_AIR = WeatherSpec(scattering_per_m=0.0, sky_cd_m2=0.0)
PLAIN = RenderSettings(extra_samples=0, haze_cells=(8, 6, 8), darkest_cd_m2=1e-9)
EVERYWHERE = IntensityTable(np.arange(-180.0, 181.0, 30.0), np.arange(-90.0, 91.0, 30.0), np.full((7, 13), 1000.0))
"""1000 cd in every direction."""


def camera(width_px: int = 160, height_px: int = 120, distortion: Sequence[float] = (0.0,) * 5) -> Camera:
    """A camera of the simulator's field of view."""
    k1, k2, p1, p2, k3 = distortion
    focal_px = 1.025 * width_px
    mount = Pose(np.zeros(3), np.eye(3))
    return Camera(width_px, height_px, (focal_px, focal_px), (width_px / 2, height_px / 2), (k1, k2, p1, p2, k3), mount)


def looking(position_m: ArrayLike, pitch_deg: float = 0.0, yaw_deg: float = 0.0) -> Pose:
    """A pose that looks along x, turned up and to the left."""
    return Pose(np.asarray(position_m, np.float64), rotation(np.radians(yaw_deg), np.radians(pitch_deg)))


def quad(corners_m: ArrayLike, material: str = LAMBERT) -> Mesh:
    """A flat rectangle with its corners in order around it."""
    return surface(np.asarray(corners_m), np.array([[0, 1, 2], [0, 2, 3]]), material_number(material))


def ground(material: str = LAMBERT, size_m: float = 200.0, height_m: float = 0.0) -> Mesh:
    """A level square around the origin; its surface coordinates are those of the world."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * size_m + np.array([0, 0, height_m])
    plain = quad(corners, material)
    return Mesh(plain.vertices_m, plain.faces, plain.materials, plain.normals, plain.vertices_m[:, :2].copy())


def wall(distance_m: float, half_size_m: float, material: str = LAMBERT, height_m: float = 0.0) -> Mesh:
    """An upright square across the x axis, around `height_m`."""
    r = half_size_m
    return quad([[distance_m, y, height_m + z] for y, z in ((-r, -r), (r, -r), (r, r), (-r, r))], material)


def box(centre_m: ArrayLike, half_size_m: float, material: str = LAMBERT) -> Mesh:
    """A cube with flat faces."""
    sides = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            flat = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
            sides.append(quad(np.insert(flat, axis, sign, axis=1) * half_size_m + np.asarray(centre_m), material))
    return joined(sides)


def bulb(position_m: ArrayLike, layer: int = 0, scale: float = 1.0) -> PlacedLamp:
    """1000 cd in every direction."""
    return PlacedLamp(Pose(np.asarray(position_m, np.float64), np.eye(3)), EVERYWHERE, layer, scale)


def renderer(
    static: Mesh,
    seen_by: Camera | None = None,
    settings: RenderSettings = PLAIN,
    bodies: Mapping[str, Mesh] | None = None,
    road: RoadSpec | None = None,
) -> Renderer:
    """A renderer of a small world."""
    return Renderer(static, bodies or {}, seen_by or camera(), settings, road=road or RoadSpec(), seed=7)


def points_on_ground(seen_by: Camera, pose: Pose) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Where the pixels' middles meet the plane z = 0: points (H, W, 3), distances (H, W), and whether they do."""
    y, x = np.indices((seen_by.height_px, seen_by.width_px)) + 0.5
    directions = seen_by.rays(np.stack([x, y], -1)) @ pose.rotation.T
    with np.errstate(divide="ignore"):
        distances = -pose.position_m[2] / directions[..., 2]
    meets = (distances > 0) & (distances < 150.0)
    distances = np.where(meets, distances, 1.0)
    return pose.position_m + directions * distances[..., None], distances, meets
