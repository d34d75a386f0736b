"""How the image moves because we turn."""

from __future__ import annotations

import numpy as np

from foreglow.geometry import Camera, Floats


def turn_shift_px(camera: Camera, centres_px: Floats, turn_rad: float) -> Floats:
    """By how many pixels x, y, shape (M, 2), distant points move when we turn to the left by `turn_rad`.

    To first order, without the lens's distortion and the camera's own tilt: within a tenth of a shift of some ten
    pixels, as a turn between two frames makes.

    Source: Longuet-Higgins and Prazdny, The interpretation of a moving retinal image, 1980, rotation about y.
    """
    normal = (centres_px - camera.centre_px) / camera.focal_px
    u = normal[:, :1]
    flow = np.concatenate([1.0 + u * u, u * normal[:, 1:]], axis=1)
    return np.asarray(flow * camera.focal_px * turn_rad)
