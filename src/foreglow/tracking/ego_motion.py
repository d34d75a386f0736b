"""How the image moves because the vehicle turns."""

from __future__ import annotations

import numpy as np

from foreglow.geometry import Camera, Floats


def turn_shift_px(camera: Camera, centres_px: Floats, turn_rad: float) -> Floats:
    """Pixels x, y, shape (M, 2), by which distant points move when the vehicle turns to the left by `turn_rad`.

    To first order, without lens distortion and the camera's own tilt: accurate to a tenth of the shift, which is some
    ten pixels for a turn between two frames.

    Source: Longuet-Higgins and Prazdny, The interpretation of a moving retinal image, 1980, rotation about y.
    """
    normal = (centres_px - camera.centre_px) / camera.focal_px
    u = normal[:, :1]
    flow = np.concatenate([1.0 + u * u, u * normal[:, 1:]], axis=1)
    return np.asarray(flow * camera.focal_px * turn_rad)
