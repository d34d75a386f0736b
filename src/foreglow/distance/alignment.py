"""Map matching: where the vehicle really stands on the mapped road, as a filter over time.

A vehicle that follows the road turns with it. If the curvature that it drives is not that of the map at its position,
but that of the map a little further on or back, then that is where the vehicle is.

State: the shift d along the road beyond the map's position, on a grid of 1 m within the bound B of the map's error,
with a probability P(d) each (a histogram filter); and yaw and offset in the lane, each with a mean and a variance (two
Kalman filters of one state). Units: metres, radians, seconds, curvature 1/m, all positive to the left or forward.

Shift, prior and prediction over the distance D travelled since the last frame, where * is a convolution:

    P0(d) ~ exp(-(d / (0.45 B))^2 / 2)                                                                          (1)
    P(d) <- k (P * N(0, (0.01 B D)^2)) + (1 - k) P0,   k = exp(-D / 300 m)                                      (2)

Correction by the yaw rate w at the speed v. The exponent keeps frames that are less than 5 m apart from counting as
independent measurements; the floor allows for a driver who avoids something:

    P(d) <- P(d) L(d)^min(D / 5 m, 1),   L = exp(-((kappa(d) - w / v) / sigma(d))^2 / 2) + 0.02                 (3)
    sigma(d)^2 = sigma_driver^2 + (sigma_w / v)^2 + (5 m d kappa / ds)^2                                        (4)

Yaw and offset fade to the map's, mean 0 and variance V0, over the time dt, and are corrected by what the lane markings
measure against them, m with the variance R. Where the map only says where on the road the vehicle is, they are those of
a driver who keeps the lane:

    mean <- c mean,   V <- V + (1 - c^2) (V0 - V),   c = exp(-dt / 2 s)                                         (5)
    mean <- mean + G (m - mean),   V <- (1 - G) V,   G = V / (V + R)                                            (6)

Source: Thrun, Burgard and Fox, Probabilistic Robotics, 2005: histogram filter and Kalman filter. The measurement
model and its constants are our own.
"""

from __future__ import annotations

import math

import numpy as np

from foreglow.distance.markings import MarkingFinder
from foreglow.distance.ribbon import CURVATURE_REACH_M, Alignment, mapped_curvatures, mapped_standing
from foreglow.geometry import Floats
from foreglow.types import Frame

YAW_SIGMA_RAD = math.radians(0.15)
LEFT_SIGMA_M = 0.2
"""Standard deviations of a driver who keeps the lane, from its direction and its middle."""

BOUND_SHARE = 0.45
"""Standard deviation of the longitudinal error as a share of its bound. An error that is equally likely anywhere within
the bound would have 0.58; one that wanders through the map's error classes has less."""

MIN_SPEED_MPS = 5.0
"""Slower vehicles turn into driveways and steer around obstacles, so their curvature says nothing of the road."""

CURVATURE_SIGMA_PER_M = 4e-4
"""sigma_driver in (4): a driver's corrections within the lane."""

YAW_RATE_SIGMA_RADPS = 0.003
INDEPENDENT_M = 5.0
"""Distance after which the driven curvature is an independent measurement."""

WANDER_M = 300.0
"""Distance over which the shift is forgotten to 1 / e."""

WANDER_SHARE = 0.01
"""Standard deviation of how far the shift moves in a metre, as a share of the bound."""

OUTLIER_LIKELIHOOD = 0.02
"""Likelihood of any curvature, relative to the best match: a driver may avoid something."""

STEP_M = 1.0
MIN_BOUND_M = 6.0
MAX_BOUND_M = 60.0
"""The shift is estimated for bounds within these. Smaller errors are less than the map's own; with larger ones, one
bend may be taken for another."""

STANDING_S = 2.0
"""Time over which yaw and offset in the lane are forgotten to 1 / e."""

MAX_GAP_S = 1.0
"""After a longer gap, and when time goes back, everything is forgotten."""


def map_alignment(frame: Frame) -> Alignment:
    """The map's own belief: no shift, with its error; infinite sigma of the shift without a road or a bound."""
    bound_m = math.inf if frame.road is None else frame.road.error_bound_m
    return Alignment(0.0, 0.0, 0.0, _yaw_sigma_rad(frame), LEFT_SIGMA_M, BOUND_SHARE * max(bound_m, STEP_M))


def _yaw_sigma_rad(frame: Frame) -> float:
    """Standard deviation of the camera's yaw against the lane, before any marking is seen: the driver's and the
    mount's.
    """
    return YAW_SIGMA_RAD if frame.camera is None else math.hypot(YAW_SIGMA_RAD, frame.camera.mount_sigmas.yaw_rad)


class RoadAligner:
    """Estimates shift, yaw and offset frame by frame.

    Without the vehicle's motion or without a road, the shift is zero with the sigma of the bound.
    """

    def __init__(self, markings: MarkingFinder | None = None) -> None:
        """Takes a finder of lane markings that may be shared, so that each image is searched once."""
        self._markings = markings or MarkingFinder()
        self.reset()

    def reset(self) -> None:
        """Forgets earlier frames, as at the start of a sequence."""
        self._timestamp_ns: int | None = None
        self._bound_m = math.nan
        self._probabilities = np.zeros(0)
        self._mapped = np.zeros(0)
        self._yaw = _Fading(YAW_SIGMA_RAD)
        self._left = _Fading(LEFT_SIGMA_M)

    def align(self, frame: Frame) -> Alignment:
        """The alignment in `frame`; infinite sigma of the shift without a road or without a bound."""
        gap_s = math.nan if self._timestamp_ns is None else (frame.timestamp_ns - self._timestamp_ns) * 1e-9
        if not 0.0 < gap_s <= MAX_GAP_S:
            self.reset()
            self._yaw = _Fading(_yaw_sigma_rad(frame))
            gap_s = math.nan
        self._timestamp_ns = frame.timestamp_ns
        shift_m, shift_sigma_m = self._shift(frame, gap_s)
        lane, (yaw_rad, left_m) = self._markings.find(frame), (0.0, 0.0)
        if frame.road is not None:
            yaw_rad, left_m = mapped_standing(frame.road)
        self._yaw.update(gap_s, lane.yaw_rad - yaw_rad, lane.yaw_sigma_rad)
        self._left.update(gap_s, lane.left_m - left_m, lane.left_sigma_m)
        return Alignment(self._yaw.mean, self._left.mean, shift_m, self._yaw.sigma, self._left.sigma, shift_sigma_m)

    def _shift(self, frame: Frame, gap_s: float) -> tuple[float, float]:
        """Mean and standard deviation of the shift; `gap_s` is NaN in the first frame."""
        road, motion = frame.road, frame.motion
        bound_m = math.inf if road is None else road.error_bound_m
        if road is None or motion is None or not MIN_BOUND_M <= bound_m <= MAX_BOUND_M:
            self._bound_m = math.nan
            return 0.0, map_alignment(frame).shift_sigma_m
        travelled_m = max(motion.speed_mps, 0.0) * gap_s if bound_m == self._bound_m else math.nan
        shifts_m = np.arange(-np.ceil(bound_m), np.ceil(bound_m) + STEP_M / 2, STEP_M)
        prior = _normalised(np.exp(-0.5 * (shifts_m / (BOUND_SHARE * bound_m)) ** 2))  # (1)
        is_ahead = shifts_m >= 0.0
        mapped = np.full(len(shifts_m), np.nan)  # the road behind is unknown at first
        mapped[is_ahead] = mapped_curvatures(road, shifts_m[is_ahead])
        if math.isnan(travelled_m):
            self._probabilities, exponent = prior, 1.0
        else:
            # Curvatures behind, and so close ahead that (3) of `ribbon` needs road behind, are those of earlier frames.
            is_past = shifts_m < CURVATURE_REACH_M
            mapped[is_past] = np.interp(shifts_m[is_past] + travelled_m, shifts_m, self._mapped)
            self._probabilities = _predicted(self._probabilities, prior, travelled_m, bound_m)
            exponent = min(travelled_m / INDEPENDENT_M, 1.0)
        self._mapped, self._bound_m = mapped, bound_m
        if motion.speed_mps >= MIN_SPEED_MPS:
            driven = motion.yaw_rate_radps / motion.speed_mps
            noise = math.hypot(CURVATURE_SIGMA_PER_M, YAW_RATE_SIGMA_RADPS / motion.speed_mps)
            likelihoods = _likelihoods(mapped, driven, noise)
            self._probabilities = _normalised(self._probabilities * likelihoods**exponent)  # (3)
        mean_m = float(self._probabilities @ shifts_m)
        return mean_m, max(math.sqrt(float(self._probabilities @ (shifts_m - mean_m) ** 2)), STEP_M / 2)


class _Fading:
    """A Kalman filter of one state with the mean 0 that is measured now and then, and forgotten in between."""

    def __init__(self, sigma: float) -> None:
        self._rest_variance = sigma * sigma
        self.mean = 0.0
        self._variance = sigma * sigma

    @property
    def sigma(self) -> float:
        """Standard deviation."""
        return math.sqrt(self._variance)

    def update(self, gap_s: float, measured: float, sigma: float) -> None:
        """Predicts over `gap_s`, NaN in the first frame, and corrects; an infinite sigma means no measurement."""
        if not math.isnan(gap_s):
            kept = math.exp(-gap_s / STANDING_S)
            self.mean *= kept  # (5)
            self._variance += (1.0 - kept * kept) * (self._rest_variance - self._variance)
        gain = self._variance / (self._variance + sigma * sigma)
        self.mean += gain * (measured - self.mean)  # (6)
        self._variance *= 1.0 - gain


def _predicted(probabilities: Floats, prior: Floats, travelled_m: float, bound_m: float) -> Floats:
    """Equation (2): the probabilities after `travelled_m`, spread by the shift's wandering and partly forgotten."""
    sigma = WANDER_SHARE * bound_m * travelled_m / STEP_M
    reach = min(math.ceil(3 * sigma), len(probabilities) // 2)
    if reach:
        kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
        probabilities = np.convolve(probabilities, kernel, mode="same")
    kept = math.exp(-travelled_m / WANDER_M)
    return kept * _normalised(probabilities) + (1.0 - kept) * prior


def _likelihoods(mapped: Floats, driven: float, noise: float) -> Floats:
    """L of (3) for each shift; where no curvature is mapped, the mean of the others.

    Where a bend begins, the mapped curvature is a mean over some metres: (4) makes it count for less there.
    """
    noises = np.hypot(noise, np.gradient(mapped) * (CURVATURE_REACH_M / STEP_M))  # (4)
    likelihoods = np.exp(-0.5 * ((mapped - driven) / noises) ** 2) + OUTLIER_LIKELIHOOD
    is_known = ~np.isnan(likelihoods)
    likelihoods[~is_known] = likelihoods[is_known].mean()
    return likelihoods


def _normalised(weights: Floats) -> Floats:
    return np.asarray(weights / weights.sum())
