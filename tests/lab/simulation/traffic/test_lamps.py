"""Lamps of vehicles at a time, and which side of the road they are for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from foreglow.geometry import Pose
from foreglow.lab.simulation.scenes.scene import EGO_BEAMS, EgoBeam, EgoSpec, RoadSpec, VehicleSpec
from foreglow.lab.simulation.scenes.surroundings import Side
from foreglow.lab.simulation.traffic.actors import Actor, actors_at, ego_tables
from foreglow.lab.simulation.world.road import Road
from foreglow.photometry import (
    bicycle_lamp,
    brake_lamp,
    centre_brake_lamp,
    low_beam,
    marker_lamp,
    read_headlamps,
    rear_lamp,
)

SIDES: tuple[Side, Side] = ("right", "left")
AHEAD = Pose(np.zeros(3), np.eye(3))


def actor(time_s: float = 0.0, traffic: Side = "right", **fields: Any) -> Actor:
    spec = VehicleSpec(**{"timetable": ((0.0, 40.0), (10.0, 240.0)), "lane": "own", **fields})
    road = Road(RoadSpec(traffic=traffic))
    return actors_at((spec,), (road, ()), AHEAD, time_s, 2)[0]


def test_brake_lamps_are_on_while_the_vehicle_brakes() -> None:
    names = [{lamp.name for lamp in actor(time_s, brakes_s=((1.0, 3.0),)).lamps} for time_s in (0.5, 2.0, 3.0)]
    assert names[1] - names[0] == {"brake_left", "brake_right", "centre_brake"}
    assert names[0] == names[2]


def test_a_vehicle_without_beam_has_no_brake_lamps_either() -> None:
    assert not actor(2.0, brakes_s=((1.0, 3.0),), beam="off").lamps


@pytest.mark.parametrize(("lane", "is_rear"), [("own", True), ("oncoming", False)])
def test_markers_show_a_lorry_on_all_sides_and_light_nothing(lane: str, is_rear: bool) -> None:
    timetable = ((0.0, 100.0), (10.0, 300.0 if lane == "own" else 0.0))
    lamps = {lamp.name: lamp for lamp in actor(kind="semitrailer", lane=lane, timetable=timetable).lamps}
    markers = [lamp for lamp in lamps.values() if lamp.placed.lights_nothing]
    assert len(markers) == 16
    assert not lamps["low_left"].placed.lights_nothing
    assert lamps["side_marker_1_left"].is_rear == is_rear
    assert lamps["rear_marker_left"].is_rear
    assert not lamps["front_marker_1_left"].is_rear
    out = lamps["side_marker_1_left"].placed.world_from_lamp.rotation[:, 0]
    left = actor(kind="semitrailer", lane=lane, timetable=timetable).state.pose.rotation[:, 1]
    np.testing.assert_allclose(out, left, atol=1e-9)


def test_far_vehicles_light_nothing_and_take_no_layer() -> None:
    specs = [
        VehicleSpec(timetable=((0.0, s_m), (10.0, s_m - 50.0)), lights_up_to_m=200.0) for s_m in (100.0, 300.0, 150.0)
    ]
    actors = actors_at(tuple(specs), (Road(RoadSpec()), ()), AHEAD, 0.0, 2)
    assert [actor.layer for actor in actors] == [2, None, 3]
    assert all(lamp.placed.lights_nothing for lamp in actors[1].lamps)
    assert {lamp.placed.layer for lamp in actors[2].lamps} == {3}
    assert actor(beam="off").layer is None


def test_candelas_are_those_of_the_regulations() -> None:
    ahead, above = [1.0, 0.0, 0.0], [np.cos(np.radians(3.4)), 0.0, np.sin(np.radians(3.4))]
    assert 60 <= brake_lamp().towards(ahead) <= 185  # UN R7
    assert 25 <= centre_brake_lamp().towards(ahead) <= 110
    assert 4 <= rear_lamp().towards(ahead) <= 12
    assert 4 <= marker_lamp().towards(ahead) <= 25
    assert bicycle_lamp().intensities_cd.max() > 1000  # 10 lx at 10 m
    assert bicycle_lamp().towards(above) < 200


def test_low_beams_are_mirrored_with_the_traffic() -> None:
    to_the_right = [np.cos(0.05), -np.sin(0.05), -0.005]
    to_the_left = [np.cos(0.05), np.sin(0.05), -0.005]
    here, there = (actor(traffic=side).lamps[0].placed.table for side in SIDES)
    assert here is low_beam()
    assert there.towards(to_the_left) == pytest.approx(here.towards(to_the_right))
    assert there.towards(to_the_left) > 2 * there.towards(to_the_right)
    assert there is actor(traffic="left").lamps[1].placed.table  # sent to the renderer once


@pytest.mark.parametrize("beam", EGO_BEAMS)
def test_our_low_beam_is_mirrored_and_our_leds_stay(beam: EgoBeam) -> None:
    headlamps = read_headlamps()
    levels = np.zeros((2, headlamps.num_leds))
    here, there = (ego_tables(EgoSpec(beam=beam, traffic=side), levels, headlamps)[0] for side in SIDES)
    np.testing.assert_allclose(there.intensities_cd, here.intensities_cd[:, ::-1])
    if beam == "matrix":
        levels[0, 3] = 1.0
        lit = ego_tables(EgoSpec(beam=beam, traffic="left"), levels, headlamps)[0]
        before = ego_tables(EgoSpec(beam=beam), levels, headlamps)[0]
        np.testing.assert_allclose(
            lit.intensities_cd - there.intensities_cd, before.intensities_cd - here.intensities_cd, atol=0.01
        )


def test_our_old_low_beam_has_less_wide_light() -> None:
    new, old = (
        ego_tables(EgoSpec(carpet=carpet), np.zeros((2, read_headlamps().num_leds)), read_headlamps())[0]
        for carpet in (1.0, 0.4)
    )
    assert new is low_beam()
    assert old is low_beam(0.4)
    dirty = ego_tables(EgoSpec(stray=5.0), np.zeros((2, read_headlamps().num_leds)), read_headlamps())[0]
    assert dirty is low_beam(1.0, 5.0)


def test_drivers_sit_on_the_other_side_of_cars_for_left_hand_traffic() -> None:
    here, there = actor(), actor(traffic="left")
    assert here.state.pose.to_body(here.eye_world_m)[1] == pytest.approx(
        -there.state.pose.to_body(there.eye_world_m)[1]
    )


def test_who_overtakes_is_there_before_it_is_beside_us() -> None:
    assert actor(lane="own", timetable=((0.0, 1.0), (10.0, 301.0))).vehicle_id == 0
    road = Road(RoadSpec())
    behind = Pose(np.array([60.0, 0.0, 0.0]), np.eye(3))
    spec = VehicleSpec(lane="own", timetable=((0.0, 20.0), (10.0, 320.0)))
    assert len(actors_at((spec,), (road, ()), behind, 0.0, 2)) == 1
    passed = VehicleSpec(lane="oncoming", timetable=((0.0, 20.0), (10.0, -200.0)))
    assert len(actors_at((passed,), (road, ()), behind, 0.0, 2)) == 0
