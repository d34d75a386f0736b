from __future__ import annotations

import numpy as np
import pytest

from foreglow.geometry import Pose
from foreglow.lab.simulation.camera.streaks import FallingParticles
from foreglow.lab.simulation.light.lamps import PlacedLamp
from foreglow.lab.simulation.scenes.scene import WeatherSpec
from foreglow.photometry import IntensityTable
from tests.lab.simulation.cameras import camera

CAMERA = camera()
GRID_DEG = np.linspace(-80.0, 80.0, 17)
TABLE = IntensityTable(GRID_DEG, GRID_DEG, np.full((17, 17), 1000.0, np.float32))


def pose(forward_m: float) -> Pose:
    return Pose(np.array([forward_m, 0.0, 1.3]), np.eye(3))


def lamps(forward_m: float) -> list[PlacedLamp]:
    return [PlacedLamp(Pose(np.array([forward_m, side, 0.7]), np.eye(3)), TABLE, 0) for side in (-0.6, 0.6)]


def drawn(
    snow: float = 0.0, rain: float = 0.0, exposure_s: float = 0.02, speed_mps: float = 20.0, seed: int = 1
) -> np.ndarray:
    particles = FallingParticles(WeatherSpec(snow_mm_h=snow, rain_mm_h=rain), CAMERA, seed)
    poses = pose(10.0), pose(10.0 + speed_mps * exposure_s)
    return particles.luminance(0.5, exposure_s, poses, lamps(10.0))


def test_nothing_falls() -> None:
    assert not drawn().any()


def test_no_lamps_no_streaks() -> None:
    particles = FallingParticles(WeatherSpec(snow_mm_h=1.0), CAMERA, 1)
    assert not particles.luminance(0.0, 0.02, (pose(0), pose(0.4)), []).any()


@pytest.mark.parametrize("kind", ["snow", "rain"])
def test_more_falls_more_is_seen(kind: str) -> None:
    rates = [(rate, 0.0) if kind == "snow" else (0.0, rate) for rate in (0.1, 0.5, 2.0)]
    lit = [(drawn(snow, rain) > 1e-3).mean() for snow, rain in rates]
    assert lit[0] < lit[1] < lit[2]


def test_deterministic() -> None:
    assert (drawn(snow=1.0) == drawn(snow=1.0)).all()
    assert (drawn(snow=1.0) != drawn(snow=1.0, seed=2)).any()


def test_longer_exposure_makes_longer_streaks_of_the_same_light() -> None:
    short, long = (drawn(snow=0.3, exposure_s=time_s, speed_mps=4.0) for time_s in (1e-4, 0.03))
    assert (long > 1e-3).sum() > 1.5 * (short > 1e-3).sum()
    assert long.sum() == pytest.approx(short.sum(), rel=0.3)  # it leaves and enters the image, and comes nearer


def test_linear_in_the_lamps() -> None:
    particles = FallingParticles(WeatherSpec(snow_mm_h=1.0), CAMERA, 1)
    poses = pose(10.0), pose(10.4)
    left, right = lamps(10.0)
    apart = sum(particles.luminance(0.5, 0.02, poses, [lamp]) for lamp in (left, right))
    both = particles.luminance(0.5, 0.02, poses, [left, right])
    np.testing.assert_allclose(both, apart, rtol=1e-3, atol=1e-3)  # streaks that are too faint are left out


def test_particles_stay_in_the_world_while_we_pass() -> None:
    """Standing still, a moment later the same flakes are a little lower; after a while none is where it was."""
    particles = FallingParticles(WeatherSpec(snow_mm_h=0.2), CAMERA, 3)
    images = [particles.luminance(time_s, 1e-4, (pose(0), pose(0)), lamps(0)) for time_s in (0.0, 0.002, 3.0)]
    now, soon, late = (np.minimum(image, 0.1).ravel() for image in images)
    assert np.corrcoef(now, soon)[0, 1] > 0.8
    assert np.corrcoef(now, late)[0, 1] < 0.3


def test_streaks_point_away_from_where_we_drive() -> None:
    image = np.log(drawn(snow=0.5, speed_mps=40.0) + 1e-2)
    down, right = np.gradient(image)
    rows, columns = np.mgrid[:240, :320] - np.array([119.5, 159.5])[:, np.newaxis, np.newaxis]
    radii = np.hypot(rows, columns)
    along, across = (down * rows + right * columns) / radii, (right * rows - down * columns) / radii
    is_outside = radii > 40
    assert (across[is_outside] ** 2).sum() > 3 * (along[is_outside] ** 2).sum()


def test_surfaces_hide_what_is_behind() -> None:
    particles = FallingParticles(WeatherSpec(snow_mm_h=1.0), CAMERA, 1)
    poses = pose(10.0), pose(10.0)
    wall = np.full((240, 320), np.nan, np.float32)
    wall[:, :160] = 0.1
    image = particles.luminance(0.5, 1e-4, poses, lamps(10.0), wall)
    assert image[:, :155].max() < 1e-3 < image[:, 165:].max()
    assert (drawn(snow=1.0, exposure_s=1e-4, speed_mps=0.0)[:, 165:] == image[:, 165:]).mean() > 0.99


def test_large_flakes_are_seen_further_away_than_small_ones() -> None:
    particles = FallingParticles(WeatherSpec(snow_mm_h=1.0), CAMERA, 1)
    small, large, _ = (swarm.range_m for swarm in particles.swarms)
    assert large > 1.5 * small


def test_streaks_of_flakes_are_dashed_and_those_of_drops_are_not() -> None:
    snow, rain = (
        FallingParticles(weather, CAMERA, 1).swarms[number].particles.tumbling[:, 0]
        for weather, number in ((WeatherSpec(snow_mm_h=1.0), 0), (WeatherSpec(rain_mm_h=1.0), 2))
    )
    assert 0.3 < snow.mean() < 0.6
    assert not rain.any()
