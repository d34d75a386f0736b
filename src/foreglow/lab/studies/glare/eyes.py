"""Glare of one other driver: time and dose above the limits, and the first moment in which we come into sight."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foreglow.geometry import Floats
from foreglow.lab.studies.glare.drive import DriverEye, GlareDrive
from foreglow.lab.studies.glare.limits import Limits
from foreglow.photometry.limits import FMVSS_ONCOMING

BINS = FMVSS_ONCOMING
"""By which ranges to an eye are told apart, whatever the limits are."""

MORE_THAN_LOW = 1.05
"""Light counts as more than the low beam's above this many times it: less is not the policy's doing."""

SETTLED_S = 0.5
"""The first glare moment is over after so long without glare, seconds."""


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
        vehicle_id: The vehicle.
        kind: What it is.
        is_oncoming: Whether it comes towards us.
        lead_s: From its first labelled light to the first sight of us; positive in an occluded approach, NaN without
            either. Light is labelled in our camera's images, sight is from the eye to our lamps: on an open road they
            may differ by a frame, so a lead of one frame says little.
        bins: Glare by range, see `BINS`.
        first_glare_s: First glare moment, see `first_glare_s`, from the first sight within the reach of the limits;
            NaN without, or where the eye is in it from the drive's first frame: then the first sight was not seen.
        first_glare_anywhere_s: The same from the first sight at any range, where the limits are taken to go on as they
            end (`Limits.extended`): without that, to come into sight far away would count as dark.
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
        """Over all bins."""
        return sum(one.dose_lxs for one in self.bins)


def score_eye(drive: GlareDrive, eye: DriverEye, levels: ArrayLike, limits: Limits) -> EyeScore:
    """The glare of `eye` when the lamps shine `levels`, shape (T, 2, L)."""
    lux, low_lx, limit_lx = eye.illuminance_lx(levels), eye.base_lx, limits.at(eye)
    places = BINS.bins(eye.ranges_m)
    bins = tuple(
        _glare(lux, low_lx, limit_lx, eye, places == place, drive.rate_hz) for place in range(len(BINS.bin_names))
    )
    sights = np.flatnonzero(eye.is_in_sight)
    sights_in_reach = np.flatnonzero(eye.is_in_sight & np.isfinite(limit_lx))
    sight_s = drive.times_s[sights[0]] if len(sights) else math.nan
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

    Glare is light above the limit and above `MORE_THAN_LOW` times the low beam. That the first 0.5 s have to be dark,
    not the first frame alone, is for eyes that see one lamp before the other, or a lamp's edge at first.

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
    return Glare(*(float(one) / rate_hz for one in sums))
