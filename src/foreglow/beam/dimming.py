"""From dark gaps to LED levels: how far each LED is dimmed for a gap, and how levels change over time.

Units: metres, radians, candela, lux; azimuths to the left in the vehicle's frame. A gap runs from the azimuth a1 to a2,
for something between the ranges r1 and r2. From a lamp at (x, y), its border a is seen within

    atan2(r sin(a) - y, r cos(a) - x)   for r = r1 and r = r2                                                   (1)

An LED that shines I(a) candela at level 1 in the direction a, at its brightest within the elevations that matter, may
give at most E lux at the gap's nearest point, which is at least d away from the lamp. Its level is

    level = min over a in the gap of E d^2 / I(a),   at most 1;   d = r1 - hypot(x, y)                          (2)

So a gap's edges are as soft as the LEDs' own light, and a gap is wider for something near. Over time, levels fall at
once and rise linearly, after an LED has not been dimmed for `hold_s`:

    level <- min(target, level + dt / restore_s)                                                                (3)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from foreglow.beam.gaps import Gap
from foreglow.geometry import Floats
from foreglow.photometry import Headlamps

STEP_RAD = math.radians(0.1)
REACH_RAD = math.radians(45.0)
"""Step and end of the azimuths at which the LEDs' light is tabulated: all that a headlamp's matrix reaches."""

AZIMUTHS_RAD = np.arange(-REACH_RAD, REACH_RAD + STEP_RAD / 2, STEP_RAD)

SIDE_RAD = math.pi / 2
"""A border further back is as one at the side: (1) would take it for one on the other side, and LEDs shine ahead."""

LOWEST_RAD, HIGHEST_RAD = math.radians(-0.5), math.radians(4.0)
"""Elevations at which the eyes and mirrors of others may be, hills and pitching bodies included; so a gap is dark over
the whole height of the matrix above the road."""

FINE_RATIO = 1.1
"""An LED whose greatest light is more than so many times the most that is tabulated of it shines between the table's
directions. Measured: 1.01 at most, of the lamps that ship."""

FAR_M = 1e4
"""Stands for an infinite range in (1)."""

FARTHEST_M = 220.0
"""Greatest r1 in (2). Anything further away is protected as if it were here, where the regulations' limits end."""

NEAREST_M = 1.0
"""Least d in (2)."""


class Dimmer:
    """Dims the LEDs of a pair of headlamps that shine into gaps, by (1) and (2)."""

    def __init__(self, headlamps: Headlamps, led_limit_lx: float) -> None:
        """Tabulates the LEDs' light.

        Args:
            headlamps: The lamps.
            led_limit_lx: E, the illuminance that a single LED may give in a gap.
        """
        self._limit_lx = led_limit_lx
        lamps = (headlamps.left, headlamps.right)
        self._lamps_m = [lamp.vehicle_from_lamp.position_m[:2].tolist() for lamp in lamps]
        elevations = np.linspace(LOWEST_RAD, HIGHEST_RAD, 10)
        azimuth, elevation = (grid.ravel() for grid in np.meshgrid(AZIMUTHS_RAD, elevations, indexing="ij"))
        level = np.cos(elevation)
        directions = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], -1)
        leds_cd = headlamps.intensities_cd(directions)[1]
        strongest = leds_cd.reshape(len(AZIMUTHS_RAD), len(elevations), 2, -1).max(1)
        strongest = self._with_fine(headlamps, strongest)
        # Shape (2, A, L): the level at which each LED gives 1 cd in each direction.
        self._per_cd = np.ascontiguousarray((1.0 / np.maximum(strongest, 1e-9)).transpose(1, 0, 2))

    def _with_fine(self, headlamps: Headlamps, strongest: Floats) -> Floats:
        """`strongest`, shape (A, 2, L), but for LEDs whose light is finer than its directions: the most beside each."""
        most = _most_cd(headlamps)
        is_fine = most.max(axis=0) > FINE_RATIO * strongest.max(axis=0)
        return np.where(is_fine, np.maximum(strongest, most), strongest)

    @property
    def num_leds(self) -> int:
        """L, LEDs of one lamp."""
        return int(self._per_cd.shape[2])

    def levels(self, gaps: Sequence[Gap]) -> Floats:
        """Shape (2, L): 1, except for the LEDs that shine into `gaps`."""
        levels = np.ones((2, self.num_leds))
        for gap in gaps:
            ends_m = _ends_m(gap)
            for lamp, (x, y) in enumerate(self._lamps_m):
                limit_cd = self._limit_lx * max(min(gap.near_m, FARTHEST_M) - math.hypot(x, y), NEAREST_M) ** 2
                borders = [math.atan2(left_m - y, forward_m - x) for forward_m, left_m in ends_m]  # (1)
                first = max(math.floor((min(borders) + REACH_RAD) / STEP_RAD), 0)
                last = min(math.ceil((max(borders) + REACH_RAD) / STEP_RAD), len(AZIMUTHS_RAD) - 1)
                if first <= last:
                    allowed = limit_cd * np.minimum.reduce(self._per_cd[lamp, first : last + 1])  # (2)
                    np.minimum(levels[lamp], allowed, out=levels[lamp])
        return levels


class Ramp:
    """Levels over time by (3): down at once, up after a pause and slowly."""

    def __init__(self, hold_s: float, restore_s: float) -> None:
        """A ramp without a past.

        Args:
            hold_s: How long an LED stays dimmed after the last gap for it.
            restore_s: Time from off to full.
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
            self._dimmed_ns = np.minimum(np.where(target <= self._levels, timestamp_ns, self._dimmed_ns), timestamp_ns)
            is_held = timestamp_ns - self._dimmed_ns < self._hold_ns
            risen = np.where(is_held, self._levels, self._levels + rise)
            self._levels = np.minimum(target, risen)  # (3)
        self._latest_ns = timestamp_ns
        return self._levels


@lru_cache(maxsize=4)
def _most_cd(headlamps: Headlamps) -> Floats:
    """Shape (A, 2, L): the most that LEDs shine beside each of `AZIMUTHS_RAD`, at any height that matters."""
    edges_deg = np.degrees(np.append(AZIMUTHS_RAD - STEP_RAD / 2, AZIMUTHS_RAD[-1] + STEP_RAD / 2))
    most = headlamps.greatest_cd(edges_deg, np.degrees([LOWEST_RAD, HIGHEST_RAD]))
    return np.stack([cells[0] for cells in most], axis=1)


def _ends_m(gap: Gap) -> list[tuple[float, float]]:
    """Where the borders of `gap` begin and end, at r1 and r2: forward and left in the vehicle's frame."""
    ranges_m = {min(gap.near_m, FAR_M), min(gap.far_m, FAR_M)}  # often one and the same
    borders = [min(max(border, -SIDE_RAD), SIDE_RAD) for border in gap[:2]]
    return [(range_m * math.cos(border), range_m * math.sin(border)) for border in borders for range_m in ranges_m]
