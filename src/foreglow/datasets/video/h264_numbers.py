"""Numbers of the frames of H.264, by which a lost frame is known; its decoder copies the one before and says nothing.

Sections, tables and names are those of ITU-T H.264.
"""

from __future__ import annotations

from typing import NamedTuple

from foreglow.datasets.video.coded_units import size_bytes_of, units_of

_SLICE, _IDR_SLICE, _SPS = 1, 5, 7
"""Types of units (table 7-1): a slice, one of a picture that refers to none before it, and the parameters."""

_CHROMA_PROFILES = frozenset((100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135))
"""Profiles whose parameters have the format of the chroma (7.3.2.1.1)."""

_HEAD_BYTES, _PARAMETER_BYTES = 32, 1024
"""So much of a slice and of parameters is looked at: what matters is among their first values."""

_MAX_BITS = 16
"""Of a number."""


class _Numbering(NamedTuple):
    """How frames are numbered: bits of a number, whether numbers may be left out, bits before it for its plane.

    And whether a frame may be two pictures, of every other row each, which follow one another.
    """

    num_bits: int
    has_gaps: bool
    plane_bits: int
    has_fields: bool


class H264Numbers:
    """Follows the numbers (`frame_num`, 7.4.3) from packet to packet.

    Attributes:
        is_field: Whether the latest packet began with one half of a frame, of every other row, instead of a frame.
    """

    def __init__(self, extradata: bytes | None) -> None:
        """Begins with the parameters that a container keeps apart; None or empty where they are in the stream."""
        self._size_bytes = size_bytes_of("h264", extradata)
        self._numbering: _Numbering | None = None
        self._latest: int | None = None
        self.is_field = False
        extradata = extradata or b""
        if self._size_bytes:
            size = int.from_bytes(extradata[6:8], "big")
            self._take_parameters(extradata[8 : 8 + size])
        else:
            self._take(extradata)

    def are_broken(self, data: bytes) -> bool:
        """Whether a frame is missing before that of this packet, which others after it may refer to."""
        return self._take(data)

    def _take(self, data: bytes) -> bool:
        self.is_field = False
        for unit in units_of(data, self._size_bytes):
            kind = unit[0] & 31 if unit else 0
            if kind == _SPS:
                self._take_parameters(unit)
            elif kind in (_SLICE, _IDR_SLICE):
                return self._is_after_gap(unit[:_HEAD_BYTES], is_first=kind == _IDR_SLICE)
        return False

    def _take_parameters(self, unit: bytes) -> None:
        try:
            self._numbering = _numbering(_Bits(unit[1:_PARAMETER_BYTES]))
        except IndexError:
            self._numbering = None

    def _is_after_gap(self, head: bytes, *, is_first: bool) -> bool:
        numbering, before = self._numbering, self._latest
        if numbering is None:
            return False
        bits = _Bits(head[1:])
        try:
            for _ in range(3):  # first macroblock, kind of slice, picture parameters
                bits.unsigned()
            bits.number(numbering.plane_bits)
            number = bits.number(numbering.num_bits)
            self.is_field = numbering.has_fields and bool(bits.number(1))
        except IndexError:
            return False
        if head[0] & 0x60:  # other pictures may refer to it
            self._latest = number
        if is_first or before is None or numbering.has_gaps:
            return False
        return (number - before) % (1 << numbering.num_bits) > 1


class _Bits:
    """Reads bits, the highest first; raises IndexError at the end (7.2, 9.1)."""

    def __init__(self, data: bytes) -> None:
        data = data.replace(b"\0\0\3", b"\0\0")  # bytes that keep start codes out (7.4.1)
        self._text = "".join(f"{byte:08b}" for byte in data)
        self._position = 0

    def number(self, num_bits: int) -> int:
        """The number in the next bits."""
        end = self._position + num_bits
        if end > len(self._text):
            raise IndexError
        text, self._position = self._text[self._position : end], end
        return int(text or "0", 2)

    def unsigned(self) -> int:
        """The next number in Exp-Golomb code."""
        one = self._text.find("1", self._position)
        if one < 0:
            raise IndexError
        num_zeros, self._position = one - self._position, one
        return self.number(num_zeros + 1) - 1

    def signed(self) -> int:
        """The next number with a sign (9.1.1)."""
        code = self.unsigned()
        return (code + 1) // 2 if code % 2 else -code // 2


def _numbering(bits: _Bits) -> _Numbering:
    """The numbering that a sequence parameter set says (7.3.2.1.1); IndexError if it is none."""
    profile = bits.number(8)
    bits.number(16)
    bits.unsigned()
    plane_bits = 0
    if profile in _CHROMA_PROFILES:
        chroma_format = bits.unsigned()
        if chroma_format == 3 and bits.number(1):
            plane_bits = 2
        bits.unsigned()
        bits.unsigned()
        bits.number(1)
        if bits.number(1):
            for index in range(12 if chroma_format == 3 else 8):
                if bits.number(1):
                    _skip_scaling_list(bits, 16 if index < 6 else 64)
    num_bits = bits.unsigned() + 4
    order = bits.unsigned()
    if order == 0:
        bits.unsigned()
    elif order == 1:
        bits.number(1)
        bits.signed()
        bits.signed()
        for _ in range(bits.unsigned()):
            bits.signed()
    bits.unsigned()
    if num_bits > _MAX_BITS:
        raise IndexError
    has_gaps = bool(bits.number(1))
    bits.unsigned()
    bits.unsigned()
    return _Numbering(num_bits, has_gaps, plane_bits, has_fields=not bits.number(1))


def _skip_scaling_list(bits: _Bits, size: int) -> None:
    """Reads over a list (7.3.2.1.1.1)."""
    latest = following = 8
    for _ in range(size):
        if following:
            following = (latest + bits.signed()) % 256
        latest = following or latest
