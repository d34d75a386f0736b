"""Small frames with all that a frame can carry, and results with all that a result can hold."""

from __future__ import annotations

import dataclasses

import numpy as np

from foreglow.geometry import Camera, Pose
from foreglow.photometry import NUM_LEDS
from foreglow.runtime.health import Health
from foreglow.types import BeamCommand, BeamMode, EgoMotion, Frame, FrameResult, RoadAhead, TrackState
from tests.stand_ins import night_image, result_of, tracks_of

CAMERA = Camera(128, 96, (130.0, 130.0), (64.0, 48.0), (0.0,) * 5, Pose(np.array([1.9, 0.0, 1.3]), np.eye(3)))
ROAD = RoadAhead(np.array([[0.0, 1.6, 0.0], [5.0, 1.6, 0.1], [10.0, 1.7, 0.2]]), 3.2, np.array([0.0, 0.01, 0.02]), 5.0)
STEP_NS = 50_000_000


def full_frame(index: int, sequence: str = "S00001", time_ns: int | None = None) -> Frame:
    return Frame(
        night_image(index),
        timestamp_ns=index * STEP_NS if time_ns is None else time_ns,
        frame=7 + 2 * index,
        sequence=sequence,
        camera=CAMERA,
        motion=EgoMotion(20.0 + index, 0.01),
        road=ROAD,
    )


def full_result(frame: Frame, *faults: str) -> FrameResult:
    """Two boxes, one accepted, two tracks, one with a range, both first ones of a known kind, a gap or a fault."""
    base = result_of(frame, [[10, 20, 20, 30], [40, 50, 60, 70]], [0.9, 0.2])
    tracks = tracks_of(
        [[10.5, 20, 20, 30], [40, 50, 60, 70]],
        [TrackState.CONFIRMED, TrackState.TENTATIVE],
        ids=[3, 8],
        ranges_m=[55.0, float("nan")],
    )
    kinds = np.array([[0.125, 0.625, 0.125, 0.125], [np.nan] * 4])
    tracks = dataclasses.replace(tracks, light_kinds=kinds)
    assert base.detections is not None
    detections = dataclasses.replace(base.detections, light_kinds=kinds.astype(np.float32))
    levels = np.full((2, NUM_LEDS), 0.5)
    beam = BeamCommand(frame.timestamp_ns, BeamMode.GLARE_FREE, levels, np.array([[-0.1, 0.05]]), np.array([77.0]))
    if faults:
        beam = BeamCommand.low(frame.timestamp_ns, NUM_LEDS, *faults)
    return FrameResult(
        frame.frame, frame.timestamp_ns, base.proposals, detections, {"proposals": 0.25}, None, tracks, beam
    )


def health_at(time_ns: int, *faults: str) -> Health:
    return Health(time_ns, faults, num_frames=5, num_dropped=2, num_late=1, beam=None)
