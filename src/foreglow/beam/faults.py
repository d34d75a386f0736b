"""Why there is low beam although high beam was wanted."""

from __future__ import annotations

from enum import StrEnum


class GuardFault(StrEnum):
    """What the guard may find; the texts stand in `BeamCommand.faults`, after those of the pipeline."""

    TIME = "time_went_back"
    """A frame or the clock is earlier than the one before."""
    TOO_OLD = "image_too_old"
    """The image is older than the deadline, or of the future."""
    GAP = "frames_missing"
    """The frame before is too long ago."""
    FROZEN = "camera_frozen"
    """The same time again, or an image that does not change although we move."""
    DAMAGED = "image_damaged"
    """The source says so, or the image has what only a damaged stream shows."""
    SATURATED = "image_saturated"
    """Too many pixels are as bright as the format allows."""
    BLACK = "image_black"
    """No pixel is bright."""
    NO_CAMERA = "no_camera"
    """Without a calibration no light has a direction."""
    NO_SPEED = "speed_unknown"
    """And it is needed."""
    TOO_SLOW = "too_slow"
    """High beam is not for this speed."""
    NO_TRACKS = "no_tracks"
    """The tracker gave none, not even an empty set."""
    BAD_TRACKS = "invalid_tracks"
    """A number is not finite that has to be, or it is not said of each track whether it is a vehicle."""
    STALE_TRACKS = "stale_tracks"
    """A track does not get older."""
    BAD_COMMAND = "invalid_command"
    """Levels of another number of LEDs, outside 0 to 1 or NaN, gaps out of order, or light with low beam."""
    STALE_COMMAND = "stale_command"
    """A command that follows from another frame."""
