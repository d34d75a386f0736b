"""A `BeamCommand` as CAN FD frames, and back; `docs/beam_can.md` has the layout, `foreglow_beam.dbc` is for tools.

Four frames carry the level of each LED; a fifth carries the dark gaps, for cars whose lamps take borders instead. All
frames of a command have the same counter and time. Each is protected as in AUTOSAR E2E profile 5: CRC, counter and data
id. Values are rounded to the steps of the message so that the light is never brighter; where gaps alone would say more
light than the levels, their frame says low beam (`gap_light`).
"""

from __future__ import annotations

import math
import struct
from binascii import crc_hqx
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from foreglow.beam.gap_light import GapLight
from foreglow.geometry import Floats
from foreglow.numbers import checked_whole
from foreglow.photometry import NUM_LEDS
from foreglow.types import BeamCommand, BeamMode
from foreglow.types.arrays import check_kind
from foreglow.wording import shortened

OWN_DBC = Path(__file__).with_name("foreglow_beam.dbc")

LEVELS_IDS = (0x3B0, 0x3B1, 0x3B2, 0x3B3)
"""Identifiers of the levels: LEDs 0 to 41 and 42 to 83 of the left lamp, then those of the right lamp."""

GAPS_ID = 0x3B4

NUM_LEDS_A_FRAME = 2 * NUM_LEDS // len(LEVELS_IDS)
NUM_COUNTS = 256
"""The counter goes from 0 to 255 and then to 0."""

NUM_TIMES_MS = 2**16
"""The time is in milliseconds modulo 65.536 s."""

MAX_NUM_GAPS = 4
MAX_LEVEL_CODE = 255
MAX_RANGE_M = 1018.0
RANGE_STEP_M = 2.0
UNKNOWN_RANGE_CODE = 511

LEVELS = np.arange(MAX_LEVEL_CODE + 1) / MAX_LEVEL_CODE
BORDERS_RAD: tuple[float, ...] = tuple(np.radians(np.arange(1021) * 0.04 - 20.4).tolist())
"""Azimuth to the left by code. Source: GlareFreeBeam in opendbc's ford_lincoln_base_pt.dbc, as are ranges and ramps."""

RAMPS_S = tuple(code * 0.2 for code in range(16))

RAMP_S = 0.5
"""Light returns as slowly as policies and guard let it in LEDs, unless they are told otherwise."""

_INITIAL_CRC = 0xFFFF
_CRC_SIZE = 2
_HEADER = struct.Struct("<BBH")
_GAPS = struct.Struct("<Bx4I")
_LEVELS_SIZE = _CRC_SIZE + _HEADER.size + NUM_LEDS_A_FRAME
_GAPS_SIZE = _CRC_SIZE + _HEADER.size + _GAPS.size


class CanFrame(NamedTuple):
    """The identifier (11 bits) and the payload of a CAN FD frame."""

    frame_id: int
    data: bytes


class LinkFault(StrEnum):
    """What may go wrong between the beam controller and the lamps."""

    LENGTH = "length"
    """A frame has the wrong length for its identifier."""
    CRC = "crc"
    """A frame was changed on its way, or was meant for another identifier."""
    CONTENT = "content"
    """A frame holds values that no command has."""
    TORN = "torn"
    """The frames belong to different commands, or some of a command are missing."""
    LOST = "lost"
    """Commands are missing."""
    REPEATED = "repeated"
    """The same command came again."""
    DISORDER = "disorder"
    """An older command came after a newer one."""
    STALE = "stale"
    """A new command follows from an image that is not newer."""
    LATE = "late"
    """A command follows from an image that is too old."""
    TIMEOUT = "timeout"
    """No valid and fresh command came in time."""
    SENDER = "sender"
    """The sender itself commands low beam because of a fault."""


class MessageError(ValueError):
    """A frame, or a set of frames, that must not be used.

    Attributes:
        fault: What is wrong.
    """

    def __init__(self, fault: LinkFault, message: str) -> None:
        super().__init__(message)
        self.fault = fault


class Header(NamedTuple):
    """The header that all frames of a command share.

    Attributes:
        counter: 0..255, increased with each command.
        time_ms: Time of exposure of the image, whole milliseconds modulo 65,536.
        mode: Low beam, glare-free or full high beam.
        has_faults: Whether the sender commands low beam because of a fault.
    """

    counter: int
    time_ms: int
    mode: BeamMode
    has_faults: bool


class LevelsPart(NamedTuple):
    """The content of one of the four frames with levels.

    Attributes:
        header: The same in all frames of a command.
        number: 0..3, which of the four frames it is.
        codes: One byte for each LED; 255 is full.
    """

    header: Header
    number: int
    codes: bytes


@dataclass(frozen=True, slots=True, eq=False)
class LevelsMessage:
    """The levels of a whole command.

    Attributes:
        header: Its counter, time and mode.
        levels: Shape (2, `NUM_LEDS`), float64 in steps of 1/255, never above what was encoded.
    """

    header: Header
    levels: Floats


@dataclass(frozen=True, slots=True, eq=False)
class GapsMessage:
    """A command for cars whose lamps take the borders of gaps.

    Attributes:
        header: Its counter, time and mode.
        gaps_rad: Shape (G, 2), G <= 4, right and left border in steps of 0.04 degrees; 20.4 degrees stands for that
            angle and any beyond.
        gap_ranges_m: Shape (G,), in steps of 2 m, at most 1018; NaN where unknown.
        ramp_s: Time that the lamps shall take to brighten, in steps of 0.2 s.
    """

    header: Header
    gaps_rad: Floats
    gap_ranges_m: Floats
    ramp_s: float


def crc(frame_id: int, content: bytes) -> int:
    """The CRC of a frame whose bytes after the CRC are `content`: CRC-16/CCITT-FALSE over them and the identifier.

    As in AUTOSAR E2E profile 5, with the identifier as data id: low byte first, after the content, and not sent.

    >>> hex(crc(0x1234, bytes(6)))  # the profile's own example
    '0xca1c'
    """
    return crc_hqx(content + frame_id.to_bytes(2, "little"), _INITIAL_CRC)


class CommandEncoder:
    """Makes the frames of one command after another, counting the commands.

    Attributes:
        counter: Counter of the next command.
        gap_light: Which commands the gaps alone can say.
    """

    def __init__(self, ramp_s: float = RAMP_S, *, has_levels: bool = True) -> None:
        """An encoder whose counter begins at 0.

        Args:
            ramp_s: Brightening time for lamps that take the borders of gaps; at most 3 s.
            has_levels: False leaves out the levels, for cars that only take borders, with lamps of any kind.

        Raises:
            ValueError: If the ramp is not within 0 to 3 s.
        """
        self.counter = 0
        self._ramp_s = _checked_ramp_s(ramp_s)
        self._has_levels = has_levels
        self.gap_light = GapLight(RAMPS_S[bisect_left(RAMPS_S, self._ramp_s)])

    def frames(self, command: BeamCommand) -> tuple[CanFrame, ...]:
        """The frames of all `MESSAGES`, in order; those with the levels only if they are wanted.

        Raises:
            ValueError: As `encode_levels` and `encode_gaps`.
        """
        check_kind("command", command, BeamCommand)
        said = dict.fromkeys(MESSAGES, command) | {"gaps": self.gap_light.told(command)}
        if not self._has_levels:
            del said["levels"]
        frames = tuple(frame for name, one in said.items() for frame in MESSAGES[name](one, self.counter, self._ramp_s))
        self.counter = (self.counter + 1) % NUM_COUNTS
        return frames


def encode_levels(command: BeamCommand, counter: int) -> tuple[CanFrame, ...]:
    """The command's levels as four frames of 48 bytes; each level is rounded down to a step of 1/255.

    Raises:
        ValueError: If the command is none, or not for `NUM_LEDS` LEDs per lamp, or the counter is outside 0..255.
    """
    check_kind("command", command, BeamCommand)
    if command.levels.shape[1] != NUM_LEDS:
        raise ValueError(f"BeamCommand.levels: expected {NUM_LEDS} LEDs a lamp, got {command.levels.shape[1]}")
    codes = (LEVELS.searchsorted(command.levels.ravel(), side="right") - 1).astype(np.uint8).tobytes()
    header = _packed_header(command, counter)
    return tuple(
        _protected(frame_id, header + codes[index * NUM_LEDS_A_FRAME : (index + 1) * NUM_LEDS_A_FRAME])
        for index, frame_id in enumerate(LEVELS_IDS)
    )


def encode_gaps(command: BeamCommand, counter: int, ramp_s: float = RAMP_S) -> CanFrame:
    """The command's gaps as one frame of 24 bytes.

    Borders are rounded outwards, ranges down, the ramp up. Gaps that touch are joined, and so are those with the least
    light between them while there are more than four. A joined gap has the nearer range, unknown if either is.

    Raises:
        ValueError: If the command is none, the ramp is not within 0 to 3 s, or the counter is outside 0..255.
    """
    check_kind("command", command, BeamCommand)
    ramp_s = _checked_ramp_s(ramp_s)
    borders, ranges_m = command.gaps_rad.tolist(), command.gap_ranges_m.tolist()
    gaps = _joined([_gap_codes(right, left, range_m) for (right, left), range_m in zip(borders, ranges_m, strict=True)])
    words = [right | left << 10 | range_code << 20 for right, left, range_code in gaps]
    words += [0] * (MAX_NUM_GAPS - len(words))
    header = _packed_header(command, counter, len(gaps))
    return _protected(GAPS_ID, header + _GAPS.pack(bisect_left(RAMPS_S, ramp_s), *words))


def _checked_ramp_s(ramp_s: object) -> float:
    if not isinstance(ramp_s, int | float | np.integer | np.floating) or not 0.0 <= ramp_s <= RAMPS_S[-1]:
        raise ValueError(f"ramp_s: expected 0 to {RAMPS_S[-1]:g} s, got {shortened(ramp_s)}")
    return float(ramp_s)


MESSAGES: Mapping[str, Callable[[BeamCommand, int, float], tuple[CanFrame, ...]]] = MappingProxyType(
    {
        "levels": lambda command, counter, _: encode_levels(command, counter),
        "gaps": lambda command, counter, ramp_s: (encode_gaps(command, counter, ramp_s),),
    }
)
"""By name, what encodes each message that is sent: from the command, its counter and the lamps' ramp to CAN frames."""


def decode_part(frame_id: int, data: bytes) -> LevelsPart:
    """The content of one of the four frames with levels.

    Raises:
        MessageError: If the frame is broken, or has another identifier.
        ValueError: If the identifier is no whole number, or the data are no bytes.
    """
    frame_id = check_frame(frame_id, data)
    if frame_id not in LEVELS_IDS:
        raise MessageError(LinkFault.CONTENT, f"frame 0x{frame_id:X}: expected one of levels, 0x3B0 to 0x3B3")
    content = _checked(frame_id, data, _LEVELS_SIZE)
    header, _ = _header(frame_id, content)
    codes = content[_HEADER.size :]
    if header.mode == BeamMode.LOW and any(codes):
        raise MessageError(LinkFault.CONTENT, f"frame 0x{frame_id:X}: expected levels of 0 with low beam")
    return LevelsPart(header, LEVELS_IDS.index(frame_id), codes)


def decode_levels(frames: Iterable[CanFrame]) -> LevelsMessage:
    """The levels in four frames, given in any order.

    Raises:
        MessageError: If a frame is broken or missing, or they belong to different commands.
        ValueError: If they are no frames: pairs of an identifier and bytes.
    """
    check_kind("frames", frames, Iterable)
    frames = tuple(frames)
    for frame in frames:
        if not isinstance(frame, tuple) or len(frame) != len(CanFrame._fields):
            raise ValueError(f"frames: expected CAN frames, each an identifier and bytes, got {shortened(frame)}")
    return join_levels([decode_part(*frame) for frame in frames])


def join_levels(parts: Iterable[LevelsPart]) -> LevelsMessage:
    """The levels in the four parts of a command, given in any order.

    Raises:
        MessageError: If a part is missing or there twice, or they belong to different commands.
    """
    ordered = sorted(parts, key=lambda part: part.number)
    if [part.number for part in ordered] != list(range(len(LEVELS_IDS))):
        raise MessageError(LinkFault.TORN, f"levels: expected parts 0 to 3, got {[part.number for part in ordered]}")
    if len({part.header for part in ordered}) > 1:
        raise MessageError(LinkFault.TORN, "levels: expected parts of one command, got several")
    codes = np.frombuffer(b"".join(part.codes for part in ordered), np.uint8)
    return LevelsMessage(ordered[0].header, LEVELS[codes].reshape(2, NUM_LEDS))


def decode_gaps(frame_id: int, data: bytes) -> GapsMessage:
    """The gaps in the frame with gaps.

    Raises:
        MessageError: If the frame is broken, or has another identifier.
        ValueError: If the identifier is no whole number, or the data are no bytes.
    """
    frame_id = check_frame(frame_id, data)
    if frame_id != GAPS_ID:
        raise MessageError(LinkFault.CONTENT, f"frame 0x{frame_id:X}: expected that of gaps, 0x{GAPS_ID:X}")
    content = _checked(frame_id, data, _GAPS_SIZE)
    header, num_gaps = _header(frame_id, content)
    if num_gaps > (MAX_NUM_GAPS if header.mode == BeamMode.GLARE_FREE else 0):
        raise MessageError(LinkFault.CONTENT, f"gaps: expected at most 4, and none but glare-free, got {num_gaps}")
    ramp, *words = _GAPS.unpack(content[_HEADER.size :])
    codes = [(word & 0x3FF, word >> 10 & 0x3FF, word >> 20 & 0x1FF) for word in words[:num_gaps]]
    borders = [border for right, left, _ in codes for border in (right, left)]
    is_ordered = all(before < after for before, after in pairwise(borders))
    if not is_ordered or max(borders, default=0) >= len(BORDERS_RAD):
        raise MessageError(LinkFault.CONTENT, f"gaps: expected borders in order, 0 to 1020, got {borders}")
    if any(code == UNKNOWN_RANGE_CODE - 1 for _, _, code in codes):
        raise MessageError(LinkFault.CONTENT, "gaps: expected ranges up to 1018 m, or 511 for unknown, got 510")
    return GapsMessage(
        header,
        np.array([BORDERS_RAD[code] for code in borders], np.float64).reshape(-1, 2),
        np.array([math.nan if code == UNKNOWN_RANGE_CODE else code * RANGE_STEP_M for _, _, code in codes], np.float64),
        RAMPS_S[ramp & 0xF],
    )


def check_frame(frame_id: object, data: object) -> int:
    """The identifier of a CAN frame as a plain number.

    Raises:
        ValueError: If it is no whole number, or the frame's data are no bytes.
    """
    if not isinstance(data, bytes | bytearray | memoryview):
        raise ValueError(f"data: expected bytes, got {type(data).__name__}")
    return checked_whole("frame_id", frame_id, 0)


def _packed_header(command: BeamCommand, counter: int, num_gaps: int = 0) -> bytes:
    counter = checked_whole("counter", counter, 0, NUM_COUNTS - 1)
    flags = int(command.mode) | bool(command.faults) << 2 | num_gaps << 3
    return _HEADER.pack(counter, flags, time_ms(command.timestamp_ns))


def time_ms(timestamp_ns: int) -> int:
    """A time as the messages carry it.

    >>> time_ms(65_537_999_999)
    1
    """
    return timestamp_ns // 1_000_000 % NUM_TIMES_MS


def _header(frame_id: int, content: bytes) -> tuple[Header, int]:
    """The header, and the number of gaps next to it."""
    counter, flags, exposed_ms = _HEADER.unpack_from(content)
    mode = flags & 3
    if mode > BeamMode.FULL:
        raise MessageError(LinkFault.CONTENT, f"frame 0x{frame_id:X}: mode: expected 0 to 2, got {mode}")
    return Header(counter, exposed_ms, BeamMode(mode), bool(flags & 4)), flags >> 3 & 7


def _protected(frame_id: int, content: bytes) -> CanFrame:
    return CanFrame(frame_id, crc(frame_id, content).to_bytes(_CRC_SIZE, "little") + content)


def _checked(frame_id: int, data: bytes, size: int) -> bytes:
    """The frame's bytes after the CRC."""
    if len(data) != size:
        raise MessageError(LinkFault.LENGTH, f"frame 0x{frame_id:X}: expected {size} bytes, got {len(data)}")
    content = data[_CRC_SIZE:]
    received, expected = int.from_bytes(data[:_CRC_SIZE], "little"), crc(frame_id, content)
    if received != expected:
        raise MessageError(LinkFault.CRC, f"frame 0x{frame_id:X}: CRC: expected 0x{expected:04X}, got 0x{received:04X}")
    return content


def _gap_codes(right_rad: float, left_rad: float, range_m: float) -> tuple[int, int, int]:
    """Codes of the borders, rounded outwards and at least a step apart, and of the range, rounded down."""
    last = len(BORDERS_RAD) - 1
    right = min(max(bisect_right(BORDERS_RAD, right_rad) - 1, 0), last - 1)
    left = max(min(bisect_left(BORDERS_RAD, left_rad), last), 1)
    if math.isnan(range_m):
        return right, left, UNKNOWN_RANGE_CODE
    return right, left, int(min(max(range_m, 0.0), MAX_RANGE_M) // RANGE_STEP_M)


def _joined(gaps: list[tuple[int, int, int]]) -> list[tuple[int, int, int]]:
    """At most four separate gaps, from right to left, that cover the given ones."""
    kept = list(gaps)
    while len(kept) > 1:
        lights = [after[0] - before[1] for before, after in pairwise(kept)]
        least = min(lights)
        if least > 0 and len(kept) <= MAX_NUM_GAPS:
            break
        index = lights.index(least)
        before, after = kept[index], kept[index + 1]
        ranges = (before[2], after[2])
        nearer = UNKNOWN_RANGE_CODE if UNKNOWN_RANGE_CODE in ranges else min(ranges)
        kept[index : index + 2] = [(before[0], max(before[1], after[1]), nearer)]
    return kept
