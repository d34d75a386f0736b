"""Our own road: how much light a policy keeps on it, how smoothly it switches, and when it dims for nobody."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats
from foreglow.lab.studies.glare.drive import GlareDrive, PolicyRun

RESTORE_S = 2.0
"""So long after a vehicle has passed, full light may take to return, seconds."""

AHEAD_S = 3.0
"""To dim so long before a vehicle's first labelled light is not yet wrong, seconds."""

MIN_SPEED_MPS = 32.0 / 3.6
"""Below, low beam is asked for, and lost light is nobody's fault."""

FULL_LEVEL = 0.99
"""A lamp shines full beam if no LED is below."""

JUMP = 0.1
"""A change of the road's light from one frame to the next that is seen, as a share of full beam."""


@dataclass(frozen=True, slots=True, eq=False)
class Phases:
    """When other vehicles matter to us. Frames slower than `MIN_SPEED_MPS` are in none.

    A vehicle is there from its first labelled light, or the first frame in which it sees us, to the last frame with a
    range; where that is the drive's last frame, or a range was never known, to the end.

    Attributes:
        is_present: Shape (T,), whether a vehicle is there.
        is_passed: Shape (T,), whether none is there, and all that were passed more than `restore_s` ago; at least one.
        is_free: Shape (T,), whether none is there, none was within `restore_s`, none will be within `AHEAD_S`.
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


@dataclass(frozen=True, slots=True)
class Dimming:
    """Light that was dimmed for nobody; it adds up over drives.

    Attributes:
        seconds: Time without anybody.
        num_events: Times that full beam went below full in any LED. A policy that never shines full beam has no event:
            read it beside `dimmed_s`.
        dimmed_s: Time below full.
        leds_off_s: Integral of the share of all LEDs' light that was missing.
        road_lost_s: Integral of the share of the road's light, both areas together, that was missing.
    """

    seconds: float
    num_events: int
    dimmed_s: float
    leds_off_s: float
    road_lost_s: float


def phases(drive: GlareDrive, restore_s: float = RESTORE_S) -> Phases:
    """When other vehicles matter in `drive`."""
    times_s = drive.times_s
    num_frames = len(times_s)
    is_present, is_near, is_shadowed, is_after = np.zeros((4, num_frames), np.bool_)
    for begin_s, end_s in _visits(drive):
        is_present |= (times_s >= begin_s) & (times_s <= end_s)
        is_shadowed |= (times_s >= begin_s) & (times_s <= end_s + restore_s)
        is_near |= (times_s >= begin_s - AHEAD_S) & (times_s <= end_s + restore_s)
        is_after |= times_s > end_s + restore_s
    is_fast = ~(drive.speeds_mps < MIN_SPEED_MPS)
    return Phases(is_present & is_fast, is_after & ~is_shadowed & is_fast, ~is_near & is_fast)


def _visits(drive: GlareDrive) -> list[tuple[float, float]]:
    """From when to when each vehicle is there, seconds; see `Phases`."""
    eyes = {one.vehicle_id: one for one in drive.eyes}
    visits = []
    for vehicle_id in sorted(eyes.keys() | drive.light_s.keys()):
        begin_s, end_s = drive.light_s.get(vehicle_id, math.inf), math.inf
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
    return np.asarray(np.divide(kept, full, out=np.ones_like(kept), where=full > 0))


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
    sums = (leds_off[is_dimmed].sum(), (1.0 - road_share(drive, run))[is_dimmed].sum())
    return Dimming(
        seconds=float(is_free.sum() / drive.rate_hz),
        num_events=int(is_event.sum()),
        dimmed_s=float(is_dimmed.sum() / drive.rate_hz),
        leds_off_s=float(sums[0] / drive.rate_hz),
        road_lost_s=float(sums[1] / drive.rate_hz),
    )
