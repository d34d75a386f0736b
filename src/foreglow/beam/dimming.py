"""From dark gaps to LED levels: which LEDs shine into a gap, and how levels change over time."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from foreglow.beam.gaps import Gap
from foreglow.geometry import Floats
from foreglow.photometry import Headlamps

STEP_RAD = math.radians(0.1)
REACH_RAD = math.radians(45.0)
"""Directions at which the LEDs' light is tabled: all that a headlamp's matrix reaches."""

LOWEST_RAD, HIGHEST_RAD = math.radians(-0.5), math.radians(4.0)
"""Elevations at which the eyes and mirrors of others may be: hills and pitching bodies included, and so the whole
matrix above the road is darkened in a gap."""

FAR_M = 1e4
"""As good as infinitely far, for directions."""

FARTHEST_M = 220.0
"""What is further away, or may be, is protected as if it were here: the regulations' limits end."""


class Dimmer:
    """Dims the LEDs of a pair of headlamps that shine into gaps.

    An LED's level is the highest at which it gives no more than `led_limit_lx` at the nearest place that a gap may be
    for, so that a gap has edges as soft as the LEDs' own light, and is wider for what is near. A gap for something near
    lies in another direction from either lamp.
    """

    def __init__(self, headlamps: Headlamps, led_limit_lx: float) -> None:
        """Tables the LEDs' light.

        Args:
            headlamps: The lamps.
            led_limit_lx: What a single LED may give in a gap.
        """
        self._limit_lx = led_limit_lx
        self._places_m = [lamp.vehicle_from_lamp.position_m for lamp in (headlamps.left, headlamps.right)]
        self._azimuths = np.arange(-REACH_RAD, REACH_RAD + STEP_RAD / 2, STEP_RAD)
        elevations = np.linspace(LOWEST_RAD, HIGHEST_RAD, 10)
        azimuth, elevation = (one.ravel() for one in np.meshgrid(self._azimuths, elevations, indexing="ij"))
        level = np.cos(elevation)
        directions = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], -1)
        leds_cd = headlamps.intensities_cd(directions)[1]
        strongest = leds_cd.reshape(len(self._azimuths), len(elevations), 2, -1).max(1)
        # Shape (2, A, L): each LED's level for 1 cd in each direction.
        self._per_cd = np.ascontiguousarray((1.0 / np.maximum(strongest, 1e-9)).transpose(1, 0, 2))

    @property
    def num_leds(self) -> int:
        """Of one lamp."""
        return int(self._per_cd.shape[2])

    def levels(self, gaps: Sequence[Gap]) -> Floats:
        """Shape (2, L): full but for the LEDs that shine into `gaps`."""
        levels = np.ones((2, self.num_leds))
        for gap in gaps:
            limit_cd = self._limit_lx * min(gap.near_m, FARTHEST_M) ** 2
            for lamp, place_m in enumerate(self._places_m):
                right, left = _seen_from(place_m, gap)
                first = max(math.floor((right + REACH_RAD) / STEP_RAD), 0)
                last = min(math.ceil((left + REACH_RAD) / STEP_RAD), len(self._azimuths) - 1)
                if first <= last:
                    allowed = limit_cd * self._per_cd[lamp, first : last + 1].min(axis=0)
                    np.minimum(levels[lamp], allowed, out=levels[lamp])
        return levels


class Ramp:
    """Levels over time: down at once, up after a while and slowly."""

    def __init__(self, hold_s: float, restore_s: float) -> None:
        """Starts dark.

        Args:
            hold_s: An LED stays dark for so long after nothing has asked for it.
            restore_s: From off to full.
        """
        self._hold_ns, self._restore_s = round(hold_s * 1e9), restore_s
        self._levels: Floats | None = None
        self._latest_ns = 0

    def reset(self) -> None:
        """Forgets the past."""
        self._levels = None

    def step(self, target: Floats, timestamp_ns: int) -> Floats:
        """The levels at `timestamp_ns` when `target` is wanted; the first target is taken as it is."""
        if self._levels is None:
            self._levels, self._dimmed_ns = target, np.full(target.shape, timestamp_ns - self._hold_ns)
        else:
            rise = max(timestamp_ns - self._latest_ns, 0) / 1e9 / self._restore_s
            self._dimmed_ns = np.where(target <= self._levels, timestamp_ns, self._dimmed_ns)
            is_held = timestamp_ns - self._dimmed_ns < self._hold_ns
            risen = np.where(is_held, self._levels, self._levels + rise)
            self._levels = np.minimum(target, risen)
        self._latest_ns = timestamp_ns
        return self._levels


def _seen_from(place_m: Floats, gap: Gap) -> tuple[float, float]:
    """Right and left border of `gap` from a lamp: whatever its range is, in between."""
    x, y, _ = place_m.tolist()
    borders = [
        math.atan2(range_m * math.sin(azimuth) - y, range_m * math.cos(azimuth) - x)
        for azimuth in gap[:2]
        for range_m in (min(gap.near_m, FAR_M), min(gap.far_m, FAR_M))
    ]
    return min(borders), max(borders)
