"""Where the objects of an ASF or WMV file end, and whether its packets hold whole media objects one behind the other.

FFmpeg leaves out packets and payloads that make no sense, and frames that lack a part: it says neither. Source:
Microsoft, Advanced Systems Format (ASF) Specification, sections 2, 3.2 and 5.2. A media object is a frame, or a piece
of sound.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

HEADER = bytes.fromhex("3026b2758e66cf11a6d900aa0062ce6c")
"""How every ASF file begins."""

_DATA = bytes.fromhex("3626b2758e66cf11a6d900aa0062ce6c")
_FILE = bytes.fromhex("a1dcab8c47a9cf118ee400c00c205365")
_PACKET = b"\x82\0\0"
"""How data packets begin that have error correction data, as those of all known recorders do."""

_DATA_START = 50  # bytes of the data object before its first packet
_LEAST_REPLICATED = 8  # bytes: size and time of the media object
_MAX_OBJECTS = 100_000  # a file with more top-level objects is not checked to its end
_MAX_HEADER_BYTES = 1 << 20

MAX_PACKETS = 4_000_000
"""Of a file with more packets, the rest is not checked. Each has at most 63 payloads."""

MAX_PACKET_BYTES = 1 << 20
"""Payloads of larger packets are not looked at; FFmpeg's have at most 65,536 bytes."""


class _Payload(NamedTuple):
    """A part of a media object.

    `number` counts modulo `modulo`, 1 if the file does not state it. `size` is the object's; None if not stated. Some
    payloads hold several small objects, and state a time in place of the offset.
    """

    stream: int
    number: int
    modulo: int
    offset: int
    length: int
    size: int | None
    has_several: bool


def objects(file: BinaryIO, size: int) -> Iterator[tuple[bytes, int, int]]:
    """Names, beginnings and ends of an ASF file's top-level objects.

    A recorder that was killed leaves data without a size, which go to the end of the file.
    """
    position = 0
    for _ in range(_MAX_OBJECTS):
        if position >= size:
            return
        file.seek(position)
        header = file.read(24)
        length = int.from_bytes(header[16:], "little")
        is_open = header[:16] == _DATA and length <= _DATA_START
        if len(header) < 24 or (length < 24 and not is_open):
            return
        stop = size if is_open else position + length
        yield header[:16], position, stop
        position = stop


def first_damage(file: BinaryIO, size: int) -> int | None:
    """The first byte at which a packet is not as it must be, or at which another file's header stands."""
    length = 0
    for name, start, stop in objects(file, size):
        if name == HEADER:
            if start:
                return start
            length = _packet_size(file, start, stop)
        elif name == _DATA and length:
            damage = _damage_of_packets(file, start + _DATA_START, min(stop, size), length)
            if damage is not None:
                return damage
    return None


def _packet_size(file: BinaryIO, start: int, stop: int) -> int:
    """Bytes of each packet by the header at `start`; 0 if they differ, or none is stated."""
    file.seek(start)
    header = file.read(min(stop - start, _MAX_HEADER_BYTES))
    found = header.find(_FILE)
    least, most = (header[found + begin : found + begin + 4] for begin in (92, 96))
    return int.from_bytes(least, "little") if found >= 0 and least == most else 0


def _damage_of_packets(file: BinaryIO, first: int, stop: int, length: int) -> int | None:
    """The first packet of `length` bytes that is damaged, or goes on with other objects than the one before ended."""
    latest: dict[int, _Payload] = {}  # of each stream
    for position in range(first, min(stop, first + MAX_PACKETS * length) - 2, length):
        file.seek(position)
        data = file.read(length if length <= MAX_PACKET_BYTES else len(_PACKET))
        if not data.startswith(_PACKET):
            # Without error correction data, packets begin in many ways.
            return None if position == first else position
        if len(data) < length:
            continue
        payloads = _payloads(data)
        if payloads is None:
            return position
        for payload in payloads:
            before = latest.get(payload.stream)
            if not _goes_on(before, payload):
                return position
            if before is not None and payload.size is None and payload.offset:  # a later part does not say it again
                payload = payload._replace(size=before.size)
            latest[payload.stream] = payload
    return None


def _goes_on(before: _Payload | None, payload: _Payload) -> bool:
    """Whether `payload` may follow the payload `before` of its stream; a recording may begin in an object."""
    if payload.has_several:
        return True
    reached = payload.offset + payload.length
    if payload.size is not None and reached > payload.size:
        return False
    if before is None or before.has_several or before.size is None or payload.modulo == 1:
        return True
    step = (payload.number - before.number) % payload.modulo
    if before.offset + before.length < before.size:
        is_next = step == 0 and payload.offset == before.offset + before.length
        return is_next and reached <= before.size and payload.size in (None, before.size)
    # Objects that are complete one by one may have the same number, as where a recorder does not count.
    return step in (0, 1) and payload.offset == 0


def _payloads(data: bytes) -> list[_Payload] | None:
    """The payloads of a packet; None if they do not fit into it, or no stream has their number. Source: section 5.2.

    Numbers of 0, 1, 2 or 4 bytes, as flags say, lie one behind the other.
    """
    cursor = _Cursor(data, len(_PACKET))
    flags, fields = cursor.number(1), cursor.number(1)
    stated = cursor.of_kind(flags >> 5)
    cursor.of_kind(flags >> 1)
    padding = cursor.of_kind(flags >> 3)
    cursor.number(6)  # time and duration
    stop = min(stated or len(data), len(data)) - padding
    many = cursor.number(1) if flags & 1 else 0
    payloads = []
    for _ in range(many & 0x3F if flags & 1 else 1):
        stream = cursor.number(1) & 0x7F
        number, offset = cursor.of_kind(fields >> 4), cursor.of_kind(fields >> 2)
        num_replicated = cursor.of_kind(fields)
        replicated = cursor.position
        cursor.position += num_replicated
        length = cursor.of_kind(many >> 6) if flags & 1 else stop - cursor.position
        cursor.position += length
        is_empty = not num_replicated and not length
        if not stream or is_empty or 1 < num_replicated < _LEAST_REPLICATED or cursor.position > stop or length < 0:
            return None
        is_sized = num_replicated >= _LEAST_REPLICATED
        size = int.from_bytes(data[replicated : replicated + 4], "little") if is_sized else None
        modulo = 1 << 8 * _BYTES_OF_KIND[fields >> 4 & 3]
        payloads.append(_Payload(stream, number, modulo, offset, length, size, num_replicated == 1))
    return payloads


_BYTES_OF_KIND = (0, 1, 2, 4)


class _Cursor:
    """Little-endian numbers from `position` on; 0 behind the end."""

    def __init__(self, data: bytes, position: int) -> None:
        self.data, self.position = data, position

    def number(self, num_bytes: int) -> int:
        self.position += num_bytes
        return int.from_bytes(self.data[self.position - num_bytes : self.position], "little")

    def of_kind(self, kind: int) -> int:
        """A number whose length the two lowest bits of `kind` say."""
        return self.number(_BYTES_OF_KIND[kind & 3])
