"""Packets of ASF, made by hand."""

from __future__ import annotations

import io

import pytest

from foreglow.datasets.video.containers.asf import HEADER, first_damage, objects

DATA = bytes.fromhex("3626b2758e66cf11a6d900aa0062ce6c")
FILE = bytes.fromhex("a1dcab8c47a9cf118ee400c00c205365")
SIZE = 200
HEADER_BYTES = 24 + 104


def payload(number: int, offset: int, length: int, size: int, *, stream: int = 1, replicated: int = 8) -> bytes:
    """A part of a media object with its header, whose fields have 1, 4, 1 and 2 bytes, as usual."""
    more = size.to_bytes(4, "little") + bytes(max(0, replicated - 4))
    header = bytes([stream, number % 256]) + offset.to_bytes(4, "little") + bytes([replicated]) + more[:replicated]
    return header + length.to_bytes(2, "little") + b"x" * length


def packet(*payloads: bytes, num: int | None = None) -> bytes:
    """Several payloads; the rest is padding of a stated length."""
    num = len(payloads) if num is None else num
    body = b"".join(payloads)
    padding = SIZE - 13 - len(body)
    assert padding >= 0
    return b"\x82\0\0\x09\x5d" + bytes([padding]) + bytes(6) + bytes([0x80 | num]) + body + bytes(padding)


def single(number: int, offset: int, length: int, size: int, *, stated: int = 0) -> bytes:
    """The only payload of a packet, whose length follows from those of the packet and of the padding."""
    body = bytes([1, number]) + offset.to_bytes(4, "little") + b"\x08" + size.to_bytes(4, "little") + bytes(4)
    header = (
        b"\x82\0\0" + (b"\x48" if stated else b"\x08") + b"\x5d" + (stated.to_bytes(2, "little") if stated else b"")
    )
    padding = (stated or SIZE) - len(header) - 7 - len(body) - length
    data = header + bytes([padding]) + bytes(6) + body + b"x" * length + bytes(padding)
    return data + bytes(SIZE - len(data))


def damage(*packets: bytes) -> int | None:
    """Number of the first damaged packet, counted from 0."""
    properties = bytearray(104)
    properties[:16] = FILE
    properties[92:100] = 2 * SIZE.to_bytes(4, "little")
    header = HEADER + HEADER_BYTES.to_bytes(8, "little") + bytes(properties)
    content = b"".join(packets)
    data = header + DATA + (50 + len(content)).to_bytes(8, "little") + bytes(26) + content
    found = first_damage(io.BytesIO(data), len(data))
    return None if found is None else (found - HEADER_BYTES - 50) // SIZE


@pytest.mark.parametrize(
    "packets",
    [
        pytest.param(
            [packet(payload(7, 0, 20, 20), payload(8, 0, 30, 50)), packet(payload(8, 30, 20, 50))], id="parts"
        ),
        pytest.param([packet(payload(255, 0, 20, 20), payload(256, 0, 30, 30))], id="numbers begin anew"),
        pytest.param([packet(payload(3, 0, 20, 20), payload(3, 0, 30, 30))], id="numbers that do not count"),
        pytest.param([packet(payload(3, 90, 10, 100), payload(4, 0, 30, 30))], id="begins in an object"),
        pytest.param([packet(payload(3, 0, 10, 100))], id="ends in an object"),
        pytest.param([packet(payload(3, 0, 0, 0), payload(4, 0, 9, 9))], id="a frame that was left out"),
        pytest.param([packet(payload(3, 0, 9, 9, replicated=30))], id="more of each object"),
        pytest.param(
            [packet(payload(3, 0, 9, 20), payload(3, 9, 11, 0, replicated=0)), packet(payload(4, 0, 9, 9))],
            id="said once",
        ),
        pytest.param(
            [packet(payload(3, 0, 9, 9, replicated=0)), packet(payload(4, 0, 9, 9, replicated=0))], id="no sizes"
        ),
        pytest.param(
            [packet(payload(3, 0, 9, 18), payload(9, 0, 5, 5, stream=0x82), payload(3, 9, 9, 18))], id="two streams"
        ),
        pytest.param(
            [single(1, 0, 100, 150), single(1, 100, 50, 150, stated=150), single(2, 0, 150, 150)], id="single"
        ),
    ],
)
def test_whole_packets(packets: list[bytes]) -> None:
    assert damage(*packets) is None


@pytest.mark.parametrize(
    "second",
    [
        pytest.param(packet(payload(8, 31, 19, 50)), id="offset"),
        pytest.param(packet(payload(8, 30, 21, 50)), id="beyond the object"),
        pytest.param(packet(payload(8, 30, 20, 60)), id="another size"),
        pytest.param(packet(payload(9, 0, 20, 20)), id="unfinished object"),
        pytest.param(packet(payload(8, 30, 20, 50), payload(10, 0, 5, 5)), id="number left out"),
        pytest.param(packet(payload(8, 30, 20, 50), payload(9, 1, 4, 5)), id="beginning left out"),
        pytest.param(packet(payload(8, 30, 20, 50), bytes(20)), id="zeros"),
        pytest.param(packet(payload(8, 30, 20, 50), payload(9, 0, 9, 9, stream=0x80)), id="no stream"),
        pytest.param(packet(payload(8, 30, 20, 50), num=2), id="a payload too few"),
        pytest.param(packet(payload(8, 30, 21, 50, replicated=0)), id="no replicated data, beyond the object"),
        pytest.param(packet(payload(8, 30, 12, 50, replicated=0)), id="no replicated data, unfinished object"),
        pytest.param(packet(payload(8, 30, 20, 50), payload(9, 0, 9, 9, replicated=7)[:-1]), id="replicated data"),
        pytest.param(packet(payload(8, 30, 20, 50))[:5] + b"\xff" + bytes(SIZE - 6), id="padding"),
        pytest.param(single(8, 30, 19, 50), id="single unfinished"),
    ],
)
def test_damaged_packets(second: bytes) -> None:
    packets = packet(payload(7, 0, 20, 20), payload(8, 0, 30, 50)), second, packet(payload(9, 0, 9, 9))
    found = damage(*packets)
    # That the object of a payload is unfinished shows at the next one.
    assert found in (1, 2)


def test_payloads_of_several_objects_are_not_followed() -> None:
    """Then the offset is a time, and the replicated data the difference of times."""
    several = (
        bytes([1, 5]) + (40_000).to_bytes(4, "little") + b"\x01\x28" + (8).to_bytes(2, "little") + b"\x03abc\x03abc"
    )
    assert damage(packet(several, payload(9, 0, 9, 9)), packet(several)) is None


@pytest.mark.parametrize("fields", [0x5D, 0x6D, 0x7D, 0x4D])
def test_numbers_of_objects_have_any_length(fields: int) -> None:
    num_bytes = (0, 1, 2, 4)[fields >> 4 & 3]

    def numbered(number: int) -> bytes:
        whole = payload(0, 0, 9, 9)
        data = packet(whole[:1] + number.to_bytes(4, "little")[:num_bytes] + whole[2:])
        return data[:4] + bytes([fields]) + data[5:]

    assert damage(numbered(200), numbered(201)) is None
    assert damage(numbered(200), numbered(203)) == (1 if num_bytes else None)


def test_an_object_of_any_size() -> None:
    data = HEADER + b"\xff" * 8
    assert list(objects(io.BytesIO(data), len(data))) == [(HEADER, 0, 2**64 - 1)]
    assert first_damage(io.BytesIO(data), len(data)) is None
