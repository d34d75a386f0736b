"""A calibration from the drive itself: where lines meet, where the image flows from, and what stands still."""

from foreglow.calibration.auto.drive import DriveCalibration, calibrate_drive
from foreglow.calibration.auto.views import lens_of

__all__ = ["DriveCalibration", "calibrate_drive", "lens_of"]
