"""Made-up drives that look like an approach: another car comes round a bend, its light ahead of it, and passes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats
from foreglow.lab.studies.glare.drive import DriverEye, GlareDrive, PolicyRun, RoadLight

RATE_HZ = 18.0
NUM_LEDS = 28
LED_AZIMUTHS_RAD = np.radians((np.arange(NUM_LEDS) - (NUM_LEDS - 1) / 2) * 1.25)
SPEED_MPS = 21.0
RESTORE_PER_S = 0.7


def approach(seed: int = 0, *, is_oncoming: bool = True, duration_s: float = 14.0) -> GlareDrive:
    """A vehicle that comes into sight and is passed, with the runs of all policies; each seed another bend."""
    rng = np.random.default_rng(seed)
    times_s = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    closing_mps = 2 * SPEED_MPS if is_oncoming else 0.5 * SPEED_MPS
    passing_s = duration_s * rng.uniform(0.62, 0.75)
    ranges_m = closing_mps * (passing_s - times_s)
    sight_s = passing_s - rng.uniform(110, 190) / closing_mps
    light_s = sight_s - rng.uniform(1.0, 2.2)
    bend = rng.uniform(4e-4, 9e-4) * rng.choice([-1.0, 1.0])
    with np.errstate(divide="ignore", invalid="ignore"):
        azimuths_rad = np.arctan2(3.5 if is_oncoming else 0.8, ranges_m) + 0.5 * bend * ranges_m
    is_known = (ranges_m > 4.0) & (ranges_m < 400.0)
    is_in_sight = is_known & (times_s >= sight_s)
    ranges_m, azimuths_rad = np.where(is_known, ranges_m, math.nan), np.where(is_known, azimuths_rad, math.nan)
    eye = _eye(1, ranges_m, azimuths_rad, is_in_sight, is_oncoming=is_oncoming)
    return GlareDrive(
        name=f"approach_{seed:02d}",
        scenario="curve",
        rate_hz=RATE_HZ,
        times_s=times_s,
        speeds_mps=np.full(len(times_s), SPEED_MPS),
        eyes=(eye,),
        road=_road(times_s, rng),
        runs=_runs(times_s, eye, light_s, sight_s, rng),
        light_s={1: light_s},
    )


def empty_drive(seed: int = 0, duration_s: float = 10.0) -> GlareDrive:
    """Nobody there; the paper's policy dims once, ours never."""
    rng = np.random.default_rng(1000 + seed)
    times_s = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    levels = {name: np.ones((len(times_s), 2, NUM_LEDS)) for name in ("high", "production", "foreglow", "oracle")}
    dimmed = np.ones((len(times_s), 2, NUM_LEDS))
    dimmed[40:76, :, 8:13] = 0.0
    levels |= {"paper": dimmed, "low": np.zeros_like(dimmed)}
    return GlareDrive(
        name=f"empty_{seed:02d}",
        scenario="straight",
        rate_hz=RATE_HZ,
        times_s=times_s,
        speeds_mps=np.full(len(times_s), SPEED_MPS),
        eyes=(),
        road=_road(times_s, rng),
        runs={name: PolicyRun.of(name, one) for name, one in levels.items()},
    )


def _eye(
    vehicle_id: int, ranges_m: Floats, azimuths_rad: Floats, is_in_sight: NDArray[np.bool_], *, is_oncoming: bool
) -> DriverEye:
    lateral = np.exp(-(((azimuths_rad[:, np.newaxis] - LED_AZIMUTHS_RAD) / math.radians(0.9)) ** 2))
    peaks_cd = 24_000.0 * np.exp(-0.5 * (LED_AZIMUTHS_RAD / math.radians(6.5)) ** 2) + 2_000.0
    leds_lx = np.where(is_in_sight[:, np.newaxis], lateral * peaks_cd / ranges_m[:, np.newaxis] ** 2, 0.0)
    base_lx = np.where(is_in_sight, 700.0 / ranges_m**2 * (1 + 0.2 * np.sin(ranges_m / 9)), 0.0)
    return DriverEye(
        vehicle_id=vehicle_id,
        kind="car",
        is_oncoming=is_oncoming,
        ranges_m=ranges_m,
        azimuths_rad=azimuths_rad,
        is_in_sight=is_in_sight,
        base_lx=base_lx,
        leds_lx=np.repeat(leds_lx[:, np.newaxis], 2, axis=1),
    )


def _road(times_s: Floats, rng: np.random.Generator) -> RoadLight:
    bumps = 1.0 + 0.1 * np.sin(times_s[:, np.newaxis] * 1.7 + rng.uniform(0, 6, 2))
    shares = np.exp(-0.5 * ((LED_AZIMUTHS_RAD - np.radians([[0.4], [-3.0]])) / math.radians(3.0)) ** 2)
    leds_lx = bumps[:, :, np.newaxis] * shares
    return RoadLight(4.0 * bumps, np.repeat(leds_lx[:, :, np.newaxis], 2, axis=2))


def _runs(
    times_s: Floats, eye: DriverEye, light_s: float, sight_s: float, rng: np.random.Generator
) -> dict[str, PolicyRun]:
    gaps = {
        "production": (sight_s + rng.uniform(0.35, 0.6), 1.6),
        "paper": (light_s + rng.uniform(0.5, 1.6), 1.4),
        "foreglow": (light_s + rng.uniform(0.3, 0.7), 1.5),
        "oracle": (light_s, 1.1),
    }
    runs = {"low": PolicyRun.of("low", np.zeros((len(times_s), 2, NUM_LEDS)))}
    runs["high"] = PolicyRun.of("high", np.ones((len(times_s), 2, NUM_LEDS)))
    for name, (begin_s, margin_deg) in gaps.items():
        runs[name] = _gap_run(name, times_s, eye, begin_s, math.radians(margin_deg))
    return runs


def _gap_run(name: str, times_s: Floats, eye: DriverEye, begin_s: float, margin_rad: float) -> PolicyRun:
    levels = np.ones((len(times_s), NUM_LEDS))
    gaps: list[list[list[float]]] = []
    for frame, time_s in enumerate(times_s):
        azimuth = eye.azimuths_rad[frame]
        has_gap = time_s >= begin_s and not math.isnan(azimuth)
        gaps.append([[azimuth - margin_rad, azimuth + margin_rad]] if has_gap else [])
        wanted = np.ones(NUM_LEDS)
        if has_gap:
            edge = (np.abs(LED_AZIMUTHS_RAD - azimuth) - margin_rad) / math.radians(0.8)
            wanted = np.clip(edge, 0.0, 1.0)
        before = levels[frame - 1] if frame else np.ones(NUM_LEDS)
        levels[frame] = np.minimum(wanted, before + RESTORE_PER_S / RATE_HZ)
    return PolicyRun.of(name, np.repeat(levels[:, np.newaxis], 2, axis=1), gaps)
