"""Physics of the renderer, on worlds small enough to know the answer."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from foreglow.geometry import Floats, Pose
from foreglow.lab.simulation.light.lamps import PlacedBody, PlacedLamp
from foreglow.lab.simulation.light.llvm import dr
from foreglow.lab.simulation.light.render import QUALITIES, Renderer, RenderSettings
from foreglow.lab.simulation.scenes.scene import WeatherSpec
from foreglow.lab.simulation.world.materials import NO_MATERIAL, material_number
from foreglow.lab.simulation.world.mesh import Mesh, joined, surface
from foreglow.photometry import IntensityTable
from tests.lab.simulation.light import rendering as small

pytestmark = pytest.mark.renderer

CAMERA = small.camera()
ABOVE = small.looking([0.0, 0.0, 3.0], pitch_deg=-12)


@pytest.fixture(scope="module")
def plain() -> Renderer:
    """Level ground and nothing else."""
    return small.renderer(small.ground())


def test_inverse_square_and_cosine_on_the_ground(plain: Renderer) -> None:
    lamp_m = np.array([12.0, 1.0, 2.0])
    seen = plain.render(ABOVE, [small.bulb(lamp_m)], 1, [], small.NO_AIR)
    points, distances, is_ground = small.points_on_ground(CAMERA, ABOVE)
    ways = lamp_m - points
    lengths = np.linalg.norm(ways, axis=-1)
    expected = 1000.0 / lengths**2 * (ways[..., 2] / lengths) * small.LAMBERT_ALBEDO / np.pi
    np.testing.assert_allclose(seen.surface_cd_m2[0][is_ground], expected[is_ground], rtol=2e-3)
    np.testing.assert_allclose(seen.depth_m[is_ground], distances[is_ground], rtol=1e-4)
    assert np.isnan(seen.depth_m[:10]).all()
    assert (seen.materials[is_ground] == material_number(small.LAMBERT)).all()
    assert (seen.materials[:10] == NO_MATERIAL).all()
    assert (seen.bodies == -1).all()
    assert not seen.surface_cd_m2[0, :10].any()


def test_haze_takes_its_share_of_the_light_on_its_way(plain: Renderer) -> None:
    lamp_m, air = np.array([12.0, 1.0, 2.0]), WeatherSpec(scattering_per_m=0.02, sky_cd_m2=0.0)
    clear = plain.render(ABOVE, [small.bulb(lamp_m)], 1, [], small.NO_AIR).surface_cd_m2[0]
    misty = plain.render(ABOVE, [small.bulb(lamp_m)], 1, [], air).surface_cd_m2[0]
    points, distances, is_ground = small.points_on_ground(CAMERA, ABOVE)
    ways_m = distances + np.linalg.norm(lamp_m - points, axis=-1)
    np.testing.assert_allclose((misty / clear.clip(1e-12))[is_ground], np.exp(-0.02 * ways_m)[is_ground], rtol=1e-3)


def test_table_and_pose_of_a_lamp(plain: Renderer) -> None:
    generator = np.random.default_rng(3)
    candela = generator.uniform(10, 1000, (11, 13)).astype(np.float32)
    table = IntensityTable(np.arange(-30, 31, 5.0), np.arange(-20, 21, 4.0), candela)
    pose = small.looking([-2.0, 0.5, 2.0], pitch_deg=-12, yaw_deg=7)
    seen = plain.render(ABOVE, [PlacedLamp(pose, table, 0, 2.5)], 1, [], small.NO_AIR).surface_cd_m2[0]
    points, _, is_ground = small.points_on_ground(CAMERA, ABOVE)
    ways = pose.position_m - points
    lengths = np.linalg.norm(ways, axis=-1)
    intensities_cd = 2.5 * table.towards(pose.to_body(points))
    expected = intensities_cd / lengths**2 * (ways[..., 2] / lengths) * small.LAMBERT_ALBEDO / np.pi
    # Right at the table's border a rounding decides; not a tenth of a percent of the pixels lies there.
    error = np.abs(seen - expected)[is_ground] > 2e-3 * expected[is_ground] + 1e-7
    assert error.mean() < 1e-3
    assert (expected[is_ground] > 0).any()
    assert (expected[is_ground] == 0).any()


def test_shadow_has_its_edge_where_it_belongs() -> None:
    # A wall 1 m high, 10 m ahead; from a lamp 2 m high at x = 0 its shadow ends at x = 20.
    standing = small.quad([[10, -50, 0], [10, 50, 0], [10, 50, 1], [10, -50, 1]])
    static = joined([small.ground(), standing])
    pose = small.looking([10.5, 0.0, 8.0], pitch_deg=-45)
    seen = small.renderer(static).render(pose, [small.bulb([0, 0, 2])], 1, [], small.NO_AIR).surface_cd_m2[0]
    points, _, is_ground = small.points_on_ground(CAMERA, pose)
    x = points[..., 0]
    is_dark = is_ground & (x > 10.1) & (x < 19.9)
    is_lit = is_ground & (x > 20.05)
    assert is_dark.sum() > 1000
    assert is_lit.sum() > 1000
    assert not seen[is_dark].any()
    assert (seen[is_lit] > 0).all()


def test_light_is_linear_in_the_lamps() -> None:
    generator = np.random.default_rng(1)
    boxes = [small.box([*generator.uniform([6, -5], [30, 5]), 0.5], 0.5, "rail") for _ in range(6)]
    world = small.renderer(joined([small.ground("grass_ground"), *boxes]))
    positions = generator.uniform([3, -6, 0.5], [35, 6, 3], (3, 3))
    air = WeatherSpec(scattering_per_m=1e-3)
    apart = world.render(ABOVE, [small.bulb(position, layer) for layer, position in enumerate(positions)], 3, [], air)
    together = world.render(ABOVE, [small.bulb(position) for position in positions], 1, [], air)
    np.testing.assert_allclose(apart.surface_cd_m2.sum(0), together.surface_cd_m2[0], rtol=1e-4, atol=1e-7)
    np.testing.assert_allclose(apart.haze_cd_m2.sum(0), together.haze_cd_m2[0], rtol=1e-4, atol=1e-7)
    doubled = world.render(ABOVE, [small.bulb(position, 0, 2.0) for position in positions], 1, [], air)
    np.testing.assert_allclose(doubled.surface_cd_m2, 2 * together.surface_cd_m2, rtol=1e-4, atol=1e-7)
    alone = world.render(ABOVE, [small.bulb(positions[1], 1)], 2, [], air)
    np.testing.assert_array_equal(alone.surface_cd_m2[1], apart.surface_cd_m2[1])
    assert not alone.surface_cd_m2[0].any()


@pytest.mark.parametrize("distortion", [(0.0,) * 5, (-0.2, 0.06, 2e-3, -1e-3, 0.0)])
def test_a_small_target_is_where_the_camera_projects_it(distortion: tuple[float, ...]) -> None:
    seen_by = small.camera(160, 120, distortion)
    pose = small.looking([1.0, 2.0, 1.5], pitch_deg=3, yaw_deg=-8)
    fine = RenderSettings(12, 1.0, 1e-6, 1e-9, (8, 6, 4), 1e-9)
    centres = pose.to_outer(np.array([[10.0, 0.0, 0.0], [10.0, -3.0, 2.0], [10.0, 3.3, -2.4]]))
    # Squares that face the camera, four pixels wide.
    across = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]]) * 0.12 @ pose.rotation.T
    world = small.renderer(joined([small.quad(centre + across) for centre in centres]), seen_by, fine)
    light = world.render(pose, [small.bulb(pose.position_m)], 1, [], small.NO_AIR).surface_cd_m2[0]
    y, x = np.indices(light.shape) + 0.5
    for expected in seen_by.project(pose.to_body(centres)):
        near = np.where(np.maximum(np.abs(x - expected[0]), np.abs(y - expected[1])) < 8, light, 0.0)
        found = np.array([(near * x).sum(), (near * y).sum()]) / near.sum()
        assert np.abs(found - expected).max() < 0.1


def test_agrees_with_path_tracing(tmp_path: Path) -> None:
    """Mitsuba's own integrator, with all bounces, on a floor with boxes."""
    static = joined([small.ground(size_m=30), small.box([8, 1, 0.7], 0.7), small.box([10, -2, 0.5], 0.5)])
    lamp_m = np.array([2.0, -3.0, 3.0])
    seen = small.renderer(static).render(ABOVE, [small.bulb(lamp_m)], 1, [], small.NO_AIR)
    expected = path_traced(static, lamp_m, tmp_path)
    is_lit = expected > 0.02 * np.nanmax(expected)
    assert is_lit.sum() > 0.3 * np.isfinite(expected).sum()
    ratio = seen.surface_cd_m2[0][is_lit] / expected[is_lit]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.01)
    assert np.mean(np.abs(ratio - 1) < 0.1) > 0.98  # at shadow edges a rounding decides


PATH_TRACER = """
import sys
import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")
given = np.load(sys.argv[1])
shape = {"type": "ply", "filename": sys.argv[2], "face_normals": True}
shape["bsdf"] = {"type": "diffuse", "reflectance": {"type": "rgb", "value": float(given["albedo"])}}
lamp = {"type": "point", "position": given["lamp_m"].tolist(), "intensity": {"type": "rgb", "value": 1000.0}}
scene = mi.load_dict({"type": "scene", "shape": shape, "lamp": lamp})
integrator = mi.load_dict({"type": "path", "max_depth": 4})
sampler = mi.load_dict({"type": "independent"})
sampler.seed(0)


def luminance(direction):
    ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(*given["origin_m"]), mi.Vector3f(*direction)))
    return np.mean([integrator.sample(scene, sampler, ray)[0][1] for _ in range(4)])


np.save(sys.argv[3], np.array([luminance(direction) for direction in given["directions"]]))
"""
"""Run in a process of its own: a variant without Dr.Jit's kernels, which a running renderer cannot change to, and in
which LLVM has no part.
"""


def path_traced(static: Mesh, lamp_m: Floats, folder: Path) -> Floats:
    """Luminance of every fourth pixel in every fourth row, NaN elsewhere; shape (H, W)."""
    given, mesh, result = folder / "given.npz", folder / "mesh.ply", folder / "result.npy"
    y, x = np.indices((120, 160))[:, ::4, ::4].reshape(2, -1)
    directions = CAMERA.rays(np.stack([x, y], -1) + 0.5) @ ABOVE.rotation.T
    np.savez(given, origin_m=ABOVE.position_m, directions=directions, lamp_m=lamp_m, albedo=small.LAMBERT_ALBEDO)
    vertices = "\n".join("{} {} {}".format(*vertex) for vertex in static.vertices_m.tolist())
    faces = "\n".join("3 {} {} {}".format(*face) for face in static.faces.tolist())
    mesh.write_text(
        f"ply\nformat ascii 1.0\nelement vertex {len(static.vertices_m)}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(static.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
        f"{vertices}\n{faces}\n"
    )
    subprocess.run([sys.executable, "-c", PATH_TRACER, given, mesh, result], check=True)
    picture = np.full((120, 160), np.nan)
    picture[y, x] = np.load(result)
    return picture


def _leaves(num: int) -> Mesh:
    generator = np.random.default_rng(5)
    corners = generator.uniform([5, -8, 0], [40, 8, 4], (num, 1, 3)) + generator.normal(0, 0.15, (num, 3, 3))
    return surface(corners, np.arange(3 * num).reshape(-1, 3), material_number("leaf"))


def test_same_bytes_again_and_with_one_thread() -> None:
    static = joined([small.ground("road"), _leaves(8_000), small.wall(50, 10, "brick")])
    bodies = {"car/dark": small.box([0, 0, 0.7], 0.7, "paint_dark")}
    placed = [PlacedBody("car", False, small.looking([20, 1, 0]))]
    lamps = [small.bulb([0, 0.5, 1.0]), small.bulb([25, 2, 1.0], 1)]
    num_threads = dr.thread_count()
    pictures = []
    try:
        for threads in (2, 1):
            dr.set_thread_count(threads)
            world = small.renderer(static, settings=QUALITIES["training"], bodies=bodies)
            seen = world.render(ABOVE, lamps, 2, placed, WeatherSpec())
            again = world.render(ABOVE, lamps, 2, placed, WeatherSpec())
            assert seen.surface_cd_m2.tobytes() == again.surface_cd_m2.tobytes()
            layers = (
                seen.surface_cd_m2,
                seen.haze_cd_m2,
                seen.ambient_cd_m2,
                seen.depth_m,
                seen.materials,
                seen.bodies,
            )
            pictures.append(b"".join(layer.tobytes() for layer in layers))
    finally:
        dr.set_thread_count(num_threads)
    assert pictures[0] == pictures[1]


def test_no_lamps_and_no_layers(plain: Renderer) -> None:
    dark = plain.render(ABOVE, [], 2, [], WeatherSpec(sky_cd_m2=1e-3, scattering_per_m=0.0))
    assert dark.surface_cd_m2.shape == dark.haze_cd_m2.shape == (2, 120, 160)
    assert not dark.surface_cd_m2.any()
    assert not dark.haze_cd_m2.any()
    _, _, is_ground = small.points_on_ground(CAMERA, ABOVE)
    np.testing.assert_allclose(dark.ambient_cd_m2[:10], 1e-3, rtol=1e-5)
    np.testing.assert_allclose(dark.ambient_cd_m2[is_ground], 1e-3 * small.LAMBERT_ALBEDO, rtol=1e-3)
    nothing = plain.render(ABOVE, [], 0, [], WeatherSpec())
    assert nothing.surface_cd_m2.shape == nothing.haze_cd_m2.shape == (0, 120, 160)


def test_the_sky_glows_above_the_horizon() -> None:
    weather = WeatherSpec(sky_cd_m2=1e-3, glow_cd_m2=1e-2, scattering_per_m=0.0)
    level = small.looking([0, 0, 1.5])
    sky = small.renderer(joined([])).render(level, [], 1, [], weather).ambient_cd_m2
    assert sky[60, 80] == pytest.approx(1.1e-2, rel=0.05)
    assert (np.diff(sky[:60, 80]) > 0).all()
    dark = weather.model_copy(update={"sky_cd_m2": 0.0})
    np.testing.assert_allclose(
        sky - small.renderer(joined([])).render(level, [], 1, [], dark).ambient_cd_m2, 1e-3, rtol=1e-3
    )


def test_an_empty_world_is_all_sky() -> None:
    seen = small.renderer(joined([])).render(ABOVE, [small.bulb([5, 0, 1])], 1, [], small.NO_AIR)
    assert np.isnan(seen.depth_m).all()
    assert not seen.surface_cd_m2.any()


def test_bodies_are_seen_and_throw_shadows() -> None:
    bodies = {"car/light": small.box([0, 0, 0], 1.0), "car/dark": small.box([0, 0, 0], 0.5)}
    world = small.renderer(small.ground(), bodies=bodies)
    lamp = small.bulb([4.0, 0.0, 1.0])
    near = PlacedBody("car", True, small.looking([12, 0, 1.0], yaw_deg=30))
    far = PlacedBody("car", False, small.looking([18, -2, 0.5]))
    seen = world.render(ABOVE, [lamp], 1, [far, near], small.NO_AIR)
    assert set(np.unique(seen.bodies)) == {-1, 0, 1}
    centre = np.round(CAMERA.project(ABOVE.to_body(near.world_from_vehicle.position_m))).astype(int)
    assert seen.bodies[centre[1], centre[0]] == 1
    assert seen.surface_cd_m2[0][seen.bodies == 1].max() > 0
    without = world.render(ABOVE, [lamp], 1, [], small.NO_AIR)
    points, _, is_ground = small.points_on_ground(CAMERA, ABOVE)
    # The lamp is as high as the body's middle: its shadow never ends.
    behind = is_ground & (seen.bodies == -1) & (np.abs(points - [60, 0, 0]) < [15, 1, 1]).all(-1)
    assert behind.any()
    assert not seen.surface_cd_m2[0][behind].any()
    assert (without.surface_cd_m2[0][behind] > 0).all()
    assert (without.bodies == -1).all()


def test_is_visible() -> None:
    bodies = {"car/dark": small.box([0, 0, 0], 0.5)}
    world = small.renderer(small.wall(10, 2.0), bodies=bodies)
    placed = [PlacedBody("car", False, small.looking([5, y, 0])) for y in (0.0, 6.0)]
    # Through the first body; past everything; inside the second body; behind the wall; on the wall's own face.
    origins = np.array([[8.0, 0, 0], [8, 3, 0], [5, 6, 0], [12, 0, 0], [10, 1.9, 0]])
    target = np.array([0.0, 0.0, 0.0])
    assert world.is_visible(origins, target, []).tolist() == [True, True, True, False, True]
    assert world.is_visible(origins, target, placed).tolist() == [False, True, False, False, True]
    inside = world.is_visible(origins, target, placed, ignore_body=1)
    assert inside.tolist() == [False, True, True, False, True]
    assert world.is_visible(origins, target, placed, ignore_body=0).tolist() == [True, True, False, False, True]
    assert world.is_visible(np.zeros((0, 3)), target, placed).shape == (0,)


def test_more_samples_smooth_an_edge() -> None:
    lit = [small.bulb([0, 0, 0])]
    pose, static = small.looking([0, 0, 0]), small.wall(10, 1.003)
    few = small.renderer(static).render(pose, lit, 1, [], small.NO_AIR).surface_cd_m2[0]
    settings = RenderSettings(8, 1.0, 0.1, 1e-6, (8, 6, 4), 1e-9)
    many = small.renderer(static, settings=settings).render(pose, lit, 1, [], small.NO_AIR).surface_cd_m2[0]
    assert len(np.unique((few / few.max()).round(1)[60])) == 2
    edge = many[60][(many[60] > 0.05 * many.max()) & (many[60] < 0.95 * many.max())]
    assert len(edge) >= 2
    width_px = 2 * 1.003 / 10 * CAMERA.focal_px[0]
    assert many[60].sum() / many[60].max() == pytest.approx(width_px, abs=0.5)


def test_unknown_bodies_and_layers_are_errors(plain: Renderer) -> None:
    with pytest.raises(ValueError, match=r"lamps\[0\]\.layer: expected 0 to 1, got 2"):
        plain.render(ABOVE, [small.bulb([0, 0, 1], 2)], 2, [], small.NO_AIR)
    with pytest.raises(ValueError, match="got 'tram/dark'"):
        plain.render(ABOVE, [], 1, [PlacedBody("tram", False, Pose(np.zeros(3), np.eye(3)))], small.NO_AIR)
