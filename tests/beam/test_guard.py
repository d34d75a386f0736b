"""The guard: its invariants over a sweep of states, over time, and from each fault to low beam at the lamps."""

from __future__ import annotations

import ast
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
from foreglow.beam.faults import GuardFault
from foreglow.beam.guard import Guard, dimmed, united
from foreglow.config import GuardConfig
from foreglow.types import BeamCommand, BeamMode, Frame, Tracks, TrackState
from tests.beam.made_up import CAMERA, FRAME_NS, IMAGES, FakeLamps, box_around, frame_at, full, guard_config, tracks_of

LAMPS = FakeLamps()
NUM_LEDS = LAMPS.num_leds
NOBODY = tracks_of([], [])
AHEAD = box_around(0.02, -0.005, 0.01)


def running(config: GuardConfig | None = None, *, num_frames: int = 25) -> Guard:
    """A guard that has let full beam through, up to frame `num_frames - 1`."""
    guard = Guard(config or guard_config(), LAMPS)
    for number in range(num_frames):
        frame = frame_at(number)
        guard.check(full(frame, NUM_LEDS), NOBODY, frame)
    return guard


def next_check(guard: Guard, frame: Frame, tracks: Tracks | None = NOBODY, **more: Any) -> BeamCommand:
    return guard.check(full(frame, NUM_LEDS), tracks, frame, **more)


def assert_low(command: BeamCommand, *faults: str) -> None:
    assert command.mode == BeamMode.LOW
    assert not command.levels.any()
    assert command.faults == faults


def with_arrays(thing: Any, **arrays: Any) -> Any:
    """`thing` with other values that its own check would not take, as after a bit flip."""
    for name, value in arrays.items():
        object.__setattr__(thing, name, value)
    return thing


# The sweep


def test_no_counter_example_in_the_sweep() -> None:
    outcome = guard_sweep.sweep(LAMPS, guard_sweep.QUICK)
    assert outcome.num_states > 10_000
    assert outcome.num_lit > 800
    assert outcome.counter_examples == {}


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
    assert seen == {"guard", "faults", "camera_watch", "led_bounds", "sightlines"}


# Faults one by one


def test_full_beam_without_anyone() -> None:
    guard = running()
    command = next_check(guard, frame_at(25))
    assert command.mode == BeamMode.FULL
    assert command.timestamp_ns == 25 * FRAME_NS
    assert (command.levels == 1).all()
    assert (command.faults, len(command.gaps_rad)) == ((), 0)


def test_begins_low_and_brightens_at_the_rate() -> None:
    guard = Guard(guard_config(brightening_s=0.5), LAMPS)
    levels = [next_check(guard, frame_at(number)).levels for number in range(12)]
    for number, level in enumerate(levels):
        np.testing.assert_allclose(level, min(1.0, number * FRAME_NS / 0.5e9))


def test_dims_at_once_and_returns_slowly() -> None:
    guard = running()
    frame = frame_at(25)
    dim = guard.check(full(frame, NUM_LEDS, 0.2), NOBODY, frame)
    assert (dim.levels == 0.2).all()
    back = next_check(guard, frame_at(26))
    np.testing.assert_allclose(back.levels, 0.2 + FRAME_NS / 1e9)


def test_low_beam_that_is_wanted_is_no_fault() -> None:
    guard, frame = running(), frame_at(25)
    assert_low(guard.check(BeamCommand.low(frame.timestamp_ns, NUM_LEDS), NOBODY, frame))
    np.testing.assert_allclose(next_check(guard, frame_at(26)).levels, FRAME_NS / 1e9)


def test_after_any_fault_light_returns_from_low_beam() -> None:
    guard = running()
    assert_low(next_check(guard, frame_at(25), pipeline_faults=("classifier", "mine")), "classifier", "mine")
    np.testing.assert_allclose(next_check(guard, frame_at(26)).levels, FRAME_NS / 1e9)


@pytest.mark.parametrize(
    ("age_ms", "is_low"), [(0, False), (300, False), (300.000001, True), (2000, True), (-0.000001, True)]
)
def test_age_of_the_image(age_ms: float, is_low: bool) -> None:
    guard, frame = running(), frame_at(25)
    command = next_check(guard, frame, time_ns=frame.timestamp_ns + round(age_ms * 1e6))
    assert command.faults == ((GuardFault.TOO_OLD,) if is_low else ())


def test_clock_that_goes_back() -> None:
    guard = running()
    frame = frame_at(25)
    next_check(guard, frame, time_ns=frame.timestamp_ns + 200_000_000)
    frame = frame_at(26)
    assert_low(next_check(guard, frame, time_ns=frame.timestamp_ns + 50_000_000), GuardFault.TIME)
    frame = frame_at(27)
    assert not next_check(guard, frame, time_ns=frame.timestamp_ns + 50_000_000).faults


def test_same_clock_twice_is_allowed() -> None:
    guard = running()
    first, second = frame_at(25), frame_at(26)
    for frame in (first, second):
        assert not next_check(guard, frame, time_ns=second.timestamp_ns).faults


def test_frame_that_goes_back() -> None:
    guard = running()
    assert_low(next_check(guard, frame_at(23), time_ns=25 * FRAME_NS), GuardFault.TIME)
    assert not next_check(guard, frame_at(24), time_ns=25 * FRAME_NS).faults


@pytest.mark.parametrize(("gap_ms", "is_low"), [(200, False), (200.001, True), (3000, True)])
def test_missing_frames(gap_ms: float, is_low: bool) -> None:
    guard = running()
    frame = frame_at(25, timestamp_ns=24 * FRAME_NS + round(gap_ms * 1e6))
    assert next_check(guard, frame).faults == ((GuardFault.GAP,) if is_low else ())


def test_same_time_again() -> None:
    guard = running()
    assert_low(next_check(guard, frame_at(25, timestamp_ns=24 * FRAME_NS)), GuardFault.FROZEN)


@pytest.mark.parametrize("most", [1, 2, 3])
def test_same_image_again(most: int) -> None:
    guard = running(guard_config(max_same_images=most))
    faults = [next_check(guard, frame_at(number, image=IMAGES[25 % 3])).faults for number in range(25, 31)]
    assert faults == [()] * most + [(GuardFault.FROZEN,)] * (6 - most)
    assert not next_check(guard, frame_at(31, image=IMAGES[0])).faults


@pytest.mark.parametrize(("share", "is_low"), [(0.2, False), (0.3, True), (1.0, True)])
def test_saturated_image(share: float, is_low: bool) -> None:
    image = IMAGES[1].copy()
    image[: round(960 * share)] = 255
    assert next_check(running(), frame_at(25, image=image)).faults == ((GuardFault.SATURATED,) if is_low else ())


@pytest.mark.parametrize(
    ("white_level", "value", "faults"),
    [
        (None, 4095, ()),
        (4095, 4095, (GuardFault.SATURATED,)),
        (4095, 4094, ()),
        (None, 3276, (GuardFault.BLACK,)),
        (None, 3277, ()),
        (4095, 204, (GuardFault.BLACK,)),
        (4095, 205, ()),
        (None, 65535, (GuardFault.SATURATED,)),
    ],
)
def test_white_and_black_of_12_and_16_bits(white_level: int | None, value: int, faults: tuple[str, ...]) -> None:
    guard = running(guard_config(white_level=white_level))
    image = np.full((48, 64), value, np.uint16)
    frame = Frame(image, 25 * FRAME_NS, camera=CAMERA.scaled(64, 48), motion=frame_at(25).motion)
    assert next_check(guard, frame).faults == faults


def test_black_image() -> None:
    assert_low(next_check(running(), frame_at(25, image=np.full((960, 1280), 12, np.uint8))), GuardFault.BLACK)
    assert not next_check(running(), frame_at(25, image=np.full((960, 1280), 13, np.uint8))).faults


@pytest.mark.parametrize("size", [(1, 1), (3, 2), (960, 1)])
def test_images_of_any_size(size: tuple[int, int]) -> None:
    image = np.full(size, 100, np.uint8)
    frame = Frame(image, 25 * FRAME_NS, camera=CAMERA.scaled(size[1], size[0]), motion=frame_at(25).motion)
    assert not next_check(running(), frame, tracks_of([AHEAD], [50.0])).faults


def test_any_sampled_part_of_the_image_is_looked_at() -> None:
    """A frozen camera is none where one block of the image moves."""
    guard = running()
    for number in range(25, 29):
        image = IMAGES[0].copy()
        image[-64:, -64:] = number
        assert not next_check(guard, frame_at(number, image=image)).faults


def test_no_camera() -> None:
    assert_low(next_check(running(), frame_at(25, with_camera=False)), GuardFault.NO_CAMERA)


def test_unknown_speed() -> None:
    assert_low(next_check(running(), frame_at(25, speed_mps=None)), GuardFault.NO_SPEED)
    guard = running(guard_config(needs_speed=False))
    assert not next_check(guard, frame_at(25, speed_mps=None)).faults
    broken = with_arrays(frame_at(25), motion=with_arrays(frame_at(25).motion, speed_mps=math.nan))
    assert_low(next_check(running(), broken), GuardFault.NO_SPEED)


def test_speed_with_hysteresis() -> None:
    """Off below 32 km/h, on from 35 km/h."""
    guard = Guard(guard_config(), LAMPS)
    speeds_kmh = [33, 34.99, 35, 33, 32.01, 31.99, 33, 34.99, 35.01, -40]
    slow = [next_check(guard, frame_at(n, speed_mps=kmh / 3.6)).faults != () for n, kmh in enumerate(speeds_kmh)]
    assert slow == [True, True, False, False, False, True, True, True, False, True]


def test_hysteresis_after_an_unknown_speed() -> None:
    guard = running()
    next_check(guard, frame_at(25, speed_mps=None))
    assert_low(next_check(guard, frame_at(26, speed_mps=33 / 3.6)), GuardFault.TOO_SLOW)


def test_no_tracks() -> None:
    guard = running()
    assert_low(next_check(guard, frame_at(25), None), GuardFault.NO_TRACKS)
    assert not next_check(guard, frame_at(26), tracks_of([AHEAD], [50.0], ages_s=0.1)).faults


@pytest.mark.parametrize("name", ["boxes_xyxy_px", "confidences", "ages_s"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_tracks_that_are_not_finite(name: str, value: float) -> None:
    tracks = tracks_of([AHEAD, AHEAD + 50], [50.0, 60.0])
    broken = getattr(tracks, name).copy()
    broken[1] = value
    command = next_check(running(), frame_at(25), with_arrays(tracks, **{name: broken}))
    assert_low(command, *command.faults)
    assert command.faults[0] == GuardFault.BAD_TRACKS


@pytest.mark.parametrize("is_vehicle", [np.array([True]), np.zeros((2, 1), bool), np.array([1, 1])])
def test_wrong_word_on_what_is_a_vehicle(is_vehicle: Any) -> None:
    tracks = tracks_of([AHEAD, AHEAD + 50], [50.0, 60.0])
    assert_low(next_check(running(), frame_at(25), tracks, is_vehicle=is_vehicle), GuardFault.BAD_TRACKS)


def test_tracks_that_do_not_age() -> None:
    guard = running()
    assert not next_check(guard, frame_at(25), tracks_of([AHEAD], [50.0], ages_s=1.0)).faults
    assert_low(next_check(guard, frame_at(26), tracks_of([AHEAD], [50.0], ages_s=1.0)), GuardFault.STALE_TRACKS)
    assert_low(next_check(guard, frame_at(27), tracks_of([AHEAD], [50.0], ages_s=0.9)), GuardFault.STALE_TRACKS)
    assert not next_check(guard, frame_at(28), tracks_of([AHEAD], [50.0], ages_s=1.1)).faults
    assert not next_check(guard, frame_at(29), tracks_of([AHEAD], [50.0], ages_s=0.1, first_id=7)).faults


def test_a_frame_that_came_twice_has_no_stale_tracks() -> None:
    guard, tracks = running(), tracks_of([AHEAD], [50.0])
    next_check(guard, frame_at(25), tracks)
    assert_low(next_check(guard, frame_at(26, timestamp_ns=25 * FRAME_NS), tracks), GuardFault.FROZEN)


def test_one_stale_track_of_several() -> None:
    guard = running()
    next_check(guard, frame_at(25), tracks_of([AHEAD, AHEAD + 50], [50.0, 60.0], ages_s=1.0))
    half = tracks_of([AHEAD, AHEAD + 50], [50.0, 60.0], ages_s=1.1)
    half = with_arrays(half, ages_s=np.array([1.1, 1.0]))
    assert_low(next_check(guard, frame_at(26), half), GuardFault.STALE_TRACKS)


@pytest.mark.parametrize("value", [math.nan, -0.001, 1.001, math.inf])
def test_levels_that_are_none(value: float) -> None:
    frame = frame_at(25)
    levels = np.full((2, NUM_LEDS), 0.5)
    levels[1, 3] = value
    wanted = with_arrays(full(frame, NUM_LEDS), levels=levels)
    assert_low(running().check(wanted, NOBODY, frame), GuardFault.BAD_COMMAND)


@pytest.mark.parametrize("shape", [(2, NUM_LEDS + 1), (1, NUM_LEDS), (2, 1), (2, NUM_LEDS, 1), (2 * NUM_LEDS,)])
def test_levels_of_another_lamp(shape: tuple[int, ...]) -> None:
    frame = frame_at(25)
    wanted = with_arrays(full(frame, NUM_LEDS), levels=np.ones(shape))
    assert_low(running().check(wanted, NOBODY, frame), GuardFault.BAD_COMMAND)


@pytest.mark.parametrize("gaps", [[[0.2, 0.1]], [[0.1, 0.1]], [[0.1, math.nan]], [[0.1, math.inf]], [[0, 3], [2, 4]]])
def test_gaps_that_are_none(gaps: Any) -> None:
    frame = frame_at(25)
    wanted = with_arrays(full(frame, NUM_LEDS), gaps_rad=np.array(gaps, float), gap_ranges_m=np.ones(len(gaps)))
    assert_low(running().check(wanted, NOBODY, frame), GuardFault.BAD_COMMAND)


@pytest.mark.parametrize("arrays", [{"levels": np.eye(2, NUM_LEDS)}, {"gaps_rad": np.array([[0.1, 0.2]])}])
def test_light_with_low_beam(arrays: Any) -> None:
    frame = frame_at(25)
    wanted = with_arrays(BeamCommand.low(frame.timestamp_ns, NUM_LEDS), **arrays)
    assert_low(running().check(wanted, NOBODY, frame), GuardFault.BAD_COMMAND)


def test_command_of_another_frame() -> None:
    frame = frame_at(25)
    assert_low(running().check(full(frame_at(24), NUM_LEDS), NOBODY, frame), GuardFault.STALE_COMMAND)


def test_several_faults_have_all_their_names() -> None:
    frame = frame_at(25, image=np.zeros((960, 1280), np.uint8), speed_mps=1.0, with_camera=False)
    command = next_check(running(), frame, None, time_ns=30 * 10**9, pipeline_faults=("x",))
    assert_low(command, "x", "image_too_old", "image_black", "no_camera", "too_slow", "no_tracks")


def test_reset() -> None:
    guard = running()
    next_check(guard, frame_at(25), tracks_of([AHEAD], [50.0], ages_s=9.0))
    guard.reset()
    first = next_check(guard, frame_at(25, timestamp_ns=5), tracks_of([AHEAD], [50.0], ages_s=0.1))
    assert not first.faults
    assert not first.levels.any()
    assert not next_check(guard, frame_at(25, timestamp_ns=6), tracks_of([AHEAD], [50.0], ages_s=0.2)).faults
    guard.reset()
    frame = frame_at(25, timestamp_ns=6, speed_mps=9.0)  # the third time the same image
    assert_low(next_check(guard, frame), GuardFault.TOO_SLOW)
    guard.reset()
    assert not next_check(guard, frame_at(26, timestamp_ns=6)).faults


# Light at vehicles


def towards_cd(command: BeamCommand, azimuth_rad: float, elevation_rad: float, range_m: float) -> Any:
    """What the LEDs of each lamp shine at a point seen from the camera in a direction of the vehicle's frame."""
    ray = np.array([np.cos(azimuth_rad) * np.cos(elevation_rad), np.sin(azimuth_rad) * np.cos(elevation_rad), 0.0])
    ray[2] = np.sin(elevation_rad)
    point = CAMERA.vehicle_from_camera.position_m + range_m * ray
    shone = []
    for place, lamp in enumerate((LAMPS.left, LAMPS.right)):
        seen = point - lamp.vehicle_from_lamp.position_m
        shone.append(float(LAMPS.intensities_cd(seen[np.newaxis])[1][0, place] @ command.levels[place]))
    return np.array(shone)


@pytest.mark.parametrize(
    ("range_m", "sigma_m", "limit_cd"),
    [
        (math.nan, math.inf, 150.0),
        (300.0, math.inf, 150.0),
        (55.0, 3.0, 150.0),
        (58.0, 3.9, 275.0),
        (100.0, 0.1, 275.0),
        (130.0, 10.0, 1400.0),
        (300.0, 40.0, 5100.0),
        (7.0, 0.1, 150.0),
    ],
)
def test_light_at_a_vehicle(range_m: float, sigma_m: float, limit_cd: float) -> None:
    tracks = tracks_of([box_around(0.03, -0.004, 0.004)], [range_m], sigmas_m=[sigma_m])
    command = next_check(running(), frame_at(25), tracks)
    assert command.mode == BeamMode.GLARE_FREE
    at_m = [15.0, 40.0, 1000.0] if math.isinf(sigma_m) else [max(range_m, 15.0)]
    shone = np.array([towards_cd(command, 0.03, -0.004, one_m) for one_m in at_m])
    assert (shone <= limit_cd).all()
    assert shone.max() > (0.1 if math.isinf(sigma_m) else 0.25) * limit_cd
    assert command.levels.max() == 1.0
    right, left = command.gaps_rad[0]
    assert right < 0.03 < left
    np.testing.assert_array_equal(command.gap_ranges_m, [range_m])


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
        assert [place for place in range(3) if shone[place] <= 275.0] == list(dark)
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
    np.testing.assert_array_equal(both.gap_ranges_m, [80.0, 70.0])
    np.testing.assert_array_equal(both.gaps_rad[0], gaps[0])
    assert both.gaps_rad[1, 0] == 0.02
    assert both.gaps_rad[1, 1] > 0.041


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


# The two pure parts

small = st.floats(0, 1)


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
