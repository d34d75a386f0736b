"""Commands as CAN FD frames and back: within the steps, never brighter, and what cantools makes of the same DBC."""

from __future__ import annotations

import math
from binascii import crc_hqx
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.beam.gap_light import FULL
from foreglow.beam.messages import (
    GAPS_ID,
    LEVELS_IDS,
    OWN_DBC,
    CanFrame,
    CommandEncoder,
    LinkFault,
    MessageError,
    crc,
    decode_gaps,
    decode_levels,
    decode_part,
    encode_gaps,
    encode_levels,
)
from foreglow.datasets.vehicle_logs.dbc import read_dbc
from foreglow.photometry import NUM_LEDS
from foreglow.types import BeamCommand, BeamMode
from tests.beam.commands import commands

counters = st.integers(0, 255)
quick = settings(derandomize=True, max_examples=60, deadline=None)


def command_of(*gaps_deg: tuple[float, float], ranges_m: tuple[float, ...] = (), level: float = 0.5) -> BeamCommand:
    ranges = np.array(ranges_m, np.float64) if ranges_m else np.full(len(gaps_deg), np.nan)
    gaps_rad = np.radians(np.array(gaps_deg, np.float64).reshape(-1, 2))
    return BeamCommand(1_234_567_890, BeamMode.GLARE_FREE, np.full((2, NUM_LEDS), level), gaps_rad, ranges)


def resealed(frame: CanFrame, **changes: int) -> CanFrame:
    """The frame with bytes changed (`b3=7`) and a CRC that fits again."""
    content = bytearray(frame.data[2:])
    for name, value in changes.items():
        content[int(name[1:]) - 2] = value
    return CanFrame(frame.frame_id, crc(frame.frame_id, bytes(content)).to_bytes(2, "little") + bytes(content))


def fault_of(frame: CanFrame) -> LinkFault:
    with pytest.raises(MessageError) as error:
        decode_gaps(*frame) if frame.frame_id == GAPS_ID else decode_part(*frame)
    return error.value.fault


@cache
def dbc() -> dict[int, Any]:
    pytest.importorskip("cantools")
    return {message.frame_id: message for message in read_dbc(OWN_DBC).values()}


def test_crc_by_the_book() -> None:
    """CRC-16/CCITT-FALSE's check value, and the example of AUTOSAR's E2E profile 5: data id 0x1234, eight zeros."""
    assert crc_hqx(b"123456789", 0xFFFF) == 0x29B1
    assert crc(0x1234, bytes(6)) == 0xCA1C


@quick
@given(commands(), counters)
def test_levels_come_back_never_brighter(command: BeamCommand, counter: int) -> None:
    frames = encode_levels(command, counter)
    assert [frame.frame_id for frame in frames] == list(LEVELS_IDS)
    assert {len(frame.data) for frame in frames} == {48}
    decoded = decode_levels(reversed(frames))
    assert decoded.header == (counter, command.timestamp_ns // 1_000_000 % 65536, command.mode, bool(command.faults))
    assert (decoded.levels <= command.levels).all()
    assert (command.levels - decoded.levels <= 1 / 255 + 1e-12).all()
    again = BeamCommand(command.timestamp_ns, command.mode, decoded.levels, faults=command.faults)
    assert encode_levels(again, counter) == frames


def test_each_led_has_its_byte() -> None:
    """The left lamp first, LED 0 first: as the numbers of the lamp description."""
    levels = (np.arange(2 * NUM_LEDS) / 255).reshape(2, NUM_LEDS)
    frames = encode_levels(BeamCommand(0, BeamMode.FULL, levels), 0)
    assert b"".join(frame.data[6:] for frame in frames) == bytes(range(2 * NUM_LEDS))
    np.testing.assert_array_equal(decode_levels(frames).levels, levels)


@quick
@given(commands(), counters, st.floats(0, 3))
def test_gaps_come_back_never_brighter(command: BeamCommand, counter: int, ramp_s: float) -> None:
    frame = encode_gaps(command, counter, ramp_s)
    decoded = decode_gaps(*frame)
    assert (frame.frame_id, len(frame.data)) == (GAPS_ID, 24)
    assert decoded.header == (counter, command.timestamp_ns // 1_000_000 % 65536, command.mode, bool(command.faults))
    assert 0 <= decoded.ramp_s - ramp_s <= 0.2 + 1e-12
    assert len(decoded.gaps_rad) <= 4
    assert (np.diff(decoded.gaps_rad.ravel()) > 0).all()
    edge_rad, step_rad = math.radians(20.4), math.radians(0.04)
    for (right, left), range_m in zip(command.gaps_rad, command.gap_ranges_m, strict=True):
        inside = np.clip([right, left], -edge_rad, edge_rad)
        covers = (decoded.gaps_rad[:, 0] <= inside[0] + 1e-12) & (inside[1] <= decoded.gaps_rad[:, 1] + 1e-12)
        assert covers.sum() == 1
        told_m = decoded.gap_ranges_m[covers][0]
        assert math.isnan(told_m) or told_m <= range_m
    if len(command.gaps_rad) == 1:
        expected = np.clip(command.gaps_rad[0], -edge_rad, edge_rad)
        assert (np.abs(decoded.gaps_rad[0] - expected) < step_rad + 1e-9).all()
        if command.gap_ranges_m[0] < 1018:
            assert command.gap_ranges_m[0] - decoded.gap_ranges_m[0] <= 2.0
        assert math.isnan(decoded.gap_ranges_m[0]) == math.isnan(command.gap_ranges_m[0])
    again = BeamCommand(
        command.timestamp_ns, command.mode, command.levels, decoded.gaps_rad, decoded.gap_ranges_m, command.faults
    )
    assert encode_gaps(again, counter, decoded.ramp_s) == frame


@pytest.mark.parametrize(
    ("gaps_deg", "ranges_m", "expected_deg", "expected_m"),
    [
        ([(-1.01, 1.01)], [51.9], [[-1.04, 1.04]], [50.0]),
        ([(0.05, 0.051), (0.06, 0.2)], [99.0, 30.0], [[0.04, 0.2]], [30.0]),
        ([(0.0, 0.05), (0.06, 0.2)], [99.0, math.nan], [[0.0, 0.2]], [math.nan]),
        ([(-40.0, -30.0), (25.0, 26.0)], [5000.0, 1.0], [[-20.4, -20.36], [20.36, 20.4]], [1018.0, 0.0]),
        # Five: those with the least light between them become one.
        (
            [(-8, -7), (-4, -3), (-2, 1), (4, 5), (9, 12)],
            [10, 20, 30, 40, 50],
            [[-8, -7], [-4, 1], [4, 5], [9, 12]],
            [10, 20, 40, 50],
        ),
    ],
)
def test_gaps_by_hand(gaps_deg: Any, ranges_m: Any, expected_deg: Any, expected_m: Any) -> None:
    decoded = decode_gaps(*encode_gaps(command_of(*gaps_deg, ranges_m=tuple(ranges_m)), 0))
    np.testing.assert_allclose(np.degrees(decoded.gaps_rad), expected_deg, atol=0.0401)
    assert (np.degrees(decoded.gaps_rad)[:, 0] <= np.array(expected_deg)[:, 0] + 1e-9).all()
    np.testing.assert_array_equal(decoded.gap_ranges_m, expected_m)


@quick
@given(commands(), counters)
def test_cantools_reads_what_we_write(command: BeamCommand, counter: int) -> None:
    encoder = CommandEncoder(1.0)
    encoder.counter = counter
    frames = encoder.frames(command)
    decoded = [dbc()[frame.frame_id].decode(frame.data, decode_choices=False) for frame in frames]
    levels = [value for part in decoded[:4] for name, value in part.items() if name[-2:].isdigit()]
    np.testing.assert_allclose(np.reshape(levels, (2, NUM_LEDS)), decode_levels(frames[:4]).levels, atol=1e-12)
    gaps = decode_gaps(*frames[4])
    for index, (right, left) in enumerate(np.degrees(gaps.gaps_rad)):
        assert (decoded[4][f"Right{index}"], decoded[4][f"Left{index}"]) == pytest.approx((right, left), abs=1e-9)
        range_m = gaps.gap_ranges_m[index]
        assert decoded[4][f"Range{index}"] == (1022 if math.isnan(range_m) else range_m)
    assert decoded[4]["NumGaps"] == len(gaps.gaps_rad)
    assert decoded[4]["Ramp"] == pytest.approx(1.0)
    is_told = command.mode == BeamMode.LOW or command.levels.max() >= FULL or decoded[4]["Mode"] == BeamMode.LOW
    assert is_told  # the first command: nobody knows what light was before
    for part in decoded:
        header = (part["Counter"], part["Time"], part["HasFaults"])
        assert header == (counter, command.timestamp_ns // 1_000_000 % 65536, bool(command.faults))
    assert {part["Mode"] for part in decoded[:4]} == {command.mode}


@quick
@given(commands(), counters)
def test_we_read_what_cantools_writes(command: BeamCommand, counter: int) -> None:
    for frame in (*encode_levels(command, counter), encode_gaps(command, counter, 0.6)):
        message = dbc()[frame.frame_id]
        assert message.is_fd
        assert message.encode(message.decode(frame.data)) == frame.data


def test_names_of_the_leds_in_the_dbc() -> None:
    names = [signal.name for frame_id in LEVELS_IDS for signal in dbc()[frame_id].signals if signal.name[-1].isdigit()]
    assert names == [f"{side}{led:02d}" for side in ("Left", "Right") for led in range(NUM_LEDS)]


def test_counter_goes_round() -> None:
    encoder = CommandEncoder()
    counters = [decode_levels(encoder.frames(command_of())[:4]).header.counter for _ in range(258)]
    assert counters == [*range(256), 0, 1]


@pytest.mark.parametrize("frame_id", [*LEVELS_IDS, GAPS_ID])
def test_any_changed_bit_is_noticed(frame_id: int) -> None:
    frame = next(sent for sent in CommandEncoder().frames(command_of((1, 2))) if sent.frame_id == frame_id)
    for bit in range(8 * len(frame.data)):
        changed = bytearray(frame.data)
        changed[bit // 8] ^= 1 << bit % 8
        assert fault_of(CanFrame(frame_id, bytes(changed))) == LinkFault.CRC


def test_frame_under_another_identifier() -> None:
    frames = encode_levels(command_of(), 7)
    assert fault_of(CanFrame(LEVELS_IDS[1], frames[0].data)) == LinkFault.CRC


@pytest.mark.parametrize("size", [0, 1, 47, 49, 64])
def test_wrong_length(size: int) -> None:
    assert fault_of(CanFrame(LEVELS_IDS[0], bytes(size))) == LinkFault.LENGTH
    assert fault_of(CanFrame(GAPS_ID, bytes(size))) == LinkFault.LENGTH


def test_other_frames() -> None:
    with pytest.raises(MessageError, match="0x3A0: expected one of levels"):
        decode_part(0x3A0, bytes(48))
    with pytest.raises(MessageError, match="0x3B0: expected that of gaps"):
        decode_gaps(0x3B0, bytes(24))


def test_content_that_no_command_has() -> None:
    command = command_of((1, 2), (3, 4))
    parts, gaps = encode_levels(command, 0), encode_gaps(command, 0)
    assert fault_of(resealed(parts[0], b3=3)) == LinkFault.CONTENT  # no such mode
    assert fault_of(resealed(parts[0], b3=0)) == LinkFault.CONTENT  # light with low beam
    assert fault_of(resealed(gaps, b3=3)) == LinkFault.CONTENT
    assert fault_of(resealed(gaps, b3=2 << 3)) == LinkFault.CONTENT  # gaps with low beam
    assert fault_of(resealed(gaps, b3=2 | 2 << 3)) == LinkFault.CONTENT  # gaps with full beam
    assert fault_of(resealed(gaps, b3=1 | 5 << 3)) == LinkFault.CONTENT  # five of them
    word = int.from_bytes(gaps.data[8:12], "little")
    for bad in (word | 0x3FF, word & ~0xFFC00, (word & ~0x1FF00000) | 510 << 20, word | 0xFFC00):
        changed = {f"b{8 + index}": value for index, value in enumerate(bad.to_bytes(4, "little"))}
        assert fault_of(resealed(gaps, **changed)) == LinkFault.CONTENT


def test_beyond_the_last_border() -> None:
    gaps = encode_gaps(command_of((19, 20)), 0)
    assert fault_of(resealed(gaps, b8=0, b9=0xFC, b10=0x0F)) == LinkFault.CONTENT  # code 1023
    decoded = decode_gaps(*resealed(gaps, b8=0, b9=0xF0, b10=0x0F))  # code 1020
    assert np.degrees(decoded.gaps_rad[0]) == pytest.approx([-20.4, 20.4])


def test_torn_commands() -> None:
    frames, others = encode_levels(command_of(), 7), encode_levels(command_of(), 8)
    for torn in ([*frames[:3], others[3]], frames[:3], [*frames, frames[0]], []):
        with pytest.raises(MessageError) as error:
            decode_levels(torn)
        assert error.value.fault == LinkFault.TORN


def test_what_cannot_be_encoded() -> None:
    with pytest.raises(ValueError, match="expected 84 LEDs a lamp, got 3"):
        encode_levels(BeamCommand.low(0, 3), 0)
    for counter in (-1, 256):
        with pytest.raises(ValueError, match=r"counter: expected a whole number (of at least 0|from 0 to 255), got"):
            encode_levels(command_of(), counter)
    for ramp_s in (-0.1, 3.1, math.nan):
        with pytest.raises(ValueError, match="ramp_s: expected 0 to 3 s"):
            encode_gaps(command_of(), 0, ramp_s)
        with pytest.raises(ValueError, match="ramp_s: expected 0 to 3 s"):
            CommandEncoder(ramp_s)
