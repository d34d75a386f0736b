"""Scenes of few frames for policies: what is seen as tracks, and the gaps that come of it."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np

from foreglow.beam import Gap
from foreglow.beam.policy import ForeglowPolicy
from foreglow.config import BeamConfig
from foreglow.photometry import read_headlamps
from foreglow.types import BeamCommand, Frame, RoadAhead, Tracks, TrackState
from foreglow.types.kinds import kinds_of_direct
from tests.beam.made_up import FRAME_NS, box_around, frame_at, tracks_of

LAMPS = read_headlamps()
CONFIG = BeamConfig(policy="foreglow")
S = FRAME_NS / 1e9

STRAIGHT = RoadAhead(np.column_stack([np.arange(-20.0, 400.0, 10.0), np.zeros((42, 2))]), half_width_m=3.5)
TENTATIVE, CONFIRMED, COASTING = TrackState


class Seen(NamedTuple):
    """One light as a track."""

    azimuth_rad: float
    direct: float = 0.95
    range_m: float = 80.0
    state: TrackState = CONFIRMED
    number: int = 0
    sigma_m: float = 5.0
    confidence: float = 0.9


def tracks_at(number: int, *seen: Seen) -> Tracks:
    tracks = tracks_of(
        [box_around(track.azimuth_rad, -0.005, 0.006) for track in seen],
        [track.range_m for track in seen],
        sigmas_m=[math.inf if math.isnan(track.range_m) else track.sigma_m for track in seen],
        states=[track.state for track in seen],
        ages_s=1.0 + number * S,
    )
    return dataclasses.replace(
        tracks,
        ids=np.array([track.number for track in seen], np.int64),
        light_kinds=kinds_of_direct(np.array([track.direct for track in seen], np.float64)),
        confidences=np.array([track.confidence for track in seen], np.float64),
    )


def frame(number: int, road: RoadAhead | None = STRAIGHT) -> Frame:
    return dataclasses.replace(frame_at(number), road=road)


def policy(kind: type[Any] = ForeglowPolicy, **fields: Any) -> Any:
    return kind(CONFIG.model_copy(update=fields), LAMPS)


def gaps_after(made: ForeglowPolicy, *scenes: tuple[Seen, ...], road: RoadAhead | None = STRAIGHT) -> list[Gap]:
    """The gaps of the last of some frames."""
    gaps: list[Gap] = []
    for number, seen in enumerate(scenes):
        gaps = made.gaps(frame(number, road), tracks_at(number, *seen))
    return gaps


def holding(gaps: list[Gap], azimuth_rad: float) -> list[Gap]:
    return [gap for gap in gaps if gap.right_rad < azimuth_rad < gap.left_rad]


def brightest_there(command: BeamCommand, azimuth_rad: float, range_m: float = 80.0) -> float:
    """Lux of the strongest LED at eyes in a direction."""
    eyes = np.array([[range_m * math.cos(azimuth_rad), range_m * math.sin(azimuth_rad), 1.2]])
    return float((LAMPS.illuminance_lx(eyes)[1][0] * command.levels).max())


LAMP, LIGHT = Seen(0.05), Seen(-0.15, direct=0.05, range_m=60.0, number=1)
