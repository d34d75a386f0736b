"""Built-in intensity tables: smooth functions of the angles, shaped to meet the regulations' test points.

They are not those of any real lamp. The headlamps have what UN R112/R149 allow: a flat hot spot below the cut-off, a
wide carpet of light, and stray light from the lens in all directions, which makes a lamp visible from the side. The
test points come from public notes of the regulations; the tests check the tables against them.
"""

from __future__ import annotations

from functools import cache, lru_cache

import numpy as np

from foreglow.geometry import Floats
from foreglow.numbers import checked_number
from foreglow.photometry.intensity import IntensityTable

HEADLAMP_AZIMUTHS_DEG = np.linspace(-90.0, 90.0, 721)
HEADLAMP_ELEVATIONS_DEG = np.linspace(-30.0, 30.0, 601)
SIGNAL_AZIMUTHS_DEG = np.linspace(-90.0, 90.0, 181)
SIGNAL_ELEVATIONS_DEG = np.linspace(-45.0, 45.0, 91)
HEMISPHERE_DEG = np.linspace(-90.0, 90.0, 181)

CUT_OFF_DEG = -0.57
"""Elevation of the cut-off left of the kink: 1 % below the horizon (UN R112, aim of the passing beam)."""

CUT_OFF_SLOPE = np.tan(np.radians(15.0))
"""The right arm of the cut-off rises by 15 degrees (UN R112)."""

CUT_OFF_ARM_DEG = 3.8
"""Angle to the right at which the rising arm becomes level again, so that signs and trees there are not too bright."""

CUT_OFF_WIDTH_DEG = 0.12
"""Softness of the cut-off: the intensity falls by a factor e over this angle, as in measured lamps (0.1 to 0.2)."""

FOREGROUND_DEG = 5.0
"""Depth below the cut-off at which the foreground of lamps with little wide light ends."""


def low_beam(carpet: float = 1.0, stray: float = 1.0) -> IntensityTable:
    """The asymmetric European passing beam for right-hand traffic; one lamp, about 1,000 lm.

    Below the cut-off a hot spot, right of the kink, and a carpet of light 40 degrees wide; above it about 200 cd of
    stray light, which falls off slowly to the side. `carpet` is a factor on the wide light; below 1, the foreground
    is darker, too: with 0.4, an old lamp of UN R112's class A, the road beside us and right before us is dark. `stray`
    is a factor on the stray light: snow and slush on a lamp scatter several times as much light above the cut-off.

    Raises:
        ValueError: If `carpet` is no number above 0 up to 1, or `stray` none from 0 to 100.
    """
    carpet, stray = checked_number("carpet", carpet), checked_number("stray", stray)
    if not 0.0 < carpet <= 1.0:
        raise ValueError(f"carpet: expected a number above 0, up to 1, got {carpet:g}")
    if not 0.0 <= stray <= 100.0:
        raise ValueError(f"stray: expected a number from 0 to 100, got {stray:g}")
    return _low_beam(carpet, stray)


@lru_cache(maxsize=16)
def _low_beam(carpet: float, stray: float) -> IntensityTable:
    azimuths, elevations = np.meshgrid(HEADLAMP_AZIMUTHS_DEG, HEADLAMP_ELEVATIONS_DEG)
    right = -azimuths
    cut_off = CUT_OFF_DEG + CUT_OFF_SLOPE * np.clip(right, 0.0, CUT_OFF_ARM_DEG)
    depth = np.clip(CUT_OFF_DEG - elevations, 0.0, None)
    hot_spot_width = np.where(right < 1.5, 3.2, 5.5)  # narrower where the oncoming driver is
    hot_spot = 26_000.0 * np.exp(-0.5 * ((right - 1.5) / hot_spot_width) ** 2 - depth / 1.9)
    wide = 7_000.0 * carpet * np.exp(-0.5 * (right / 19.0) ** 2 - depth / (5.5 * np.sqrt(carpet)))
    foreground = np.exp(-(1.0 - carpet) * (depth / FOREGROUND_DEG) ** 2)
    is_below = 1.0 / (1.0 + np.exp(np.clip((elevations - cut_off) / CUT_OFF_WIDTH_DEG, -50.0, 50.0)))
    return _headlamp((hot_spot + wide) * foreground * is_below + stray * _stray_light(azimuths, elevations))


@cache
def high_beam() -> IntensityTable:
    """Low beam and driving beam of one lamp together, about 80,000 cd along the axis (UN R149 class B: 40,000)."""
    azimuths, elevations = np.meshgrid(HEADLAMP_AZIMUTHS_DEG, HEADLAMP_ELEVATIONS_DEG)
    narrow = 72_000.0 * np.exp(-0.5 * (azimuths / 3.0) ** 2 - 0.5 * ((elevations - 0.2) / 1.5) ** 2)
    wide = 10_000.0 * np.exp(-0.5 * (azimuths / 9.0) ** 2 - 0.5 * ((elevations - 0.6) / 2.6) ** 2)
    return IntensityTable(
        HEADLAMP_AZIMUTHS_DEG,
        HEADLAMP_ELEVATIONS_DEG,
        low_beam().intensities_cd + _headlamp(narrow + wide).intensities_cd,
    )


@cache
def position_lamp() -> IntensityTable:
    """Front position lamp: 20 cd ahead, seen up to the side (UN R7: at least 4 cd ahead, 0.05 cd anywhere)."""
    return _signal(20.0)


@cache
def rear_lamp() -> IntensityTable:
    """Rear position lamp, its axis backwards: 8 cd, seen up to the side (UN R7: 4 to 17 cd)."""
    return _signal(8.0)


@cache
def brake_lamp() -> IntensityTable:
    """Brake lamp, its axis backwards: 100 cd (UN R7, now R148: 60 to 185 cd for the pair's lamps of steady light)."""
    return _signal(100.0)


@cache
def centre_brake_lamp() -> IntensityTable:
    """The third brake lamp, its axis backwards: 50 cd (UN R7, category S3: 25 to 110 cd)."""
    return _signal(50.0)


@cache
def marker_lamp() -> IntensityTable:
    """End-outline or side marker: 6 cd on its axis (UN R7: at least 4 cd ahead; UN R91, category SM1: 4 to 25 cd)."""
    return _signal(6.0)


@cache
def bicycle_lamp() -> IntensityTable:
    """A bicycle's dynamo or LED lamp: 4,000 cd below its cut-off, 40 lx on a wall at 10 m, and 110 cd above it.

    German requirements, which most lamps in Europe follow: at least 10 lx at 10 m in the hot spot, which is 1,000 cd,
    and at most 2 lx, 200 cd, from 3.4 degrees above it on (TA 23 of paragraph 22a StVZO). The hot spot is aimed so low
    that it meets the road 15 to 30 m ahead.
    """
    azimuths, elevations = np.meshgrid(HEADLAMP_AZIMUTHS_DEG, HEADLAMP_ELEVATIONS_DEG)
    depth = np.clip(-1.5 - elevations, 0.0, None)
    beam = 4_600.0 * np.exp(-0.5 * (azimuths / 7.0) ** 2 - depth / 3.5)
    is_below = 1.0 / (1.0 + np.exp(np.clip((elevations + 1.5) / 0.3, -50.0, 50.0)))
    stray = 110.0 / (1.0 + (azimuths / 35.0) ** 2) * np.exp(-np.abs(elevations) / 12.0)
    return _headlamp(beam * is_below + stray)


@cache
def traffic_light() -> IntensityTable:
    """A lit lens of a traffic light, in candela for 1 cd on its axis: scale it by its intensity.

    EN 12368 has classes from 100 cd to 400 cd on the axis, which may be dimmed at night.
    """
    return _signal(1.0)


@cache
def street_lamp() -> IntensityTable:
    """A luminaire whose axis x points down, in candela for 1 cd straight down: scale it by the lamp's intensity.

    It throws 1.6 times as much 55 degrees aside, and a twentieth just above its rim, as older luminaires do.
    """
    azimuths, elevations = np.radians(np.meshgrid(HEMISPHERE_DEG, HEMISPHERE_DEG))
    aside_deg = np.degrees(np.arccos(np.clip(np.cos(azimuths) * np.cos(elevations), -1.0, 1.0)))
    wings = 1.0 + 0.6 * np.exp(-0.5 * ((aside_deg - 55.0) / 16.0) ** 2)
    is_inside = 1.0 / (1.0 + np.exp((aside_deg - 76.0) / 3.0))
    return IntensityTable(HEMISPHERE_DEG, HEMISPHERE_DEG, (wings * (0.03 + 0.97 * is_inside)).astype(np.float32))


@cache
def window() -> IntensityTable:
    """A lit window that faces along x, in candela for 1 cd ahead: scale it by luminance times area (Lambert's law)."""
    azimuths, elevations = np.radians(np.meshgrid(HEMISPHERE_DEG, HEMISPHERE_DEG))
    cosines = np.clip(np.cos(azimuths) * np.cos(elevations), 0.0, None).astype(np.float32)
    return IntensityTable(HEMISPHERE_DEG, HEMISPHERE_DEG, cosines)


def _stray_light(azimuths_deg: Floats, elevations_deg: Floats) -> Floats:
    """Light scattered by lens and housing, cd: above its cut-off, a lamp still shines like a position lamp."""
    return 240.0 / (1.0 + (azimuths_deg / 20.0) ** 2) * np.exp(-np.abs(elevations_deg) / 7.0)


def _headlamp(intensities_cd: Floats) -> IntensityTable:
    """A table on the headlamps' grid that fades to 0 at its borders: a hard border would show as an edge on trees."""
    sides = _fade(90.0 - np.abs(HEADLAMP_AZIMUTHS_DEG), 15.0)
    heights = _fade(30.0 - np.abs(HEADLAMP_ELEVATIONS_DEG), 8.0)
    faded = (intensities_cd * sides * heights[:, np.newaxis]).astype(np.float32)
    return IntensityTable(HEADLAMP_AZIMUTHS_DEG, HEADLAMP_ELEVATIONS_DEG, faded)


def _signal(axial_cd: float) -> IntensityTable:
    """A signal lamp: wide to the sides, narrower in height, as the regulation's test points require."""
    azimuths, elevations = np.meshgrid(SIGNAL_AZIMUTHS_DEG, SIGNAL_ELEVATIONS_DEG)
    core = np.exp(-0.5 * (azimuths / 18.0) ** 2 - 0.5 * (elevations / 9.0) ** 2)
    wide = 0.05 * np.exp(-np.abs(elevations) / 25.0) * np.clip(np.cos(np.radians(azimuths)), 0.0, None) ** 0.5
    intensities = (axial_cd * (0.95 * core + wide)).astype(np.float32)
    return IntensityTable(SIGNAL_AZIMUTHS_DEG, SIGNAL_ELEVATIONS_DEG, intensities)


def _fade(inside_deg: Floats, width_deg: float) -> Floats:
    """0 at the border to 1 at `width_deg` inside it, smooth."""
    share = np.clip(inside_deg / width_deg, 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))
