"""Calibration files: our own TOML, KITTI's text and ROS's YAML, all as a `Camera`.

Only our own says where the camera sits in the vehicle; to the others a `Mount` is given.
"""

from foreglow.calibration.reading import read_calibration, read_intrinsics
from foreglow.calibration.toml_file import calibration_to_toml, calibration_values
from foreglow.calibration.values import ImageChoice, Intrinsics, Mount

__all__ = [
    "ImageChoice",
    "Intrinsics",
    "Mount",
    "calibration_to_toml",
    "calibration_values",
    "read_calibration",
    "read_intrinsics",
]
