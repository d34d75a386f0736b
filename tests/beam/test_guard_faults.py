"""Each fault by itself: what the guard notices, and that it means low beam."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from foreglow.beam.faults import GuardFault
from foreglow.beam.guard import Guard
from foreglow.types import BeamCommand, BeamMode, EgoMotion, Frame
from tests.beam.guards import AHEAD, LAMPS, NOBODY, NUM_LEDS, assert_low, next_check, running, with_arrays
from tests.beam.made_up import CAMERA, FRAME_NS, IMAGES, frame_at, full, guard_config, tracks_of


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


@pytest.mark.parametrize("step_ns", [1, 999_999])
def test_images_that_no_camera_takes_so_soon(step_ns: int) -> None:
    guard = running()
    next_check(guard, frame_at(25))
    again = frame_at(26, timestamp_ns=frame_at(25).timestamp_ns + step_ns)
    assert_low(next_check(guard, again), GuardFault.FROZEN)


@pytest.mark.parametrize("motion", [EgoMotion(30.0, 50.0), EgoMotion(30.0, -3.1), EgoMotion(160.0, 0.0)])
def test_motion_that_is_not_one_of_a_car(motion: EgoMotion) -> None:
    frame = dataclasses.replace(frame_at(25), motion=motion)
    assert_low(next_check(running(), frame), GuardFault.NO_SPEED)


def test_same_clock_twice_is_allowed() -> None:
    guard = running()
    first, second = frame_at(25), frame_at(26)
    for frame in (first, second):
        assert not next_check(guard, frame, time_ns=second.timestamp_ns).faults


def test_frame_that_goes_back() -> None:
    guard = running()
    assert_low(next_check(guard, frame_at(23, image=IMAGES[30]), time_ns=25 * FRAME_NS), GuardFault.TIME)
    assert not next_check(guard, frame_at(24, image=IMAGES[31]), time_ns=25 * FRAME_NS).faults


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
    faults = [next_check(guard, frame_at(number, image=IMAGES[25 % len(IMAGES)])).faults for number in range(25, 31)]
    assert faults == [()] * most + [(GuardFault.FROZEN,)] * (6 - most)
    assert not next_check(guard, frame_at(31)).faults


@pytest.mark.parametrize(
    ("share", "fault"), [(0.2, GuardFault.DAMAGED), (0.3, GuardFault.SATURATED), (1.0, GuardFault.SATURATED)]
)
def test_saturated_image(share: float, fault: GuardFault) -> None:
    """A part that is suddenly white may be filled."""
    image = IMAGES[1].copy()
    image[: round(955 * share)] = 255  # off the grid of encoders
    assert next_check(running(), frame_at(25, image=image)).faults == (fault,)


@pytest.mark.parametrize(
    ("white_level", "value", "faults"),
    [
        (None, 4095, (GuardFault.SATURATED, GuardFault.BLACK)),  # of 12 bits, perhaps
        (None, 3685, (GuardFault.BLACK,)),
        (None, 4096, (GuardFault.BLACK,)),
        (None, 16383, (GuardFault.SATURATED, GuardFault.BLACK)),  # of 14 bits, perhaps
        (None, 16384, ()),
        (16383, 4096, ()),
        (None, 940, (GuardFault.SATURATED, GuardFault.BLACK)),
        (4095, 4095, (GuardFault.SATURATED,)),
        (4095, 4080, (GuardFault.SATURATED,)),  # a camera that clips a little below
        (4095, 3685, ()),
        (None, 3276, (GuardFault.BLACK,)),
        (4095, 204, (GuardFault.BLACK,)),
        (4095, 205, ()),
        (None, 65535, (GuardFault.SATURATED,)),
    ],
)
def test_white_and_black_of_12_to_16_bits(white_level: int | None, value: int, faults: tuple[str, ...]) -> None:
    guard = running(guard_config(white_level=white_level))
    image = np.full((48, 64), value, np.uint16)
    image[:6] = 0  # for contrast
    frame = Frame(image, 25 * FRAME_NS, camera=CAMERA.scaled(64, 48), motion=frame_at(25).motion)
    assert next_check(guard, frame).faults == (GuardFault.RESIZED, *faults)


def test_images_of_fewer_bits_than_white_has_are_black() -> None:
    """They are not those of the camera that is described, or have lost their lower bits."""
    assert_low(next_check(running(guard_config(white_level=4095)), frame_at(25)), GuardFault.BLACK)


def test_black_image() -> None:
    dark = IMAGES[0] % 3
    dark[:475, :300] += 10  # off the grid of encoders; not whole rows, as noise is
    assert_low(next_check(running(), frame_at(25, image=dark)), GuardFault.BLACK)
    assert not next_check(running(), frame_at(25, image=dark + (dark == 12))).faults


@pytest.mark.parametrize("size", [(1, 1), (3, 2), (960, 1)])
def test_images_of_any_size(size: tuple[int, int]) -> None:
    image = np.full(size, 100, np.uint8)
    frame = Frame(image, 25 * FRAME_NS, camera=CAMERA.scaled(size[1], size[0]), motion=frame_at(25).motion)
    assert_low(next_check(running(), frame, tracks_of([AHEAD], [50.0])), GuardFault.RESIZED, GuardFault.BLACK)


def test_a_camera_is_not_frozen_where_one_block_of_the_image_moves() -> None:
    guard = running()
    for number in range(25, 29):
        image = IMAGES[0].copy()
        image[448:512, -64:] = 9 * number
        assert GuardFault.FROZEN not in next_check(guard, frame_at(number, image=image)).faults


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


def test_an_unknown_speed_ends_no_slowness() -> None:
    """Where it counts as high enough, low beam stays until 35 km/h are known again."""
    guard = Guard(guard_config(needs_speed=False), LAMPS)
    speeds_mps = [5.0, None, 33 / 3.6, 36 / 3.6, None, 33 / 3.6]
    slow = [next_check(guard, frame_at(n, speed_mps=speed)).faults != () for n, speed in enumerate(speeds_mps)]
    assert slow == [True, False, True, False, False, False]


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


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_a_fault_of_the_policy(level: float) -> None:
    """A policy may know of one that nobody else sees, and still give levels with it."""
    frame = frame_at(25)
    guard = running()
    wanted = dataclasses.replace(full(frame, NUM_LEDS, level), faults=("map_lost",))
    assert_low(guard.check(wanted, NOBODY, frame, pipeline_faults=("x",)), "x", "map_lost")
    np.testing.assert_allclose(next_check(guard, frame_at(26)).levels, FRAME_NS / 1e9)


def test_several_faults_have_all_their_names() -> None:
    frame = frame_at(25, image=np.zeros((960, 1280), np.uint8), speed_mps=1.0, with_camera=False)
    command = next_check(running(), frame, None, time_ns=30 * 10**9, pipeline_faults=("x",))
    assert_low(command, "x", "image_too_old", "image_black", "no_camera", "too_slow", "no_tracks")


@pytest.mark.parametrize("time_ns", [-(10**400), -(2**63), 0, 2**63, 10**400])
@pytest.mark.parametrize("is_vehicle", [None, np.zeros(0, np.bool_), np.ones(3), np.array(["x"]), np.zeros((2, 2))])
@pytest.mark.parametrize("names", [(), ("",), ["\udcff" * 1000], [str(number) for number in range(1000)]])
def test_no_value_raises(time_ns: int, is_vehicle: Any, names: Any) -> None:
    frame = frame_at(25)
    command = next_check(running(), frame, time_ns=time_ns, is_vehicle=is_vehicle, pipeline_faults=names)
    assert command.mode == BeamMode.LOW
    assert GuardFault.TOO_OLD in command.faults
    assert (GuardFault.BAD_TRACKS in command.faults) == (is_vehicle is not None and len(is_vehicle) > 0)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("is_vehicle", value) for value in ([False], False, ())),
        *(("wanted", value) for value in (None, BeamMode.LOW, "low")),
        *(("pipeline_faults", value) for value in (None, "fault", 3, [None])),
        *(("tracks", value) for value in (False, "none")),
        *(("frame", value) for value in (None, np.zeros((960, 1280), np.uint8))),
        *(("time_ns", value) for value in (True, 1.5, "now")),
    ],
)
def test_an_argument_of_another_type_is_named(name: str, value: Any) -> None:
    guard, frame = running(), frame_at(25)
    right: dict[str, Any] = {"wanted": full(frame, NUM_LEDS), "tracks": NOBODY, "frame": frame}
    with pytest.raises(ValueError, match=rf"^{name}: expected "):
        guard.check(**right | {name: value})
    assert not guard.check(**right).faults  # it remembers nothing of it


def test_reset() -> None:
    guard = running()
    next_check(guard, frame_at(25), tracks_of([AHEAD], [50.0], ages_s=9.0))
    guard.reset()
    first = next_check(guard, frame_at(25, timestamp_ns=5), tracks_of([AHEAD], [50.0], ages_s=0.1))
    assert not first.faults
    assert not first.levels.any()
    assert not next_check(guard, frame_at(25, timestamp_ns=5 + FRAME_NS), tracks_of([AHEAD], [50.0], ages_s=0.2)).faults
    guard.reset()
    frame = frame_at(25, timestamp_ns=6, speed_mps=9.0)  # the third time the same image
    assert_low(next_check(guard, frame), GuardFault.TOO_SLOW)
    guard.reset()
    assert not next_check(guard, frame_at(26, timestamp_ns=6)).faults
