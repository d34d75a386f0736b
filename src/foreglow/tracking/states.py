"""What a tracker remembers of its tracks: one array for each quantity, one entry for each track, ordered by id."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats
from foreglow.types import LIGHT_KINDS

NUM_CHANNELS = 5
SIZES = slice(2, 4)
RANGE = 4
"""Channels of the filter: centre x, y, width, height in pixels, range in metres."""


@dataclass(slots=True, eq=False)
class TrackStates:
    """The state of M tracks.

    Arrays are replaced, never written to, so that results returned earlier stay unchanged.

    Attributes:
        ids: Shape (M,).
        values: Shape (M, NUM_CHANNELS), filtered; NaN where never measured.
        rates: Shape (M, NUM_CHANNELS), per second.
        measured_s: Shape (M, NUM_CHANNELS), time of each channel's latest measurement; -infinity where there is none.
        sigmas_m: Shape (M,), standard deviation of the range; infinite where unknown.
        range_history: Shape (M, H), the latest measured ranges, newest first, NaN where there are fewer.
        sigma_history: Shape (M, H), their standard deviations.
        confidences: Shape (M,), the filtered score.
        light_kinds: Shape (M, 4), filtered; NaN where unknown.
        found_px: Shape (M,), centre x of the latest detection, as it was measured; NaN where nobody asks.
        drifts_pxps: Shape (M,), its rate from the detection before, pixels per second; NaN where there is none.
        restless: Shape (M,), how restless the light is, 0 to 1 (`restlessness`); NaN before the third detection.
        num_hits: Shape (M,), detections so far.
        num_misses: Shape (M,), frames in a row without a detection.
        births_s: Shape (M,), time of the first detection.
        missing_s: Shape (M,), how long the track has gone without a detection.
        memory: Shape (M, K), of the confirmation rule.
        is_plausible: Shape (M,), whether the track is confirmed.
        detections: Shape (M,), index of the box in the latest frame's detections; -1 without one.
    """

    ids: NDArray[np.int64]
    values: Floats
    rates: Floats
    measured_s: Floats
    sigmas_m: Floats
    range_history: Floats
    sigma_history: Floats
    confidences: Floats
    light_kinds: Floats
    found_px: Floats
    drifts_pxps: Floats
    restless: Floats
    num_hits: NDArray[np.int64]
    num_misses: NDArray[np.int64]
    births_s: Floats
    missing_s: Floats
    memory: Floats
    is_plausible: NDArray[np.bool_]
    detections: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.ids)

    def where(self, is_kept: NDArray[np.bool_]) -> TrackStates:
        """The states of the tracks that are kept."""
        return TrackStates(*(getattr(self, name)[is_kept] for name in _NAMES))

    def joined(self, others: TrackStates) -> TrackStates:
        """These states followed by `others`."""
        return TrackStates(*(np.concatenate([getattr(self, name), getattr(others, name)]) for name in _NAMES))


_NAMES = tuple(field.name for field in dataclasses.fields(TrackStates))


def unmeasured(ids: NDArray[np.int64], now_s: float, history_size: int, memory_size: int) -> TrackStates:
    """New tracks at the time `now_s`, before their first measurement."""
    count = len(ids)
    history = np.full((count, history_size), np.nan)
    return TrackStates(
        ids=ids,
        values=np.full((count, NUM_CHANNELS), np.nan),
        rates=np.zeros((count, NUM_CHANNELS)),
        measured_s=np.full((count, NUM_CHANNELS), -np.inf),
        sigmas_m=np.full(count, np.inf),
        range_history=history,
        sigma_history=history,
        confidences=np.full(count, np.nan),
        light_kinds=np.full((count, len(LIGHT_KINDS)), np.nan),
        found_px=np.full(count, np.nan),
        drifts_pxps=np.full(count, np.nan),
        restless=np.full(count, np.nan),
        num_hits=np.zeros(count, np.int64),
        num_misses=np.zeros(count, np.int64),
        births_s=np.full(count, now_s),
        missing_s=np.zeros(count),
        memory=np.zeros((count, memory_size)),
        is_plausible=np.zeros(count, np.bool_),
        detections=np.full(count, -1),
    )
