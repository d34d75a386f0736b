"""How fast the car turns: the yaw rate, from features that are followed over two frames.

All in tangents of angles: u to the right, v downwards. Between two frames, a point at p moves away from the image
(a, b) of the direction of travel, and with the camera's rotation w = (w_u, w_v, w_z) about the axes to the right,
downwards and ahead. The part of its motion m across the way from (a, b) is only the rotation's:

    0 = n . (m - B(p) w),   n across p - (a, b),   B = [[u v, -(1 + u^2), v], [1 + v^2, -u v, -u]]              (1)

which holds at any distance. (1) is fitted for (a, b) and w with weights that make moving things count little, and with
(a, b) near the point to which the lines of the road lead. The flow alone can hardly tell a turn from a travel to the
side: without that point, the yaw rate is wrong by up to 1 degree a second, with it by 0.1 to 0.3.

Source: Longuet-Higgins and Prazdny, The interpretation of a moving retinal image, 1980.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.calibration.auto.views import Grey, Lens, View
from foreglow.geometry import Floats

NUM_FEATURES = 300
QUALITY = 0.005
SPACING_PX = 6
WINDOW_PX = (21, 21)
NUM_LEVELS = 4

MAX_STEP_S = 0.12
"""Over longer steps, features near the car move too far to be followed."""
MAX_RETURN_PX = 0.5
"""A feature that does not come back to its place when followed backwards is dropped."""

MIN_MOTION_PX = 0.5
"""Slower features stand still: the bonnet, the dashboard in the windscreen, dirt."""

MIN_FEATURES = 20
MIN_SPREAD_PX = 1.0
"""Median motion below which the car hardly moves."""

NOISE_PX = 0.3
"""Standard deviation of a feature's motion."""

ROTATION_SIGMAS = np.radians([3.0, 15.0, 2.0])
"""Standard deviations of w_u, w_v and w_z a second."""

POINT_SIGMA = 0.005
"""Standard deviation of the direction of travel about the point to which the lines lead."""

NUM_STEPS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """Features in two frames, in tangents of angles.

    Attributes:
        middles: Shape (N, 2), half-way.
        motions: Shape (N, 2).
        step_s: Time between the frames.
    """

    middles: Floats
    motions: Floats
    step_s: float


@dataclass(frozen=True, slots=True)
class Turn:
    """How fast the camera turns to the right between two frames.

    Attributes:
        rate_radps: w_v a second.
        sigma_radps: Its standard deviation.
    """

    rate_radps: float
    sigma_radps: float


def is_next(first: View, second: View) -> bool:
    """Whether the second frame comes soon after the first."""
    return first.sequence == second.sequence and 0.0 < second.time_s - first.time_s <= MAX_STEP_S


def follow(first: View, second: View, lens: Lens) -> Tracks | None:
    """Features that move from a frame to the next; None if the car stands, or too few are seen."""
    found = cv2.goodFeaturesToTrack(first.grey, NUM_FEATURES, QUALITY, SPACING_PX)
    if found is None or len(found) < MIN_FEATURES:
        return None
    starts = np.asarray(found, np.float32).reshape(-1, 1, 2)
    ends, is_found = _followed(first.grey, second.grey, starts)
    back, is_back = _followed(second.grey, first.grey, ends)
    moves = np.linalg.norm((ends - starts).reshape(-1, 2), axis=1)
    is_kept = is_found & is_back & (np.linalg.norm((back - starts).reshape(-1, 2), axis=1) < MAX_RETURN_PX)
    is_kept &= moves > MIN_MOTION_PX
    if is_kept.sum() < MIN_FEATURES or np.median(moves[is_kept]) < MIN_SPREAD_PX:
        return None
    before = lens.tangents(starts.reshape(-1, 2)[is_kept])
    after = lens.tangents(ends.reshape(-1, 2)[is_kept])
    return Tracks((before + after) / 2, after - before, second.time_s - first.time_s)


def _followed(first: Grey, second: Grey, points: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    ends, status, _ = cv2.calcOpticalFlowPyrLK(first, second, points, None, winSize=WINDOW_PX, maxLevel=NUM_LEVELS)  # type: ignore[call-overload]
    return np.asarray(ends, np.float32).reshape(-1, 1, 2), np.asarray(status).reshape(-1) == 1


def turn_of(tracks: Tracks, ahead: Floats, focal_px: float) -> Turn:
    """The camera's turn by (1), travelling about towards the point `ahead`, shape (2,)."""
    u, v = tracks.middles.T
    shares = np.stack([np.stack([u * v, -(1 + u * u), v], -1), np.stack([1 + v * v, -u * v, -u], -1)], 1)  # B
    sigma = NOISE_PX * np.sqrt(2) / focal_px
    point, turn = ahead, np.zeros(3)
    prior = np.diag(np.concatenate([[POINT_SIGMA**-2.0] * 2, (ROTATION_SIGMAS * tracks.step_s) ** -2.0]))
    information = np.zeros((5, 5))
    for step in range(NUM_STEPS):
        away = tracks.middles - point
        distances = np.maximum(np.hypot(*away.T), 1e-3)
        across = np.stack([away[:, 1], -away[:, 0]], -1) / distances[:, None]  # n
        rest = tracks.motions - shares @ turn
        residuals = np.einsum("ij,ij->i", across, rest)
        # of n . rest: turning n about p changes it by the part of the motion along the way
        to_point = np.stack([rest[:, 1], -rest[:, 0]], -1) / distances[:, None]
        rows = np.concatenate([-to_point, np.einsum("ij,ijk->ik", across, shares)], 1)
        scale = max(2.0, 20.0 * 0.6**step)
        weights = 1.0 / (sigma**2 * (1.0 + (residuals / (scale * sigma)) ** 2))
        information = (rows * weights[:, None]).T @ rows
        pull = prior @ -np.concatenate([point - ahead, turn])
        change = np.linalg.solve(information + prior, (rows * weights[:, None]).T @ residuals + pull)
        point, turn = point + change[:2], turn + change[2:]
    sigma_rad = float(np.linalg.inv(information + prior)[3, 3]) ** 0.5
    return Turn(float(turn[1]) / tracks.step_s, sigma_rad / tracks.step_s)
