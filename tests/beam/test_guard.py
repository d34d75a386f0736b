"""The guard: its invariants over a sweep of states, at vehicles, and over time."""

from __future__ import annotations

import ast
import dataclasses
import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import foreglow.beam
from benchmarks import guard_sweep
from foreglow.beam import guard as guard_module
from foreglow.beam.guard import Guard, dimmed, united
from foreglow.geometry import Floats, Pose, rotation
from foreglow.photometry import Headlamp, Headlamps, read_headlamps
from foreglow.photometry.matrix import LedGrid
from foreglow.types import BeamCommand, BeamMode, TrackState
from tests.beam.guards import AHEAD, LAMPS, NOBODY, NUM_LEDS, assert_low, next_check, running, towards_cd, with_arrays
from tests.beam.made_up import (
    CAMERA,
    FRAME_NS,
    FakeLamps,
    box_around,
    frame_at,
    from_origin,
    full,
    guard_config,
    lamps_of,
    tracks_of,
)

# The sweep


@pytest.mark.slow
def test_no_counter_example_in_the_sweep() -> None:
    outcome = guard_sweep.sweep(LAMPS, guard_sweep.QUICK)
    assert outcome.num_states > 10_000
    assert outcome.num_lit > 800
    assert outcome.counter_examples == {}


@pytest.mark.slow
def test_no_counter_example_with_leds_finer_than_the_guards_table() -> None:
    """Whose light is all between the directions that the table once looked at."""
    grid = LedGrid(
        num_columns=100,
        pitch_deg=0.2,
        row_elevations_deg=(-0.1, 0.9),
        row_peaks_cd=(38_000.0, 9_000.0),
        side_sigma_deg=6.5,
        everywhere_cd=0.0,
        half_width_deg=0.05,
        half_height_deg=0.4,
        edge_exponent=2.6,
        reach_width_deg=0.2,
        reach_height_deg=1.2,
    )
    outcome = guard_sweep.sweep(lamps_of(grid), SMALL)
    assert outcome.num_lit > 10
    # The sweep looks at too few directions to say which of such LEDs shine elsewhere.
    assert set(outcome.counter_examples) <= {"an LED that shines elsewhere is not dimmed"}


SMALL = guard_sweep.Grid(
    azimuths_deg=(-1, 2),
    elevations_deg=(0.5,),
    widths_deg=(0.6,),
    ranges_m=(math.nan, 130.0),
    relative_sigmas=(0.1,),
    wanted=(1.0,),
    before=(0.4, 1.0),
    speeds_mps=(20.0, 8.8),
    ages_s=(0.0,),
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "replacement", "invariant"),
    [
        ("dimmed", lambda levels, *_: levels, "no more than the limit towards a vehicle"),
        ("dimmed", lambda levels, *_: levels * 0.5, "an LED that shines elsewhere is not dimmed"),
        ("dimmed", lambda levels, *_: np.minimum(levels + 0.01, 1.0), "no LED brightens faster than allowed"),
        ("dimmed", lambda levels, *_: levels * 0.0, "light where nothing is wrong"),
        ("united", lambda gaps, ranges: (gaps + 0.02, ranges), "a gap covers the vehicle"),
    ],
)
def test_the_sweep_finds_what_is_broken(
    monkeypatch: pytest.MonkeyPatch, name: str, replacement: Any, invariant: str
) -> None:
    monkeypatch.setattr(guard_module, name, replacement)
    assert invariant in guard_sweep.sweep(LAMPS, SMALL).counter_examples


@pytest.mark.parametrize(
    ("name", "invariant"),
    [("_motion_faults", "low beam where, and only where, something is wrong")],
)
def test_the_sweep_finds_missing_checks(monkeypatch: pytest.MonkeyPatch, name: str, invariant: str) -> None:
    monkeypatch.setattr(Guard, name, lambda *_: [])
    assert invariant in guard_sweep.sweep(LAMPS, SMALL).counter_examples


# Imports


def test_guard_imports_no_policy() -> None:
    """Whatever the guard's files import of this stage is theirs: no policy, no message, and no other stage."""
    folder = Path(foreglow.beam.__file__).parent
    own, seen = ["guard"], set()
    while own:
        name = own.pop()
        seen.add(name)
        for node in ast.walk(ast.parse((folder / f"{name}.py").read_text(encoding="utf-8"))):
            module = node.module if isinstance(node, ast.ImportFrom) else None
            parts = (module or "").split(".")
            if parts[:2] == ["foreglow", "beam"]:
                own += [parts[2]] if parts[2] not in seen else []
            elif parts[0] == "foreglow":
                assert parts[1] in {"config", "geometry", "rays", "types"}
    assert seen == {
        "guard",
        "faults",
        "camera_watch",
        "image_change",
        "image_damage",
        "image_pieces",
        "image_stripes",
        "known_images",
        "led_bounds",
        "sightlines",
    }


# Light at vehicles


@pytest.mark.parametrize(
    ("range_m", "sigma_m", "limit_cd"),
    [
        (math.nan, math.inf, 150.0),
        (300.0, math.inf, 150.0),
        (8.0, math.inf, 150.0),
        (55.0, 3.0, 150.0),
        (58.0, 3.9, 275.0),
        (100.0, 0.1, 275.0),
        (130.0, 10.0, 1400.0),
        (300.0, 40.0, 5100.0),
        (7.0, 0.1, 150.0),
        (9.0, 0.9, 150.0),
        (12.0, 1.2, 150.0),
    ],
)
def test_light_at_a_vehicle(range_m: float, sigma_m: float, limit_cd: float) -> None:
    tracks = tracks_of([box_around(0.03, -0.004, 0.004)], [range_m], sigmas_m=[sigma_m])
    command = next_check(running(), frame_at(25), tracks)
    assert command.mode == BeamMode.GLARE_FREE
    at_m = [15.0, 40.0, 1000.0] if math.isinf(sigma_m) else [range_m]
    if math.isinf(sigma_m) and not math.isnan(range_m):  # anywhere, and its range above all
        at_m += [4.0, 8.0, 12.0, range_m]
    shone = np.array([towards_cd(command, 0.03, -0.004, one_m) for one_m in at_m])
    assert (shone <= limit_cd).all()
    if not range_m < 15.0:  # nearer, the box alone is as wide as several LEDs' light
        assert shone.max() > (0.1 if math.isinf(sigma_m) else 0.25) * limit_cd
    assert command.levels.max() == 1.0
    right, left = command.gaps_rad[0]
    assert right < 0.03 < left
    _, from_origin_m = from_origin(0.03, range_m)  # as the policy's gaps count, and as documented
    assert command.gap_ranges_m == pytest.approx([from_origin_m], abs=0.01, nan_ok=True)


def test_eyes_are_above_the_lamps() -> None:
    """Half a metre above what shines the limit is kept, too."""
    tracks = tracks_of([box_around(0.0, -0.012, 0.001)], [58.0], sigmas_m=[0.5])
    command = next_check(running(), frame_at(25), tracks)
    assert (towards_cd(command, 0.0, -0.012 + 0.5 / 58.0, 58.0) <= 275.0).all()
    low_eyes = running(guard_config(eyes_above_m=0.0))
    assert (towards_cd(next_check(low_eyes, frame_at(25), tracks), 0.0, -0.012 + 0.5 / 58.0, 58.0) > 275.0).any()


def test_tentative_tracks_and_other_lights_are_not_protected() -> None:
    boxes = [box_around(azimuth, -0.004, 0.004) for azimuth in (-0.1, 0.0, 0.1)]
    states = [TrackState.COASTING, TrackState.TENTATIVE, TrackState.CONFIRMED]
    tracks = tracks_of(boxes, [60.0] * 3, states=states)
    for is_vehicle, dark in ((None, (0, 2)), (np.array([True, True, False]), (0,)), (np.zeros(3, bool), ())):
        command = next_check(running(), frame_at(25), tracks, is_vehicle=is_vehicle)
        shone = [towards_cd(command, azimuth, -0.004, 60.0).max() for azimuth in (-0.1, 0.0, 0.1)]
        assert [span for span in range(3) if shone[span] <= 275.0] == list(dark)
        assert len(command.gaps_rad) == len(dark)
        assert command.mode == (BeamMode.GLARE_FREE if dark else BeamMode.FULL)


def test_gaps_of_the_policy_stay() -> None:
    frame = frame_at(25)
    gaps, ranges_m = np.array([[-0.2, -0.1], [0.02, 0.04]]), np.array([80.0, 300.0])
    wanted = BeamCommand(frame.timestamp_ns, BeamMode.GLARE_FREE, np.ones((2, NUM_LEDS)), gaps, ranges_m)
    alone = running().check(wanted, NOBODY, frame)
    np.testing.assert_array_equal(alone.gaps_rad, gaps)
    np.testing.assert_array_equal(alone.gap_ranges_m, ranges_m)
    both = running().check(wanted, tracks_of([box_around(0.04, -0.004, 0.002)], [70.0]), frame)
    assert both.gap_ranges_m == pytest.approx([80.0, from_origin(0.04, 70.0)[1]], abs=0.01)
    np.testing.assert_array_equal(both.gaps_rad[0], gaps[0])
    assert both.gaps_rad[1, 0] == 0.02
    assert both.gaps_rad[1, 1] > 0.041


def test_what_has_passed_no_longer_changes() -> None:
    """A policy may use its arrays again for the next frame."""
    frame, gaps_rad, ranges_m = frame_at(25), np.array([[-0.1, 0.1]]), np.array([50.0])
    wanted = BeamCommand(frame.timestamp_ns, BeamMode.GLARE_FREE, np.ones((2, NUM_LEDS)), gaps_rad, ranges_m)
    passed = running().check(wanted, NOBODY, frame)
    gaps_rad[:], ranges_m[:] = 0.3, 1.0
    assert passed.gaps_rad.tolist() == [[-0.1, 0.1]]
    assert passed.gap_ranges_m.tolist() == [50.0]


def test_other_camera_other_directions() -> None:
    guard = running()
    tracks = tracks_of([box_around(0.03, -0.004, 0.004)], [100.0])
    before = next_check(guard, frame_at(25), tracks).gaps_rad
    frame = frame_at(26)
    shifted = with_arrays(frame, camera=CAMERA.scaled(1280, 960).scaled(2560, 1920))
    tracks = tracks_of([box_around(0.03, -0.004, 0.004)], [100.0], ages_s=2.0)
    after = guard.check(full(frame, NUM_LEDS), tracks, shifted).gaps_rad
    assert np.degrees(np.abs(after - before)).max() > 1.0


@pytest.mark.parametrize("step_px", [[-900, 0], [900, 0], [0, -900], [0, 900], [5000, 5000]])
def test_boxes_beyond_the_image(step_px: list[float]) -> None:
    """Are taken as at its border: nothing raises, and there is a gap."""
    command = next_check(running(), frame_at(25), tracks_of([AHEAD + np.tile(step_px, 2)], [60.0]))
    assert command.mode == BeamMode.GLARE_FREE
    assert len(command.gaps_rad) == 1


def test_lamps_that_shine_anywhere_are_refused() -> None:
    with pytest.raises(ValueError, match="expected LEDs that shine within 45 degrees to the sides and -10 to 15"):
        Guard(guard_config(), FakeLamps(num_columns=60))


@pytest.mark.parametrize("turned", [rotation(np.pi / 2), rotation(np.pi), rotation(0, -0.8), rotation(0, 1.5)])
def test_lamps_that_shine_where_no_vehicle_is_looked_for_are_refused(turned: Floats) -> None:
    """Such LEDs would never be dimmed, since they are dark at every vehicle and at the edges as well."""
    shipped = read_headlamps()
    left = Headlamp(Pose(shipped.left.vehicle_from_lamp.position_m, turned), shipped.left.matrix)
    with pytest.raises(ValueError, match=r"^lamps: expected LEDs that shine within 45 degrees"):
        Guard(guard_config(), Headlamps("turned", left, shipped.right))


def test_an_led_that_is_dark_wherever_vehicles_are_is_refused() -> None:
    shipped = read_headlamps()
    matrix = shipped.left.matrix
    leds_cd = matrix.leds_cd.copy()
    leds_cd[3] *= 1e-6
    left = Headlamp(shipped.left.vehicle_from_lamp, dataclasses.replace(matrix, leds_cd=leds_cd))
    with pytest.raises(ValueError, match=r"^lamps: LED 3 of the left one: expected at least 1 cd within 45 degrees"):
        Guard(guard_config(), Headlamps("dark", left, shipped.right))


# The two pure parts

small = st.floats(0, 1)


@pytest.mark.slow
@settings(derandomize=True, max_examples=150, deadline=None)
@given(st.data(), st.integers(1, 4), st.integers(1, 6))
def test_dimmed(data: st.DataObject, num_spans: int, num_leds: int) -> None:
    """Within every limit, never brighter, and no darker than the first limit that an LED meets needs."""
    levels = np.array(data.draw(st.lists(small, min_size=2 * num_leds, max_size=2 * num_leds))).reshape(2, num_leds)
    size = num_spans * 2 * num_leds
    bounds = np.array(data.draw(st.lists(st.floats(0, 4e4, width=32), min_size=size, max_size=size)), np.float32)
    bounds = bounds.reshape(num_spans, 2, num_leds)
    limits = np.array(data.draw(st.lists(st.floats(1, 6e3), min_size=num_spans, max_size=num_spans)))
    result = dimmed(levels, bounds, limits)
    sums = (result * bounds).sum(axis=-1)
    assert (sums <= limits[:, np.newaxis] * (1 + 1e-9)).all()
    assert (result <= levels).all()
    assert (result >= 0).all()
    is_dimmed = result < levels
    if num_spans == 1:
        for lamp in range(2):
            if is_dimmed[lamp].any():
                assert sums[0, lamp] == pytest.approx(limits[0], rel=1e-6)
                caps = (result * bounds[0])[lamp][is_dimmed[lamp]]
                np.testing.assert_allclose(caps, caps[0], rtol=1e-6)
                assert (levels * bounds[0])[lamp][~is_dimmed[lamp]].max(initial=0.0) <= caps[0] * (1 + 1e-6)


@settings(derandomize=True, max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.integers(-30, 30), st.integers(1, 9), st.floats(1, 100) | st.just(math.nan)), min_size=1))
def test_united(gaps: list[tuple[int, int, float]]) -> None:
    borders = np.array([[right, right + width] for right, width, _ in gaps], np.float64)
    ranges_m = np.array([range_m for *_, range_m in gaps])
    apart, nearest_m = united(borders, ranges_m)
    assert (np.diff(apart.ravel()) > 0).all()
    for at in np.arange(-31, 41, 0.5):
        covering = (borders[:, 0] <= at) & (at <= borders[:, 1])
        assert ((apart[:, 0] <= at) & (at <= apart[:, 1])).any() == covering.any()
    for (right, left), told_m in zip(apart, nearest_m, strict=True):
        inside = ranges_m[(borders[:, 0] >= right) & (borders[:, 1] <= left)]
        assert told_m == np.min(inside) or (math.isnan(told_m) and np.isnan(inside).any())


# Over time

_steps = st.lists(
    st.tuples(
        st.sampled_from([FRAME_NS] * 6 + [0, -FRAME_NS, 150_000_000, 400_000_000]),  # to the next frame
        st.sampled_from([20.0] * 4 + [9.3, 8.0]),  # speed, m/s
        st.sampled_from([0.0] * 6 + [0.35]),  # age, s
        st.floats(0, 1),  # wanted
        st.booleans(),  # a track
    ),
    min_size=2,
    max_size=30,
)


def test_the_mode_says_what_shines() -> None:
    """Light returns from 0: low beam, then LEDs on their way, then full beam."""
    guard, modes = Guard(guard_config(), LAMPS), []
    for number in range(25):
        command = next_check(guard, frame_at(number))
        assert command.faults == ()
        assert command.mode == guard_sweep.mode_of(command)
        modes.append(command.mode)
    assert [mode for mode, _ in itertools.groupby(modes)] == [BeamMode.LOW, BeamMode.GLARE_FREE, BeamMode.FULL]


@pytest.mark.parametrize("speed_mps", [151.0, -151.0, 1e6])
def test_no_speed_of_a_car_is_no_speed(speed_mps: float) -> None:
    frame = frame_at(0, speed_mps=speed_mps)
    command = Guard(guard_config(), LAMPS).check(full(frame, NUM_LEDS), NOBODY, frame)
    assert_low(command, "speed_unknown")


@pytest.mark.slow
@settings(derandomize=True, max_examples=60, deadline=None)
@given(_steps)
def test_over_time(steps: list[tuple[int, float, float, float, bool]]) -> None:
    guard, frame_ns, levels = Guard(guard_config(), LAMPS), 10**10, np.zeros((2, NUM_LEDS))
    latest_ns, is_fast, track = -math.inf, False, box_around(0.0, -0.003, 0.003)
    for number, (step_ns, speed_mps, age_s, level, has_track) in enumerate(steps):
        frame_ns += step_ns
        frame = frame_at(number, speed_mps=speed_mps, timestamp_ns=frame_ns)
        tracks = tracks_of([track], [60.0], sigmas_m=[1.0], ages_s=number + 1.0) if has_track else NOBODY
        now_ns = frame_ns + round(age_s * 1e9)
        command = guard.check(full(frame, NUM_LEDS, level), tracks, frame, time_ns=now_ns)
        is_fast = speed_mps >= (32 / 3.6 if is_fast else 35 / 3.6)
        is_timely = number == 0 or 0 < step_ns <= 200_000_000
        if not (is_fast and is_timely and age_s <= 0.3 and now_ns >= latest_ns):
            assert_low(command, *command.faults)
            assert command.faults
        else:
            assert command.faults == ()
            elapsed_s = 0.0 if number == 0 else step_ns / 1e9
            allowed = np.minimum(level, levels + elapsed_s)
            assert (command.levels <= allowed + 1e-12).all()
            if has_track:
                assert (towards_cd(command, 0.0, -0.003, 60.0) <= 275.0).all()
            else:
                np.testing.assert_allclose(command.levels, allowed)
        levels, latest_ns = command.levels, now_ns
