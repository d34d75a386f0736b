"""Packs of MPEG program streams, made by hand."""

from __future__ import annotations

import io

import pytest

from foreglow.datasets.video.containers.program_stream import PACK, walk

PACK_1 = PACK + b"\x21\0\1\0\1\x80\0\1"
PACK_2 = PACK + b"\x44\0\4\0\4\1\0\0\3\xf8"
END = b"\0\0\1\xb9"
TIME, BOTH = b"\x21\0\1\0\1", b"\x31\0\1\0\1\x11\0\1\0\1"


def packet(code: int, data: bytes) -> bytes:
    return bytes([0, 0, 1, code]) + len(data).to_bytes(2, "big") + data


def film(*headers: bytes, pack: bytes = PACK_2) -> bytes:
    return pack + b"".join(packet(0xE0, header + b"x" * 100) for header in headers)


def walked(data: bytes) -> tuple[int, int | None]:
    return walk(io.BytesIO(data), len(data))


MPEG_1 = film(b"\x0f", TIME, BOTH, b"\xff" * 16 + b"\x60\x2e" + BOTH, pack=PACK_1)
MPEG_2 = film(b"\x81\0\0", b"\x81\x80\5" + TIME, b"\x81\xc0\x0a" + BOTH, b"\x81\xc1\x10" + BOTH + b"\xff" * 6)


@pytest.mark.parametrize(
    "data",
    [
        pytest.param(MPEG_1, id="MPEG-1"),
        pytest.param(MPEG_2, id="MPEG-2"),
        pytest.param(PACK_2[:-1] + b"\xfb\xff\xff\xff" + packet(0xBB, bytes(9)) + MPEG_2, id="stuffing of a pack"),
        pytest.param(
            PACK_2 + packet(0xBE, b"\xff" * 50) + packet(0xBF, bytes(50)) + MPEG_2, id="padding, private data"
        ),
        pytest.param(PACK_2 + packet(0xBE, b"") + packet(0xBC, bytes(20)) + MPEG_2, id="empty padding, map"),
        pytest.param(PACK_1 + packet(0xC0, b"\xff" * 16) + MPEG_1, id="nothing but stuffing"),
        pytest.param(MPEG_1 + END + MPEG_2, id="two joined"),
        pytest.param(MPEG_2 + END + bytes(9000), id="zeros behind the end"),
        pytest.param(MPEG_2 + bytes(2048 - len(MPEG_2)) + MPEG_2, id="rest of a sector"),
        pytest.param(MPEG_1 + bytes(2324 - len(MPEG_1)) + MPEG_1, id="rest of a sector of a Video CD"),
        pytest.param(MPEG_2 + bytes(2048 - len(MPEG_2)), id="rest of the last sector"),
        pytest.param(PACK_2 + b"\0\0\1\xe0\0\0\x81\0\0" + bytes(5000), id="a video without a length"),
        pytest.param(b"\0\0\1\xe0\0\3xyz" + bytes(1000), id="not from a pack on"),
    ],
)
def test_whole_streams(data: bytes) -> None:
    assert walked(data)[1] is None
    assert walked(data)[0] <= len(data)


@pytest.mark.parametrize(
    "damaged",
    [
        pytest.param(b"x" + MPEG_2, id="a byte too many"),
        pytest.param(bytes(300) + b"x" * 1000, id="zeros and data"),
        pytest.param(bytes(300) + MPEG_2, id="zeros and a pack, not at a sector"),
        pytest.param(bytes(10000) + MPEG_2, id="more zeros than a sector"),
        pytest.param(bytes(10000), id="zeros to the end"),
        pytest.param(b"\0\0\1\xb3" + MPEG_2, id="a start code of a video"),
        pytest.param(PACK + bytes(10) + MPEG_2, id="pack of neither kind"),
        pytest.param(b"\0\0\1\xe0\0\0" + bytes(300) + MPEG_2, id="no length"),
        pytest.param(packet(0xE0, bytes(100)), id="no header of a packet"),
        pytest.param(packet(0xE0, b"\x81\x80\0" + bytes(100)), id="no room for times"),
        pytest.param(packet(0xE0, b"\x81\x80\5" + bytes(100)), id="no time"),
        pytest.param(packet(0xE0, b"\x81\x80\xff" + TIME + bytes(90)), id="longer than the packet"),
        pytest.param(packet(0xE0, b"\x81\x80"), id="shorter than a header"),
        pytest.param(packet(0xE0, b"\x21" + bytes(100)), id="no time of MPEG-1"),
        pytest.param(packet(0xE0, b"\x60\x2e" + bytes(100)), id="no kind of time"),
    ],
)
def test_damaged_streams(damaged: bytes) -> None:
    assert walked(MPEG_2 + damaged)[1] == len(MPEG_2)


def test_zeros_at_the_beginning() -> None:
    assert walked(bytes(2048) + MPEG_2)[1] == 0


def test_a_sector_that_lost_its_pack() -> None:
    sector = MPEG_2 + bytes(2048 - len(MPEG_2))
    assert walked(3 * sector)[1] is None
    assert walked(sector + bytes(2048) + sector)[1] is not None


@pytest.mark.parametrize("data", [MPEG_1, MPEG_2])
def test_streams_that_were_cut(data: bytes) -> None:
    parts = [index for index in range(4, len(data)) if data[index:].startswith(b"\0\0\1")]
    for length in range(4, len(data)):
        end, damage = walked((data + END)[:length])
        assert damage is None
        if length in parts:
            assert end == length
        else:
            assert length < end <= len(data)
