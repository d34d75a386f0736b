"""The haze against an integral along the ray, and at the edges of what stands in it."""

from __future__ import annotations

import numpy as np
import pytest

from foreglow.geometry import Floats
from foreglow.lab.simulation.light.render import Renderer, RenderSettings
from foreglow.lab.simulation.light.shading import FAR_M, NEAR_M
from foreglow.lab.simulation.scenes.scene import WeatherSpec
from foreglow.lab.simulation.world.mesh import joined
from tests.lab.simulation.light import rendering as small

pytestmark = pytest.mark.renderer

CAMERA = small.camera()
AIR = WeatherSpec(scattering_per_m=2e-3, asymmetry=0.7, sky_cd_m2=0.0)
SETTINGS = RenderSettings(extra_samples=0, haze_cells=(41, 31, 24), darkest_cd_m2=1e-9)
POSE = small.looking([0.0, 0.0, 1.5])


def integral(lamp_m: Floats, row: int, column: int, end_m: float) -> float:
    """Luminance that 1000 cd scatter into a pixel's ray, cd/m^2: brute force in steps of a centimetre."""
    direction = POSE.rotation @ CAMERA.rays([column + 0.5, row + 0.5])
    along = np.arange(NEAR_M, end_m, 0.01) + 0.005
    ways = lamp_m - (POSE.position_m + along[:, None] * direction)
    lengths = np.linalg.norm(ways, axis=1)
    cosines = (ways @ direction) / lengths
    phase = (1 - 0.49) / (4 * np.pi * (1 + 0.49 - 1.4 * cosines) ** 1.5)
    return float(np.sum(1000 / lengths**2 * 2e-3 * phase * np.exp(-2e-3 * (along + lengths))) * 0.01)


@pytest.mark.parametrize("lamp_m", [[60.0, 8.0, 3.0], [0.5, 3.0, 0.6], [25.0, -4.0, 2.0]])
def test_equals_the_integral_along_the_ray(lamp_m: list[float]) -> None:
    seen = small.renderer(joined([]), settings=SETTINGS).render(POSE, [small.bulb(lamp_m)], 1, [], AIR)
    for row, column in ((20, 30), (60, 80), (100, 40), (50, 140)):
        expected = integral(np.array(lamp_m), row, column, FAR_M)
        assert seen.haze_cd_m2[0, row, column] == pytest.approx(expected, rel=0.08)


@pytest.fixture(scope="module")
def half_hidden() -> Renderer:
    """A wall 10 m ahead that covers the left half of the picture."""
    static = small.quad([[10, 0, -50], [10, 50, -50], [10, 50, 50], [10, 0, 50]])
    return small.renderer(static, settings=SETTINGS)


def test_does_not_bleed_over_an_edge(half_hidden: Renderer) -> None:
    # Lit from the camera's side: no shadows, only depths differ.
    lamp_m = np.array([-1.0, -2.0, 1.0])
    haze = half_hidden.render(POSE, [small.bulb(lamp_m)], 1, [], AIR).haze_cd_m2[0]
    for row in (30, 60, 90):
        length = 1 / CAMERA.rays([79.5, row + 0.5])[0]
        assert haze[row, 79] == pytest.approx(integral(lamp_m, row, 79, 10 * length), rel=0.03)
        assert haze[row, 80] > 1.05 * haze[row, 79]


def test_has_shadows(half_hidden: Renderer) -> None:
    # A lamp behind the wall shines into the free half only beyond the wall's edge.
    lamp_m = np.array([20.0, 10.0, 1.5])
    haze = half_hidden.render(POSE, [small.bulb(lamp_m)], 1, [], AIR).haze_cd_m2[0]
    free = small.renderer(joined([]), settings=SETTINGS).render(POSE, [small.bulb(lamp_m)], 1, [], AIR).haze_cd_m2[0]
    # Not quite dark before the wall: the step that ends behind it counts in part.
    assert (haze[60, :76] < 0.1 * free[60, :76]).all()
    assert 0.1 * free[60, 130] < haze[60, 130] < 0.9 * free[60, 130]


def test_clear_air_scatters_nothing(half_hidden: Renderer) -> None:
    assert not half_hidden.render(POSE, [small.bulb([5, -1, 1])], 1, [], small.NO_AIR).haze_cd_m2.any()
