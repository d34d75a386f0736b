"""Roads and poses that the tests of maps share."""

from __future__ import annotations

import numpy as np

from foreglow.geometry import Floats, Pose, rotation
from foreglow.maps import CentreLine


def straight(length_m: float = 300.0, step_m: float = 10.0, slope: float = 0.0) -> CentreLine:
    """A road to the east."""
    x = np.arange(0.0, length_m + step_m / 2, step_m)
    return CentreLine(np.stack([x, np.zeros_like(x), slope * x], -1), 3.5)


def arc(radius_m: float = 200.0, length_m: float = 300.0) -> Floats:
    """Points each metre of a circle to the left that begins to the east."""
    turns = np.arange(0.0, length_m + 0.5) / radius_m
    return np.stack([radius_m * np.sin(turns), radius_m * (1 - np.cos(turns)), np.zeros_like(turns)], -1)


def pose(x: float, y: float, z: float = 0.0, yaw_deg: float = 0.0, pitch_deg: float = 0.0) -> Pose:
    return Pose(np.array([x, y, z]), rotation(*np.radians([yaw_deg, pitch_deg])))
