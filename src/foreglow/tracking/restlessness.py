"""How restless a light is, as evidence: a hidden vehicle's runs along what it lights, a reflector keeps its place.

What stands still moves steadily in the image, whatever our own motion, and most of what we light stands still. With the
centres x of a box in its latest three detections, in pixels, and the rate v at which it moved between the former two,
the light was elsewhere than expected by x - (x' + v dt). With n frame periods in dt and the focal length f in pixels,

    m <- m + g (|x - x' - v dt| / (n f) - m)                                                                    (1)

is a moving mean of that angle in each frame. The vertical is left out: there the pitch of our car moves everything.
From the restlessness m follows for the score s of a detection

    logit(s') = logit(s) + w log(m / A) / log(B / A),   the fraction limited to [0, 1]                          (2)

with `STEADY_RAD` for A and `RESTLESS_RAD` for B. A lamp in sight moves steadily, too: its score stays as it is, and so
does that of a light that was detected no more than twice.
"""

from __future__ import annotations

import numpy as np

from foreglow.geometry import Floats

STEADY_RAD, RESTLESS_RAD = 1.5e-3, 4.0e-3
"""Angles in a frame at 18 Hz up to which a light is steady, and from which it is as restless as any: decision 24."""

MAX_DIRECT = 0.5
"""Light that is more likely to be a lamp in sight than this is no light on something."""


def surprises_rad(residuals_px: Floats, focal_px: float, num_frames: Floats) -> Floats:
    """The angle in each frame, shape (M,), by which lights were elsewhere than expected; NaN where nothing is known.

    Args:
        residuals_px: Shape (M,), measured less expected centre x.
        focal_px: Focal length.
        num_frames: Shape (M,), frame periods since the previous detection; less than one counts as one.
    """
    return np.asarray(np.abs(residuals_px) / (focal_px * np.maximum(num_frames, 1.0)))  # in (1)


def scores_of_restless(scores: Floats, restlessness_rad: Floats, direct: Floats, weight: float) -> Floats:
    """The scores of (2), shape (M,): each unchanged where the restlessness is NaN, and that of a lamp in sight.

    Args:
        scores: Shape (M,); NaN stays NaN.
        restlessness_rad: Shape (M,).
        direct: Shape (M,), probability of a lamp in sight; NaN where unknown, which counts as none.
        weight: The w of (2).

    >>> restless = np.array([0.001, 0.004, np.nan, 0.01])
    >>> scores_of_restless(np.full(4, 0.5), restless, np.array([0.1, 0.1, 0.1, 0.9]), np.log(3.0)).round(3).tolist()
    [0.5, 0.75, 0.5, 0.5]
    """
    is_light = ~(np.isnan(restlessness_rad) | (direct > MAX_DIRECT))
    known_rad = np.where(is_light, np.clip(restlessness_rad, STEADY_RAD, RESTLESS_RAD), STEADY_RAD)
    odds = np.exp(weight * np.log(known_rad / STEADY_RAD) / np.log(RESTLESS_RAD / STEADY_RAD))  # (2)
    return np.asarray(scores * odds / (scores * odds + (1.0 - scores)))
