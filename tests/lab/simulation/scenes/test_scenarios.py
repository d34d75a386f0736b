from __future__ import annotations

import functools
from unittest.mock import patch

import numpy as np
import pytest

from foreglow.lab.simulation.scenes import planning
from foreglow.lab.simulation.scenes.planning import Corridor, are_lights_in_sight, corridor, is_in_sight, sight_time_s
from foreglow.lab.simulation.scenes.scenarios import (
    LONG_DRIVES,
    MIXTURES,
    SCENARIOS,
    SPLITS,
    draw_scenes,
    long_drives,
    resized,
    scenario,
    with_beam,
    without_traffic,
)
from foreglow.lab.simulation.scenes.scene import RoadSpec, Scene, VehicleSpec
from foreglow.lab.simulation.scenes.surroundings import SurroundingsSpec, Verge, Wall
from foreglow.lab.simulation.world.road import Road

pytestmark = pytest.mark.slow

WIDE = Corridor(60.0, 60.0)


@pytest.fixture
def first_plans(monkeypatch: pytest.MonkeyPatch) -> None:
    """Quick: encounters as the first draw comes."""
    monkeypatch.setattr(planning, "MAX_PLANS", 1)


@functools.cache
def fifty() -> tuple[Scene, ...]:
    with patch.object(planning, "MAX_PLANS", 1):
        return draw_scenes(50, 1)


@pytest.mark.usefixtures("first_plans")
def test_same_seed_same_scenes() -> None:
    """With all plans it is an example in the docstring of the package."""
    assert draw_scenes(3, 7)[:2] == draw_scenes(2, 7)  # more scenes leave the first as they are


@pytest.mark.usefixtures("first_plans")
def test_seeds_and_splits_differ() -> None:
    seen = [draw_scenes(1, seed, split)[0] for seed in (1, 2) for split in SPLITS]
    assert len({scene.model_dump_json() for scene in seen}) == len(seen)


def test_all_scenarios_come_up() -> None:
    assert {scene.name for scene in fifty()} == set(MIXTURES["pvdn"])


def test_some_drives_are_empty() -> None:
    empty = [not scene.vehicles for scene in fifty()]
    assert 0 < sum(empty) < 20


@functools.cache
def long() -> tuple[Scene, ...]:
    with patch.object(planning, "MAX_PLANS", 1):
        return long_drives(7, 1, "val")


def test_long_drives_go_by_every_kind_of_road_and_meet_somebody() -> None:
    assert [scene.name for scene in long()] == [*LONG_DRIVES, next(iter(LONG_DRIVES))]
    assert len(LONG_DRIVES) >= 5
    for scene in long():
        assert scene.duration_s >= 20.0
        assert scene.vehicles != without_traffic(scene).vehicles
        (first_s, first_m), (last_s, last_m) = scene.ego.timetable[0], scene.ego.timetable[-1]
        end_m = first_m + (last_m - first_m) / (last_s - first_s) * scene.duration_s
        assert end_m < scene.road.length_m


def test_long_drives_have_time_before_and_after_the_meeting() -> None:
    for scene in long():
        if scene.name != "town":
            (_, ego_m), (s, later_m) = scene.ego.timetable[0], scene.ego.timetable[-1]
            (_, other_m), (t, nearer_m) = scene.vehicles[0].timetable[0], scene.vehicles[0].timetable[-1]
            meeting_s = (other_m - ego_m) / ((later_m - ego_m) / s - (nearer_m - other_m) / t)
            assert 8.0 < meeting_s < scene.duration_s - 4.0


def test_other_long_drives_for_other_splits_and_more_leave_the_first_as_they_are() -> None:
    with patch.object(planning, "MAX_PLANS", 1):
        assert long_drives(1, 1, "val") == long()[:1] != long_drives(1, 1, "test")


@pytest.mark.usefixtures("first_plans")
@pytest.mark.parametrize("name", SCENARIOS)
def test_everybody_stays_on_the_road(name: str) -> None:
    for seed in range(2):
        scene = scenario(name, seed)
        (_, first_m), (last_s, last_m) = scene.ego.timetable[0], scene.ego.timetable[-1]
        end_m = first_m + (last_m - first_m) / last_s * scene.duration_s
        assert 0 < first_m < end_m < scene.road.length_m
        for sign in scene.surroundings.signs:
            assert 0 < sign.s_m < scene.road.length_m


def test_unknown_names() -> None:
    with pytest.raises(ValueError, match="expected one of curve"):
        scenario("nothing")
    with pytest.raises(ValueError, match="split"):
        draw_scenes(1, 1, "exam")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="scenes"):
        draw_scenes(0, 1)


def test_resizing_keeps_the_field_of_view() -> None:
    scene = resized(scenario("curve"), 640, 480)
    full = scenario("curve")
    assert scene.camera.focal_px / 640 == pytest.approx(full.camera.focal_px / 1280)
    assert resized(full, 1280, 960) == full
    assert resized(Scene(), 320, 240).camera.centre_px is None


def test_a_straight_level_road_is_open() -> None:
    road = Road(RoadSpec())
    assert is_in_sight(road, 10.0, 400.0, WIDE)


def test_a_crest_hides_until_close() -> None:
    # A parabola of radius R hides eyes and lamps beyond sqrt(2 R eye) + sqrt(2 R lamp).
    road = Road(RoadSpec(elevation_m=((0.0, 0.0), (200.0, 5.0), (400.0, 0.0))))
    assert not is_in_sight(road, 50.0, 350.0, WIDE)
    assert is_in_sight(road, 180.0, 220.0, WIDE)


@pytest.mark.parametrize("sign", [-1, 1])
def test_an_obstacle_inside_a_bend_hides(sign: int) -> None:
    road = Road(RoadSpec(curvature_per_m=((0.0, sign / 150.0),)))
    narrow = Corridor(6.0, 60.0) if sign > 0 else Corridor(60.0, 6.0)
    assert is_in_sight(road, 50.0, 200.0, WIDE)
    assert not is_in_sight(road, 50.0, 200.0, narrow)


def test_time_in_sight_by_hand() -> None:
    # Meeting after 5 s at 20 m/s each; on an open road they see each other all the time.
    road = Road(RoadSpec())
    ego, oncoming = ((0.0, 0.0), (10.0, 200.0)), ((0.0, 200.0), (10.0, 0.0))
    assert sight_time_s(road, WIDE, ego, oncoming) == pytest.approx(5.0, abs=0.21)


def test_the_corridor_is_the_nearest_obstacle() -> None:
    spec = SurroundingsSpec(
        left=Verge(bank_m=3.0, bank_offset_m=4.0),
        right=Verge(bank_m=0.0),
        walls=(Wall(side="left", span_m=(0.0, 9.0), offset_m=2.0, height_m=2.0),
               Wall(side="right", span_m=(0.0, 9.0), offset_m=2.0, height_m=0.5)),
    )  # fmt: skip
    free = corridor(spec, 3.5)
    assert free.left_m == pytest.approx(5.5)
    assert free.right_m > 50.0  # one looks over the low wall


def test_cars_come_into_sight_as_planned_and_their_light_soon_before() -> None:
    times, leads = [], []
    for scene in draw_scenes(10, 5):
        oncoming = [vehicle for vehicle in scene.vehicles if vehicle.lane == "oncoming"]
        if scene.name in ("curve", "s_bend", "forest", "crest") and oncoming:
            road = Road(scene.road)
            free = corridor(scene.surroundings, road.half_width_m)
            ego, other = scene.ego.timetable, oncoming[0].timetable
            rate = (ego[1][1] - ego[0][1] + other[0][1] - other[1][1]) / 10.0
            meeting = (other[0][1] - ego[0][1]) / rate
            seen = sight_time_s(road, free, ego, other)
            times.append(meeting - seen)
            leads.append(sight_time_s(road, free, ego, other, are_lights_in_sight) - seen)
    assert len(times) >= 4
    assert 2.0 < np.median(times) < 5.0
    assert min(leads) >= 0.0  # who sees the car, sees what it lights
    assert np.median(leads) < 1.5


def test_another_beam_changes_nothing_else() -> None:
    scene = fifty()[0]
    changed = with_beam(scene, "matrix")
    assert (scene.ego.beam, changed.ego.beam) == ("low", "matrix")
    assert with_beam(changed, "low") == scene


@pytest.mark.usefixtures("first_plans")
def test_only_drives_with_low_beam_have_an_old_one() -> None:
    """Scenes with the matrix beam said that they had one, which is not in their images."""
    changed = {"low": 0, "matrix": 0}
    for scene in draw_scenes(80, 7, mixture="standard"):
        changed[scene.ego.beam] += bool(scene.ego.changed_low_beam)
    assert changed["low"] > 0 == changed["matrix"]


def test_without_traffic_dark_cars_stay() -> None:
    scene = fifty()[0]
    parked = VehicleSpec(timetable=((0.0, 50.0), (10.0, 50.0)), beam="off")
    driven = VehicleSpec(timetable=((0.0, 90.0), (10.0, -110.0)))
    assert without_traffic(scene.model_copy(update={"vehicles": (driven, parked)})).vehicles == (parked,)
