"""Light artifacts tracked over time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from foreglow.types.arrays import Value, checked_array
from foreglow.types.kinds import LIGHT_KINDS, checked_kinds, direct_of_kinds, names_of_kinds
from foreglow.types.states import TrackState, check_states
from foreglow.types.vehicles import Vehicles
from foreglow.wording import shortened


@dataclass(frozen=True, slots=True, eq=False)
class Tracks(Value):
    """The light artifacts that are tracked over time, in the order of their ids.

    Attributes:
        ids: Shape (M,), int64, unique since the last reset, ascending; never reused.
        states: Shape (M,), int64, a `TrackState` each.
        boxes_xyxy_px: Shape (M, 4), float64, filtered, half-open, full-frame pixels, x1 < x2 and y1 < y2.
        confidences: Shape (M,), float64 in [0, 1], the filtered score.
        num_hits: Shape (M,), int64, number of detections so far, at least 1.
        num_misses: Shape (M,), int64, frames in a row without a detection, up to this frame.
        ages_s: Shape (M,), float64, time since its first detection, not negative.
        ranges_m: Shape (M,), float64, filtered, from the camera along the viewing ray, positive; NaN where unknown.
        sigmas_m: Shape (M,), float64, standard deviation of the range, not negative; infinite where unknown.
        detections: Shape (M,), int64, index of the box in this frame's `Detections`; -1 without one.
        light_kinds: Shape (M, 4), float64, the filtered probabilities of the kinds of `LIGHT_KINDS`, which sum to 1;
            NaN where unknown. An empty array becomes NaNs.
        vehicles: The vehicles that they belong to; None without them.

    Raises:
        ValueError: If a shape or a dtype is wrong, ids do not ascend, a box is not in order or not finite, a range is
            not positive, a standard deviation is negative or NaN, kinds do not sum to 1, or another value is outside
            its limits.
    """

    ids: NDArray[np.int64]
    states: NDArray[np.int64]
    boxes_xyxy_px: NDArray[np.float64]
    confidences: NDArray[np.float64]
    num_hits: NDArray[np.int64]
    num_misses: NDArray[np.int64]
    ages_s: NDArray[np.float64]
    ranges_m: NDArray[np.float64]
    sigmas_m: NDArray[np.float64]
    detections: NDArray[np.int64]
    light_kinds: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, len(LIGHT_KINDS))))
    vehicles: Vehicles | None = None

    def __post_init__(self) -> None:
        count = len(checked_array("Tracks.ids", self.ids, _TRACK_DTYPES["ids"], (None,)))
        for name, dtype in _TRACK_DTYPES.items():
            shape = (count, 4) if name == "boxes_xyxy_px" else (count,)
            object.__setattr__(self, name, checked_array(f"Tracks.{name}", getattr(self, name), dtype, shape))
        light_kinds = checked_kinds("Tracks.light_kinds", self.light_kinds, count, np.float64)
        object.__setattr__(self, "light_kinds", light_kinds)
        if not isinstance(self.vehicles, Vehicles | None):
            raise ValueError(f"Tracks.vehicles: expected Vehicles or None, got {type(self.vehicles).__name__}")
        if self.vehicles is not None and len(self.vehicles.of_tracks) != count:
            raise ValueError(f"Tracks.vehicles: expected those of {count} tracks, got {len(self.vehicles.of_tracks)}")
        boxes = self.boxes_xyxy_px
        if not (self.ids[1:] > self.ids[:-1]).all():
            raise ValueError(f"Tracks.ids: expected ascending numbers, got {shortened(self.ids)}")
        if not (np.isfinite(boxes).all() and (boxes[:, :2] < boxes[:, 2:]).all()):
            raise ValueError("Tracks.boxes_xyxy_px: expected finite boxes with x1 < x2 and y1 < y2")
        if (self.ranges_m <= 0).any() or np.isinf(self.ranges_m).any():
            raise ValueError("Tracks.ranges_m: expected positive numbers or NaN, got zero, a negative or infinity")
        if not (self.sigmas_m >= 0).all():
            raise ValueError("Tracks.sigmas_m: expected numbers of at least 0, got NaN or a negative")
        check_states("Tracks.states", self.states)
        for name, least, most in _LIMITS:
            values = getattr(self, name)
            if count and not (values.min() >= least and values.max() <= most):
                raise ValueError(f"Tracks.{name}: expected numbers from {least:g} to {most:g}, got {shortened(values)}")

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def is_plausible(self) -> NDArray[np.bool_]:
        """Shape (M,): which tracks may be acted on, confirmed or coasting."""
        return np.asarray(self.states != _TENTATIVE)

    @property
    def kind_names(self) -> tuple[str | None, ...]:
        """For each track the most probable of `LIGHT_KINDS`; None where it is unknown."""
        return names_of_kinds(self.light_kinds)

    @property
    def direct_probabilities(self) -> NDArray[np.float64]:
        """Shape (M,): filtered probability of a lamp in sight, front or rear, not its light; NaN where unknown."""
        return direct_of_kinds(self.light_kinds)


_TENTATIVE = int(TrackState.TENTATIVE)
"""A plain number: NumPy takes several times as long to compare with an enum's member."""

_TRACK_DTYPES: Mapping[str, np.dtype[np.generic]] = MappingProxyType(
    {
        "ids": np.dtype(np.int64),
        "states": np.dtype(np.int64),
        "boxes_xyxy_px": np.dtype(np.float64),
        "confidences": np.dtype(np.float64),
        "num_hits": np.dtype(np.int64),
        "num_misses": np.dtype(np.int64),
        "ages_s": np.dtype(np.float64),
        "ranges_m": np.dtype(np.float64),
        "sigmas_m": np.dtype(np.float64),
        "detections": np.dtype(np.int64),
    }
)

MAX_PX = 1e6
"""Largest coordinate of a box in pixels, either way; beyond 2^31 nothing could be drawn."""

MAX_AGE_S = 1e10
"""More than the seconds that a time of 64 bits in nanoseconds holds."""

_LIMITS = (
    ("boxes_xyxy_px", -MAX_PX, MAX_PX),
    ("confidences", 0.0, 1.0),
    ("num_hits", 1, math.inf),
    ("num_misses", 0, math.inf),
    ("ages_s", 0.0, MAX_AGE_S),
    ("detections", -1, math.inf),
)
"""Least and greatest values, by field."""
