"""The values that flow through the pipeline: Frame -> Proposals -> Detections -> Ranges -> Tracks -> BeamCommand, and
FrameResult, which keeps them all.

Every type is frozen and checked once, when it is made. Names of arrays are plural, boxes are half-open `xyxy` in
full-frame pixels (x = column to the right, y = row downwards), and arrays are read-only afterwards.
"""

from foreglow.types.arrays import Boxes, Image
from foreglow.types.beam import BeamCommand, BeamMode
from foreglow.types.boxes import Detections, Proposals, Ranges
from foreglow.types.frame import MIN_STEP_S, EgoMotion, Frame, RoadAhead
from foreglow.types.kinds import KINDS, LIGHT_KINDS
from foreglow.types.result import FrameResult
from foreglow.types.states import TrackState
from foreglow.types.tracks import Tracks
from foreglow.types.vehicles import Vehicles

__all__ = [
    "KINDS",
    "LIGHT_KINDS",
    "MIN_STEP_S",
    "BeamCommand",
    "BeamMode",
    "Boxes",
    "Detections",
    "EgoMotion",
    "Frame",
    "FrameResult",
    "Image",
    "Proposals",
    "Ranges",
    "RoadAhead",
    "TrackState",
    "Tracks",
    "Vehicles",
]
