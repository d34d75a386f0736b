"""Which tracks count as lamps in sight."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from foreglow.beam.in_sight import SURE_DIRECT, lamps_in_sight
from foreglow.beam.stage import BeamStage
from foreglow.config import BeamConfig, GuardConfig
from foreglow.types import BeamMode, Tracks, TrackState, Vehicles
from foreglow.types.kinds import kinds_of_direct
from tests.beam.made_up import box_around, frame_at, tracks_of

MIN_DIRECT = 0.5
SURE, UNSURE, LIGHT = SURE_DIRECT + 0.05, 0.5 * (MIN_DIRECT + SURE_DIRECT), MIN_DIRECT - 0.1
TENTATIVE, CONFIRMED, _ = TrackState


def tracks_with(direct: list[float], *, vehicles: list[int] | None, states: list[TrackState] | None = None) -> Tracks:
    boxes = [box_around(0.01 * number, -0.005, 0.006) for number in range(len(direct))]
    tracks = tracks_of(boxes, [80.0] * len(direct), states=states)
    of_vehicles = None
    if vehicles is not None:
        ids, leading = np.unique(vehicles, return_index=True)
        of_vehicles = Vehicles(
            ids=ids,
            states=np.full(len(ids), CONFIRMED, np.int64),
            confidences=np.full(len(ids), 0.9),
            is_in_sight=np.ones(len(ids), np.bool_),
            of_tracks=np.array(vehicles),
            leading=leading,
        )
    return dataclasses.replace(tracks, light_kinds=kinds_of_direct(np.array(direct)), vehicles=of_vehicles)


@pytest.mark.parametrize("vehicles", [None, [4, 4, 4, 4], [1, 2, 3, 4]])
def test_without_a_sure_one_all_that_may_be_lamps_count(vehicles: list[int] | None) -> None:
    tracks = tracks_with([UNSURE, LIGHT, math.nan, UNSURE], vehicles=vehicles)
    assert lamps_in_sight(tracks, MIN_DIRECT).tolist() == [True, False, True, True]


def test_beside_a_sure_one_of_the_same_vehicle_only_sure_ones_count() -> None:
    direct = [SURE, UNSURE, UNSURE, SURE, LIGHT, math.nan]
    for vehicles, expected in (
        ([7, 7, 8, 7, 7, 7], [True, False, True, True, False, True]),
        ([7, 8, 8, 9, 8, 8], [True, True, True, True, False, True]),
        (None, [True, True, True, True, False, True]),
    ):
        assert lamps_in_sight(tracks_with(direct, vehicles=vehicles), MIN_DIRECT).tolist() == expected


def test_a_sure_one_that_may_not_be_acted_on_rules_nothing_out() -> None:
    """Otherwise nothing at all would be protected."""
    tracks = tracks_with([SURE, UNSURE], vehicles=[7, 7], states=[TENTATIVE, CONFIRMED])
    assert lamps_in_sight(tracks, MIN_DIRECT).tolist() == [True, True]


@pytest.mark.parametrize("min_direct", [0.5, 0.8, 1.0])
def test_the_guard_protects_lamps_of_which_a_policy_wants_to_be_surer(min_direct: float) -> None:
    stage = BeamStage(BeamConfig(policy="high", min_direct=min_direct), GuardConfig())
    lamp = dataclasses.replace(
        tracks_of([box_around(0.0, 0.0, 0.01)], [60.0]), light_kinds=np.array([[0.6, 0.0, 0.4, 0.0]])
    )
    for number in range(25):
        frame = frame_at(number)
        command = stage.command(frame, dataclasses.replace(lamp, ages_s=np.array([0.05 + number])))
    assert command.mode == BeamMode.GLARE_FREE
    assert len(command.gaps_rad) == 1
    assert command.levels.min() < 0.1
