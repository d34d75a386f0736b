"""Faults for which the guard commands low beam instead of the beam that was wanted."""

from __future__ import annotations

from enum import StrEnum


class GuardFault(StrEnum):
    """What the guard may find; the texts are listed in `BeamCommand.faults`, after those of the pipeline."""

    TIME = "time_went_back"
    """The frame's time or the clock is earlier than before."""
    TOO_OLD = "image_too_old"
    """The image is older than the deadline, or in the future."""
    GAP = "frames_missing"
    """The previous frame is too long ago."""
    FROZEN = "camera_frozen"
    """The same time twice, or an image that does not change although the vehicle moves."""
    DAMAGED = "image_damaged"
    """The source says so, or the image shows what only a damaged stream shows."""
    RESIZED = "image_resized"
    """The size or the type of the images has changed, and too few of the new ones are known to judge the next."""
    SATURATED = "image_saturated"
    """Too many pixels are as bright as the format allows."""
    BLACK = "image_black"
    """No pixel is bright, or all of the image is equally bright, as where the lens is covered."""
    NO_CAMERA = "no_camera"
    """There is no calibration, so no light has a direction."""
    NO_SPEED = "speed_unknown"
    """The speed is unknown although the configuration needs it."""
    TOO_SLOW = "too_slow"
    """The vehicle is too slow for high beam."""
    NO_TRACKS = "no_tracks"
    """The tracker returned nothing, not even an empty set of tracks."""
    BAD_TRACKS = "invalid_tracks"
    """A number that must be finite is not, or it is unknown for some track whether it is a vehicle."""
    STALE_TRACKS = "stale_tracks"
    """A track's age has not grown."""
    BAD_COMMAND = "invalid_command"
    """The number of LEDs is wrong, a level is outside 0 to 1 or NaN, gaps are out of order, or low beam has light."""
    STALE_COMMAND = "stale_command"
    """The command follows from another frame."""
