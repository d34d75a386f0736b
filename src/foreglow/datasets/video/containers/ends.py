"""What is missing of a video file by its container: at the end, or between its parts.

Demultiplexers of FFmpeg end silently where a file was cut, look for the next part where they find none, and leave out a
second film behind the first, or read it as the same. Only where parts begin and end is looked at: their data is the
decoder's to judge.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, NamedTuple

from foreglow.datasets.images import MAX_SIDE_PX
from foreglow.datasets.video.containers import asf, avi, matroska, ogg, program_stream
from foreglow.datasets.video.containers.transport import PACKETS, SYNC

MAX_PARTS = 4_000_000
"""Of a file with more parts, which is two days of 25 frames a second, the rest is not checked."""

_MAX_BOXES = 100_000  # an MP4 with more top-level boxes is not checked to its end
_MP4_BEGINNINGS = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")
_PIECE = 1 << 20  # bytes

_NUM_SYNCS = 8  # so many packets in a row begin with 0x47

_Y4M = b"YUV4MPEG2 "
_Y4M_CHROMA = {
    "420": (2, 2, 2),
    "411": (4, 1, 2),
    "422": (2, 1, 2),
    "444": (1, 1, 2),
    "444alpha": (1, 1, 3),
    "mono": (1, 1, 0),
}
"""By what width and height are divided in the further planes, and how many there are; alpha counts as one."""

_AVI, _MXF = "an AVI file", "an MXF file"
"""Whose frames have no times but by their number."""

_MXF_KEY = bytes.fromhex("060e2b34")
_MXF_PARTITION = bytes.fromhex("060e2b34020501010d01020101")
_MXF_HEADER = _MXF_PARTITION + b"\x02"

_JPEG = b"\xff\xd8\xff"

_DV, _DV_PAL_BYTES, _DV_NTSC_BYTES = b"\x1f\x07\x00", 144_000, 120_000
"""How a raw DV file begins, and the bytes of a frame, or of each of several parts of one (IEC 61834-2, SMPTE 314M)."""

_FLV = b"FLV\x01"
_FLV_TAGS = (8, 9, 15, 18)  # sound, video, script data; the bits above say whether it is encrypted


def missing_bytes(path: Path) -> int:
    """Number of bytes missing at the end of `path`, by sizes in its container; more may be missing.

    Known are MP4/MOV, Matroska/WebM, AVI, ASF/WMV, MXF, Y4M and, up to the end of the packet that was cut, Ogg, MPEG-TS
    and MPEG program streams. 0 for a complete file, and where a container states no size (live Matroska, raw streams).
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(12)
        if head[4:8] in _MP4_BEGINNINGS:
            end = _mp4(file, size)[0]
        elif avi.is_avi(head):
            end = avi.end_of(head)
        elif head.startswith(matroska.MAGIC):
            end = matroska.end_of(file, size)
        elif head.startswith(_DV):
            frame = _DV_PAL_BYTES if head[3] & 0x80 else _DV_NTSC_BYTES
            end = -(-size // frame) * frame
        elif head.startswith(asf.HEADER[:12]):
            end = next((stop for _, _, stop in asf.objects(file, size) if stop > size), size)
        elif head.startswith(program_stream.PACK):
            end = program_stream.walk(file, size)[0]
        elif head.startswith(ogg.CAPTURE):
            end = ogg.walk(file, size)[0]
        elif head.startswith(_Y4M):
            end = _y4m_end(file, size)
        elif head.startswith(_MXF_KEY):
            end = max(_mxf_footer(file), _mxf(file, size)[0])
        else:
            end = size + _missing_of_packet(file, size)
    return max(0, end - size)


class Hole(NamedTuple):
    """Damage between parts of a file, or a second film in it.

    Attributes:
        lines: For people: about the first damage, and about the second film.
        spans: Half-open intervals of bytes with damage, in order, none within another.
        film: At which byte the second film begins that the demultiplexer would read as if the first went on.
    """

    lines: tuple[str, ...]
    spans: Sequence[tuple[int, int]] = ()
    film: int | None = None

    def are_between(self, start: int, stop: int) -> bool:
        """Whether something is lost within these bytes of the file, as `transport.TransportLosses` says it."""
        num_before = bisect_left(self.spans, (stop,))
        return num_before > 0 and self.spans[num_before - 1][1] > start


def hole(path: Path, demultiplexer: str = "") -> Hole | None:
    """The damage between parts of a file, or a second film in it; None if there is none.

    Behind the damage of Matroska, AVI, ASF/WMV, MXF, FLV, Ogg and MPEG program streams the demultiplexer silently goes
    on, or ends. `demultiplexer` is FFmpeg's name of it, which says more than the first bytes where those are damaged.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(12)
        if head[4:8] in _MP4_BEGINNINGS:
            second = _mp4(file, size)[1]
            return None if second is None else Hole((_second_film(path, second, "moov box"),))
        if demultiplexer == "mjpeg":
            before = _before_pictures(path, file)
            return Hole((before,)) if before else None
        kind, what, damage, spans, film = _walked(file, size, head, demultiplexer)
    lines = [] if damage is None else [_damage(path, damage, size, kind, what)]
    lines += [] if film is None else [_second_film(path, film, "header")]
    return Hole(tuple(lines), spans, film) if lines else None


class _Walked(NamedTuple):
    """The kind of a file, what its parts are, where damage begins, and all damage and a second film as in `Hole`."""

    kind: str
    what: str
    damage: int | None
    spans: list[tuple[int, int]]
    film: int | None = None


def _walked(file: BinaryIO, size: int, head: bytes, demultiplexer: str) -> _Walked:
    """What is found in a file that begins with `head`; of some kinds only the first damage."""
    if head.startswith(matroska.MAGIC):
        return _Walked("a Matroska file", "an element", *matroska.walk(file, size)[1:])
    if avi.is_avi(head):
        spans, film = avi.walk(file, size)
        return _Walked(_AVI, "a chunk", spans[0][0] if spans else None, spans, film)
    if head.startswith(ogg.CAPTURE) or demultiplexer == "ogg":
        places = ogg.walk(file, size)[1]
        return _Walked("an Ogg file", "a page", next(iter(places), None), [(place, place + 1) for place in places])
    kind, what, damage, film = "", "", None, None
    if head.startswith(asf.HEADER[:12]):
        kind, what, damage = "an ASF file", "a packet", asf.first_damage(file, size)
    elif head.startswith(_MXF_KEY):
        kind, what, (_, damage, film) = _MXF, "a key", _mxf(file, size)
    elif head.startswith(_FLV):
        kind, what, damage = "an FLV file", "a tag", _flv_damage(file)
    elif head.startswith(program_stream.PACK) or (demultiplexer == "mpeg" and head.startswith(bytes(4))):
        kind, what, damage = "an MPEG program stream", "a packet", program_stream.walk(file, size)[1]
    if damage is not None:
        file.seek(damage)
        if file.read(16).startswith((_FLV, asf.HEADER)):
            damage, film = None, damage
    return _Walked(kind, what, damage, [] if damage is None else [(damage, damage + 1)], film)


def _damage(path: Path, position: int, size: int, kind: str, what: str) -> str:
    found = "damage" if position < size else "the end of the file"
    numbers = "numbers and times" if kind in (_AVI, _MXF) else "numbers"
    return (
        f"{path}: byte {position}: expected {what} of {kind}, found {found}; frames may be missing from there on, and "
        f"those behind have too small {numbers}"
    )


def _second_film(path: Path, position: int, what: str) -> str:
    return f"{path}: byte {position}: expected one film, found a second {what}; the film that it begins is not read"


def _before_pictures(path: Path, file: BinaryIO) -> str:
    """A line about other data before the first picture of raw MJPEG; FFmpeg takes any file with JPEGs for that.

    Recordings of network cameras may begin with the header of a part, as HTTP sends it.
    """
    file.seek(0)
    data = file.read(_PIECE)
    before = data[: max(0, data.find(_JPEG))].strip(b"\r\n")
    if not before or b"image/jpeg" in before.lower():
        return ""
    return (
        f"{path}: byte 0: expected a picture of raw MJPEG, found other data up to byte {data.find(_JPEG)}; frames may "
        "be missing there, or it is a damaged file of another format, whose times are not read"
    )


def _mp4(file: BinaryIO, size: int) -> tuple[int, int | None]:
    """End of the last top-level box, and where a second film's `moov` is. Source: ISO/IEC 14496-12, section 4.2.

    A film has a `moov` and an `mdat`; fragments (`moof`) may be of several `moov`, and are all read.
    """
    position, num_data, films, is_fragmented = 0, 0, [], False
    for _ in range(_MAX_BOXES):
        if position >= size:
            break
        file.seek(position)
        header = file.read(16)
        if len(header) < 8:
            return position + 8, None
        num_data += header[4:8] == b"mdat"
        films += [position] if header[4:8] == b"moov" else []
        is_fragmented |= header[4:8] == b"moof"
        length = int.from_bytes(header[:4], "big")
        if length == 1:
            length = int.from_bytes(header[8:16], "big")
        if length < 8:  # 0: to the end of the file; else not a box
            break
        position += length
    # Some recorders write the same `moov` twice, for one `mdat`.
    return position, films[1] if len(films) > 1 and num_data > 1 and not is_fragmented else None


def _y4m_end(file: BinaryIO, size: int) -> int:
    """Where the last frame of a Y4M file ends; `size` where a frame does not begin. Source: yuv4mpeg(5)."""
    file.seek(0)
    words = file.readline(256).decode("latin-1").split()[1:]
    values = {word[0]: word[1:] for word in words}
    match = re.fullmatch(r"(420|411|422|444alpha|444|mono)(?:jpeg|mpeg2|paldv|p?(\d+))?", values.get("C", "420"))
    sides = values.get("W", ""), values.get("H", "")
    if match is None or not all(side.isdecimal() for side in sides):
        return size
    width, height = (int(side) for side in sides)
    if max(width, height) > MAX_SIDE_PX:  # no decoder opens it
        return size
    across, down, num_more = _Y4M_CHROMA[match[1]]
    samples = width * height + num_more * -(-width // across) * -(-height // down)
    length = samples * (2 if int(match[2] or 8) > 8 else 1)
    position = file.tell()
    for _ in range(MAX_PARTS):
        if position >= size:
            return position
        file.seek(position)
        line = file.readline(256)
        if not line.startswith(b"FRAME"[: len(line)]):
            return size
        position += (len(line) if line.endswith(b"\n") else 6) + length
    return size


def _missing_of_packet(file: BinaryIO, size: int) -> int:
    """Number of bytes that a transport stream's last packet lacks; 0 for a whole one, and for another file."""
    for length, offset in PACKETS:
        file.seek(0)
        if _first_packet(file.read(length * (_NUM_SYNCS + 1)), length, offset) is None:
            continue
        # Whole packets at the end, wherever the first one began: a stream may have been joined in a packet.
        file.seek(max(0, size - length * (_NUM_SYNCS + 1)))
        tail = file.read()
        begin = _first_packet(tail, length, offset)
        rest = 0 if begin is None else (len(tail) - begin) % length
        return length - rest if rest else 0
    return 0


def _first_packet(data: bytes, length: int, offset: int) -> int | None:
    """Where packets of this length begin in `data`, all of which have their sync byte; None if they do not."""
    for begin in range(length):
        syncs = data[begin + offset :: length]
        if len(syncs) > 1 and syncs.count(SYNC) == len(syncs):
            return begin
    return None


def _mxf(file: BinaryIO, size: int) -> tuple[int, int | None, int | None]:
    """End of an MXF file's last part, the first byte at which a part lacks its key, and where a second film begins.

    Source: SMPTE ST 336 (key, length, value) and ST 377-1.
    """
    position = 0
    for _ in range(MAX_PARTS):
        if position >= size:
            break
        file.seek(position)
        header = file.read(25)
        if not header.startswith(_MXF_KEY[: len(header)]):
            return position, position, None
        if position and header.startswith(_MXF_HEADER):
            return position, None, position
        if len(header) < 17:
            return position + 17, None, None
        num_more = header[16] & 0x7F if header[16] & 0x80 else 0
        if num_more > 8:
            return position, position, None
        length = int.from_bytes(header[17 : 17 + num_more], "big") if num_more else header[16]
        position += 17 + num_more + length
    return position, None, None


def _mxf_footer(file: BinaryIO) -> int:
    """Behind the beginning of the footer, by the first partition; 0 where it does not know, as of a killed recorder."""
    file.seek(0)
    header = file.read(256)
    if not header.startswith(_MXF_PARTITION):
        return 0
    start = 17 + (header[16] & 0x7F if header[16] & 0x80 else 0)
    footer = int.from_bytes(header[start + 24 : start + 32], "big")
    return footer + len(_MXF_KEY) if footer else 0


def _flv_damage(file: BinaryIO) -> int | None:
    """The first byte at which an FLV file lacks a tag. Source: Adobe, Video file format specification 10.1, annex E."""
    file.seek(5)
    position = int.from_bytes(file.read(4), "big") + 4
    for _ in range(MAX_PARTS):
        file.seek(position)
        header = file.read(4)
        if len(header) < 4:
            break
        if header[0] & 0x1F not in _FLV_TAGS:
            return position
        position += 11 + int.from_bytes(header[1:], "big") + 4
    return None
