"""How restless a light is, as evidence: a hidden vehicle's runs along what it lights, a reflector keeps its place.

What stands still moves steadily in the image, whatever our own motion, and most of what we light stands still. With the
centres x of a box in its latest three detections, in pixels, and the rate v at which it moved between the former two,
the light was elsewhere than expected by x - (x' + v dt). With n frame periods in dt and the focal length f in pixels,
that is an angle d in each frame, and the light was restless by q in it:

    d = |x - x' - v dt| / (n f)                                                                                 (1)
    q = log(d / A) / log(B / A), limited to [0, 1],   A = `STEADY_RAD`, B = `RESTLESS_RAD`                      (2)

The vertical is left out: there the pitch of our car moves everything. The restlessness m is a moving mean of q, and the
score s of a detection becomes s' as evidence:

    logit(s') = logit(s) + w m                                                                                  (3)

A lamp in sight moves steadily, too: its score stays as it is, and so does that of a light that was detected no more
than twice.
"""

from __future__ import annotations

import math

import numpy as np

from foreglow.geometry import Floats

STEADY_RAD, RESTLESS_RAD = 1.5e-3, 4.0e-3
"""Angles in a frame at 18 Hz up to which a light is steady, and from which it is as restless as any: decision 24."""

MAX_DIRECT = 0.5
"""Light that is more likely to be a lamp in sight than this is no light on something."""


def restlessness(residuals_px: Floats, focal_px: float, num_frames: Floats) -> Floats:
    """The q of (2), shape (M,); NaN where a residual is.

    Args:
        residuals_px: Shape (M,), measured less expected centre x.
        focal_px: Focal length.
        num_frames: Shape (M,), frame periods since the previous detection; less than one counts as one.

    >>> restlessness(np.array([-1.0, 2.5, 4.0, 99.0, np.nan]), 1000.0, np.ones(5)).round(2).tolist()
    [0.0, 0.52, 1.0, 1.0, nan]
    """
    angles_rad = np.abs(residuals_px) / (focal_px * np.maximum(num_frames, 1.0))  # (1)
    limited_rad = np.minimum(np.maximum(angles_rad, STEADY_RAD), RESTLESS_RAD)
    return np.asarray(np.log(limited_rad / STEADY_RAD) / math.log(RESTLESS_RAD / STEADY_RAD))  # (2)


def scores_of_restless(scores: Floats, restless: Floats, direct: Floats, weight: float) -> Floats:
    """The scores of (3), shape (M,): each unchanged where the restlessness is NaN, and that of a lamp in sight.

    Args:
        scores: Shape (M,); NaN stays NaN.
        restless: Shape (M,), the m of (3).
        direct: Shape (M,), probability of a lamp in sight; NaN where unknown, which counts as none.
        weight: The w of (3).

    >>> restless, direct = np.array([0.0, 1.0, np.nan, 1.0]), np.array([0.1, 0.1, 0.1, 0.9])
    >>> scores_of_restless(np.full(4, 0.5), restless, direct, np.log(3.0)).round(3).tolist()
    [0.5, 0.75, 0.5, 0.5]
    """
    odds = np.exp(weight * np.where(np.isnan(restless) | (direct > MAX_DIRECT), 0.0, restless))
    return np.asarray(scores * odds / (scores * odds + (1.0 - scores)))  # (3)
