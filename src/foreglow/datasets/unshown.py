"""Which packets of H.264 and H.265 give no picture: their decoders leave out, in silence, what lacks others."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Protocol


class _Units(Protocol):
    """What a codec's units are."""

    def size_bytes(self, extradata: bytes) -> int:
        """How many bytes before each unit say how long it is; 0 where start codes are between units."""

    def must_be_shown(self, head: int) -> bool | None:
        """Whether a unit with this first byte is of a picture that must be shown; None if it is of no picture."""


class _H264Units:
    """Source: Rec. ITU-T H.264, table 7-1; ISO/IEC 14496-15, section 5.3.3."""

    def size_bytes(self, extradata: bytes) -> int:
        return (extradata[4] & 3) + 1 if len(extradata) > 8 and extradata[0] == 1 else 0

    def must_be_shown(self, head: int) -> bool | None:
        return True if head & 31 in (1, 2, 5) else None


class _H265Units:
    """Source: Rec. ITU-T H.265, table 7-1; ISO/IEC 14496-15, section 8.3.3."""

    _LEADING = (8, 9)  # pictures that cannot be decoded where a stream begins with the key frame behind them (RASL)
    _PICTURES = 32  # below, types of units are those of pictures

    def size_bytes(self, extradata: bytes) -> int:
        return (extradata[21] & 3) + 1 if len(extradata) > 22 and extradata[0] == 1 else 0

    def must_be_shown(self, head: int) -> bool | None:
        kind = head >> 1 & 0x3F
        return kind not in self._LEADING if kind < self._PICTURES else None


_UNITS: dict[str, _Units] = {"h264": _H264Units(), "hevc": _H265Units()}


class Unshown:
    """The packets whose pictures have not come yet; none are waited for of a codec other than H.264 and H.265.

    Attributes:
        numbers: The packets that are waited for, and may still come.
    """

    _MOST = 64  # packets; a decoder holds back 16 pictures. Source: Rec. ITU-T H.265, annex A.4

    def __init__(self, codec_name: str, extradata: bytes | None) -> None:
        self._units = _UNITS.get(codec_name)
        self._size_bytes = self._units.size_bytes(extradata or b"") if self._units is not None else 0
        self.numbers: list[int] = []

    def await_picture(self, number: int, data: bytes) -> None:
        """Waits for the picture of this packet, unless it has none that must be shown.

        Where units have sizes, each packet is a picture, even if nothing in it can be recognised.
        """
        if self._units is None:
            return
        told = (self._units.must_be_shown(head) for head in self._heads(data))
        is_picture = next((must for must in told if must is not None), bool(self._size_bytes))
        if is_picture:
            self.numbers.append(number)

    def lost_before(self, origin: int, *, is_key: bool) -> list[int]:
        """The packets that will give no picture any more, now that packet `origin` has given one.

        All pictures are shown before a key frame that come before it. Source: Rec. ITU-T H.265, section 8.1.3.
        """
        if origin in self.numbers:
            self.numbers.remove(origin)
        lost = [each for each in self.numbers if each < origin] if is_key else self.numbers[: -self._MOST]
        self.numbers = self.numbers[len(lost) :]
        return lost

    def _heads(self, data: bytes) -> Iterator[int]:
        """The first bytes of the packet's units."""
        if not self._size_bytes:
            for match in re.finditer(rb"\x00\x00\x01(.)", data, re.DOTALL):
                yield match[1][0]
            return
        position = 0
        while position + self._size_bytes < len(data):
            start = position + self._size_bytes
            yield data[start]
            position = start + int.from_bytes(data[position:start], "big")
