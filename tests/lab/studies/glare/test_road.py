from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from foreglow.lab.simulation import Scene
from foreglow.lab.simulation.scenes.scene import RoadSpec
from foreglow.lab.simulation.scenes.surroundings import StreetLamp, SurroundingsSpec
from foreglow.lab.studies.glare.drive import DriverEye, GlareDrive, PolicyRun, RoadLight
from foreglow.lab.studies.glare.eyes import FMVSS_108
from foreglow.lab.studies.glare.light import StreetLight
from foreglow.lab.studies.glare.pooled import score_drive
from foreglow.lab.studies.glare.road import lit_road, phase_light, phases, road_share, switching, wrong_dimming

NUM = 20
SEEN = range(6, 10)
"""In one frame a second, a vehicle is in range from 4 to 9 s, sees us from 6 to 9 s, its light is there from 5 s on."""


def drive(**changes: Any) -> GlareDrive:
    frames = np.arange(NUM)
    is_known = (frames >= 4) & (frames <= 9)
    eye = DriverEye(
        vehicle_id=3,
        kind="car",
        is_oncoming=True,
        ranges_m=np.where(is_known, 100.0, math.nan),
        azimuths_rad=np.where(is_known, 0.0, math.nan),
        is_in_sight=np.isin(frames, SEEN),
        base_lx=np.zeros(NUM),
        leds_lx=np.zeros((NUM, 2, 1), np.float32),
    )
    # Own lane: low beam 2, full 10 lx; verge: 1 and 2 lx.
    leds_lx = np.tile(np.array([[[4.0], [4.0]], [[0.5], [0.5]]], np.float32), (NUM, 1, 1, 1))
    fields: dict[str, Any] = {"eyes": (eye,), "light_s": {3: 5.0}, "speeds_mps": np.full(NUM, 20.0)} | changes
    road = RoadLight(np.tile([2.0, 1.0], (NUM, 1)), leds_lx)
    return GlareDrive("a", "curve", 1.0, frames.astype(float), road=road, runs={}, **fields)


def run(**dimmed: float) -> PolicyRun:
    """Full beam, but for the frames in `dimmed`, such as f3=0.5."""
    levels = np.ones((NUM, 2, 1))
    for frame, level in dimmed.items():
        levels[int(frame[1:])] = level
    return PolicyRun.of("x", levels)


def frames_of(mask: np.ndarray[Any, np.dtype[np.bool_]]) -> list[int]:
    return np.flatnonzero(mask).tolist()


def test_phases() -> None:
    found = phases(drive())
    assert frames_of(found.is_present) == [5, 6, 7, 8, 9]
    assert frames_of(found.is_passed) == list(range(12, 20))
    assert frames_of(found.is_free) == [0, 1, *range(12, 20)]


def test_without_a_labelled_light_the_first_sight_begins() -> None:
    assert frames_of(phases(drive(light_s={})).is_present) == [6, 7, 8, 9]


def test_a_vehicle_that_stays_is_present_to_the_end() -> None:
    eye = drive().eyes[0]
    stays = dataclasses.replace(eye, ranges_m=np.full(NUM, 50.0), azimuths_rad=np.zeros(NUM))
    found = phases(drive(eyes=(stays,)))
    assert frames_of(found.is_present) == list(range(5, 20))
    assert not found.is_passed.any()
    lit = phases(drive(light_s={3: 5.0, 4: 17.0}))  # a light without an eye
    assert frames_of(lit.is_passed) == [12, 13, 14, 15, 16]
    assert frames_of(lit.is_free) == [0, 1, 12, 13]


def test_a_vehicle_that_had_passed_before_the_drive_is_not_there() -> None:
    found = phases(drive(eyes=(), light_s={3: -2.0}, gone_s={3: -0.5}))
    assert not found.is_present.any()
    assert frames_of(found.is_passed) == frames_of(found.is_free) == list(range(2, NUM))
    assert not score_drive(drive(eyes=(), light_s={}, gone_s={3: -0.5}), run(), FMVSS_108).is_empty


def test_a_drive_without_vehicles_is_free() -> None:
    found = phases(drive(eyes=(), light_s={}))
    assert found.is_free.all()
    assert not found.is_present.any()
    assert not found.is_passed.any()


def test_slow_frames_are_in_no_phase() -> None:
    speeds = np.full(NUM, 20.0)
    speeds[[0, 7, 15]] = 8.8  # 31.7 km/h
    speeds[1] = math.nan
    found = phases(drive(speeds_mps=speeds))
    assert frames_of(found.is_present) == [5, 6, 8, 9]
    assert frames_of(found.is_free) == [1, 12, 13, 14, 16, 17, 18, 19]


def test_light_kept() -> None:
    its = drive()
    found = phase_light(its, run(f5=0.5, f6=0.0, f15=0.0), phases(its).is_present)
    assert found.seconds == 5.0
    assert found.kept_lxs == (6.0 + 2.0 + 30.0, 1.5 + 1.0 + 6.0)
    assert found.full_lxs == (50.0, 10.0)
    assert found.low_lxs == (10.0, 5.0)


def test_switching() -> None:
    # Both areas together: low beam 3, full 12 lx.
    found = switching(drive(), run(f3=0.0, f4=0.5, f5=0.9))
    assert (found.seconds, found.num_falls, found.num_rises) == (19.0, 1, 2)
    assert found.change == pytest.approx(2 * 0.75)
    assert found.level_change == pytest.approx(2.0)
    still = switching(drive(), run())
    assert (still.change, still.num_falls, still.num_rises, still.level_change) == (0.0, 0, 0, 0.0)


def test_the_roads_own_ups_and_downs_are_no_switching() -> None:
    its = drive()
    wave = 1.0 + 0.5 * np.sin(np.arange(NUM))[:, np.newaxis]
    leds_lx = (its.road.leds_lx * wave[..., np.newaxis, np.newaxis]).astype(np.float32)
    road = RoadLight(its.road.base_lx * wave, leds_lx)
    assert switching(dataclasses.replace(its, road=road), run(f0=0.5, f1=0.5)).change == pytest.approx(0.375, abs=1e-6)


def test_no_light_on_the_road_at_all() -> None:
    its = drive()
    dark = RoadLight(np.zeros((NUM, 2)), np.zeros((NUM, 2, 2, 1), np.float32))
    assert road_share(dataclasses.replace(its, road=dark), run(f3=0.0)).tolist() == [1.0] * NUM


def test_wrong_dimming() -> None:
    its = drive()
    is_free = phases(its).is_free
    # Twice without anybody; the one for the vehicle, and what lasts of it beyond 12 s, is no event.
    found = wrong_dimming(its, run(f1=0.5, f9=0.0, f10=0.0, f11=0.0, f12=0.5, f15=0.0, f16=0.0), is_free)
    assert found.seconds == 10.0
    assert found.num_events == 2
    assert found.num_questions == 0  # at one image a second, nothing is short
    assert found.dimmed_s == 4.0
    assert found.leds_off_s == pytest.approx(0.5 + 0.5 + 1.0 + 1.0)
    assert found.road_lost_s == pytest.approx(0.75 * 3.0)


def test_what_is_shallow_and_short_is_a_question() -> None:
    its = dataclasses.replace(drive(), rate_hz=18.0)
    is_free = np.ones(NUM, np.bool_)
    asked = dict.fromkeys(("f1", "f2", "f3", "f4", "f5"), 0.7)
    found = wrong_dimming(its, run(**asked, f9=0.0, f11=0.69, f15=0.8), is_free)
    assert (found.num_events, found.num_questions) == (4, 2)
    assert wrong_dimming(its, run(**asked, f6=0.9), is_free).num_questions == 0
    assert wrong_dimming(its, run(f18=0.8, f19=0.8), is_free).num_questions == 0  # nobody knows how long it took


def test_low_beam_has_no_event_but_is_dimmed_all_the_time() -> None:
    its = drive()
    low = PolicyRun.of("low", np.zeros((NUM, 2, 1)))
    found = wrong_dimming(its, low, phases(its).is_free)
    assert (found.num_events, found.dimmed_s, found.leds_off_s) == (0, 10.0, 10.0)
    almost = wrong_dimming(its, run(f15=0.991), phases(its).is_free)
    assert (almost.num_events, almost.dimmed_s) == (0, 0.0)


LIT = np.isin(np.arange(NUM), range(11, 17))
"""A street that is lit from 11 to 16 s."""


def test_on_lit_roads_no_dimming_is_wrong() -> None:
    found = phases(drive(is_lit=LIT))
    assert frames_of(found.is_free) == [0, 1, 17, 18, 19]
    assert frames_of(found.is_passed) == [17, 18, 19]
    dimmed = run(f13=0.0, f14=0.0)
    assert wrong_dimming(drive(), dimmed, phases(drive()).is_free).num_events == 1
    assert wrong_dimming(drive(is_lit=LIT), dimmed, found.is_free).num_events == 0


def test_high_beam_on_lit_roads_counts_after_two_seconds() -> None:
    late = lit_road(drive(is_lit=LIT), run(f14=0.0, f15=0.0))
    assert (late.seconds, late.high_s, late.num_streets, late.num_switched) == (4.0, 2.0, 1, 0)
    in_time = lit_road(drive(is_lit=LIT), run(f13=0.0, f14=0.0, f15=0.0, f16=0.0))
    assert (in_time.high_s, in_time.num_switched) == (0.0, 1)
    dimmed = lit_road(drive(is_lit=LIT), run(f13=0.5, f14=0.5, f15=0.5, f16=0.5))
    assert (dimmed.high_s, dimmed.num_switched) == (4.0, 0)


def test_low_beam_on_dark_roads_is_counted_once() -> None:
    found = lit_road(drive(is_lit=LIT), run(f3=0.0, f4=0.0, f8=0.2, f13=0.0, f16=0.0, f17=0.0))
    assert (found.dark_s, found.num_low) == (14.0, 1)
    assert lit_road(drive(speeds_mps=np.full(NUM, 5.0)), run(f3=0.0)).num_low == 0


def lamps(*at_m: float, intensity_cd: float = 1000.0) -> Scene:
    row = tuple(StreetLamp(side="right", s_m=s_m, height_m=7.0, intensity_cd=intensity_cd) for s_m in at_m)
    surroundings = SurroundingsSpec(street_lamps=row)
    return Scene(name="x", duration_s=2.0, road=RoadSpec(length_m=600.0), surroundings=surroundings)


def test_where_a_road_is_lit() -> None:
    assert StreetLight(lamps(*range(0, 400, 30))).is_lit(100.0)
    assert not StreetLight(lamps(*range(0, 400, 30))).is_lit(450.0)
    assert not StreetLight(lamps(130.0)).is_lit(100.0)
    assert not StreetLight(lamps()).is_lit(100.0)
    assert not StreetLight(lamps(*range(0, 400, 30), intensity_cd=0.0)).is_lit(100.0)
