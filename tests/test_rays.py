from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from foreglow.geometry import Camera, Pose, rotation
from foreglow.rays import RayCaster
from tests.distance.places import camera

PVDN_LIKE = Camera(
    1280,
    960,
    (1285.2, 1290.1),
    (639.77, 477.96),
    (-0.0285, 0.0114, 1.4e-4, -1.3e-4, 0.001),
    Pose(np.array([1.9, -0.1, 1.36]), rotation(0.01, -0.015, 0.002)),
)
STRONG = dataclasses.replace(PVDN_LIKE, distortion=(-0.25, 0.08, 1e-3, -1e-3, 0.0))
TINY = dataclasses.replace(PVDN_LIKE, width_px=3, height_px=2, centre_px=(1.77, 0.96))


@pytest.mark.parametrize("seen", [PVDN_LIKE, STRONG, camera(), TINY])
def test_rays_are_the_cameras(seen: Camera) -> None:
    pixels = np.random.default_rng(1).uniform((0, 0), (seen.width_px, seen.height_px), (500, 2))
    rays = RayCaster().cast(seen, pixels)
    assert rays.origin_m.tolist() == seen.vehicle_from_camera.position_m.tolist()
    exact = seen.rays(pixels) @ seen.vehicle_from_camera.rotation.T
    assert np.abs(rays.directions - exact).max() < 1e-8


def test_the_latest_camera_counts() -> None:
    """Same intrinsics in another place, other intrinsics, and back."""
    pixels = np.array([[10.0, 20.0], [1200.5, 900.5]])
    moved = dataclasses.replace(PVDN_LIKE, vehicle_from_camera=Pose(np.array([0.0, 0.0, 1.0]), rotation(0.5)))
    caster = RayCaster()
    for seen in (PVDN_LIKE, moved, STRONG, camera(), PVDN_LIKE):
        assert caster.cast(seen, pixels).directions.tolist() == RayCaster().cast(seen, pixels).directions.tolist()


def test_pitch_turns_the_body() -> None:
    rays = RayCaster().cast(PVDN_LIKE, np.array([[600.0, 500.0]]), 0.02, 0.003)
    body = Pose(np.zeros(3), rotation(pitch_rad=0.02))
    pitched = dataclasses.replace(PVDN_LIKE, vehicle_from_camera=body @ PVDN_LIKE.vehicle_from_camera)
    expected = RayCaster().cast(pitched, np.array([[600.0, 500.0]]))
    assert rays.directions == pytest.approx(expected.directions, abs=1e-15)
    assert rays.origin_m == pytest.approx(expected.origin_m)
    assert rays.pitch_sigma_rad == 0.003


def test_a_distortion_that_folds_is_an_error() -> None:
    folded = dataclasses.replace(PVDN_LIKE, distortion=(-3.0, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match=r"camera.distortion: expected one that can be undone .* at pixel \(0, 0\)"):
        RayCaster().cast(folded, np.zeros((1, 2)))


def test_no_pixels() -> None:
    assert RayCaster().cast(PVDN_LIKE, np.zeros((0, 2))).directions.shape == (0, 3)
