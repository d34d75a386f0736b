"""The lens of a camera that was never calibrated: its focal length, and what is usual for the rest."""

from __future__ import annotations

import math

from foreglow.calibration.values import Intrinsics
from foreglow.types import Frame


def lens_of(frame: Frame, name: str, focal_px: float | None = None, fov_deg: float | None = None) -> Intrinsics:
    """The lens that took `frame`: with the focal length or field of view given, or else that of the frame's camera.

    With a focal length, the principal point is the middle, and nothing is distorted.

    Args:
        frame: A frame.
        name: Of its source, for messages.
        focal_px: Focal length.
        fov_deg: Field of view, from the left edge of the image to the right one.

    Raises:
        ValueError: If both are given, or neither, and the frame has no camera.
    """
    if focal_px is not None and fov_deg is not None:
        raise ValueError(f"{name}: expected a focal length or a field of view, got both")
    width_px, height_px = frame.width_px, frame.height_px
    if fov_deg is not None:
        focal_px = width_px / 2 / math.tan(math.radians(fov_deg) / 2)
    if focal_px is not None:
        return Intrinsics(
            width_px=width_px,
            height_px=height_px,
            focal_px=(focal_px, focal_px),
            centre_px=(width_px / 2, height_px / 2),
        )
    camera = frame.camera
    if camera is None:
        raise ValueError(
            f"{name}: expected a focal length, which a drive does not show: give --fov DEG (the horizontal field of "
            "view, from the data sheet) or --focal PX"
        )
    return Intrinsics(
        width_px=camera.width_px,
        height_px=camera.height_px,
        focal_px=camera.focal_px,
        centre_px=camera.centre_px,
        distortion=camera.distortion,
    )
