"""The vehicles that tracked light belongs to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.types.arrays import Value, checked_array
from foreglow.types.states import check_states
from foreglow.wording import shortened

_DTYPES = {
    "ids": np.dtype(np.int64),
    "states": np.dtype(np.int64),
    "confidences": np.dtype(np.float64),
    "is_in_sight": np.dtype(np.bool_),
    "leading": np.dtype(np.int64),
}


@dataclass(frozen=True, slots=True, eq=False)
class Vehicles(Value):
    """The other vehicles that show in a frame, by their lamps or by their light alone, in the order of their ids.

    Attributes:
        ids: Shape (V,), int64, unique since the last reset, ascending; never reused.
        states: Shape (V,), int64, a `TrackState` each: those of its tracks.
        confidences: Shape (V,), float64 in [0, 1], the filtered best score of their tracks in each frame.
        is_in_sight: Shape (V,), bool, whether one of its tracks that may be acted on is a lamp, front or rear, more
            likely than not.
        of_tracks: Shape (M,), int64, for each of the frame's `Tracks` the id of its vehicle.
        leading: Shape (V,), int64, the index of the track that says where it is: of its nearest lamp in sight, or else
            of its farthest light, which is the nearest to it on its road. Its range and bearing are the vehicle's.

    Raises:
        ValueError: If a shape or a dtype is wrong, ids do not ascend, a state is no `TrackState`, a confidence is
            outside [0, 1], or a track's vehicle is none of them.
    """

    ids: NDArray[np.int64]
    states: NDArray[np.int64]
    confidences: NDArray[np.float64]
    is_in_sight: NDArray[np.bool_]
    of_tracks: NDArray[np.int64]
    leading: NDArray[np.int64]

    def __post_init__(self) -> None:
        count = len(checked_array("Vehicles.ids", self.ids, _DTYPES["ids"], (None,)))
        for name, dtype in _DTYPES.items():
            object.__setattr__(self, name, checked_array(f"Vehicles.{name}", getattr(self, name), dtype, (count,)))
        of_tracks = checked_array("Vehicles.of_tracks", self.of_tracks, _DTYPES["ids"], (None,))
        object.__setattr__(self, "of_tracks", of_tracks)
        if not (self.ids[1:] > self.ids[:-1]).all():
            raise ValueError(f"Vehicles.ids: expected ascending numbers, got {shortened(self.ids)}")
        check_states("Vehicles.states", self.states)
        if not ((self.confidences >= 0.0) & (self.confidences <= 1.0)).all():
            raise ValueError(f"Vehicles.confidences: expected numbers from 0 to 1, got {shortened(self.confidences)}")
        if not set(self.of_tracks.tolist()) <= set(self.ids.tolist()):
            raise ValueError(f"Vehicles.of_tracks: expected ids of vehicles, got {shortened(self.of_tracks)}")
        is_index = (self.leading >= 0) & (self.leading < len(self.of_tracks))
        if not is_index.all() or (self.of_tracks[self.leading] != self.ids).any():
            raise ValueError(f"Vehicles.leading: expected a track of each vehicle, got {shortened(self.leading)}")

    def __len__(self) -> int:
        return len(self.ids)
