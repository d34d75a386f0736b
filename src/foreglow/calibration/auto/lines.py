"""Where the lines on the road meet: the vanishing point of each frame, from OpenCV's line segments.

All in tangents of angles: u to the right, v downwards. A line along a flat road that lies Y to the right of a camera at
the height h, on a road of the curvature k to the right, is seen at

    u(v) = u0 + (Y / h) (v - v0) + (k h / 2) / (v - v0),   v > v0                                               (1)

with the vanishing point (u0, v0) of the way ahead. So the tangent of the line at the row v meets the horizon at

    u0 + k h / (v - v0)

whatever Y is. Likewise, the tangents of a road that falls away with the vertical curvature c meet lower. The tangent at
the row v leads to the point

    (u0 + k h / (v - v0), v0 + c h / (v - v0))                                                                  (2)

Each line segment gives one equation (2) for (u0, v0, k h, c h), which are fitted with weights that make segments of
other things count little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from foreglow.calibration.auto.views import Grey, Lens
from foreglow.geometry import Floats

MIN_LENGTH_SHARE = 0.025
"""Shorter segments, as a share of the image's width, are not used."""

MIN_SLOPE = 0.1
"""Segments that fall by less than this for each pixel to the side are level, such as kerbs across and bonnets."""

MIN_LEAN = 0.15
"""Segments that lean by less than this for each pixel downwards are poles, walls, and lamps mirrored in a wet road."""

REACH = 0.3
GRID_STEP = 0.01
"""The vanishing point of a drive is searched for up to `REACH` to either side of the axis, with this step."""

VOTE_SIGMA = 0.012
MAX_LENGTH = 0.2
MAX_VOTE = 0.6
MIN_VOTE = 0.05
"""Votes: of a segment at most `MAX_LENGTH`, of a side of a frame at most `MAX_VOTE`, and of a point at least `MIN_VOTE`
for each frame."""

MIN_DEPTH = 0.03
"""The middle of a segment is at least this far below the horizon."""

POSITION_SIGMA_PX = 0.35
SLOPE_SIGMA = 0.005
"""Standard deviations of a segment's ends across it, and of the direction of a line against the road's, rad."""

HIT_SIGMA = 0.002
"""Standard deviation of (2) where the direction is exact: the lines of a road are not straight."""

BEND_SIGMA = 0.005
HILL_SIGMA = 0.0007
"""Standard deviations of k h and c h where nothing else tells them."""

PRIOR_SIGMA = 0.035
"""Standard deviation of a frame's vanishing point about that of the drive before the fit."""

NUM_STEPS = 8
MIN_SEGMENTS = 4

WAY_SIGMA = 0.02
WAY_STEP_DEG = 5.0
"""A segment whose line passes the vanishing point within `WAY_SIGMA` leads there on one of the ways of this width."""

MIN_WAYS, MAX_WAYS = 2.0, 10.0
"""On simulated drives, the lines of a road take 3 to 9 ways, streaks of snow in our light 11 to 19, and lamps mirrored
in a wet road 1 to 2."""


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """Line segments of a frame, in tangents of angles.

    Attributes:
        middles: Shape (N, 2).
        slopes: Shape (N,), du/dv.
        lengths: Shape (N,).
        tops: Shape (N,), v of the upper end.
    """

    middles: Floats
    slopes: Floats
    lengths: Floats
    tops: Floats

    def __len__(self) -> int:
        return len(self.slopes)


@dataclass(frozen=True, slots=True)
class Bend:
    """The road's curvature to the right times the height of the camera, k h of (1), before the lines are looked at.

    Attributes:
        mean: k h.
        sigma: Its standard deviation.
    """

    mean: float = 0.0
    sigma: float = BEND_SIGMA


UNKNOWN_BEND = Bend()


@dataclass(frozen=True, slots=True, eq=False)
class Direction:
    """Where the way ahead is seen in a frame.

    Attributes:
        point: Shape (2,), tangents u, v.
        information: Shape (2, 2), inverse of the covariance.
        bend: k h of (1), as found.
    """

    point: Floats
    information: Floats
    bend: float

    @property
    def worst_sigma(self) -> float:
        """Standard deviation in the direction in which the point is known least."""
        least = float(np.linalg.eigvalsh(self.information)[0])
        return least**-0.5 if least > 0 else np.inf


def find_segments(grey: Grey, lens: Lens) -> Segments:
    """The segments in `grey` that are long enough, and neither level nor upright."""
    found = cv2.createLineSegmentDetector().detect(grey)[0]
    ends_px = np.zeros((0, 2, 2)) if found is None else np.asarray(found, np.float64).reshape(-1, 2, 2)
    spans_px = ends_px[:, 1] - ends_px[:, 0]
    lengths_px = np.hypot(spans_px[:, 0], spans_px[:, 1])
    is_used = lengths_px > MIN_LENGTH_SHARE * grey.shape[1]
    across_px, down_px = np.abs(spans_px).T
    is_used &= (down_px > MIN_SLOPE * across_px) & (across_px > MIN_LEAN * down_px)
    ends = lens.tangents(ends_px[is_used])
    spans = ends[:, 1] - ends[:, 0]
    slopes, lengths = spans[:, 0] / spans[:, 1], np.hypot(spans[:, 0], spans[:, 1])
    return Segments(ends.mean(1), slopes, lengths, ends[..., 1].min(1))


def vote(frames: Sequence[Segments]) -> Floats | None:
    """The point (u, v) at which most segments of all frames meet from both sides; None if they meet nowhere.

    A segment votes for the points on its line that are above it. A point counts the votes from the left and from the
    right alike, and neither side of a frame for more than `MAX_VOTE`.
    """
    axis = np.arange(-REACH, REACH + GRID_STEP / 2, GRID_STEP)
    totals = np.zeros((2, len(axis), len(axis)))
    for segments in frames:
        hits = segments.middles[:, :1] + segments.slopes[:, None] * (axis - segments.middles[:, 1:])  # (N, V)
        is_below = (segments.tops[:, None] > axis) & (segments.middles[:, 1:] > axis + MIN_DEPTH)
        weights = is_below * np.minimum(segments.lengths, MAX_LENGTH)[:, None]
        sigmas = VOTE_SIGMA * np.sqrt(1.0 + segments.slopes**2)
        offsets = (hits[..., None] - axis) / sigmas[:, None, None]  # (N, V, U)
        votes = weights[..., None] * np.maximum(1.0 - offsets * offsets / 6.0, 0.0)
        for side, is_side in enumerate((segments.slopes < 0, segments.slopes >= 0)):
            totals[side] += np.minimum(votes[is_side].sum(0), MAX_VOTE)
    both = np.sqrt(totals[0] * totals[1])
    v, u = np.unravel_index(both.argmax(), both.shape)
    if both[v, u] < MIN_VOTE * len(frames):
        return None
    return np.array([axis[u], axis[v]])


def meet(segments: Segments, start: Floats, focal_px: float, bend: Bend = UNKNOWN_BEND) -> Direction | None:
    """The vanishing point of a frame by (2), near `start`; None where too few segments say where it is."""
    found = np.array([*start, bend.mean, 0.0])  # u0, v0, k h, c h
    if len(segments) < MIN_SEGMENTS:
        return None
    expected, prior = found.copy(), np.diag(np.array([PRIOR_SIGMA, PRIOR_SIGMA, bend.sigma, HILL_SIGMA]) ** -2.0)
    information = np.zeros((4, 4))
    for step in range(NUM_STEPS):
        depths = segments.middles[:, 1] - found[1]
        is_used = (segments.tops > found[1]) & (depths > MIN_DEPTH)
        if is_used.sum() < MIN_SEGMENTS:
            return None
        slopes, depths = segments.slopes[is_used], depths[is_used]
        hits = segments.middles[is_used, 0] - slopes * depths
        sigmas = np.hypot(POSITION_SIGMA_PX / focal_px * 3.5 / segments.lengths[is_used], SLOPE_SIGMA)
        sigmas = np.hypot(sigmas * np.sqrt(1.0 + slopes**2) * depths, HIT_SIGMA)  # across the line
        across = 1.0 / np.sqrt(1.0 + slopes**2)
        residuals = (hits - found[0] - (found[2] - slopes * found[3]) / depths) * across
        rows = np.stack([np.ones_like(slopes), -slopes, 1.0 / depths, -slopes / depths], -1) * across[:, None]
        scale = max(3.0, 8.0 * 0.6**step)
        weights = 1.0 / (sigmas**2 * (1.0 + (residuals / (scale * sigmas)) ** 2))
        information = (rows * weights[:, None]).T @ rows
        pull = prior @ (expected - found)
        found += np.linalg.solve(information + prior, (rows * weights[:, None]).T @ residuals + pull)
    information[2:, 2:] += prior[2:, 2:]
    known = information[:2, :2] - information[:2, 2:] @ np.linalg.solve(information[2:, 2:], information[2:, :2])
    return Direction(found[:2], known, float(found[2]))


def num_ways(segments: Segments, point: Floats) -> float:
    """Number of ways on which the segments lead to the vanishing point, each counted by the length on it.

    It is e to the entropy of the lengths' distribution over directions: a road has few lines, each of which is found in
    many segments, while streaks of snow and rain lead away from their point on all ways. 0 without segments.
    """
    depths = segments.middles[:, 1] - point[1]
    misses = (segments.middles[:, 0] - segments.slopes * depths - point[0]) / np.sqrt(1.0 + segments.slopes**2)
    leads = (segments.tops > point[1]) & (depths > MIN_DEPTH) & (np.abs(misses) < WAY_SIGMA)
    ways = np.round(np.degrees(np.arctan(segments.slopes[leads])) / WAY_STEP_DEG).astype(np.int64)
    lengths = np.bincount(ways - ways.min(initial=0), np.minimum(segments.lengths[leads], MAX_LENGTH))
    shares = lengths[lengths > 0] / max(float(lengths.sum()), 1e-9)
    return float(np.exp(-(shares * np.log(shares)).sum())) if len(shares) else 0.0
