"""Commands that are not valid or not fresh: what the lamps take, and what ends in low beam."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from foreglow.beam.messages import CanFrame, LinkFault, encode_levels
from foreglow.beam.receiver import LampReceiver, ReceiverConfig
from foreglow.photometry import NUM_LEDS
from foreglow.types import BeamCommand, BeamMode
from tests.beam.lamps import (
    DEADLINE,
    MS,
    PERIOD,
    START,
    arrival,
    brightness,
    feed,
    frames_of,
    is_dark_by,
    only_gaps,
    other_frames,
    running,
)


def repeated(_: int) -> Sequence[CanFrame]:
    return frames_of(9)


def same_counter(number: int) -> Sequence[CanFrame]:
    return frames_of(number, counter=259)


def same_image(number: int) -> Sequence[CanFrame]:
    return frames_of(number, image=9)


def older_images(number: int) -> Sequence[CanFrame]:
    return frames_of(number, image=number - 4)


def backwards(number: int) -> Sequence[CanFrame]:
    return frames_of(19 - number)


def corrupted(number: int) -> Sequence[CanFrame]:
    return [CanFrame(frame_id, data[:-1] + bytes([data[-1] ^ 1])) for frame_id, data in frames_of(number)]


def cut(number: int) -> Sequence[CanFrame]:
    return [CanFrame(frame_id, data[:-1]) for frame_id, data in frames_of(number)]


@pytest.mark.parametrize(
    ("frames", "fault"),
    [
        (repeated, LinkFault.REPEATED),
        (same_counter, LinkFault.REPEATED),
        (same_image, LinkFault.STALE),
        (backwards, LinkFault.DISORDER),
        (corrupted, LinkFault.CRC),
        (cut, LinkFault.LENGTH),
        (only_gaps, LinkFault.TIMEOUT),
        (other_frames, LinkFault.TIMEOUT),
    ],
)
@pytest.mark.parametrize("has_clock", [True, False])
def test_what_is_not_valid_and_fresh_ends_in_low_beam(frames: object, fault: LinkFault, has_clock: bool) -> None:
    config = ReceiverConfig() if has_clock else ReceiverConfig(max_age_s=None)
    receiver = running(config=config)
    assert callable(frames)
    for number in range(10, 19):
        if arrival(number) > arrival(9) + DEADLINE:
            break
        feed(receiver, frames(number), arrival(number))
        assert brightness(receiver, arrival(number)) == 1
    assert is_dark_by(receiver, arrival(9))
    assert {fault, LinkFault.TIMEOUT} <= set(receiver.shining(arrival(14))[1])
    for number in range(14, 18):
        feed(receiver, frames(number), arrival(number))
        assert brightness(receiver, arrival(number)) == 0


def test_a_replay_of_old_images() -> None:
    """New counters with images of four periods ago: stale at first, and later never newer than what was shone."""
    receiver = running(config=ReceiverConfig(max_age_s=None))
    for number in range(10, 13):
        feed(receiver, older_images(number), arrival(number))
    assert is_dark_by(receiver, arrival(9))
    assert receiver.noticed[LinkFault.STALE] == 3


@pytest.mark.parametrize(("step", "fault"), [(100, LinkFault.LOST), (127, LinkFault.LOST), (128, LinkFault.DISORDER)])
def test_half_of_the_counters_are_ahead(step: int, fault: LinkFault) -> None:
    receiver = running()
    feed(receiver, frames_of(10, counter=259 + step, level=0.2), arrival(10))
    assert brightness(receiver, arrival(10)) == 1
    assert receiver.noticed == {fault: 1}
    receiver = running()
    feed(receiver, (*frames_of(10)[:1], *frames_of(11, counter=260 + step)), arrival(11))
    # Ahead of what is being collected it begins anew; whole, it is a step further from the command before.
    whole = LinkFault.LOST if step == 100 else LinkFault.DISORDER
    assert receiver.noticed == ({LinkFault.DISORDER: 4} if step == 128 else {LinkFault.TORN: 1, whole: 1})


@pytest.mark.parametrize(
    ("newer_ms", "is_fresh"), [(0, False), (1, True), (25_000, True), (32_767, True), (32_768, False), (65_535, False)]
)
def test_half_of_the_times_are_newer(newer_ms: int, is_fresh: bool) -> None:
    receiver = running(config=ReceiverConfig(max_age_s=None))
    time_ns = START + 9 * PERIOD + newer_ms * MS
    command = BeamCommand(time_ns, BeamMode.FULL, np.full((2, NUM_LEDS), 0.2))
    feed(receiver, encode_levels(command, 260 % 256), arrival(10))
    assert (brightness(receiver, arrival(10)) < 1) == is_fresh
    assert receiver.noticed == ({} if is_fresh else {LinkFault.STALE: 1})


def test_a_fresh_command_after_stale_ones_is_taken_at_once() -> None:
    """Their counter goes on, so that nothing is lost; their time does not."""
    receiver = running()
    for number in range(5):
        feed(receiver, frames_of(10 + number, image=7), arrival(9) + 20 * (number + 1) * MS)
    feed(receiver, frames_of(15, image=9), arrival(9) + 120 * MS)  # newer than those, but not than the latest good one
    assert brightness(receiver, arrival(9) + 120 * MS) == 1
    feed(receiver, frames_of(16, image=10, level=0.2), arrival(9) + 140 * MS)
    assert brightness(receiver, arrival(9) + 140 * MS) == pytest.approx(0.2, abs=1 / 255)
    assert receiver.noticed == {LinkFault.STALE: 6}


def test_the_next_command_after_an_older_one_is_taken() -> None:
    receiver = running()
    feed(receiver, frames_of(5), arrival(9) + 10 * MS)
    feed(receiver, frames_of(10, level=0.2), arrival(10))
    assert brightness(receiver, arrival(10)) == pytest.approx(0.2, abs=1 / 255)
    assert receiver.noticed == {LinkFault.DISORDER: 1}


@pytest.mark.parametrize("num_images", [1, 2, 3])
def test_images_in_a_circle_never_recover(num_images: int) -> None:
    receiver = LampReceiver(ReceiverConfig(max_age_s=None))
    for number in range(200):
        feed(receiver, frames_of(number, image=number % num_images), arrival(number))
        assert brightness(receiver, arrival(number)) == 0


def test_late_commands() -> None:
    """300 ms are young enough, 301 are not; nor is one of the future."""
    for delay_ms, is_taken in ((0, True), (300, True), (301, False), (60_000, False), (-1, False)):
        receiver = LampReceiver()
        for number in range(10):
            feed(receiver, frames_of(number), START + number * PERIOD + delay_ms * MS)
        end_ns = START + 9 * PERIOD + delay_ms * MS
        assert brightness(receiver, end_ns) == is_taken
        assert receiver.noticed == ({} if is_taken else {LinkFault.LATE: 10})


def test_commands_that_grow_late() -> None:
    receiver = running()
    for number in range(10, 30):
        arrival_ns = START + number * PERIOD + (20 + 40 * (number - 9)) * MS
        feed(receiver, frames_of(number), arrival_ns)
    assert brightness(receiver, arrival_ns) == 0
    assert receiver.noticed[LinkFault.LATE] > 9


def test_without_a_common_clock_age_does_not_count() -> None:
    receiver = LampReceiver(ReceiverConfig(max_age_s=None))
    for number in range(5):
        feed(receiver, frames_of(number), arrival(number) + 7_777_777 * MS)
    assert not receiver.is_low
