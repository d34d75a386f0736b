from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foreglow.lab.simulation.camera.sensor import Sensor
from foreglow.lab.simulation.scenes.scene import SensorSpec
from tests.lab.simulation.cameras import camera

SPEC = SensorSpec(vignetting=0.0)
SENSOR = Sensor(SPEC, camera(), seed=5)
NIGHT = Sensor(SPEC.model_copy(update={"exposure": "night"}), camera(), seed=5)
DARK = np.zeros((240, 320), np.float32)


def even(luminance_cd_m2: float) -> np.ndarray:
    return np.full((240, 320), luminance_cd_m2, np.float32)


def expected(luminance_cd_m2: float, sensor: Sensor = SENSOR) -> float:
    return float(sensor.expected_grey(even(luminance_cd_m2))[120, 160])


def test_linear_below_the_knee_with_the_stated_slope() -> None:
    assert expected(0.0) == pytest.approx(SPEC.black_level)
    for luminance in (0.01, 0.1, 0.39):
        assert expected(luminance) == pytest.approx(SPEC.black_level + SPEC.grey_per_cd_m2 * luminance, rel=1e-5)


def test_logarithmic_above_the_knee() -> None:
    assert expected(100.0 * math.e) - expected(100.0) == pytest.approx(SPEC.log_slope, rel=0.01)
    assert expected(1e12) == 255


@given(st.floats(0, 1e6), st.floats(1.001, 100))
def test_more_light_is_never_darker(luminance: float, factor: float) -> None:
    assert expected(luminance * factor) >= expected(luminance)


def test_night_collects_more() -> None:
    assert expected(0.01, NIGHT) - SPEC.black_level == pytest.approx(
        SPEC.night_gain * (expected(0.01) - SPEC.black_level), rel=1e-4
    )
    assert (SENSOR.exposure_s, NIGHT.exposure_s) == (SPEC.day_exposure_s, SPEC.night_exposure_s)
    assert NIGHT.noise_grey(DARK)[0, 0] > 2 * SENSOR.noise_grey(DARK)[0, 0]


def test_same_seed_same_bytes_and_other_frames_other_noise() -> None:
    light = even(0.1)
    again = Sensor(SPEC, camera(), seed=5)
    assert (SENSOR.capture(light, 3) == again.capture(light, 3)).all()
    assert (SENSOR.capture(light, 3) != SENSOR.capture(light, 4)).mean() > 0.2
    assert (SENSOR.capture(light, 3) != Sensor(SPEC, camera(), seed=6).capture(light, 3)).mean() > 0.5


@pytest.fixture(scope="module")
def dark_frames() -> np.ndarray:
    sensor = Sensor(SPEC, camera(1280, 320), seed=2)
    return np.stack([sensor.capture(np.full((320, 1280), 0.02, np.float32), frame) for frame in range(8)]).astype(float)


def test_the_pattern_stays_while_the_noise_changes(dark_frames: np.ndarray) -> None:
    first, second = dark_frames[:4].mean((0, 1)), dark_frames[4:].mean((0, 1))
    assert np.corrcoef(first, second)[0, 1] > 0.99
    noises = dark_frames - dark_frames.mean(0)
    assert abs(np.corrcoef(noises[0].ravel(), noises[1].ravel())[0, 1]) < 0.2
    assert first.std() > 1.0


def test_noise_is_as_stated(dark_frames: np.ndarray) -> None:
    stated = float(Sensor(SPEC, camera(1280, 320), seed=2).noise_grey(np.full((320, 1280), 0.02, np.float32))[5, 5])
    assert dark_frames.std(0, ddof=1).mean() == pytest.approx(stated, rel=0.05)


@pytest.mark.slow
def test_noise_is_correlated_as_in_the_real_frame(dark_frames: np.ndarray) -> None:
    noises = dark_frames - dark_frames.mean(0)
    for first, second, real in (
        (noises[:, :, :-1], noises[:, :, 1:], 0.34),
        (noises[:, :-1], noises[:, 1:], 0.33),
        (noises[:, :-1, :-1], noises[:, 1:, 1:], 0.22),
    ):
        assert np.corrcoef(first.ravel(), second.ravel())[0, 1] == pytest.approx(real, abs=0.06)


def test_even_and_odd_rows_have_patterns_of_their_own(dark_frames: np.ndarray) -> None:
    even_rows, odd_rows = (dark_frames[:, start::2].mean((0, 1)) for start in (0, 1))
    assert (even_rows - odd_rows).std() / 2 == pytest.approx(0.555, rel=0.2)


def test_column_noise_scales_and_switches_off() -> None:
    without = Sensor(SPEC.model_copy(update={"column_noise": 0.0}), camera(), seed=5)
    assert without.pattern_grey.mean(0).std() < 0.2 < SENSOR.pattern_grey.mean(0).std()


def test_half_the_size_gives_the_same_grey_with_less_noise() -> None:
    full, half = (Sensor(SPEC, camera(*size), seed=1) for size in ((1280, 960), (640, 480)))
    light = np.full((960, 1280), 0.3, np.float32)
    light[:480] = 0.05
    greys = full.expected_grey(full.optics.spread(light)), half.expected_grey(half.optics.spread(light[::2, ::2]))
    for row in (0.2, 0.8):
        assert greys[1][int(480 * row), 320] == pytest.approx(greys[0][int(960 * row), 640], abs=0.05)
    noises = [
        float(sensor.noise_grey(light[: 960 // step, : 1280 // step])[0, 0]) for sensor, step in ((full, 1), (half, 2))
    ]
    assert noises[1] < 0.7 * noises[0]


def test_capture_is_around_what_is_expected() -> None:
    light = even(0.3)
    kept = light.copy()
    mean = np.mean([SENSOR.capture(light, frame).mean() for frame in range(4)])
    assert mean == pytest.approx(SENSOR.expected_grey(light).mean() + SENSOR.pattern_grey.mean(), abs=0.3)
    assert (light == kept).all()
    image = SENSOR.capture(light, 0)
    assert image.dtype == np.uint8
    assert image.shape == (240, 320)


def test_coarse_grain_has_the_same_variance_and_more_correlation() -> None:
    full = camera(1280, 960)
    seen = {}
    for grain_px in (0.0, 1.25):
        spec = SPEC.model_copy(update={"grain_px": grain_px, "read_noise": 6.0, "black_level": 60.0})
        sensor = Sensor(spec, full, seed=5)
        light = np.zeros((960, 1280), np.float32)
        noise = np.subtract(sensor.capture(light, 1), sensor.capture(light, 2), dtype=np.float64) / 2.0**0.5
        noise -= noise.mean()
        seen[grain_px] = noise.std(), (noise[:, 1:] * noise[:, :-1]).mean() / noise.var()
    assert seen[1.25][0] == pytest.approx(seen[0.0][0], rel=0.03)
    assert seen[1.25][1] > seen[0.0][1] + 0.3


def test_coarse_grain_is_averaged_away_less_in_small_images() -> None:
    spec = SPEC.model_copy(update={"grain_px": 2.0, "row_noise": 0.0})
    coarse, fine = (
        Sensor(changed, camera(), seed=5).noise_grey(DARK)[0, 0]
        for changed in (spec, spec.model_copy(update={"grain_px": 0.0}))
    )
    assert coarse > 1.5 * fine


def test_rows_have_more_noise_in_common_where_asked() -> None:
    def row_noise(factor: float) -> float:
        sensor = Sensor(SPEC.model_copy(update={"row_noise": factor, "black_level": 60.0}), camera(), seed=5)
        return float(np.subtract(sensor.capture(DARK, 1), sensor.capture(DARK, 2), dtype=np.float64).mean(1).std())

    assert row_noise(10.0) > 5.0 * row_noise(1.0)
