"""What tracks are worth, on cases counted by hand."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest

from foreglow.lab.evaluation.boxes.lights import Light
from foreglow.lab.evaluation.vehicles import SequenceTracks, match_tracks
from foreglow.types import Tracks, TrackState, Vehicles
from tests.lab.evaluation.scored_boxes import light, split_labels

TENTATIVE, CONFIRMED, COASTING = TrackState.TENTATIVE, TrackState.CONFIRMED, TrackState.COASTING
HERE, THERE = (0.0, 0.0, 10.0, 10.0), (50.0, 0.0, 60.0, 10.0)
BOXES = np.array([HERE, THERE])


def tracks_of(*rows: tuple[int, TrackState, int]) -> Tracks:
    """Rows of id, state and index of the detection; the box of track 0 is here, those of others are there."""
    count = len(rows)
    ids, states, detections = np.array(rows, np.int64).reshape(-1, 3).T
    ones, zeros = np.ones(count, np.int64), np.zeros(count)
    boxes = np.where(ids[:, None] == 0, HERE, THERE)
    ranges_m, sigmas_m = np.full(count, np.nan), np.full(count, np.inf)
    return Tracks(ids, states, boxes, zeros, ones, ones, zeros, ranges_m, sigmas_m, detections)


def matched(
    lights: Mapping[int, Sequence[Light]], tracks: dict[int, Tracks], **fields: Any
) -> tuple[SequenceTracks, ...]:
    labels = split_labels(lights, **fields)
    return match_tracks(labels, tracks, dict.fromkeys(lights, BOXES))


def test_first_confirmation_and_false_tracks() -> None:
    """Track 0 holds the light from the second image on and is plausible in the third; track 1 never holds any."""
    (only,) = matched(
        {0: [light(0, 5, 5)], 1: [light(1, 5, 5)], 2: [light(2, 5, 5)], 3: []},
        {
            0: tracks_of((1, CONFIRMED, 1)),
            1: tracks_of((0, TENTATIVE, 0), (1, CONFIRMED, 1)),
            2: tracks_of((0, COASTING, -1)),
            3: tracks_of((0, COASTING, -1)),
        },
    )
    (vehicle,) = only.vehicles
    assert (vehicle.light_s, vehicle.found_s, vehicle.lamp_s, vehicle.num_frames) == (0.0, 1.0, 0.0, 2.0)
    assert (only.num_plausible, only.num_false, only.duration_s) == (2, 1, 2.0)


def test_the_box_of_a_plausible_track_must_hold_the_light() -> None:
    """Its detection held the light before; its own box does so in the second image only."""
    (only,) = matched(
        {0: [light(0, 55, 5)], 1: [light(1, 5, 5)]},
        {0: tracks_of((0, CONFIRMED, 1)), 1: tracks_of((0, COASTING, -1))},
    )
    (vehicle,) = only.vehicles
    assert (vehicle.found_s, vehicle.num_frames, only.num_false) == (0.5, 1.0, 0)


def test_tentative_tracks_are_not_false() -> None:
    (only,) = matched({0: []}, {0: tracks_of((0, TENTATIVE, 0))})
    assert (only.num_plausible, only.num_false) == (0, 0)


@pytest.mark.parametrize("when", [0, 2])
def test_any_light_at_any_time_makes_it_true(when: int) -> None:
    """Doubtful light and rear lamps too, before or after it was plausible; neither of them is a vehicle found."""
    tracks = {number: tracks_of((0, CONFIRMED if number == 1 else TENTATIVE, 0)) for number in range(3)}
    empty: dict[int, Sequence[Light]] = {0: [], 1: [], 2: []}
    (doubtful,) = matched(empty, tracks, doubtful_px={when: [(5.0, 5.0)]})
    (rear,) = matched(empty | {when: [light(when, 5, 5, is_rear=True)]}, tracks)
    for each in (doubtful, rear):
        assert (each.num_plausible, each.num_false, each.vehicles) == (1, 0, ())


def test_a_vehicle_that_is_never_confirmed() -> None:
    (only,) = matched({0: [light(0, 99, 99, kind="rail")]}, {0: tracks_of((0, CONFIRMED, 0))})
    (vehicle,) = only.vehicles
    assert math.isnan(vehicle.found_s)
    assert math.isnan(vehicle.lamp_s)
    assert math.isnan(vehicle.num_frames)


def test_sequences_are_apart() -> None:
    """The same id in another sequence is another track."""
    first, second = matched(
        {0: [light(0, 5, 5)], 100: []}, {0: tracks_of((0, CONFIRMED, 0)), 100: tracks_of((0, CONFIRMED, 0))}
    )
    assert (first.sequence_id, first.num_false) == (0, 0)
    assert (second.sequence_id, second.num_false) == (1, 1)


def test_false_tracks_where_nobody_is() -> None:
    """Track 1 comes up in an image without light, track 2 in one with light; both stay and hold none."""
    (only,) = matched(
        {0: [], 1: [light(1, 5, 5)], 2: []},
        {
            0: tracks_of((1, CONFIRMED, 1)),
            1: tracks_of((1, CONFIRMED, 1), (2, CONFIRMED, 1)),
            2: tracks_of((1, COASTING, -1), (2, COASTING, -1)),
        },
        empty=[0, 2],
    )
    assert (only.num_false, only.num_false_empty, only.empty_s) == (2, 1, 1.0)


def test_false_vehicles_are_counted_beside_false_tracks() -> None:
    """Vehicle 4 is both tracks: it holds light by one, and is found by that one's box, whatever its own state."""
    tracks = tracks_of((0, TENTATIVE, 0), (1, CONFIRMED, 1))
    states, of_tracks = np.array([int(CONFIRMED)]), np.array([4, 4])
    vehicles = Vehicles(np.array([4]), states, np.zeros(1), np.array([False]), of_tracks, np.array([1]))
    lights = {0: [light(0, 5, 5)]}
    (alone,) = matched(lights, {0: tracks})
    (only,) = matched(lights, {0: dataclasses.replace(tracks, vehicles=vehicles)})
    (dark,) = matched({0: []}, {0: dataclasses.replace(tracks, vehicles=vehicles)})
    assert (alone.num_false, alone.num_false_vehicles, math.isnan(alone.vehicles[0].found_s)) == (1, None, True)
    assert (only.num_false, only.num_false_vehicles, only.vehicles[0].found_s) == (1, 0, 0.0)
    assert (dark.num_false, dark.num_false_vehicles) == (1, 1)


@pytest.mark.parametrize(("gap_px", "num_groups"), [(20.0, 0), (20.5, 1)])
def test_tracks_that_come_as_close_as_their_size_are_one_group(gap_px: float, num_groups: int) -> None:
    """Track 0 holds light; track 1, 20 px wide and without, is close to it in the second image, if at all."""
    here, far = np.array(HERE), np.array([100.0, 0.0, 120.0, 10.0])
    near = np.array([10.0 + gap_px, 0.0, 30.0 + gap_px, 10.0])
    both = tracks_of((0, CONFIRMED, 0), (1, CONFIRMED, -1))
    shown = {k: dataclasses.replace(both, boxes_xyxy_px=np.array([here, box])) for k, box in enumerate((far, near))}
    (only,) = matched({0: [light(0, 5, 5)], 1: []}, shown)
    assert (only.num_plausible, only.num_false, only.num_false_groups) == (2, 1, num_groups)
