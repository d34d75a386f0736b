"""How much light may reach another driver's eye, by its range: regulations' numbers as a line over all ranges."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from foreglow.geometry import Floats
from foreglow.lab.studies.glare.drive import DriverEye
from foreglow.photometry.limits import FMVSS_ONCOMING, FMVSS_PRECEDING, UN_R123, Towards

LimitLx: TypeAlias = Callable[[Floats], Floats]
"""From ranges, metres, to the most light that may reach an eye, lux; infinite where there is no limit, and for NaN."""


@dataclass(frozen=True, slots=True)
class Limits:
    """How much light may reach other drivers' eyes, by their range.

    Attributes:
        name: What they are from.
        oncoming_lx: For drivers who come towards us.
        preceding_lx: For drivers whom we follow, at their mirrors.
        oncoming_reach_m: The ranges between which there is a limit for the former.
        preceding_reach_m: Likewise for the latter.
    """

    name: str
    oncoming_lx: LimitLx
    preceding_lx: LimitLx
    oncoming_reach_m: tuple[float, float]
    preceding_reach_m: tuple[float, float]

    def at(self, eye: DriverEye) -> Floats:
        """Shape (T,): the limit for `eye` at each frame; infinite where there is none."""
        return self.oncoming_lx(eye.ranges_m) if eye.is_oncoming else self.preceding_lx(eye.ranges_m)

    def extended(self, eye: DriverEye) -> Floats:
        """Shape (T,): the same, but nearer and further away the limit of the nearest range that has one holds."""
        if eye.is_oncoming:
            return self.oncoming_lx(np.clip(eye.ranges_m, *self.oncoming_reach_m))
        return self.preceding_lx(np.clip(eye.ranges_m, *self.preceding_reach_m))


def _interpolated(towards: Towards) -> tuple[LimitLx, tuple[float, float]]:
    """UN R123's limits of two lamps, and their reach: linear between the distances that its table names.

    Of two limits at one distance the lower is taken, since the notes do not say where each of them holds.
    """
    limits_lx: dict[float, float] = {}
    for one in UN_R123:
        if one.towards == towards:
            limits_lx[one.distance_m] = min(one.illuminance_lx(), limits_lx.get(one.distance_m, math.inf))
    distances_m = sorted(limits_lx)
    first_m, last_m = distances_m[0], distances_m[-1]

    def limit_lx(ranges_m: Floats) -> Floats:
        is_inside = (ranges_m >= first_m) & (ranges_m <= last_m)
        return np.where(is_inside, np.interp(ranges_m, distances_m, [limits_lx[one] for one in distances_m]), math.inf)

    return limit_lx, (first_m, last_m)


def _fmvss() -> Limits:
    oncoming, preceding = FMVSS_ONCOMING, FMVSS_PRECEDING
    its_reach_m, preceding_reach_m = ((one.edges_m[0], one.edges_m[-1]) for one in (oncoming, preceding))
    return Limits("FMVSS 108", oncoming.at, preceding.at, its_reach_m, preceding_reach_m)


def _r123() -> Limits:
    (oncoming, its_reach_m), (preceding, preceding_reach_m) = _interpolated("oncoming"), _interpolated("preceding")
    return Limits("UN R123", oncoming, preceding, its_reach_m, preceding_reach_m)


FMVSS_108 = _fmvss()
"""Steps by range. Beyond 220 m, for preceding drivers beyond 100 m, and nearer than 15 m there is no limit."""

R123 = _r123()
"""The table limits the intensity of a lamp towards drivers 50, 100 and 200 m away. Here it is the illuminance of two
such lamps, wherever the driver is at these ranges, and linear in between: both are a reading of ours."""

LIMITS = (FMVSS_108, R123)
