from __future__ import annotations

import pytest

from foreglow.datasets.pvdn.schema import EnvironmentLighting, StreetStyle, Weather
from foreglow.lab.simulation.scenes.scene import RoadSpec, Scene, WeatherSpec
from foreglow.lab.simulation.world.road import Road
from foreglow.lab.simulation.writing.pvdn_labels import is_crest, lighting, street_style, weather

LEFT_THEN_RIGHT = ((0.0, 0.0), (100.0, 0.01), (150.0, 0.0), (200.0, -0.01), (250.0, 0.0))


@pytest.mark.parametrize(
    ("curvature", "driven_m", "style"),
    [
        (((0.0, 0.0),), (0.0, 300.0), StreetStyle.STRAIGHT_STREET),
        (((0.0, 0.0009),), (0.0, 300.0), StreetStyle.STRAIGHT_STREET),
        (((0.0, 0.0), (50.0, 0.01), (100.0, 0.0)), (0.0, 300.0), StreetStyle.LEFT_TURN),
        (((0.0, 0.0), (50.0, -0.01), (100.0, 0.0)), (0.0, 300.0), StreetStyle.RIGHT_TURN),
        (((0.0, 0.004),), (0.0, 300.0), StreetStyle.LONG_LEFT_TURN),
        (((0.0, -0.004),), (0.0, 300.0), StreetStyle.LONG_RIGHT_TURN),
        (LEFT_THEN_RIGHT, (0.0, 300.0), StreetStyle.LEFT_RIGHT_TURN),
        (LEFT_THEN_RIGHT, (0.0, 150.0), StreetStyle.LEFT_TURN),
        (LEFT_THEN_RIGHT, (160.0, 300.0), StreetStyle.RIGHT_TURN),
        (tuple((s, -k) for s, k in LEFT_THEN_RIGHT), (0.0, 300.0), StreetStyle.RIGHT_LEFT_TURN),
        (((0.0, 0.0), (50.0, 0.002), (60.0, 0.0)), (0.0, 300.0), StreetStyle.STRAIGHT_STREET),
    ],
)
def test_the_course_of_a_road_in_pvdns_words(
    curvature: tuple[tuple[float, float], ...], driven_m: tuple[float, float], style: StreetStyle
) -> None:
    assert street_style(Road(RoadSpec(curvature_per_m=curvature)), driven_m) is style


@pytest.mark.parametrize(
    ("heights", "is_one"),
    [
        ((0.0, 0.0, 0.0), False),
        ((0.0, 8.0, 0.0), True),
        ((8.0, 0.0, 8.0), False),
        ((0.0, 20.0, 40.0), False),
    ],
)
def test_a_crest(heights: tuple[float, float, float], is_one: bool) -> None:
    elevation = tuple(zip((0.0, 150.0, 300.0), heights, strict=True))
    road = Road(RoadSpec(elevation_m=elevation))
    assert is_crest(road, (50.0, 250.0)) is is_one


@pytest.mark.parametrize(
    ("road", "air", "expected"),
    [
        (RoadSpec(), WeatherSpec(), Weather.DRY),
        (RoadSpec(wetness=0.6), WeatherSpec(), Weather.WET),
        (RoadSpec(snow=0.5), WeatherSpec(), Weather.SNOW),
        (RoadSpec(wetness=0.6), WeatherSpec(scattering_per_m=3e-3), Weather.FOG),
        (RoadSpec(wetness=0.6), WeatherSpec(scattering_per_m=3e-3, rain_mm_h=2.0), Weather.RAIN),
        (RoadSpec(), WeatherSpec(snow_mm_h=1.0, rain_mm_h=1.0), Weather.SNOW),
    ],
)
def test_weather(road: RoadSpec, air: WeatherSpec, expected: Weather) -> None:
    assert weather(Scene(road=road, weather=air)) is expected


@pytest.mark.parametrize(
    ("sky_cd_m2", "expected"),
    [(3e-4, EnvironmentLighting.DARK), (0.5, EnvironmentLighting.DUSK), (100.0, EnvironmentLighting.BRIGHT)],
)
def test_lighting(sky_cd_m2: float, expected: EnvironmentLighting) -> None:
    assert lighting(Scene(weather=WeatherSpec(sky_cd_m2=sky_cd_m2))) is expected
