"""Which packets give no picture: decoders leave out, in silence, what lacks others or cannot be read."""

from __future__ import annotations

from collections.abc import Callable

from foreglow.datasets.video.coded_units import size_bytes_of, units_of


class Unshown:
    """The packets whose pictures have not come yet, of codecs of which each packet shows one.

    Attributes:
        numbers: The packets that are waited for, and may still come.
    """

    _MOST = 64  # packets; a decoder holds back 16 pictures. Source: Rec. ITU-T H.265, annex A.4

    def __init__(self, codec_name: str, extradata: bytes | None) -> None:
        self._has_picture = _checks(extradata or b"").get(codec_name, _never)
        self.numbers: list[int] = []

    def await_picture(self, number: int, data: bytes) -> None:
        """Waits for the picture of this packet, unless it has none that must be shown."""
        if self._has_picture(data):
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


def _checks(extradata: bytes) -> dict[str, Callable[[bytes], bool]]:
    """By codec, whether a packet has a picture that must be shown."""
    h264_bytes, h265_bytes = size_bytes_of("h264", extradata), size_bytes_of("hevc", extradata)
    return {
        "h264": lambda data: _has_picture(data, h264_bytes, _of_h264),
        "hevc": lambda data: _has_picture(data, h265_bytes, _of_h265),
        "mpeg1video": _has_mpeg_picture,
        "mpeg2video": _has_mpeg_picture,
        "av1": lambda data: bool(data),
        "vp9": lambda data: bool(data),
        "vp8": lambda data: bool(data and data[0] >> 4 & 1),  # others are references. Source: RFC 6386, section 9.1
    }


def _has_mpeg_picture(data: bytes) -> bool:
    """Whether a picture's header is there. Source: ITU-T H.262, table 6-1."""
    return b"\0\0\1\0" in data


def _never(_: bytes) -> bool:
    return False


def _has_picture(data: bytes, size_bytes: int, must_be_shown: Callable[[int], bool | None]) -> bool:
    """By the first unit of a picture; where units have sizes, each packet is one, even if nothing is recognised."""
    told = (must_be_shown(unit[0]) for unit in units_of(data, size_bytes) if unit)
    return next((must for must in told if must is not None), bool(size_bytes))


def _of_h264(head: int) -> bool | None:
    """Whether a unit with this first byte must be shown; None if it is of no picture. Source: H.264, table 7-1."""
    return True if head & 31 in (1, 2, 5) else None


def _of_h265(head: int) -> bool | None:
    """The same, of H.265, table 7-1; RASL (8, 9) cannot be decoded where a stream begins behind them."""
    kind = head >> 1 & 0x3F
    return kind not in (8, 9) if kind < 32 else None
