from __future__ import annotations

import numpy as np
import pytest

from foreglow.geometry import Floats
from foreglow.lab.simulation.scenes.scene import RoadSpec
from foreglow.lab.simulation.world.road import Road
from foreglow.lab.simulation.writing.street_data import StreetDataError, StreetMap, road_ahead
from foreglow.street import ERROR_BOUNDS_M, NUM_SEGMENT_IDS, points_from_message

STRAIGHT = RoadSpec(length_m=600.0)
WINDING = RoadSpec(
    length_m=900.0,
    curvature_per_m=((0.0, 0.0), (100.0, 0.0), (150.0, 0.01), (300.0, 0.01), (350.0, 0.0), (400.0, -0.005), (500.0, 0)),
    elevation_m=((0.0, 0.0), (200.0, 5.0), (350.0, 2.0), (500.0, 0.0)),
)


def street_map(spec: RoadSpec, error_class: int = 0, seed: int = 3) -> StreetMap:
    return StreetMap(Road(spec), StreetDataError(longitudinal_class=error_class), np.random.default_rng([seed, 1]))


def _ahead(spec: RoadSpec, ego_s_m: float) -> Floats:
    road = Road(spec)
    return road_ahead(road, ego_s_m, road.pose(ego_s_m, -1.75, 1, 2.7))


def test_the_true_road_ahead() -> None:
    straight = _ahead(STRAIGHT, 50.0)
    assert straight.shape == (401, 3)
    np.testing.assert_allclose(straight[:, 0], np.arange(401.0), atol=1e-3)
    np.testing.assert_allclose(straight[:, 1], 1.75, atol=1e-3)
    winding = _ahead(WINDING, 120.0)
    np.testing.assert_allclose(np.linalg.norm(np.diff(winding, axis=0), axis=1), 1.0, atol=5e-3)
    assert winding[150, 1] > 40
    assert len(road_ahead(Road(STRAIGHT), 580.0, Road(STRAIGHT).pose(580.0, 0, 1, 2.7), length_m=30.0)) == 31


@pytest.mark.parametrize("ego_s_m", [0.0, 60.0, 130.5, 280.0, 610.0])
def test_a_message_without_offset_tells_the_road(ego_s_m: float) -> None:
    streets = street_map(WINDING)
    # The message is asked for where the car believes to be, so that only the quantisation is left.
    believed_m = ego_s_m + float(streets.offset_m(ego_s_m))
    sent, true = points_from_message(streets.message(ego_s_m), 1.75), _ahead(WINDING, believed_m)
    errors_m = np.linalg.norm(sent[:401] - true[: len(sent)], axis=1)
    assert len(sent) >= 400
    assert errors_m[:50].max() < 1.0
    assert errors_m[200] < 4.0
    assert errors_m[400 - 1] < 12.0


def test_segments_follow_each_other() -> None:
    message = street_map(WINDING).message(20.0)
    ids = [segment.segment_id for segment in message.segments]
    assert [segment.parent_id for segment in message.segments[1:]] == ids[:-1]
    assert sum(segment.length_m for segment in message.segments[1:]) + message.remaining_length_m >= 400
    assert sum(segment.length_m for segment in message.segments[1:-1]) + message.remaining_length_m < 400 + 254
    assert 0 <= message.remaining_length_m <= message.segments[0].length_m


def test_ids_come_round_again() -> None:
    hills = tuple((25.0 * index, 1.5 * (index % 2)) for index in range(180))
    road = RoadSpec(length_m=4500.0, elevation_m=hills)
    streets = street_map(road)
    ids = {segment.segment_id for s_m in range(0, 4500, 100) for segment in streets.message(s_m).segments}
    assert ids == set(range(1, NUM_SEGMENT_IDS + 1))


@pytest.mark.slow
@pytest.mark.parametrize("error_class", range(6))
def test_the_offset_keeps_to_its_class_and_wanders_slowly(error_class: int) -> None:
    places_m = np.arange(0.0, 2000.0)
    lower_m, upper_m = (0.0, *ERROR_BOUNDS_M)[error_class], ERROR_BOUNDS_M[error_class]
    for seed in range(8):
        offsets_m = street_map(STRAIGHT, error_class, seed).offset_m(places_m)
        assert lower_m < np.abs(offsets_m).max() < upper_m
        assert np.abs(np.diff(offsets_m)).max() < 0.03 * upper_m
        assert offsets_m.min() < 0 < offsets_m.max()


def test_the_message_is_wrong_by_the_offset() -> None:
    streets = street_map(WINDING, 4)
    places_m = np.arange(0.0, 80.0, 10.0)
    offsets_m = streets.offset_m(places_m)
    assert np.abs(offsets_m).max() > 20
    for s_m, offset_m in zip(places_m.tolist(), offsets_m.tolist(), strict=True):
        sent = points_from_message(streets.message(s_m), 1.75)[150, :2]
        assert np.linalg.norm(sent - _ahead(WINDING, s_m + offset_m)[150, :2]) < 2.0
        if abs(offset_m) > 10:
            assert np.linalg.norm(sent - _ahead(WINDING, s_m)[150, :2]) > 4.0


def test_the_same_seed_gives_the_same_messages() -> None:
    first, second = street_map(WINDING, 3, seed=5), street_map(WINDING, 3, seed=5)
    messages = [first.message(s_m) for s_m in (10.0, 50.0, 90.0)]
    assert messages == [second.message(s_m) for s_m in (90.0, 50.0, 10.0)][::-1]
    assert messages != [street_map(WINDING, 3, seed=6).message(s_m) for s_m in (10.0, 50.0, 90.0)]


@pytest.mark.slow
def test_a_class_is_drawn_by_its_share() -> None:
    rngs = [np.random.default_rng([seed, 1]) for seed in range(15)]
    road = Road(RoadSpec(length_m=50.0))
    error = StreetDataError(class_shares=(0.0, 3.0, 0.0, 0.0, 1.0, 0.0))
    drawn = [StreetMap(road, error, rng).error_class for rng in rngs]
    assert set(drawn) == {1, 4}
    assert drawn.count(1) > drawn.count(4)


def test_a_position_off_the_map() -> None:
    with pytest.raises(ValueError, match="ego_s_m: expected an arc length on the map, -1000 to 1600 m, got 2000"):
        street_map(STRAIGHT).message(2000.0)


@pytest.mark.parametrize("shares", [(1.0,) * 5, (0.0,) * 6, (-1.0, *(1.0,) * 5)])
def test_bad_shares(shares: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="class_shares"):
        StreetDataError(class_shares=shares)
