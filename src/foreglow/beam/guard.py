"""An independent check of every beam command: what passes keeps the invariants, whatever a policy wants.

It knows no policy. From the command, the tracks, the frame and the time alone, it dims the LEDs that shine at vehicles,
lets light return slowly, and commands low beam when anything is wrong. `docs/guard.md` has the invariants.

Units: seconds, radians, candela. Levels of the LEDs lie in [0, 1]. They rise at most linearly over time,

    level <- min(wanted, level + dt / brightening_s)                                                            (1)

For each protected vehicle and lamp, with the upper bound B_i on what LED i shines towards it at level 1 (`led_bounds`)
and the limit I for its range, all LEDs together may shine no more than I. Those that shine most are capped at c:

    sum over i of min(level_i B_i, c) <= I                                                                      (2)

With the LEDs sorted by level_i B_i and S_j the sum of the j faintest of L, the cap is the greatest of

    c_j = (I - S_j) / (L - j),   j = 0 .. L - 1                                                                 (3)

because the right j fulfils (2) as an equation, and any other j would leave more light than that, hence a smaller c.
An LED is then dimmed to the level c / B_i, if that is lower.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from foreglow.beam.camera_watch import CameraWatch
from foreglow.beam.faults import GuardFault
from foreglow.beam.led_bounds import Lamps, led_bounds
from foreglow.beam.sightlines import Sightlines
from foreglow.config import GuardConfig
from foreglow.geometry import Floats
from foreglow.types import MIN_STEP_S, BeamCommand, BeamMode, Frame, Tracks
from foreglow.types.arrays import check_kind, check_names, check_optional
from foreglow.types.beam import MAX_FAULTS, fault_name


class Guard:
    """Checks one command after another; when in doubt, it commands low beam."""

    def __init__(self, config: GuardConfig, lamps: Lamps) -> None:
        """A guard with the limits of `config` for the given lamps.

        Raises:
            ValueError: If an LED shines beyond the directions of `led_bounds`, or is dark in all of them.
        """
        self._config = config
        self._bounds = led_bounds(lamps)
        lamps_m = np.stack([lamps.left.vehicle_from_lamp.position_m, lamps.right.vehicle_from_lamp.position_m])
        self._sightlines = Sightlines(lamps_m, config)
        self._limit_ranges_m, self._limits_cd = np.array(config.led_limits_cd).T
        self._watch = CameraWatch(config)
        self.reset()

    def reset(self) -> None:
        """Forgets earlier frames, as at the start of a sequence: begins with low beam."""
        self._levels = np.zeros((2, self._bounds.num_leds))
        self._frame_ns: int | None = None
        self._time_ns: int | None = None
        self._is_fast = False
        self._ages_s: dict[int, float] = {}
        self._watch.reset()

    def resume(self) -> None:
        """Begins with low beam after frames that it did not see, as a stage before it failed in them.

        What is known of images and clock stays: damage that was found is not taken for what is usual.
        """
        self._levels = np.zeros_like(self._levels)
        self._ages_s = {}

    def check(
        self,
        wanted: BeamCommand,
        tracks: Tracks | None,
        frame: Frame,
        *,
        time_ns: int | None = None,
        pipeline_faults: Sequence[str] = (),
        is_vehicle: NDArray[np.bool_] | None = None,
    ) -> BeamCommand:
        """The command that may be carried out.

        Types are the caller's: an argument of another class is an error, before anything is remembered. No value
        raises: what a guard must not trust is a fault, and means low beam.

        Args:
            wanted: The policy's command for the frame; a fault in it means low beam.
            tracks: The frame's tracks; None is a fault.
            frame: The frame; its image, time, camera and motion are checked.
            time_ns: The time now, by the frames' clock; None offline, where no time passes.
            pipeline_faults: Faults that the pipeline reports; any of them means low beam.
            is_vehicle: Shape (M,), which tracks are a vehicle's lamps; None for all. Only plausible tracks count.

        Raises:
            ValueError: If an argument is of another type, or the camera's distortion cannot be undone.
        """
        _check_kinds(wanted, tracks, frame, time_ns, pipeline_faults, is_vehicle)
        elapsed_s, faults = self._clock_faults(frame.timestamp_ns, frame.timestamp_ns if time_ns is None else time_ns)
        faults += self._watch.faults(
            frame.image, frame.timestamp_ns, is_moving=self._is_moving(frame), is_damaged=frame.is_damaged
        )
        faults += self._motion_faults(frame)
        faults += self._track_faults(tracks, is_vehicle, elapsed_s)
        faults += self._command_faults(wanted, frame)
        others = [fault_name(name) for name in (*pipeline_faults, *wanted.faults)]
        names = (*others[: MAX_FAULTS - len(faults)], *(str(fault) for fault in faults))
        if names or wanted.mode == BeamMode.LOW or tracks is None or frame.camera is None:
            self._levels = np.zeros_like(self._levels)
            return BeamCommand.low(frame.timestamp_ns, self._bounds.num_leds, *names)
        levels = np.minimum(wanted.levels, self._levels + elapsed_s / self._config.brightening_s)  # (1)
        gaps_rad, gap_ranges_m = wanted.gaps_rad.copy(), wanted.gap_ranges_m.copy()  # what passed stays so
        is_protected = tracks.is_plausible if is_vehicle is None else tracks.is_plausible & is_vehicle
        if is_protected.any():
            boxes, ranges_m = tracks.boxes_xyxy_px[is_protected], tracks.ranges_m[is_protected]
            spans_rad, nearest_m = self._sightlines.spans_rad(
                frame.camera, boxes, ranges_m, tracks.sigmas_m[is_protected]
            )
            limits_cd = self._limits_cd[np.searchsorted(self._limit_ranges_m, nearest_m, side="right") - 1]
            levels = dimmed(levels, self._bounds.towards(spans_rad), limits_cd)
            right_rad, left_rad = spans_rad[:, :, 0].min(axis=1), spans_rad[:, :, 1].max(axis=1)
            borders_rad = np.stack([right_rad, np.maximum(left_rad, np.nextafter(right_rad, np.inf))], axis=1)
            from_origin_m = self._sightlines.from_origin_m(frame.camera, boxes, ranges_m)  # as gaps count
            gaps_rad, gap_ranges_m = united(
                np.concatenate([gaps_rad, borders_rad]), np.concatenate([gap_ranges_m, from_origin_m])
            )
        self._levels = levels
        if not levels.any():  # light has not begun to return, or must shine nowhere
            return BeamCommand.low(frame.timestamp_ns, self._bounds.num_leds)
        is_full = not len(gaps_rad) and levels.min() >= 1.0
        mode = BeamMode.FULL if is_full else BeamMode.GLARE_FREE
        return BeamCommand(frame.timestamp_ns, mode, levels, gaps_rad, gap_ranges_m)

    def _clock_faults(self, frame_ns: int, time_ns: int) -> tuple[float, list[GuardFault]]:
        """Time since the previous frame, 0 for the first, and what is wrong with the times."""
        elapsed_s = 0.0 if self._frame_ns is None else (frame_ns - self._frame_ns) / 1e9
        is_first, has_gone_back = self._frame_ns is None, self._time_ns is not None and time_ns < self._time_ns
        self._frame_ns, self._time_ns = frame_ns, time_ns
        faults = []
        if elapsed_s < 0 or has_gone_back:
            faults.append(GuardFault.TIME)
        if 0 <= elapsed_s < MIN_STEP_S and not is_first:
            faults.append(GuardFault.FROZEN)
        if elapsed_s > self._config.max_gap_s:
            faults.append(GuardFault.GAP)
        if not 0 <= time_ns - frame_ns <= self._config.max_age_s * 1e9:
            faults.append(GuardFault.TOO_OLD)
        return elapsed_s, faults

    def _is_moving(self, frame: Frame) -> bool | None:
        """Whether the vehicle is fast enough for every image to change; None where its speed is not known."""
        speed_mps = _speed_mps(frame)
        return None if math.isnan(speed_mps) else speed_mps >= self._config.low_below_mps

    def _motion_faults(self, frame: Frame) -> list[GuardFault]:
        faults = [] if frame.camera is not None else [GuardFault.NO_CAMERA]
        speed_mps = _speed_mps(frame)
        if math.isnan(speed_mps):
            if not self._config.needs_speed:
                return faults
            self._is_fast = False
            return [*faults, GuardFault.NO_SPEED]
        self._is_fast = speed_mps >= (self._config.low_below_mps if self._is_fast else self._config.high_above_mps)
        return faults if self._is_fast else [*faults, GuardFault.TOO_SLOW]

    def _track_faults(
        self, tracks: Tracks | None, is_vehicle: NDArray[np.bool_] | None, elapsed_s: float
    ) -> list[GuardFault]:
        if tracks is None:
            return [GuardFault.NO_TRACKS]
        numbers = (tracks.boxes_xyxy_px, tracks.confidences, tracks.ages_s)
        is_right = all(np.isfinite(array).all() for array in numbers)
        if is_vehicle is not None:
            is_right = is_right and is_vehicle.shape == (len(tracks),) and is_vehicle.dtype == np.bool_
        faults = [] if is_right else [GuardFault.BAD_TRACKS]
        ages_s = dict(zip(tracks.ids.tolist(), tracks.ages_s.tolist(), strict=True))
        if elapsed_s > 0 and any(age_s <= self._ages_s.get(track_id, -math.inf) for track_id, age_s in ages_s.items()):
            faults.append(GuardFault.STALE_TRACKS)
        self._ages_s = ages_s
        return faults

    def _command_faults(self, wanted: BeamCommand, frame: Frame) -> list[GuardFault]:
        levels, gaps_rad = wanted.levels, wanted.gaps_rad.ravel()
        faults = []
        is_right = levels.shape == self._levels.shape and bool(((levels >= 0.0) & (levels <= 1.0)).all())
        is_dark = wanted.mode != BeamMode.LOW or not (levels.any() or len(gaps_rad))
        if not (is_right and is_dark and np.isfinite(gaps_rad).all() and (gaps_rad[1:] > gaps_rad[:-1]).all()):
            faults.append(GuardFault.BAD_COMMAND)
        if wanted.timestamp_ns != frame.timestamp_ns:
            faults.append(GuardFault.STALE_COMMAND)
        return faults


def _check_kinds(
    wanted: object, tracks: object, frame: object, time_ns: object, pipeline_faults: object, is_vehicle: object
) -> None:
    """ValueError if an argument of `Guard.check` is of another type."""
    check_kind("wanted", wanted, BeamCommand)
    check_kind("frame", frame, Frame)
    check_names("pipeline_faults", pipeline_faults)
    for name, value, kind in (("tracks", tracks, Tracks), ("is_vehicle", is_vehicle, np.ndarray)):
        check_optional(name, value, kind)
    if not isinstance(time_ns, int | np.integer | None) or isinstance(time_ns, bool):
        raise ValueError(f"time_ns: expected nanoseconds as a whole number, got {type(time_ns).__name__}")


def _speed_mps(frame: Frame) -> float:
    """The vehicle's speed; NaN if it is unknown, or the motion is not one of a car."""
    return math.nan if frame.motion is None or not frame.motion.is_possible else frame.motion.speed_mps


def dimmed(levels: Floats, bounds_cd: NDArray[np.float32], limits_cd: Floats) -> Floats:
    """The levels, lowered by (2) and (3) so that neither lamp shines more than the limit in any of the spans.

    In each span, the LEDs that shine most into it are dimmed to the same intensity; the fainter ones stay as they are.

    Args:
        levels: Shape (2, L).
        bounds_cd: Shape (M, 2, L), upper bound of what each LED shines into each span at level 1.
        limits_cd: Shape (M,), for the sum over the LEDs of one lamp.

    >>> levels = dimmed(np.ones((2, 3)), np.array([[[900.0, 100.0, 0.0], [80.0, 0.0, 0.0]]]), np.array([300.0]))
    >>> np.round(levels * [900.0, 100.0, 1.0])
    array([[200., 100.,   1.],
           [900., 100.,   1.]])
    """
    shining_cd = levels * bounds_cd
    is_over = (np.add.reduce(shining_cd, axis=-1) > limits_cd[:, np.newaxis]).any(axis=1)
    if not is_over.any():
        return levels
    shining_cd, bounds_cd, limits_cd = shining_cd[is_over], bounds_cd[is_over], limits_cd[is_over]
    shining_cd.sort(axis=-1)
    fainter_cd = np.add.accumulate(shining_cd, axis=-1) - shining_cd  # S_j
    num_brighter = np.arange(shining_cd.shape[-1], 0, -1)  # L - j
    caps_cd = np.maximum.reduce((limits_cd[:, np.newaxis, np.newaxis] - fainter_cd) / num_brighter, axis=-1)  # (3)
    allowed = caps_cd[..., np.newaxis] / np.maximum(bounds_cd, caps_cd[..., np.newaxis])
    return np.minimum(levels, np.minimum.reduce(allowed, axis=0))


def united(gaps_rad: Floats, ranges_m: Floats) -> tuple[Floats, Floats]:
    """Separate gaps that cover the given ones, shape (G, 2), from right to left, and the nearest range of each.

    A range is NaN, for unknown, where that of any covered gap is.

    >>> united(np.array([[0.3, 0.4], [0.0, 0.1], [0.05, 0.2]]), np.array([90.0, 50.0, 70.0]))
    (array([[0. , 0.2],
           [0.3, 0.4]]), array([50., 90.]))
    """
    apart: list[list[float]] = []
    order = np.argsort(gaps_rad[:, 0], kind="stable")
    for (right, left), range_m in zip(gaps_rad[order].tolist(), ranges_m[order].tolist(), strict=True):
        if apart and right <= apart[-1][1]:
            nearest_m = math.nan if math.isnan(range_m) else min(apart[-1][2], range_m)
            apart[-1][1:] = max(apart[-1][1], left), nearest_m
        else:
            apart.append([right, left, range_m])
    rows = np.array(apart)
    return rows[:, :2], rows[:, 2]
