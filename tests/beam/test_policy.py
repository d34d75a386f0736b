"""What policies make of tracks: scenes of few frames, and what has to come of them."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from foreglow.beam import Gap, occurrence
from foreglow.beam.interface import BeamPolicy
from foreglow.beam.policy import ForeglowPolicy, PaperPolicy
from foreglow.beam.stage import BeamStage
from foreglow.config import GuardConfig
from foreglow.geometry import Pose
from foreglow.photometry import NUM_LEDS
from foreglow.types import BeamCommand, BeamMode, EgoMotion, Frame, RoadAhead, Tracks, TrackState, Vehicles
from tests.beam.made_up import box_around, from_origin
from tests.beam.policy_scenes import (
    COASTING,
    CONFIG,
    CONFIRMED,
    LAMP,
    LIGHT,
    STRAIGHT,
    TENTATIVE,
    S,
    Seen,
    brightest_there,
    frame,
    gaps_after,
    holding,
    policy,
    tracks_at,
)


def test_without_tracks_there_is_full_beam() -> None:
    command = policy().command(frame(0), tracks_at(0))
    assert command.mode == BeamMode.FULL
    assert (command.levels == 1.0).all()
    assert len(command.gaps_rad) == 0


def test_a_lamp_has_a_gap_that_holds_its_vehicle() -> None:
    command = policy().command(frame(0), tracks_at(0, LAMP))
    assert command.mode == BeamMode.GLARE_FREE
    (right, left), *rest = command.gaps_rad.tolist()
    assert not rest
    margin = math.atan2(1.2, LAMP.range_m) + math.radians(CONFIG.margin_deg)
    azimuth_rad, range_m = from_origin(LAMP.azimuth_rad, LAMP.range_m)
    assert right < azimuth_rad - margin < azimuth_rad + margin < left
    assert brightest_there(command, azimuth_rad) <= CONFIG.led_limit_lx
    assert brightest_there(command, -0.15) > 1.0  # and elsewhere it is bright
    assert command.gap_ranges_m[0] == pytest.approx(range_m, rel=1e-3)


@pytest.mark.parametrize("direct", [0.95, math.nan])
def test_what_may_be_a_lamp_has_a_gap(direct: float) -> None:
    assert holding(policy().gaps(frame(0), tracks_at(0, LAMP._replace(direct=direct))), LAMP.azimuth_rad)


def test_rear_lamps_are_protected_as_front_lamps_are() -> None:
    """Their light on something as well, and a lamp of which it is unclear whose it is."""
    for kinds, direct in (([0.05, 0.9, 0.0, 0.05], 0.95), ([0.3, 0.3, 0.4, 0.0], 0.6), ([0.0, 0.05, 0.05, 0.9], 0.05)):
        tracks = dataclasses.replace(tracks_at(0, LAMP), light_kinds=np.array([kinds]))
        gaps = policy().gaps(frame(0), tracks)
        assert gaps == policy().gaps(frame(0), tracks_at(0, LAMP._replace(direct=direct)))
        assert bool(holding(gaps, LAMP.azimuth_rad)) == (direct > CONFIG.min_direct)
        assert len(gaps) == 1


def test_nearer_vehicles_have_wider_gaps_and_unknown_ranges_are_taken_as_near() -> None:
    widths = []
    for range_m in (200.0, 100.0, math.nan, 20.0):
        (gap,) = policy().gaps(frame(0), tracks_at(0, LAMP._replace(range_m=range_m)))
        widths.append(gap.left_rad - gap.right_rad)
    assert widths == sorted(widths)
    assert len(set(widths)) == 4


def test_the_gap_is_where_a_lamp_that_moves_aside_will_be() -> None:
    towards_left, away = (
        gaps_after(policy(), *((LAMP._replace(azimuth_rad=rate * S * number),) for number in range(20)))[0]
        for rate in (0.1, -0.1)
    )
    now_rad, _ = from_origin(0.1 * S * 19, LAMP.range_m)
    lead_rad = 0.5 * (towards_left.right_rad + towards_left.left_rad) - now_rad
    assert lead_rad == pytest.approx(0.1 * CONFIG.latency_s, rel=0.1)
    assert away.right_rad == pytest.approx(-towards_left.left_rad, abs=1e-3)
    assert away.left_rad == pytest.approx(-towards_left.right_rad, abs=1e-3)
    (still,) = policy().gaps(frame(0), tracks_at(0, LAMP))
    assert towards_left.left_rad - towards_left.right_rad == pytest.approx(still.left_rad - still.right_rad, rel=0.01)
    (fast,) = gaps_after(policy(), *((LAMP._replace(azimuth_rad=0.03 * number),) for number in range(10)))
    assert fast.right_rad < from_origin(0.27, LAMP.range_m)[0]  # the lamp itself, too


def test_light_on_things_has_its_gap_where_the_vehicle_will_appear() -> None:
    gaps = policy().gaps(frame(0), tracks_at(0, LIGHT))
    expected = occurrence(STRAIGHT, LIGHT.range_m)
    assert expected is not None
    assert len(gaps) == 1
    assert holding(gaps, expected.azimuth_rad)
    assert not holding(gaps, LIGHT.azimuth_rad)
    rest = 0.5 * (1.0 - CONFIG.coverage)
    assert all(holding(gaps, azimuth_rad) for azimuth_rad in expected.quantiles_rad((rest, 0.5, 1.0 - rest)))


def test_the_range_of_the_light_counts_less_its_deviation() -> None:
    """Light that may as well be near does not rule out that the vehicle appears near."""
    sure, unsure = (
        policy().gaps(frame(0), tracks_at(0, LIGHT._replace(range_m=200.0, sigma_m=sigma_m)))[0]
        for sigma_m in (1.0, 150.0)
    )
    assert unsure.near_m < sure.near_m


def test_where_it_appears_is_seen_from_where_we_are_then() -> None:
    made, along_m = policy(), np.arange(0.0, 400.0, 5.0)
    bend = RoadAhead(np.stack([along_m, 1e-6 * along_m**3, 0.0 * along_m], axis=1), half_width_m=3.5)
    made.gaps(dataclasses.replace(frame(0, bend), motion=EgoMotion(25.0, 0.0)), tracks_at(0, LIGHT))
    moving = made.expected.azimuth_rad
    made.gaps(dataclasses.replace(frame(0, bend), motion=None), tracks_at(0, LIGHT))
    assert moving > made.expected.azimuth_rad


@pytest.mark.parametrize(
    "road", [None, RoadAhead(STRAIGHT.points_m[:6], half_width_m=3.5)], ids=["no road", "a road that ends before"]
)
def test_without_a_road_the_light_is_the_place(road: RoadAhead | None) -> None:
    gaps = policy().gaps(frame(0, road), tracks_at(0, LIGHT))
    assert len(gaps) == 1
    assert holding(gaps, LIGHT.azimuth_rad)


def test_light_is_explained_by_a_lamp_in_sight() -> None:
    both = policy().gaps(frame(0), tracks_at(0, LAMP, LIGHT))
    assert both == policy().gaps(frame(0), tracks_at(0, LAMP))


def of_vehicles(tracks: Tracks, *of_tracks: int, confidence: float) -> Tracks:
    """The tracks as those of vehicles that are this sure, each led by its first track."""
    ids, leading = np.unique(of_tracks, return_index=True)
    vehicles = Vehicles(
        ids=ids,
        states=np.full(len(ids), CONFIRMED, np.int64),
        confidences=np.full(len(ids), confidence),
        is_in_sight=np.zeros(len(ids), np.bool_),
        of_tracks=np.array(of_tracks),
        leading=leading,
    )
    return dataclasses.replace(tracks, vehicles=vehicles)


@pytest.mark.parametrize(("confidence", "num_gaps"), [(0.6, 1), (CONFIG.min_hidden_confidence - 0.01, 0)])
def test_a_vehicle_is_as_sure_as_all_its_light_together(confidence: float, num_gaps: int) -> None:
    """Its leading track alone is not."""
    tracks = tracks_at(0, LIGHT._replace(confidence=0.3), LIGHT._replace(confidence=0.3, state=TENTATIVE, number=2))
    assert not policy().gaps(frame(0), tracks)
    assert len(policy().gaps(frame(0), of_vehicles(tracks, 4, 4, confidence=confidence))) == num_gaps


def test_each_hidden_vehicle_has_a_gap_of_its_own_and_keeps_it_for_a_while() -> None:
    near, far = LIGHT, LIGHT._replace(range_m=150.0, number=2)
    of_near, of_far = policy().gaps(frame(0), tracks_at(0, near)), policy().gaps(frame(0), tracks_at(0, far))
    assert of_near != of_far
    made = policy()
    assert made.gaps(frame(0), of_vehicles(tracks_at(0, near, far), 3, 7, confidence=0.9)) == of_near + of_far
    assert made.gaps(frame(1), of_vehicles(tracks_at(1, far), 7, confidence=0.9)) == of_far + of_near
    assert made.gaps(frame(20), of_vehicles(tracks_at(20, far), 7, confidence=0.9)) == of_far
    assert policy().gaps(frame(0), of_vehicles(tracks_at(0, near, far), 3, 3, confidence=0.9)) == of_far
    beyond = LIGHT._replace(range_m=390.0, number=7)  # the end of the road: track 7, and the near one is vehicle 7
    assert len(policy().gaps(frame(0), of_vehicles(tracks_at(0, near, beyond), 7, 3, confidence=0.9))) == 2


SURE = LAMP._replace(direct=0.99)
BESIDE = Seen(-0.01, direct=0.7, number=6)
"""Light on a rail that looks half like a lamp."""


def test_light_beside_a_sure_lamp_of_its_vehicle_opens_no_gap() -> None:
    sure, unsure = SURE, SURE._replace(direct=0.7)
    for lamp, vehicles, num_gaps in ((sure, (3, 3), 1), (unsure, (3, 3), 2), (sure, (3, 4), 2)):
        gaps = policy().gaps(frame(0), of_vehicles(tracks_at(0, lamp, BESIDE), *vehicles, confidence=0.9))
        assert len(gaps) == num_gaps
        assert holding(gaps, lamp.azimuth_rad)
        assert bool(holding(gaps, BESIDE.azimuth_rad)) == (num_gaps == 2)


def test_the_guard_leaves_that_light_out_as_well() -> None:
    stage = BeamStage(CONFIG, GuardConfig())
    for number in range(30):
        command = stage.command(frame(number), of_vehicles(tracks_at(number, SURE, BESIDE), 3, 3, confidence=0.9))
    gaps = [Gap(right, left, 0.0, 0.0) for right, left in command.gaps_rad.tolist()]
    assert command.mode == BeamMode.GLARE_FREE
    assert holding(gaps, SURE.azimuth_rad)
    assert not holding(gaps, BESIDE.azimuth_rad)


@pytest.mark.parametrize("is_by_setting", [True, False])
def test_the_guard_sees_the_tracks_and_the_car_the_command_whatever_a_policy_does_to_them(is_by_setting: bool) -> None:
    class Dazzling(BeamPolicy):
        def __init__(self, config: Any, headlamps: Any) -> None:
            pass

        def command(self, frame: Frame, tracks: Tracks) -> BeamCommand:
            if is_by_setting:
                object.__setattr__(tracks, "states", np.zeros_like(tracks.states))
            else:
                array = tracks.states
                while array.base is not None:
                    array = array.base
                array.setflags(write=True)
                array[:] = 0
            return BeamCommand(frame.timestamp_ns, BeamMode.FULL, np.ones((2, NUM_LEDS)))

        def shone(self, command: BeamCommand) -> None:
            object.__setattr__(command, "levels", np.ones((2, NUM_LEDS)))

    stage = BeamStage(CONFIG, GuardConfig(), Dazzling)
    for number in range(30):
        command = stage.command(frame(number), tracks_at(number, LAMP))
    assert command.mode == BeamMode.GLARE_FREE
    assert command.levels.min() < 0.1


def test_no_gap_is_held_for_a_vehicle_that_another_lamp_shows() -> None:
    """Neither that of a lamp that was none, nor the one that was open while the vehicle was hidden.

    A lamp that is unsure may be light: while it comes and goes, the gap for the hidden vehicle stays.
    """
    first, second = LAMP, SURE._replace(azimuth_rad=-0.1, number=6)
    unsure = second._replace(direct=0.7)
    for before in (first, LIGHT._replace(azimuth_rad=first.azimuth_rad)):
        for now, vehicle, is_held in ((second, 3, False), (second, 4, True), (unsure, 3, True)):
            made = policy()
            (old,) = made.gaps(frame(0, None), of_vehicles(tracks_at(0, before), 3, confidence=0.9))
            gaps = made.gaps(frame(1, None), of_vehicles(tracks_at(1, now), vehicle, confidence=0.9))
            assert holding(gaps, second.azimuth_rad)
            assert (old in gaps) == is_held


def lamps_apart(apart_m: float, *vehicles: int, direct: float = 0.99) -> list[float]:
    """The borders of all gaps of two lamps, 100 m away and so far apart, and where the lamps are, metres."""
    lamps = [Seen(side * apart_m / 200, direct, 100.0, number=number) for number, side in enumerate((-1, 1))]
    gaps = policy().gaps(frame(0), of_vehicles(tracks_at(0, *lamps), *vehicles, confidence=0.9))
    places = [from_origin(lamp.azimuth_rad, lamp.range_m) for lamp in lamps]
    borders = (min(gap.right_rad for gap in gaps), max(gap.left_rad for gap in gaps))
    return [angle * places[0][1] for angle in (*borders, *(place[0] for place in places))]


def test_the_gap_of_a_vehicle_with_both_lamps_in_sight_ends_beside_its_body() -> None:
    right_m, left_m, first_m, last_m = lamps_apart(1.4, 3, 3)
    edge_m = 100.0 * (0.3 * 0.003 + math.radians(CONFIG.margin_deg))
    for outside_m in (first_m - right_m, left_m - last_m):
        assert 0.4 < outside_m - edge_m < 0.7
    # Of two vehicles, light below a lamp, two vehicles in one, or perhaps light beside a lamp.
    for apart_m, vehicles, direct in (
        (1.4, (3, 4), 0.99),
        (0.3, (3, 3), 0.99),
        (5.0, (3, 3), 0.99),
        (1.4, (3, 3), 0.7),
    ):
        right_m, left_m, first_m, last_m = lamps_apart(apart_m, *vehicles, direct=direct)
        for outside_m in (first_m - right_m, left_m - last_m):
            assert outside_m - edge_m > 1.2


def test_between_the_lamps_of_a_vehicle_it_is_dark() -> None:
    for apart_m in (0.9, 1.4, 2.2):
        lamps = [Seen(side * apart_m / 200, range_m=100.0, number=number) for number, side in enumerate((-1, 1))]
        made = policy().command(frame(0), of_vehicles(tracks_at(0, *lamps), 3, 3, confidence=0.9))
        assert len(made.gaps_rad) == 1


def test_more_coverage_is_a_wider_gap() -> None:
    widths = []
    for coverage in (0.2, 0.5, 0.9):
        (gap,) = policy(coverage=coverage).gaps(frame(0), tracks_at(0, LIGHT))
        widths.append(gap.left_rad - gap.right_rad)
    assert widths[0] < widths[1] < widths[2]


@pytest.mark.parametrize("state", [CONFIRMED, COASTING])
def test_plausible_tracks_count(state: TrackState) -> None:
    assert policy().gaps(frame(0), tracks_at(0, LAMP._replace(state=state)))


@pytest.mark.parametrize("seen", [LAMP, LIGHT])
def test_a_tentative_track_alone_does_not(seen: Seen) -> None:
    assert not policy().gaps(frame(0), tracks_at(0, seen._replace(state=TENTATIVE)))


def test_tentative_lamps_count_while_a_gap_is_open() -> None:
    coming = Seen(0.12, state=TENTATIVE, number=5)
    shine = coming._replace(direct=0.1)
    for opener in (LAMP, LIGHT):
        assert holding(policy().gaps(frame(0), tracks_at(0, opener, coming)), coming.azimuth_rad)
        assert not holding(policy().gaps(frame(0), tracks_at(0, opener, shine)), coming.azimuth_rad)
    assert holding(gaps_after(policy(), (LAMP,), (coming,)), coming.azimuth_rad)  # held is open


def test_tentative_lamps_that_are_rear_lamps_or_not_seen_now_do_not() -> None:
    coming = Seen(0.12, state=TENTATIVE, number=5)
    tracks = tracks_at(0, LAMP, coming)
    rear = dataclasses.replace(tracks, light_kinds=np.roll(tracks.light_kinds, 1, axis=1))
    missed = dataclasses.replace(tracks, num_misses=np.array([0, 1]), detections=np.array([0, -1]))
    for others in (rear, missed):
        assert not holding(policy().gaps(frame(0), others), coming.azimuth_rad)
        assert holding(policy().gaps(frame(0), others), LAMP.azimuth_rad)


def test_a_gap_is_held_and_then_light_returns() -> None:
    made, modes, levels = policy(), [], []
    num_frames = math.ceil((2 * CONFIG.hold_s + CONFIG.restore_s) / S) + 4
    for number in range(num_frames):
        command = made.command(frame(number), tracks_at(number, *((LAMP,) if number < 3 else ())))
        modes.append(len(command.gaps_rad))
        levels.append(command.levels)
        is_full = not len(command.gaps_rad) and bool((command.levels == 1.0).all())
        assert command.mode == (BeamMode.FULL if is_full else BeamMode.GLARE_FREE)
    last_seen = 2
    num_held = math.floor(CONFIG.hold_s / S)
    assert modes == [1] * (last_seen + num_held + 1) + [0] * (num_frames - last_seen - num_held - 1)
    dark = levels[last_seen] < 0.5
    assert dark.any()
    for before, after in zip(levels[last_seen:], levels[last_seen + 1 :], strict=False):
        assert (after >= before).all()
        assert (after - before).max() <= S / CONFIG.restore_s + 1e-6
    assert (levels[-1] == 1.0).all()
    assert command.mode == BeamMode.FULL


EDGE_RAD = 0.42
"""Near the left border of the image: a lamp there passes us."""


def approach(last_rad: float, num_frames: int = 12) -> list[tuple[Seen, ...]]:
    """A lamp that moves to `last_rad`, beside light on something that stays."""
    azimuths = np.linspace(0.3 * last_rad, last_rad, num_frames)
    light = LIGHT._replace(azimuth_rad=-0.02, number=7)
    return [(LAMP._replace(azimuth_rad=float(azimuth)), light) for azimuth in azimuths]


def gaps_of_each(frames: list[tuple[Seen, ...]]) -> list[list[Gap]]:
    made = policy()
    return [made.gaps(frame(number), tracks_at(number, *seen)) for number, seen in enumerate(frames)]


def test_no_gap_is_held_for_what_has_left_the_image() -> None:
    for last_rad, is_held in ((EDGE_RAD, False), (0.1, True)):
        last = gaps_of_each([frame[:1] for frame in approach(last_rad)] + [()])[-1]
        assert bool(holding(last, last_rad)) == is_held


def test_light_beside_a_vehicle_that_has_passed_is_no_hidden_vehicle() -> None:
    alone = (approach(0.0)[0][1],)
    for last_rad, is_passed in ((EDGE_RAD, True), (0.1, False)):
        after = gaps_of_each(approach(last_rad) + [alone] * 70)[-70:]
        assert bool(after[10]) != is_passed
        assert after[-1]  # light that is still there is somebody's


def test_a_lamp_that_passes_close_by_sinks_and_stays_a_lamp() -> None:
    """At 8 m a lamp is as low as light on the road: what was beside it is not to be taken for a hidden vehicle."""
    made = policy()
    for number, (lamp, light) in enumerate(approach(EDGE_RAD)):
        tracks = tracks_at(number, lamp, light)
        boxes = tracks.boxes_xyxy_px.copy()
        boxes[0] = box_around(lamp.azimuth_rad, math.radians(-1 - 0.6 * number), 0.006)
        gaps = made.gaps(frame(number), dataclasses.replace(tracks, boxes_xyxy_px=boxes))
        (gap,) = gaps
        assert gap.right_rad < lamp.azimuth_rad < gap.left_rad
    assert not made.gaps(frame(12), tracks_at(12, light))


def test_new_light_after_a_vehicle_has_passed_is_the_next_ones() -> None:
    new = (LIGHT._replace(azimuth_rad=0.02, number=9),)
    assert gaps_of_each([*approach(EDGE_RAD), new])[-1]


def test_light_that_is_explained_is_so_only_until_the_next_lamp_is_lost_ahead() -> None:
    first, light = approach(EDGE_RAD), approach(0.0)[0][1]
    second = LAMP._replace(azimuth_rad=0.05, number=11)
    assert gaps_of_each([*first, (light,), (light, second), *[(light,)] * 10])[-1]


@pytest.mark.parametrize(
    ("seen", "name"), [(LAMP, "min_confidence"), (LIGHT, "min_hidden_confidence")], ids=["lamp", "light"]
)
def test_a_gap_begins_once_its_track_was_confident_enough(seen: Seen, name: str) -> None:
    wanted: dict[str, Any] = {name: 0.6}
    unsure, sure = seen._replace(confidence=0.5), seen._replace(confidence=0.7)
    assert not gaps_after(policy(**wanted), (unsure,), (unsure,))
    assert gaps_after(policy(**wanted), (unsure,), (sure,), (unsure,))


@pytest.mark.parametrize("kind", [ForeglowPolicy, PaperPolicy])
def test_without_a_camera_nothing_has_a_direction(kind: type[Any]) -> None:
    blind = dataclasses.replace(frame(0), camera=None)
    assert policy(kind).gaps(blind, tracks_at(0, LAMP)) == []


@pytest.mark.parametrize("kind", [ForeglowPolicy, PaperPolicy])
def test_a_new_start_knows_nothing(kind: type[Any]) -> None:
    def lived(made: BeamPolicy) -> list[BeamCommand]:
        return [made.command(frame(n), tracks_at(n, *((LAMP,) if n in (1, 2) else ()))) for n in range(5)]

    made = policy(kind)
    first = lived(made)
    made.reset()
    for before, after in zip(first, lived(made), strict=True):
        assert before.mode == after.mode
        np.testing.assert_array_equal(before.levels, after.levels)
        np.testing.assert_array_equal(before.gaps_rad, after.gaps_rad)


def test_a_gap_is_not_held_when_time_jumps_back() -> None:
    made = policy()
    assert made.gaps(frame(10), tracks_at(10, LAMP))
    assert not made.gaps(frame(0), tracks_at(0))


def test_light_far_below_is_no_lamp() -> None:
    """At 10 degrees below nothing but the road in front of the car is seen."""
    low = dataclasses.replace(tracks_at(0, LAMP), boxes_xyxy_px=np.array([box_around(0.0, math.radians(-10), 0.006)]))
    assert not policy().gaps(frame(0), low)


def test_lamps_below_a_lorrys_camera_are_lamps() -> None:
    """A car's lamp 15 m ahead is 7.5 degrees below a camera 2.6 m above the road: it was taken for light on that."""
    lamp = dataclasses.replace(tracks_at(0, LAMP), boxes_xyxy_px=np.array([box_around(0.0, math.radians(-7.5), 0.006)]))
    for height_m, num_gaps in ((1.35, 0), (2.6, 1)):
        ahead = frame(0)
        assert ahead.camera is not None
        mount = Pose(np.array([1.8, 0.0, height_m]), ahead.camera.vehicle_from_camera.rotation)
        ahead = dataclasses.replace(ahead, camera=dataclasses.replace(ahead.camera, vehicle_from_camera=mount))
        assert len(policy().gaps(ahead, lamp)) == num_gaps


def test_a_vehicle_beside_us_does_not_darken_the_whole_beam() -> None:
    near, far = (policy().gaps(frame(0), tracks_at(0, LAMP._replace(range_m=range_m)))[0] for range_m in (3.0, 15.0))
    assert near.left_rad - near.right_rad < math.radians(12.0)
    assert near.near_m == far.near_m == pytest.approx(20.0)
