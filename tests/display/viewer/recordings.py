"""Reading back what was recorded, and a made-up frame with all that can be shown."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from foreglow.geometry import Camera, Pose
from foreglow.photometry import NUM_LEDS
from foreglow.types import BeamCommand, BeamMode, Frame, FrameResult, RoadAhead, TrackState
from tests.stand_ins import night_image, result_of, tracks_of

CAMERA = Camera(128, 96, (120.0, 120.0), (64.0, 48.0), (0.0,) * 5, Pose(np.array([1.9, 0.0, 1.3]), np.eye(3)))
ROAD = RoadAhead(np.array([[0.0, 1.6, 0.0], [90.0, 1.6, 0.0]]), half_width_m=3.25)
GAPS_RAD = np.array([[-0.05, 0.02], [0.1, 0.2]])


def frame_at(time_ns: int, number: int = 0, sequence: str = "S00001") -> Frame:
    return Frame(night_image(), time_ns, number, sequence, camera=CAMERA, road=ROAD)


def full_result(frame: Frame, faults: tuple[str, ...] = (), mode: BeamMode = BeamMode.GLARE_FREE) -> FrameResult:
    """Two boxes, one of them accepted; a confirmed track with a range and a tentative one without; two gaps."""
    is_low = mode == BeamMode.LOW
    levels = np.zeros((2, NUM_LEDS)) if is_low else np.linspace(0.0, 1.0, 2 * NUM_LEDS).reshape(2, -1)
    gaps = np.zeros((0, 2)) if is_low else GAPS_RAD
    beam = BeamCommand(frame.timestamp_ns, mode, levels, gaps, np.array([40.0, np.nan])[: len(gaps)], faults)
    states = [TrackState.CONFIRMED, TrackState.TENTATIVE]
    tracks = tracks_of([(10, 40, 20, 50), (60, 40, 70, 50)], states, [3, 8], [50.0, np.nan])
    plain = result_of(frame, [(10, 40, 20, 50), (80, 40, 90, 50)], [0.9, 0.1])
    return dataclasses.replace(plain, tracks=tracks, beam=beam)


class Recording:
    """What is in a file: by entity and component, the values in the order of time."""

    def __init__(self, path: Path) -> None:
        self._batches: dict[str, list[Any]] = {}
        for chunk in rr.chunk.RrdReader(path).stream():
            self._batches.setdefault(chunk.entity_path, []).append(chunk.to_record_batch())

    @property
    def entities(self) -> set[str]:
        return set(self._batches)

    def values(self, entity: str, component: str) -> list[Any]:
        """With each value the time in nanoseconds before it."""
        rows = []
        for batch in self._batches[entity]:
            if component in batch.schema.names:
                times = batch.column("time").cast("int64").to_pylist() if "time" in batch.schema.names else None
                values = batch.column(component).to_pylist()
                rows += list(zip(times or [0] * len(values), values, strict=True))
        return sorted(rows, key=lambda row: row[0])
