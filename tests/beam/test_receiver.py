"""The lamps' end: what is not valid and fresh is noticed, and ends in low beam within the deadline."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.beam.messages import LEVELS_IDS, CanFrame, LinkFault
from foreglow.beam.receiver import LampReceiver, ReceiverConfig
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


def test_begins_low_and_takes_the_fourth_command() -> None:
    receiver = LampReceiver()
    for number in range(4):
        assert brightness(receiver, arrival(number)) == 0
        assert receiver.is_low
        feed(receiver, frames_of(number), arrival(number))
    assert brightness(receiver, arrival(3)) == 1
    assert receiver.shining(arrival(3))[1] == ()
    assert not receiver.is_low
    assert not receiver.noticed


def test_other_frames_on_the_bus_are_none_of_its_business() -> None:
    receiver = LampReceiver()
    for number in range(4):
        for frame in (*only_gaps(number), *frames_of(number), CanFrame(0x3A0, bytes(8)), *other_frames(number)):
            receiver.receive(arrival(number), *frame)
    assert not receiver.is_low
    assert not receiver.noticed


@pytest.mark.parametrize("kind", [bytearray, memoryview])
def test_whatever_holds_the_bytes_of_a_frame(kind: type[bytearray | memoryview]) -> None:
    receiver = LampReceiver()
    for number in range(4):
        for frame_id, data in frames_of(number):
            receiver.receive(arrival(number), frame_id, kind(data))
    assert brightness(receiver, arrival(3)) == 1
    assert not receiver.noticed


def test_counter_and_time_come_round() -> None:
    receiver = LampReceiver()
    for number in range(1500):  # six times the counter, once the time
        feed(receiver, frames_of(number, level=number % 2), arrival(number))
        assert brightness(receiver, arrival(number)) == (number % 2 if number >= 3 else 0)
    assert not receiver.noticed


def test_silence() -> None:
    receiver = running()
    assert is_dark_by(receiver, arrival(9))
    assert receiver.shining(arrival(30))[1] == (LinkFault.TIMEOUT,)
    assert receiver.noticed == {LinkFault.TIMEOUT: 1}


def test_recovers_after_good_ones() -> None:
    receiver = running()
    lit = []
    for number in range(30, 36):
        feed(receiver, frames_of(number), arrival(number))
        lit.append(brightness(receiver, arrival(number)))
    assert lit == [0, 0, 0, 1, 1, 1]
    assert receiver.shining(arrival(36))[1] == ()


def test_a_bad_one_begins_the_count_anew() -> None:
    receiver = running()
    lit = []
    for number in range(30, 39):
        frames = frames_of(number)
        if number == 32:
            frames = (*frames[:3], CanFrame(frames[3].frame_id, bytes(48)))
        feed(receiver, frames, arrival(number))
        lit.append(brightness(receiver, arrival(number)))
    # 33 only shows that 32 was torn, then is good itself.
    assert lit == [0, 0, 0, 0, 0, 1, 1, 1, 1]


@pytest.mark.parametrize("missing", [1, 2])
def test_few_lost_commands_are_borne(missing: int) -> None:
    receiver = running()
    feed(receiver, frames_of(9 + missing + 1, level=0.2), arrival(9 + missing + 1))
    assert brightness(receiver, arrival(9 + missing + 1)) == pytest.approx(0.2, abs=1 / 255)
    assert receiver.noticed == {LinkFault.LOST: 1}


def test_after_a_greater_step_the_next_one_is_taken() -> None:
    receiver = running()
    feed(receiver, frames_of(10, counter=3 + 250 + 10, level=0.2), arrival(10))
    assert brightness(receiver, arrival(10)) == 1
    assert receiver.shining(arrival(10))[1] == (LinkFault.LOST,)
    feed(receiver, frames_of(11, counter=3 + 250 + 11, level=0.4), arrival(11))
    assert brightness(receiver, arrival(11)) == pytest.approx(0.4, abs=1 / 255)
    assert receiver.noticed == {LinkFault.LOST: 1}


@pytest.mark.parametrize("index", range(4))
def test_lost_frame_of_a_command(index: int) -> None:
    receiver = running()
    frames = frames_of(10, level=0.2)
    feed(receiver, frames[:index] + frames[index + 1 :], arrival(10))
    assert brightness(receiver, arrival(10)) == 1  # nothing of it
    feed(receiver, frames_of(11, level=0.4), arrival(11))
    assert brightness(receiver, arrival(11)) == pytest.approx(0.4, abs=1 / 255)
    assert receiver.noticed == {LinkFault.TORN: 1, LinkFault.LOST: 1}


@pytest.mark.parametrize("index", range(4))
def test_frames_always_lost_end_in_low_beam(index: int) -> None:
    receiver = running()
    for number in range(10, 20):
        frames = frames_of(number)
        feed(receiver, frames[:index] + frames[index + 1 :], arrival(number))
    assert brightness(receiver, arrival(20)) == 0
    assert LinkFault.TORN in receiver.shining(arrival(20))[1]


def test_halves_of_two_commands_are_none() -> None:
    receiver = running()
    feed(receiver, (*frames_of(10, level=0.2)[:2], *frames_of(11, level=0.2)[2:]), arrival(11))
    assert brightness(receiver, arrival(11)) == 1
    feed(receiver, frames_of(11, level=0.2)[:2], arrival(11))  # the rest of 11
    assert brightness(receiver, arrival(11)) < 1


def test_parts_of_a_command_that_disagree() -> None:
    """The same counter, but of another image: 256 commands are between them."""
    receiver = running()
    feed(receiver, (*frames_of(10, level=0.2)[:2], *frames_of(10, image=12, level=0.2)[2:]), arrival(12))
    assert brightness(receiver, arrival(12)) == 1
    assert receiver.noticed == {LinkFault.TORN: 1}


def test_any_order_of_the_parts() -> None:
    receiver = running()
    for number, order in ((10, (3, 1, 0, 2)), (11, (2, 3, 1, 0))):
        frames = frames_of(number, level=0.1 * number - 0.8)
        feed(receiver, [frames[index] for index in order], arrival(number))
        assert brightness(receiver, arrival(number)) == pytest.approx(0.1 * number - 0.8, abs=1 / 255)
    assert not receiver.noticed


def test_a_part_that_comes_twice() -> None:
    receiver = running()
    frames = frames_of(10, level=0.2)
    feed(receiver, (frames[0], frames[0], *frames[1:], frames[3]), arrival(10))
    assert brightness(receiver, arrival(10)) == pytest.approx(0.2, abs=1 / 255)
    assert receiver.noticed == {LinkFault.REPEATED: 2}


def test_late_part_of_an_older_command() -> None:
    receiver = running()
    older, newer = frames_of(10), frames_of(11, level=0.2)
    feed(receiver, (*newer[:2], older[3], *newer[2:]), arrival(11))
    assert brightness(receiver, arrival(11)) == pytest.approx(0.2, abs=1 / 255)
    assert receiver.noticed == {LinkFault.DISORDER: 1, LinkFault.LOST: 1}


def test_sender_begins_anew() -> None:
    """Its counter and its time are others: low beam, then taken."""
    receiver = running(config=ReceiverConfig(max_age_s=None))
    lit = []
    for number in range(10, 18):
        feed(receiver, frames_of(number, counter=number + 100, image=number - 400), arrival(number))
        lit.append(brightness(receiver, arrival(number)))
    assert lit == [1, 1, 1, 0, 0, 0, 1, 1]


def test_leftover_parts_do_not_block_a_new_sender() -> None:
    receiver = LampReceiver()
    feed(receiver, frames_of(0, counter=100)[:2], arrival(0))
    for number in range(1, 6):
        feed(receiver, frames_of(number, counter=number), arrival(number))
    assert not receiver.is_low


def test_fault_of_the_sender() -> None:
    receiver = running()
    feed(receiver, frames_of(10, fault=True), arrival(10))
    levels, faults = receiver.shining(arrival(10))
    assert not levels.any()
    assert faults == (LinkFault.SENDER,)
    feed(receiver, frames_of(11), arrival(11))
    assert receiver.shining(arrival(11))[1] == ()


def test_latency() -> None:
    receiver = running(config=ReceiverConfig(latency_s=0.03))
    feed(receiver, frames_of(10, level=0.0), arrival(10))
    assert brightness(receiver, arrival(10) + 30 * MS - 1) == 1
    assert brightness(receiver, arrival(10) + 30 * MS) == 0
    feed(receiver, frames_of(11), arrival(11))
    assert brightness(receiver, arrival(11) + 30 * MS) == 1
    assert brightness(receiver, arrival(11) + DEADLINE + 30 * MS - 1) == 1
    assert brightness(receiver, arrival(11) + DEADLINE + 30 * MS) == 0


def test_brightens_slowly_and_dims_at_once() -> None:
    receiver = running(5, ReceiverConfig(brightening_s=1.0))
    feed(receiver, frames_of(5), arrival(5))  # taken since command 3
    assert brightness(receiver, arrival(3) + 2 * PERIOD + 10 * MS) == pytest.approx(0.12)
    feed(receiver, frames_of(6, level=0.05), arrival(6))
    assert brightness(receiver, arrival(6)) == pytest.approx(0.05, abs=1 / 255)
    for number in range(7, 30):
        feed(receiver, frames_of(number, level=0.6), arrival(number))
    assert brightness(receiver, arrival(29)) == pytest.approx(0.6, abs=1 / 255)


def test_brightens_from_the_moment_of_change() -> None:
    receiver = running(4, ReceiverConfig(brightening_s=1.0, latency_s=0.03))
    assert brightness(receiver, arrival(3) + 50 * MS) == pytest.approx(0.02)


def test_levels_belong_to_the_caller() -> None:
    receiver = running()
    receiver.shining(arrival(9))[0][:] = 0.3
    assert brightness(receiver, arrival(9)) == 1


def test_time_goes_on() -> None:
    receiver = running()
    with pytest.raises(ValueError, match=f"expected {arrival(9)} or later, got {arrival(9) - 1}"):
        receiver.shining(arrival(9) - 1)
    with pytest.raises(ValueError, match="or later"):
        receiver.receive(arrival(9) - 1, 0x123, b"")
    with pytest.raises(ValueError, match="expected nanoseconds as a whole number of 64 bits, got nan"):
        receiver.receive(float("nan"), 0x123, b"")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="data: expected bytes, got str"):
        receiver.receive(arrival(1000), LEVELS_IDS[0], "x")  # type: ignore[arg-type]
    receiver.receive(arrival(10), 0x123, b"")  # what is refused moves no clock


@st.composite
def _traffic(draw: st.DrawFn) -> list[tuple[int, tuple[CanFrame, ...]]]:
    """Commands, each with a chance to be lost, delayed, cut short, changed, repeated or of an old image."""
    traffic, latest_ns = [], START
    for number in range(draw(st.integers(10, 40))):
        frames = frames_of(number, image=draw(st.sampled_from([number] * 6 + [3, number - 1])))
        fault = draw(st.sampled_from(["good"] * 6 + ["lost", "torn", "changed", "twice", "swapped"]))
        if fault == "torn":
            frames = frames[: draw(st.integers(0, 3))]
        elif fault == "changed":
            frames = (*frames[:3], CanFrame(frames[3].frame_id, b"\x55" + frames[3].data[1:]))
        elif fault == "twice":
            frames += frames
        elif fault == "swapped":
            frames = frames[::-1]
        latest_ns = max(latest_ns, arrival(number) + draw(st.sampled_from([0] * 6 + [90, 400])) * MS)
        if fault != "lost":
            traffic.append((latest_ns, frames))
    return traffic


@pytest.mark.slow
@settings(derandomize=True, max_examples=80, deadline=None)
@given(_traffic())
def test_light_only_while_something_fresh_came(traffic: list[tuple[int, tuple[CanFrame, ...]]]) -> None:
    """Whatever happens: light only within the deadline after a whole command, young and newer than all before."""
    receiver, fresh_ns, newest_ns = LampReceiver(), -(10**18), -(10**18)
    for arrival_ns, frames in traffic:
        if brightness(receiver, arrival_ns):
            assert arrival_ns - fresh_ns <= DEADLINE
        image_ns = int.from_bytes(frames[0].data[4:6], "little") * MS if frames else 0
        image_ns += 65536 * MS if image_ns < START // 2 else 0
        whole = {frame.frame_id for frame in frames if frame.data[:1] != b"\x55"} == set(LEVELS_IDS)
        if whole and image_ns > newest_ns and arrival_ns - image_ns <= 301 * MS:
            fresh_ns, newest_ns = arrival_ns, image_ns
        feed(receiver, frames, arrival_ns)
        if brightness(receiver, arrival_ns):
            assert arrival_ns - fresh_ns <= DEADLINE
