"""Random numbers as scenarios need them, and what drives draw with them: weather, camera, sensor, what is far away."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from foreglow.lab.simulation.scenes.scene import CameraSpec, SensorSpec, WeatherSpec
from foreglow.lab.simulation.scenes.surroundings import Settlement
from foreglow.numbers import checked_whole

Value = TypeVar("Value")


class Draw:
    """Draws from a seed; numbers are rounded, so that a scene is readable and the same after TOML and JSON."""

    def __init__(self, *seeds: int) -> None:
        """Starts the stream of the given seeds, such as the data set's seed and the number of the scene.

        Raises:
            ValueError: If one is no whole number of at least 0, or one that no scene can have.
        """
        self._rng = np.random.default_rng([checked_whole("seed", seed) for seed in seeds])

    def uniform(self, low: float, high: float) -> float:
        """Between `low` and `high`."""
        return self._rounded(self._rng.uniform(low, high))

    def log_uniform(self, low: float, high: float) -> float:
        """Between `low` and `high`, uniform in the logarithm."""
        return self._rounded(np.exp(self._rng.uniform(np.log(low), np.log(high))))

    def normal(self, mean: float, deviation: float, limit: float = 2.5) -> float:
        """Gaussian, clipped at `limit` standard deviations."""
        return self._rounded(mean + deviation * float(np.clip(self._rng.normal(), -limit, limit)))

    def integer(self, low: int, high: int) -> int:
        """From `low` to `high`, both included."""
        return int(self._rng.integers(low, high + 1))

    def chance(self, probability: float) -> bool:
        """True with this probability."""
        return bool(self._rng.random() < probability)

    def choice(self, values: Sequence[Value], weights: Sequence[float] | None = None) -> Value:
        """One of `values`, with probabilities proportional to `weights`."""
        shares = None if weights is None else np.array(weights) / np.sum(weights)
        return values[int(self._rng.choice(len(values), p=shares))]

    @staticmethod
    def _rounded(value: float) -> float:
        return float(f"{value:.5g}")


WEATHERS = {"dry": 0.55, "wet": 0.2, "rain": 0.1, "snow": 0.08, "mist": 0.07}
"""Kinds of weather with their shares."""


def draw_weather(draw: Draw, *, is_even: bool = False) -> tuple[WeatherSpec, float]:
    """The weather, and how wet the road is; `is_even` draws all kinds alike."""
    kind = draw.choice(list(WEATHERS), None if is_even else list(WEATHERS.values()))
    haze = {
        "dry": (5e-5, 3e-4),
        "wet": (1e-4, 6e-4),
        "rain": (2e-4, 1e-3),
        "snow": (4e-4, 1.5e-3),
        "mist": (1e-3, 4e-3),
    }
    weather = WeatherSpec(
        scattering_per_m=draw.log_uniform(*haze[kind]),
        rain_mm_h=draw.log_uniform(0.5, 8.0) if kind == "rain" else 0.0,
        snow_mm_h=draw.log_uniform(0.3, 3.0) if kind == "snow" else 0.0,
        sky_cd_m2=draw.log_uniform(1e-4, 5e-3),
    )
    wetness = {"dry": 0.0, "wet": draw.uniform(0.3, 1.0), "rain": draw.uniform(0.6, 1.0)}
    return weather, wetness.get(kind, draw.uniform(0.0, 0.4))


def draw_settlements(draw: Draw, length_m: float) -> tuple[tuple[Settlement, ...], float]:
    """Places in the distance, ahead of us and beside a road of this length, and the glow that they make above it."""
    if draw.chance(0.35):
        return (), 0.0
    settlements = [
        Settlement(
            side=draw.choice(["left", "right"]),
            s_m=round(length_m + draw.log_uniform(100.0, 2500.0), 1),
            offset_m=draw.uniform(0.0, 200.0),
            size_m=(draw.uniform(300.0, 1500.0), draw.log_uniform(150.0, 1200.0)),
            height_m=draw.log_uniform(10.0, 90.0),
            num_lamps=draw.integer(15, 90),
            intensity_cd=draw.log_uniform(150.0, 900.0),
        )
    ]
    settlements += [
        Settlement(  # beside the road, nearer and smaller
            side=draw.choice(["left", "right"]),
            s_m=round(draw.uniform(0.4, 1.0) * length_m, 1),
            offset_m=draw.uniform(120.0, 400.0),
            size_m=(draw.uniform(80.0, 300.0), draw.uniform(60.0, 200.0)),
            height_m=draw.log_uniform(6.0, 20.0),
            num_lamps=draw.integer(4, 25),
            intensity_cd=draw.log_uniform(50.0, 400.0),
        )
        for _ in range(draw.integer(0, 2))
    ]
    return tuple(settlements), draw.log_uniform(2e-3, 4e-2)


def draw_camera(draw: Draw) -> CameraSpec:
    """A calibration and a mount around those of PVDN's camera."""
    return CameraSpec(
        focal_px=draw.normal(1312.0, 50.0),
        centre_px=(draw.normal(640.0, 6.0), draw.normal(480.0, 6.0)),
        distortion=(
            draw.normal(-0.05, 0.02),
            draw.normal(0.02, 0.01),
            draw.normal(0.0, 3e-4),
            draw.normal(0.0, 3e-4),
            0.0,
        ),
        mount_m=(draw.uniform(1.7, 2.1), draw.normal(0.0, 0.05), draw.uniform(1.2, 1.45)),
        pitch_deg=draw.normal(-0.7, 0.4),
        yaw_deg=draw.normal(0.0, 0.3),
        roll_deg=draw.normal(0.0, 0.2),
    )


def draw_sensor(draw: Draw) -> SensorSpec:
    """Draws around the figures of the one lossless real frame."""
    return SensorSpec(
        grey_per_cd_m2=draw.log_uniform(38.0, 66.0),
        night_gain=draw.log_uniform(6.0, 11.0),
        black_level=draw.normal(7.6, 0.8),
        knee=draw.normal(38.0, 3.0),
        log_slope=draw.normal(14.0, 1.5),
        read_noise=draw.normal(1.35, 0.15),
        shot_noise=draw.log_uniform(0.038, 0.066),
        column_noise=draw.log_uniform(0.7, 1.3),
        core_px=draw.normal(0.8, 0.08),
        middle_share=draw.uniform(0.18, 0.32),
        middle_px=draw.log_uniform(0.5, 1.2),
        tail_share=draw.log_uniform(8e-3, 2.2e-2),
    )
