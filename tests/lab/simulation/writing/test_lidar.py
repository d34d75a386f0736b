from __future__ import annotations

import numpy as np
import pytest

from foreglow.datasets.simulated.files import decoded_depth_m
from foreglow.geometry import Camera, Floats, Pose, rotation
from foreglow.lab.simulation.writing.lidar import LidarConfig, lidar_depth, scan_pixels

PLAIN = LidarConfig(noise_m=0.0, near_loss=0.0, far_loss=0.0)


def camera(width_px: int = 320, height_px: int = 240, pitch_deg: float = -0.7, yaw_deg: float = 0.0) -> Camera:
    turned = rotation(np.radians(yaw_deg), np.radians(pitch_deg))
    focal = 328.0 * width_px / 320
    mount = Pose(np.array([1.9, 0.0, 1.3]), turned)
    return Camera(width_px, height_px, (focal, focal), (width_px / 2, height_px / 2), (-0.05, 0.02, 0, 0, 0), mount)


def plane_depth_m(given: Camera) -> Floats:
    """Distance to the road's plane along the ray of each pixel's centre; NaN above the horizon."""
    x, y = np.meshgrid(np.arange(given.width_px) + 0.5, np.arange(given.height_px) + 0.5)
    directions = given.rays(np.stack([x, y], -1)) @ given.vehicle_from_camera.rotation.T
    down = -directions[..., 2]
    return np.where(down > 1e-6, given.vehicle_from_camera.position_m[2] / np.maximum(down, 1e-6), np.nan)


def test_echoes_of_a_plane_are_where_rings_cross_pixels() -> None:
    single = camera()
    exact = plane_depth_m(single)
    found = decoded_depth_m(lidar_depth(exact, single, np.random.default_rng(0), PLAIN))
    is_echo = np.isfinite(found)
    np.testing.assert_allclose(found[is_echo], exact[is_echo], atol=0.5 / 256 + 1e-9)
    expected = np.zeros_like(is_echo)
    pixels = scan_pixels(single, PLAIN)
    expected[pixels[:, 1], pixels[:, 0]] = True
    np.testing.assert_array_equal(is_echo, expected & (exact <= 200.0))
    assert 500 < is_echo.sum() < 10_000


def test_a_ring_on_a_plane_is_a_circle_around_us() -> None:
    config = LidarConfig(num_rings=1, lowest_deg=-5.0, highest_deg=-5.0, noise_m=0.0, near_loss=0.0, far_loss=0.0)
    single = camera(640, 480)
    found = decoded_depth_m(lidar_depth(plane_depth_m(single), single, np.random.default_rng(0), config))
    distances = found[np.isfinite(found)]
    assert len(distances) > 200
    np.testing.assert_allclose(distances, 1.3 / np.sin(np.radians(5.0)), rtol=0.03)


def test_shots_are_spread_as_configured() -> None:
    config = LidarConfig(num_rings=3, lowest_deg=-2.0, highest_deg=0.0, azimuth_step_deg=0.5)
    single = camera(1280, 960, yaw_deg=20.0)
    directions = single.rays(scan_pixels(single, config) + 0.5) @ single.vehicle_from_camera.rotation.T
    elevations = np.degrees(np.arcsin(directions[:, 2]))
    azimuths = np.degrees(np.arctan2(directions[:, 1], directions[:, 0]))
    assert np.abs(elevations - np.round(elevations)).max() < 0.04
    assert set(np.round(elevations)) == {-2.0, -1.0, 0.0}
    assert np.abs(azimuths * 2 - np.round(azimuths * 2)).max() < 0.08
    assert np.median(azimuths) == pytest.approx(20.0, abs=0.5)
    assert (azimuths.min(), azimuths.max()) == pytest.approx((-6.0, 46.0), abs=1.0)


def test_noise_and_losses_grow_as_they_say() -> None:
    single = camera(1280, 960)
    config = LidarConfig(near_loss=0.1, far_loss=0.6)
    num_shots = len(scan_pixels(single, config))
    for distance_m, loss in ((20.0, 0.105), (100.0, 0.225), (199.9, 0.6)):
        depth = np.full((960, 1280), distance_m, np.float32)
        found = decoded_depth_m(lidar_depth(depth, single, np.random.default_rng(4), config))
        distances = found[np.isfinite(found)]
        assert len(distances) / num_shots == pytest.approx(1 - loss, abs=0.02)
        assert distances.mean() == pytest.approx(distance_m, abs=0.002)
        assert distances.std() == pytest.approx(0.02, rel=0.05)


def test_nothing_comes_back_from_the_sky_and_from_beyond() -> None:
    single = camera()
    for depth_m in (np.nan, 200.5, np.inf):
        depth = np.full((240, 320), depth_m, np.float32)
        assert not lidar_depth(depth, single, np.random.default_rng(0)).any()


def test_the_nearest_of_several_echoes_stays() -> None:
    single = camera(64, 48)
    config = LidarConfig(num_rings=400, azimuth_step_deg=0.05, noise_m=0.5, near_loss=0.0, far_loss=0.0)
    depth = np.full((48, 64), 50.0, np.float32)
    found = decoded_depth_m(lidar_depth(depth, single, np.random.default_rng(0), config))
    middle = found[10:40, 10:50]
    assert middle.max() < 50.0
    assert middle.mean() < 49.0


def test_the_same_generator_gives_the_same_image() -> None:
    alone, depth = camera(), np.full((240, 320), 30.0, np.float32)
    first = lidar_depth(depth, alone, np.random.default_rng(7))
    assert first.dtype == np.uint16
    np.testing.assert_array_equal(first, lidar_depth(depth, alone, np.random.default_rng(7)))
    assert (first != lidar_depth(depth, alone, np.random.default_rng(8))).any()


def test_a_depth_image_of_another_size() -> None:
    with pytest.raises(ValueError, match=r"depth_m: expected shape \(240, 320\), got \(320, 240\)"):
        lidar_depth(np.zeros((320, 240), np.float32), camera(), np.random.default_rng(0))
