"""How one policy glares at other drivers in one drive.

    E(t)     illuminance at another driver's eye, lx
    L(t)     limit at the range of that eye, lx; infinite where there is none
    dose     integral of max(0, E - L) over time, lx s

Frames have the same length, so integrals are sums over frames divided by their rate. Everything here is a sum that adds
up over range bins, eyes and drives; `scores` divides only after adding.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foreglow.geometry import Floats
from foreglow.lab.studies.glare.drive import DriverEye, GlareDrive
from foreglow.photometry.limits import FMVSS_ONCOMING, FMVSS_PRECEDING, UN_R123, Towards

BINS = FMVSS_ONCOMING
"""Bins of the range to an eye, whatever the limits are."""

MORE_THAN_LOW = 1.05
"""Light counts as more than the low beam's above this many times it: less is not the policy's doing."""

SETTLED_S = 0.5
"""Time without glare, seconds, after which the first glare moment is over; shorter pauses do not end it."""


@dataclass(frozen=True, slots=True)
class Limit:
    """How much light may reach some drivers' eyes, by their range.

    Attributes:
        at_lx: From ranges, metres, to the most light, lux; infinite where there is no limit, and for NaN.
        reach_m: The ranges between which there is a limit.
    """

    at_lx: Callable[[Floats], Floats]
    reach_m: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Limits:
    """How much light may reach other drivers' eyes.

    Attributes:
        name: Of the rule that sets them.
        oncoming: For drivers who come towards us.
        preceding: For drivers whom we follow, at their mirrors.
    """

    name: str
    oncoming: Limit
    preceding: Limit

    def at(self, eye: DriverEye) -> Floats:
        """Shape (T,): the limit for `eye` at each frame; infinite where there is none."""
        return self._of(eye).at_lx(eye.ranges_m)

    def extended(self, eye: DriverEye) -> Floats:
        """Shape (T,): the limit for `eye`; beyond its reach, that of the nearest range which has one."""
        limit = self._of(eye)
        return limit.at_lx(np.clip(eye.ranges_m, *limit.reach_m))

    def _of(self, eye: DriverEye) -> Limit:
        return self.oncoming if eye.is_oncoming else self.preceding


def _interpolated(towards: Towards) -> Limit:
    """UN R123's limit of two lamps: linear between the distances that its table names.

    Of two limits at one distance the lower is taken, since the notes do not say where each of them holds.
    """
    limits_lx: dict[float, float] = {}
    for entry in UN_R123:
        if entry.towards == towards:
            limits_lx[entry.distance_m] = min(entry.illuminance_lx(), limits_lx.get(entry.distance_m, math.inf))
    distances_m = sorted(limits_lx)
    reach_m = distances_m[0], distances_m[-1]

    def at_lx(ranges_m: Floats) -> Floats:
        has_limit = (ranges_m >= reach_m[0]) & (ranges_m <= reach_m[1])
        return np.where(has_limit, np.interp(ranges_m, distances_m, [limits_lx[m] for m in distances_m]), math.inf)

    return Limit(at_lx, reach_m)


FMVSS_108 = Limits(
    "FMVSS 108",
    *(Limit(steps.at, (steps.edges_m[0], steps.edges_m[-1])) for steps in (FMVSS_ONCOMING, FMVSS_PRECEDING)),
)
"""Steps by range. Beyond 220 m, for preceding drivers beyond 100 m, and nearer than 15 m there is no limit."""

R123 = Limits("UN R123", _interpolated("oncoming"), _interpolated("preceding"))
"""The table limits the intensity of a lamp towards drivers 50, 100 and 200 m away. Here it is the illuminance of two
such lamps, wherever the driver is at these ranges, and linear in between: both are a reading of ours."""

LIMITS = (FMVSS_108, R123)


@dataclass(frozen=True, slots=True)
class Glare:
    """Glare while an eye is in one range bin. It adds up over bins, eyes and drives: each second weighs the same.

    Attributes:
        in_sight_s: Time in the bin with at least one of our lamps in sight, whatever is shone.
        above_s: Time above the limit. Its share of `in_sight_s` says nothing about how far above.
        dose_lxs: Integral of max(0, E - limit), lux-seconds. A short flash of full beam can weigh as much as a minute
            slightly above: read it beside `above_s`.
        added_lxs: Integral of what the LEDs add to the low beam, while the whole is above the limit. Where the low beam
            alone is above, this is all that a policy can answer for.
        low_dose_lxs: The dose of the low beam alone, which no policy can go below.
    """

    in_sight_s: float
    above_s: float
    dose_lxs: float
    added_lxs: float
    low_dose_lxs: float


@dataclass(frozen=True, slots=True)
class EyeScore:
    """What one policy did to one other driver.

    Attributes:
        is_oncoming: Whether it comes towards us.
        lead_s: From its first labelled light to the first sight of us; positive in an occluded approach, NaN without
            either, and where nothing was in between before: the eye sees us in the drive's first frame, or as soon as
            it has a range, as on an open road when it comes near enough. Light is labelled in our camera's images,
            sight is from the eye to our lamps: they may differ by a frame, so a lead of one frame says little.
        bins: Glare by range, see `BINS`.
        first_glare_s: First glare moment, see `first_glare_s`, from the first sight within the reach of the limits;
            NaN without, or where the eye is in it from the drive's first frame: then the first sight was not seen.
        first_glare_anywhere_s: The first glare moment from the first sight at any range, with the limits continued
            beyond their reach (`Limits.extended`): otherwise, to come into sight far away would count as dark.
    """

    vehicle_id: int
    kind: str
    is_oncoming: bool
    lead_s: float
    bins: tuple[Glare, ...]
    first_glare_s: float
    first_glare_anywhere_s: float

    @property
    def is_occluded(self) -> bool:
        """Whether its light was labelled before it could see us."""
        return self.lead_s > 0

    @property
    def dose_lxs(self) -> float:
        """The dose in all bins together."""
        return sum(glare.dose_lxs for glare in self.bins)


def score_eye(drive: GlareDrive, eye: DriverEye, levels: ArrayLike, limits: Limits) -> EyeScore:
    """The glare of `eye` when the lamps shine `levels`, shape (T, 2, L)."""
    lux, low_lx, limit_lx = eye.illuminance_lx(levels), eye.base_lx, limits.at(eye)
    bin_of_frame = BINS.bins(eye.ranges_m)
    bins = tuple(
        _glare(lux, low_lx, limit_lx, eye, bin_of_frame == index, drive.rate_hz) for index in range(len(BINS.bin_names))
    )
    sights = np.flatnonzero(eye.is_in_sight)
    sights_in_reach = np.flatnonzero(eye.is_in_sight & np.isfinite(limit_lx))
    was_hidden = len(sights) > 0 and sights[0] > 0 and not math.isnan(eye.ranges_m[sights[0] - 1])
    sight_s = drive.times_s[sights[0]] if was_hidden else math.nan
    return EyeScore(
        vehicle_id=eye.vehicle_id,
        kind=eye.kind,
        is_oncoming=eye.is_oncoming,
        lead_s=float(sight_s - drive.light_s.get(eye.vehicle_id, math.nan)),
        bins=bins,
        first_glare_s=first_glare_s(lux, low_lx, limit_lx, sights_in_reach, drive.rate_hz),
        first_glare_anywhere_s=first_glare_s(lux, low_lx, limits.extended(eye), sights, drive.rate_hz),
    )


def first_glare_s(lux: Floats, low_lx: Floats, limit_lx: Floats, sights: NDArray[np.intp], rate_hz: float) -> float:
    """Time with glare from the first of `sights` on, until there is none for `SETTLED_S`; 0 where it starts dark.

    Glare is light above the limit and above `MORE_THAN_LOW` times the low beam; frames without it are not counted. That
    the first 0.5 s have to be dark, not the first frame alone, is for eyes that see one lamp before the other, or a
    lamp's edge at first.

    Args:
        lux: Shape (T,), at the eye.
        low_lx: Shape (T,), of the low beam alone.
        limit_lx: Shape (T,).
        sights: The frames in which the eye sees us.
        rate_hz: Frames a second.

    Returns:
        Seconds; NaN where the eye never sees us, or does so in the first frame.

    >>> lux = np.array([0.0, 2, 2, 0, 0, 0, 2])
    >>> first_glare_s(lux, 0 * lux, 0 * lux + 1, np.array([1, 2, 6]), rate_hz=4.0)
    0.5
    """
    if not len(sights) or sights[0] == 0:
        return math.nan
    is_glare = ((lux > limit_lx) & (lux > MORE_THAN_LOW * low_lx))[sights[0] :]
    glaring = np.flatnonzero(is_glare)
    # Dark frames before each glaring one, from the first sight on.
    pauses = np.diff(glaring, prepend=-1) - 1
    longest = max(1, round(SETTLED_S * rate_hz))
    ends = np.flatnonzero(pauses >= longest)
    return float((ends[0] if len(ends) else len(glaring)) / rate_hz)


def _glare(
    lux: Floats, low_lx: Floats, limit_lx: Floats, eye: DriverEye, is_in_bin: NDArray[np.bool_], rate_hz: float
) -> Glare:
    is_above = is_in_bin & (lux > limit_lx)
    sums = (
        (is_in_bin & eye.is_in_sight).sum(),
        is_above.sum(),
        (lux - limit_lx)[is_above].sum(),
        (lux - low_lx)[is_above].sum(),
        np.maximum(0.0, low_lx - limit_lx)[is_in_bin].sum(),
    )
    return Glare(*(float(total) / rate_hz for total in sums))
