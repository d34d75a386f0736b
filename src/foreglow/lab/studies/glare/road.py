"""What one policy does to the light on our own road in one drive: kept, changed, and dimmed for nobody.

Everything here is a sum over frames divided by their rate, and adds up over drives; `scores` divides only after adding.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats
from foreglow.lab.evaluation.ratios import ratios
from foreglow.lab.studies.glare.drive import GlareDrive, PolicyRun

AFTER_S = 2.0
"""Time, seconds, that full light may take to return after a vehicle has passed."""

AHEAD_S = 3.0
"""Time before a vehicle's first labelled light, seconds, in which dimming is not yet wrong."""

MIN_SPEED_MPS = 32.0 / 3.6
"""Below this speed low beam is asked for, and lost light is nobody's fault."""

SWITCH_S = 2.0
"""Time, seconds, in which a policy may switch to low beam once the road is lit."""

DARK_LEVEL = 0.01
"""There is low beam if no LED is above."""

FULL_LEVEL = 0.99
"""A lamp shines full beam if no LED is below."""

JUMP = 0.1
"""A change of the road's light from one frame to the next that is seen, as a share of full beam."""


@dataclass(frozen=True, slots=True, eq=False)
class Phases:
    """When other vehicles matter to us. Frames slower than `MIN_SPEED_MPS`, or on lit roads, are in none.

    A vehicle is there from its first labelled light, or the first frame in which it sees us, to the last frame with a
    range, be it before the drive's first; where that is the drive's last frame, or a range was never known, to the end.

    Attributes:
        is_present: Shape (T,), whether a vehicle is there.
        is_passed: Shape (T,), whether none is there, and all that were passed more than `AFTER_S` ago; at least one.
        is_free: Shape (T,), whether none is there, none was within `AFTER_S`, none will be within `AHEAD_S`.
    """

    is_present: NDArray[np.bool_]
    is_passed: NDArray[np.bool_]
    is_free: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class PhaseLight:
    """Light on the road in one phase of a drive; it adds up over drives. By area, as `AREAS`, lux-seconds.

    Attributes:
        seconds: Duration.
        kept_lxs: What the policy shines.
        full_lxs: What the full high beam would.
        low_lxs: What the low beam alone would.
    """

    seconds: float
    kept_lxs: tuple[float, float]
    full_lxs: tuple[float, float]
    low_lxs: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Switching:
    """How much the light changes in a drive; it adds up over drives.

    Attributes:
        seconds: From the first to the last frame.
        change: Sum of the changes of the road's light, both areas together, as a share of full beam at each frame, so
            that the road's own ups and downs do not count.
        num_falls: Jumps of more than `JUMP` down from one frame to the next. To dim at once is wanted.
        num_rises: Jumps up. These disturb: light should come back slowly. Both depend on the rate of frames.
        level_change: Total variation of the levels, mean of all LEDs.
    """

    seconds: float
    change: float
    num_falls: int
    num_rises: int
    level_change: float


SHALLOW, SHORT_S = 0.3, 0.3
"""What a question takes at most: a share of the light of an LED, and a time."""

LEVEL_STEP = 1.0 / 255.0
"""Levels come over the bus in such steps."""


@dataclass(frozen=True, slots=True)
class Dimming:
    """Light that was dimmed for nobody; it adds up over drives.

    Attributes:
        seconds: Time without anybody.
        num_events: Times that full beam went below full in any LED. A policy that never shines full beam has no event:
            read it beside `dimmed_s`.
        num_questions: Those of them that are no deeper than `SHALLOW` and no longer than `SHORT_S`.
        dimmed_s: Time below full.
        leds_off_s: Integral of the share of all LEDs' light that was missing.
        road_lost_s: Integral of the share of the road's light, both areas together, that was missing.
    """

    seconds: float
    num_events: int
    num_questions: int
    dimmed_s: float
    leds_off_s: float
    road_lost_s: float


@dataclass(frozen=True, slots=True)
class LitRoad:
    """High beam on lit roads, and low beam on dark ones; it adds up over drives.

    Attributes:
        seconds: Time on lit roads, from `SWITCH_S` after each begins.
        high_s: Time of these with high beam, gaps or not: a fault.
        num_streets: Stretches of lit road that take longer than `SWITCH_S`.
        num_switched: Those in which there was low beam at `SWITCH_S`, or before.
        dark_s: Time on dark roads.
        num_low: Times that high beam ended there in low beam: a fault as well.
    """

    seconds: float
    high_s: float
    num_streets: int
    num_switched: int
    dark_s: float
    num_low: int


def phases(drive: GlareDrive) -> Phases:
    """When other vehicles matter in `drive`."""
    times_s = drive.times_s
    num_frames = len(times_s)
    is_present, is_near, is_shadowed, is_after = np.zeros((4, num_frames), np.bool_)
    for begin_s, end_s in _visits(drive):
        is_present |= (times_s >= begin_s) & (times_s <= end_s)
        is_shadowed |= (times_s >= begin_s) & (times_s <= end_s + AFTER_S)
        is_near |= (times_s >= begin_s - AHEAD_S) & (times_s <= end_s + AFTER_S)
        is_after |= times_s > end_s + AFTER_S
    is_fast = ~(drive.speeds_mps < MIN_SPEED_MPS) & ~drive.is_lit
    return Phases(is_present & is_fast, is_after & ~is_shadowed & is_fast, ~is_near & is_fast)


def _visits(drive: GlareDrive) -> list[tuple[float, float]]:
    """From when to when each vehicle is there, seconds; see `Phases`."""
    eyes = {eye.vehicle_id: eye for eye in drive.eyes}
    visits = []
    for vehicle_id in sorted(eyes.keys() | drive.light_s.keys() | drive.gone_s.keys()):
        begin_s, end_s = drive.light_s.get(vehicle_id, math.inf), math.inf
        if vehicle_id in drive.gone_s:
            end_s = drive.gone_s[vehicle_id]
            begin_s = min(begin_s, end_s)
        if vehicle_id in eyes:
            sights = np.flatnonzero(eyes[vehicle_id].is_in_sight)
            ranged = np.flatnonzero(~np.isnan(eyes[vehicle_id].ranges_m))
            begin_s = min(begin_s, drive.times_s[sights[0]]) if len(sights) else begin_s
            if len(ranged) and ranged[-1] < len(drive.times_s) - 1:
                end_s = max(begin_s, drive.times_s[ranged[-1]])
        if begin_s < math.inf:
            visits.append((float(begin_s), float(end_s)))
    return visits


def phase_light(drive: GlareDrive, run: PolicyRun, is_in_phase: NDArray[np.bool_]) -> PhaseLight:
    """The light that `run` keeps on the road in a phase."""

    def total_lxs(lux: Floats) -> tuple[float, float]:
        own_lane, verge = (lux[is_in_phase].sum(axis=0) / drive.rate_hz).tolist()
        return own_lane, verge

    return PhaseLight(
        seconds=float(is_in_phase.sum() / drive.rate_hz),
        kept_lxs=total_lxs(drive.road.illuminance_lx(run.levels)),
        full_lxs=total_lxs(drive.road.illuminance_lx(1.0)),
        low_lxs=total_lxs(drive.road.base_lx),
    )


def road_share(drive: GlareDrive, run: PolicyRun) -> Floats:
    """Shape (T,): light on both areas together over that of full beam; 1 where there is none to keep."""
    kept, full = (drive.road.illuminance_lx(levels).sum(axis=1) for levels in (run.levels, 1.0))
    return np.where(full > 0, ratios(kept, full), 1.0)


def switching(drive: GlareDrive, run: PolicyRun) -> Switching:
    """How much the light of `run` changes."""
    changes = np.diff(road_share(drive, run))
    levels = np.diff(run.levels.astype(np.float64), axis=0)
    return Switching(
        seconds=float(drive.times_s[-1] - drive.times_s[0]),
        change=float(np.abs(changes).sum()),
        num_falls=int((changes < -JUMP).sum()),
        num_rises=int((changes > JUMP).sum()),
        level_change=float(np.abs(levels).mean(axis=(1, 2)).sum()),
    )


def wrong_dimming(drive: GlareDrive, run: PolicyRun, is_free: NDArray[np.bool_]) -> Dimming:
    """What `run` dims while nobody is there, shape (T,)."""
    is_full = np.asarray((run.levels >= FULL_LEVEL).all(axis=(1, 2)))
    is_event = is_full[:-1] & ~is_full[1:] & is_free[:-1] & is_free[1:]
    is_dimmed = is_free & ~is_full
    leds_off = 1.0 - run.levels.mean(axis=(1, 2), dtype=np.float64)
    road_lost = 1.0 - road_share(drive, run)
    return Dimming(
        seconds=float(is_free.sum() / drive.rate_hz),
        num_events=int(is_event.sum()),
        num_questions=sum(_is_question(drive, run, is_full, first + 1) for first in np.flatnonzero(is_event).tolist()),
        dimmed_s=float(is_dimmed.sum() / drive.rate_hz),
        leds_off_s=float(leds_off[is_dimmed].sum() / drive.rate_hz),
        road_lost_s=float(road_lost[is_dimmed].sum() / drive.rate_hz),
    )


def _is_question(drive: GlareDrive, run: PolicyRun, is_full: NDArray[np.bool_], first: int) -> bool:
    """Whether the dimming that begins in a frame is shallow and short; of one that the end cuts off nobody knows."""
    after = np.flatnonzero(is_full[first:])
    last = first + int(after[0]) if len(after) else len(is_full)
    is_short = len(after) > 0 and (last - first) / drive.rate_hz <= SHORT_S
    return is_short and bool((run.levels[first:last] >= 1.0 - SHALLOW - LEVEL_STEP).all())


def lit_road(drive: GlareDrive, run: PolicyRun) -> LitRoad:
    """What `run` shines where the road is lit, and where it is not."""
    is_fast = ~(drive.speeds_mps < MIN_SPEED_MPS)
    is_low = np.asarray((run.levels <= DARK_LEVEL).all(axis=(1, 2)))
    waits = round(SWITCH_S * drive.rate_hz)
    is_late = np.zeros(len(drive.times_s), np.bool_)
    num_streets = num_switched = 0
    starts = np.flatnonzero(np.diff(drive.is_lit.astype(np.int8), prepend=0) > 0)
    ends = np.flatnonzero(np.diff(drive.is_lit.astype(np.int8), append=0) < 0) + 1
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        is_late[start + waits : end] = True
        if end - start > waits:
            num_streets += 1
            num_switched += bool(is_low[start : start + waits + 1].any())
    is_late &= is_fast
    is_dark = ~drive.is_lit & is_fast
    return LitRoad(
        seconds=float(is_late.sum() / drive.rate_hz),
        high_s=float((is_late & ~is_low).sum() / drive.rate_hz),
        num_streets=num_streets,
        num_switched=num_switched,
        dark_s=float(is_dark.sum() / drive.rate_hz),
        num_low=int((is_dark[:-1] & is_dark[1:] & ~is_low[:-1] & is_low[1:]).sum()),
    )
