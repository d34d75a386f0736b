"""Where we really stand on the road that the map tells.

A car that follows its road turns with it. Where the curvature that we drive differs from the map's at the believed
place, but is that of a place a little further on or back, we are there. Yaw and offset are those between the lane
markings.
"""

from __future__ import annotations

import math

import numpy as np

from foreglow.distance.markings import MarkingFinder
from foreglow.distance.ribbon import CURVATURE_REACH_M, Alignment, mapped_curvatures
from foreglow.geometry import Floats
from foreglow.types import Frame

YAW_SIGMA_RAD = math.radians(0.15)
LEFT_SIGMA_M = 0.2
"""Of a driver who keeps the lane, against its middle and direction."""

BOUND_SHARE = 0.45
"""Standard deviation of the longitudinal error in terms of its bound: that of an error that is as likely anywhere
within the bound has 0.58, that of one that wanders within classes of errors less."""

MIN_SPEED_MPS = 5.0
"""Slower cars turn into drives and around obstacles."""

CURVATURE_SIGMA_PER_M = 4e-4
"""Of the curvature driven against that of the road: a driver's corrections in the lane."""

YAW_RATE_SIGMA_RADPS = 0.003
LOOK_M = 5.0
"""Way after which another look at the curvature tells something new."""

WANDER_M = 300.0
"""Way over which the shift is forgotten, e-fold."""

WANDER_SHARE = 0.01
"""Standard deviation of how the shift moves in a metre, in terms of the bound."""

OUTLIER_LIKELIHOOD = 0.02
"""Of any curvature, of the greatest: a driver may also avoid something."""

STEP_M = 1.0
MIN_BOUND_M = 6.0
MAX_BOUND_M = 60.0
"""Smaller errors are less than the map's own; beyond, a bend may be taken for another."""

STANDING_S = 2.0
"""Time after which yaw and offset in the lane are forgotten, e-fold."""

MAX_GAP_S = 1.0
"""After a longer gap, and when time goes back, all is forgotten."""


def believed(frame: Frame) -> Alignment:
    """How the map believes us to stand, with what that may err; infinite sigma of the shift without road or bound."""
    bound_m = math.inf if frame.road is None else frame.road.error_bound_m
    return Alignment(0.0, 0.0, 0.0, YAW_SIGMA_RAD, LEFT_SIGMA_M, BOUND_SHARE * max(bound_m, STEP_M))


class RoadAligner:
    """Filters how we stand over time: the shift on a grid within the bound of the position's error, yaw and offset
    towards those of a driver who keeps the lane.

    Where nothing is told of our motion or of the road, the shift is zero with the sigma of the bound.
    """

    def __init__(self, markings: MarkingFinder | None = None) -> None:
        """Takes a finder that others use as well, so that it looks at each image once."""
        self._markings = markings or MarkingFinder()
        self.reset()

    def reset(self) -> None:
        """Forgets earlier frames, as at the start of a sequence."""
        self._timestamp_ns: int | None = None
        self._bound_m = math.nan
        self._shares = np.zeros(0)
        self._mapped = np.zeros(0)
        self._yaw = _Fading(YAW_SIGMA_RAD)
        self._left = _Fading(LEFT_SIGMA_M)

    def align(self, frame: Frame) -> Alignment:
        """How we stand in `frame`; infinite sigma of the shift where there is no road, or no bound."""
        gap_s = math.nan if self._timestamp_ns is None else (frame.timestamp_ns - self._timestamp_ns) * 1e-9
        if not 0.0 < gap_s <= MAX_GAP_S:
            self.reset()
            gap_s = math.nan
        self._timestamp_ns = frame.timestamp_ns
        shift_m, shift_sigma_m = self._shift(frame, gap_s)
        lane = self._markings.find(frame)
        self._yaw.update(gap_s, lane.yaw_rad, lane.yaw_sigma_rad)
        self._left.update(gap_s, lane.left_m, lane.left_sigma_m)
        return Alignment(self._yaw.mean, self._left.mean, shift_m, self._yaw.sigma, self._left.sigma, shift_sigma_m)

    def _shift(self, frame: Frame, gap_s: float) -> tuple[float, float]:
        """Mean and standard deviation of the shift; `gap_s` is NaN in the first frame."""
        road, motion = frame.road, frame.motion
        bound_m = math.inf if road is None else road.error_bound_m
        if road is None or motion is None or not MIN_BOUND_M <= bound_m <= MAX_BOUND_M:
            self._bound_m = math.nan
            return 0.0, believed(frame).shift_sigma_m
        way_m = max(motion.speed_mps, 0.0) * gap_s if bound_m == self._bound_m else math.nan
        shifts_m = np.arange(-np.ceil(bound_m), np.ceil(bound_m) + STEP_M / 2, STEP_M)
        prior = _normalised(np.exp(-0.5 * (shifts_m / (BOUND_SHARE * bound_m)) ** 2))
        is_ahead = shifts_m >= 0.0
        mapped = np.full(len(shifts_m), np.nan)  # of what lies behind nothing is known at first
        mapped[is_ahead] = mapped_curvatures(road, shifts_m[is_ahead])
        if math.isnan(way_m):
            self._shares, weight = prior, 1.0
        else:
            # Nearer than the reach of a curvature the map told better when that was still further ahead.
            is_past = shifts_m < CURVATURE_REACH_M
            mapped[is_past] = np.interp(shifts_m[is_past] + way_m, shifts_m, self._mapped)
            self._shares, weight = _moved(self._shares, prior, way_m, bound_m), min(way_m / LOOK_M, 1.0)
        self._mapped, self._bound_m = mapped, bound_m
        if motion.speed_mps >= MIN_SPEED_MPS:
            driven = motion.yaw_rate_radps / motion.speed_mps
            noise = math.hypot(CURVATURE_SIGMA_PER_M, YAW_RATE_SIGMA_RADPS / motion.speed_mps)
            self._shares = _normalised(self._shares * _likelihoods(mapped, driven, noise) ** weight)
        mean_m = float(self._shares @ shifts_m)
        return mean_m, max(math.sqrt(float(self._shares @ (shifts_m - mean_m) ** 2)), STEP_M / 2)


class _Fading:
    """A number about zero that is measured now and then, and forgotten in between: a Kalman filter of one state."""

    def __init__(self, sigma: float) -> None:
        self._rest_variance = sigma * sigma
        self.mean = 0.0
        self._variance = sigma * sigma

    @property
    def sigma(self) -> float:
        """Standard deviation."""
        return math.sqrt(self._variance)

    def update(self, gap_s: float, measured: float, sigma: float) -> None:
        """Fades over `gap_s`, NaN in the first frame, and takes what was measured; an infinite sigma tells nothing."""
        if not math.isnan(gap_s):
            kept = math.exp(-gap_s / STANDING_S)
            self.mean *= kept
            self._variance += (1.0 - kept * kept) * (self._rest_variance - self._variance)
        gain = self._variance / (self._variance + sigma * sigma)
        self.mean += gain * (measured - self.mean)
        self._variance *= 1.0 - gain


def _moved(shares: Floats, prior: Floats, way_m: float, bound_m: float) -> Floats:
    """The shares after `way_m`: spread by the shift's wandering, and partly forgotten."""
    sigma = WANDER_SHARE * bound_m * way_m / STEP_M
    reach = min(math.ceil(3 * sigma), len(shares) // 2)
    if reach:
        kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
        shares = np.convolve(shares, kernel, mode="same")
    kept = math.exp(-way_m / WANDER_M)
    return kept * _normalised(shares) + (1.0 - kept) * prior


def _likelihoods(mapped: Floats, driven: float, noise: float) -> Floats:
    """How well the mapped curvatures explain the driven one; where none is known, as well as all of them do.

    Where a bend begins the mapped one is a mean over some metres, and speaks against less.
    """
    noises = np.hypot(noise, np.gradient(mapped) * (CURVATURE_REACH_M / STEP_M))
    likelihoods = np.exp(-0.5 * ((mapped - driven) / noises) ** 2) + OUTLIER_LIKELIHOOD
    is_known = ~np.isnan(likelihoods)
    likelihoods[~is_known] = likelihoods[is_known].mean()
    return likelihoods


def _normalised(shares: Floats) -> Floats:
    return np.asarray(shares / shares.sum())
