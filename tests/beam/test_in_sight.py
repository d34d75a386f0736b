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
CAMERA = frame_at(0).camera


def tracks_with(
    direct: list[float],
    *,
    vehicles: list[int] | None,
    states: list[TrackState] | None = None,
    azimuths_rad: list[float] | None = None,
    range_m: float = 80.0,
) -> Tracks:
    azimuths_rad = azimuths_rad or [0.01 * number for number in range(len(direct))]
    boxes = [box_around(azimuth_rad, -0.005, 0.006) for azimuth_rad in azimuths_rad]
    tracks = tracks_of(boxes, [range_m] * len(direct), states=states)
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
    assert lamps_in_sight(tracks, MIN_DIRECT, CAMERA).tolist() == [True, False, True, True]


def test_beside_a_sure_one_of_the_same_vehicle_only_sure_ones_count() -> None:
    direct = [SURE, UNSURE, UNSURE, SURE, LIGHT, math.nan]
    for vehicles, expected in (
        ([7, 7, 8, 7, 7, 7], [True, False, True, True, False, True]),
        ([7, 8, 8, 9, 8, 8], [True, True, True, True, False, True]),
        (None, [True, True, True, True, False, True]),
    ):
        assert lamps_in_sight(tracks_with(direct, vehicles=vehicles), MIN_DIRECT, CAMERA).tolist() == expected


def test_a_sure_one_that_may_not_be_acted_on_rules_nothing_out() -> None:
    """Otherwise nothing at all would be protected."""
    tracks = tracks_with([SURE, UNSURE], vehicles=[7, 7], states=[TENTATIVE, CONFIRMED])
    assert lamps_in_sight(tracks, MIN_DIRECT, CAMERA).tolist() == [True, True]


@pytest.mark.parametrize(
    ("sure_m", "aside_m", "is_lamp"),
    [
        ([0.0], 1.0, False),
        ([0.0], 5.0, False),
        ([0.0], -5.0, False),
        ([0.0], 8.0, True),  # too far for light of the lamp
        ([0.0, 1.5], -5.0, False),
        ([0.0, 8.0], 4.5, True),  # the lamps are those of two vehicles
        ([0.0, 8.0], 1.5, True),
    ],
)
def test_what_is_too_far_aside_of_the_sure_ones_is_no_light_of_theirs(
    sure_m: list[float], aside_m: float, *, is_lamp: bool
) -> None:
    """The lights of a motorway may all be one vehicle's: its other lamps were then left without protection."""
    azimuths_rad = [math.atan2(each, 40.0) for each in (*sure_m, aside_m)]
    direct = [*([SURE] * len(sure_m)), UNSURE]
    tracks = tracks_with(direct, vehicles=[7] * len(direct), azimuths_rad=azimuths_rad, range_m=40.0)
    assert lamps_in_sight(tracks, MIN_DIRECT, CAMERA).tolist() == [*([True] * len(sure_m)), is_lamp]


@pytest.mark.parametrize(
    ("sure_kinds", "is_lamp"),
    [
        ([0.95, 0.0, 0.05, 0.0], False),
        ([0.0, 0.95, 0.0, 0.05], True),
        ([0.5, 0.45, 0.05, 0.0], True),  # perhaps a rear lamp
    ],
)
def test_only_front_lamps_have_light_that_looks_like_a_lamp(sure_kinds: list[float], *, is_lamp: bool) -> None:
    """On a motorway, far vehicles beside the rear lamps of a near one were left without protection."""
    tracks = tracks_with([SURE, UNSURE], vehicles=[7, 7])
    tracks = dataclasses.replace(tracks, light_kinds=np.array([sure_kinds, [0.6, 0.02, 0.36, 0.02]]))
    assert lamps_in_sight(tracks, MIN_DIRECT, CAMERA).tolist() == [True, is_lamp]


def test_a_sure_rear_lamp_far_from_the_front_lamp_makes_them_two_vehicles() -> None:
    azimuths_rad = [math.atan2(each, 40.0) for each in (0.0, 8.0, 1.5)]
    tracks = tracks_with([SURE, SURE, UNSURE], vehicles=[7, 7, 7], azimuths_rad=azimuths_rad, range_m=40.0)
    kinds = tracks.light_kinds.copy()
    kinds[1] = [0.0, 1.0, 0.0, 0.0]
    tracks = dataclasses.replace(tracks, light_kinds=kinds)
    assert lamps_in_sight(tracks, MIN_DIRECT, CAMERA).tolist() == [True, True, True]


@pytest.mark.parametrize("is_without", ["camera", "range"])
def test_where_nobody_knows_what_is_beside_a_sure_one_all_count(is_without: str) -> None:
    range_m = math.nan if is_without == "range" else 80.0
    tracks = tracks_with([SURE, UNSURE], vehicles=[7, 7], range_m=range_m)
    camera = None if is_without == "camera" else CAMERA
    assert lamps_in_sight(tracks, MIN_DIRECT, camera).tolist() == [True, True]


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
