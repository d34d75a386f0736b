"""Which tracks belong to one vehicle, and the confirmation of vehicles instead of tracks.

The light of a vehicle runs along a rail, jumps by its own width and splits: its tracks begin and end, and the vehicle
stays. A track belongs to one vehicle as long as it lives. That is the vehicle with the nearest light, now or up to
`KEEP_S` ago, if the gap d between the two boxes is small for their sizes, and otherwise a new one:

    max(d_x, d_y) <= gate s,   s = the mean size of both boxes, in width or height, whichever is larger         (1)

New tracks that are near to each other by (1), also through others, begin one vehicle.

A vehicle is confirmed by the rule that would confirm a track, with the best score of its tracks in each frame: what is
lit together is no independent evidence, and the best is not lost when a light moves on to another track. The tracks of
a confirmed vehicle are plausible, except those whose own scores speak against light; its leading track always is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from foreglow.config import TrackerConfig
from foreglow.geometry import Floats
from foreglow.tracking.alpha_beta import gain_in, moving_mean
from foreglow.tracking.confirmation import CONFIRMATIONS, Company, Observations
from foreglow.tracking.states import RANGE, TrackStates
from foreglow.types import TrackState, Vehicles
from foreglow.types.kinds import direct_of_kinds

KEEP_S = 0.6
"""A vehicle is remembered, with the places of its light, for so long after its last track has ended."""

MIN_OWN_CONFIDENCE = 0.5
"""A track of a confirmed vehicle that does not lead it is plausible if its own confidence is above this."""

MAX_LIGHTS = 1024
"""Of more tracks, those that have ended are forgotten at once, the first ones first."""


@dataclass(slots=True, eq=False)
class _Lights:
    """Where the light of vehicles is, or was a moment ago: one entry for each track, ordered by its id."""

    track_ids: NDArray[np.int64]
    vehicle_ids: NDArray[np.int64]
    boxes_xyxy_px: Floats
    seen_s: Floats

    def where(self, is_kept: NDArray[np.bool_]) -> _Lights:
        return _Lights(*(getattr(self, name)[is_kept] for name in self.__slots__))

    def joined(self, others: _Lights) -> _Lights:
        return _Lights(*(np.concatenate([getattr(self, name), getattr(others, name)]) for name in self.__slots__))


@dataclass(slots=True, eq=False)
class _States:
    """What is known of V vehicles, ordered by their ids; as in `TrackStates`."""

    ids: NDArray[np.int64]
    memory: Floats
    num_hits: NDArray[np.int64]
    confidences: Floats
    is_plausible: NDArray[np.bool_]

    def of(self, ids: NDArray[np.int64], memory_size: int) -> _States:
        """The states of the vehicles with these ids, ascending; those that are new begin."""
        if np.array_equal(ids, self.ids):
            return self
        is_left, born = np.isin(self.ids, ids), _unseen(ids[~np.isin(ids, self.ids)], memory_size)
        return _States(
            *(np.concatenate([getattr(self, name)[is_left], getattr(born, name)]) for name in self.__slots__)
        )


def _unseen(ids: NDArray[np.int64], memory_size: int) -> _States:
    """Vehicles before their first score."""
    count = len(ids)
    hits, confidences, is_plausible = np.zeros(count, np.int64), np.full(count, np.nan), np.zeros(count, np.bool_)
    return _States(ids, np.zeros((count, memory_size)), hits, confidences, is_plausible)


class VehicleGroups:
    """The vehicles of a tracker's tracks, frame by frame."""

    def __init__(self, config: TrackerConfig) -> None:
        self._gate = config.vehicle_gate
        self._alpha_confidence = config.alpha_confidence
        self._rule = CONFIRMATIONS[config.confirmation](config)
        self.reset()

    def reset(self) -> None:
        """Forgets all vehicles, as at the start of a sequence; ids begin again."""
        self._next_id = 0
        self.forget()

    def forget(self) -> None:
        """Forgets all vehicles; their ids are not reused."""
        self._company = Company()
        none = np.zeros(0, np.int64)
        self._lights = _Lights(none, none, np.zeros((0, 4)), np.zeros(0))
        self._states = _unseen(none, self._rule.memory_size)

    def update(
        self, now_s: float, tracks: TrackStates, boxes_xyxy_px: Floats, scores: Floats, num_frames: float
    ) -> tuple[NDArray[np.bool_], Vehicles]:
        """Which tracks are plausible, shape (M,), and their vehicles, after this frame.

        Args:
            now_s: The time of the frame; ascending.
            tracks: Those of the frame.
            boxes_xyxy_px: Shape (M, 4), their boxes.
            scores: Shape (M,), of their detections, as evidence; NaN where a track was missed.
            num_frames: As in `Observations`.
        """
        vehicle_ids = self._vehicles_of(now_s, tracks.ids, boxes_xyxy_px)
        states = self._states
        vehicles = states.ids.searchsorted(vehicle_ids)
        best = np.full(len(states.ids), np.nan)
        np.fmax.at(best, vehicles, scores)
        states.num_hits = states.num_hits + ~np.isnan(best)
        weight = float(gain_in(self._alpha_confidence, num_frames))
        states.confidences = moving_mean(states.confidences, best, weight)
        observed = Observations(
            scores=best,
            num_hits=states.num_hits,
            confidences=states.confidences,
            was_plausible=states.is_plausible,
            since_others_s=self._company.since_others_s(states.ids, now_s),
            num_frames=num_frames,
        )
        states.memory, states.is_plausible = self._rule.update(states.memory, observed)
        self._company.note(states.ids[states.is_plausible], now_s)
        is_light = tracks.confidences > MIN_OWN_CONFIDENCE
        is_confirmed = states.is_plausible[vehicles]
        is_lamp = is_confirmed & (direct_of_kinds(tracks.light_kinds) > 0.5)
        leading = _leading(vehicles, tracks.values[:, RANGE], is_light, is_lamp)
        is_plausible = is_confirmed & is_light
        is_plausible[leading] = is_confirmed[leading]
        shown = vehicles[leading]
        is_in_sight = np.zeros(len(states.ids), np.bool_)
        is_in_sight[vehicles[is_plausible & is_lamp]] = True
        is_hit = ~np.isnan(best[shown])
        seen = np.where(is_hit, TrackState.CONFIRMED, TrackState.COASTING)
        return is_plausible, Vehicles(
            ids=states.ids[shown],
            states=np.where(states.is_plausible[shown], seen, TrackState.TENTATIVE),
            confidences=states.confidences[shown],
            is_in_sight=is_in_sight[shown],
            of_tracks=vehicle_ids,
            leading=leading,
        )

    def _vehicles_of(self, now_s: float, track_ids: NDArray[np.int64], boxes_xyxy_px: Floats) -> NDArray[np.int64]:
        """The id of each track's vehicle, shape (M,); remembers where the light of each is, and which there are."""
        lights = self._lights
        num_old = int(track_ids.searchsorted(lights.track_ids[-1], "right")) if len(lights.track_ids) else 0
        rows = lights.track_ids.searchsorted(track_ids[:num_old])
        lights.boxes_xyxy_px[rows], lights.seen_s[rows] = boxes_xyxy_px[:num_old], now_s
        is_kept = now_s - lights.seen_s <= KEEP_S
        is_kept[:-MAX_LIGHTS] &= lights.seen_s[:-MAX_LIGHTS] == now_s
        if not is_kept.all():
            lights = lights.where(is_kept)
        if num_old < len(track_ids):
            new = boxes_xyxy_px[num_old:]
            begun = self._joining(lights, new)
            lights = lights.joined(_Lights(track_ids[num_old:], begun, new, np.full(len(new), now_s)))
        if lights is not self._lights:
            self._lights = lights
            self._states = self._states.of(np.unique(lights.vehicle_ids), self._rule.memory_size)
        return lights.vehicle_ids[lights.track_ids.searchsorted(track_ids)]

    def _joining(self, lights: _Lights, boxes_xyxy_px: Floats) -> NDArray[np.int64]:
        """The vehicles of new tracks, shape (N,): those of the nearest light, and new ones for the others."""
        vehicle_ids = np.full(len(boxes_xyxy_px), -1)
        if len(lights.track_ids):
            gaps = gaps_between(boxes_xyxy_px, lights.boxes_xyxy_px)
            nearest = gaps.argmin(axis=1)
            is_near = gaps[np.arange(len(gaps)), nearest] <= self._gate
            vehicle_ids[is_near] = lights.vehicle_ids[nearest[is_near]]
        alone = np.flatnonzero(vehicle_ids < 0)
        if len(alone):
            boxes = boxes_xyxy_px[alone]
            count, groups = connected_components(gaps_between(boxes, boxes) <= self._gate, directed=False)
            vehicle_ids[alone] = self._next_id + groups
            self._next_id += count
        return vehicle_ids


def _leading(
    vehicles: NDArray[np.int64], ranges_m: Floats, is_light: NDArray[np.bool_], is_lamp: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """The index of each vehicle's leading track, shape (V,), in the order of `vehicles`, shape (M,); see `Vehicles`."""
    nearness = np.where(is_lamp, -ranges_m, ranges_m)
    order = np.lexsort((nearness, ~np.isnan(ranges_m), is_lamp, is_light, vehicles))
    is_last = np.ones(len(order), np.bool_)
    of_vehicle = vehicles[order]
    is_last[:-1] = of_vehicle[1:] > of_vehicle[:-1]
    return order[is_last]


def gaps_between(boxes_xyxy: Floats, others_xyxy: Floats) -> Floats:
    """The gap between every two boxes in units of their size, shape (M, N), by (1); 0 where they overlap.

    >>> gaps_between(np.array([[0.0, 0, 2, 2]]), np.array([[1.0, 1, 3, 3], [4, 0, 6, 2], [0, 4, 6, 6]])).tolist()
    [[0.0, 1.0, 0.5]]
    """
    rows, columns = boxes_xyxy[:, None], others_xyxy[None]
    gaps = np.maximum(rows[..., :2], columns[..., :2]) - np.minimum(rows[..., 2:], columns[..., 2:])
    sizes = 0.5 * (rows[..., 2:] - rows[..., :2] + columns[..., 2:] - columns[..., :2])
    return np.asarray(np.maximum(gaps.max(axis=-1), 0.0) / sizes.max(axis=-1))
