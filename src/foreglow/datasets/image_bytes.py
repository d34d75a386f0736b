"""Checks that an encoded image is complete and whole, and reads its size: decoders are too tolerant.

OpenCV returns a partly grey picture for a truncated or damaged JPEG (and, before version 5, a truncated PNG), and
allocates whatever size a header claims. For other formats, only the size is read: OpenCV refuses them when they are cut
short.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator

import simplejpeg

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_USED = frozenset({b"tRNS", b"eXIf"})
"""Chunks that are not critical and count: which grey or colour is an opacity, and how the image is turned."""

PNG_END = b"\0\0\0\0IEND\xaeB`\x82"
"""The last chunk of a PNG."""

JPEG_SIGNATURE = b"\xff\xd8\xff"

MAX_SCANS = 100
"""Scans of a JPEG, of which each takes time for all pixels, however few bytes it has; encoders write about ten. It is
libtiff's own limit for JPEGs in a TIFF."""

_PNG_HEADER = struct.Struct(">IIBBBBB")
_PNG_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
"""Bits of a sample by colour type. PNG specification, table 11.1."""

_PNM_SPACE = rb"\s(?:\s|#[^\n]{0,1000}\n){0,100}"
_PNM = re.compile(rb"P[1-6]" + 2 * (_PNM_SPACE + rb"(\d{1,9})") + rb"\s")
_PNM_WHITE = re.compile(rb"P[2356]" + 2 * (_PNM_SPACE + rb"\d{1,9}") + _PNM_SPACE + rb"(\d{1,9})\s")
_PNM_MAX_WHITE = 65535
_TIFF_TYPES = {3: "H", 4: "I", 16: "Q"}
_TIFF_SIZES = {256: "width", 257: "height", 322: "width of a tile", 323: "height of a tile"}
_TIFF_KIND, _TIFF_REDUCED = 254, 1  # NewSubfileType, and its bit of an image that is a smaller copy of another
_TIFF_EXTRA, _TIFF_ALPHA = 338, 2  # ExtraSamples, and its value for an opacity that is not in the colours
_TIFF_BITS, _TIFF_MEANING, _TIFF_WHITE_IS_0 = 258, 262, 0  # BitsPerSample, PhotometricInterpretation
_TIFF_CODING, _TIFF_FORMAT, _TIFF_FLOAT = 259, 339, 3  # Compression, SampleFormat
_TIFF_OTHERS = (_TIFF_KIND, _TIFF_EXTRA, _TIFF_BITS, _TIFF_MEANING, _TIFF_CODING, _TIFF_FORMAT)
_TIFF_CODINGS = {34712: "JPEG 2000", 34925: "LZMA", 50000: "Zstandard", 50001: "WebP", 50002: "JPEG XL"}
_MAX_TIFF_PAGES = 16

ONE_IMAGE = "expected one image, got several in one file; a video or a folder of images has more than one"

_WEBP_ANIMATION = 0x02

GIF_SIGNATURES = (b"GIF87a", b"GIF89a")
BRANDS_OF_PHONES = frozenset({b"heic", b"heix", b"heim", b"heis", b"hevc", b"mif1", b"msf1", b"avif", b"avis"})
"""How a HEIC or AVIF begins, whatever its file is called: phones take such images, and nothing here decodes them."""

_UNREAD = (
    *((signature, "a GIF") for signature in GIF_SIGNATURES),
    (b"P7\n", "PAM"),
    (b"Pf", "a PFM"),
    (b"PF", "a PFM"),
    (b"\0\0\0\x0cjP  ", "JPEG 2000"),
    (b"\xff\x4f\xff\x51", "JPEG 2000"),
    (b"\0\0\0\x0cJXL ", "JPEG XL"),
    (b"\xff\x0a", "JPEG XL"),
    (b"v/1\x01", "OpenEXR"),
    (b"#?RADIANCE", "Radiance HDR"),
)
"""How images begin that nothing here decodes, and what they are."""
_GIF_TABLE, _GIF_TABLE_SIZE = 0x80, 0x07  # bits: whether a table of colours follows, and of how many
_GIF_EXTENSION, _GIF_IMAGE = 0x21, 0x2C

_JPEG_END = b"\xff\xd9"
_JPEG_FIRST, _JPEG_LAST, _JPEG_SCAN = 0xD8, 0xD9, 0xDA
_JPEG_PADDING = re.compile(r"Corrupt JPEG data: [1-4] extraneous bytes before marker 0xd9")
# Of streams, cameras are known that fill up to each marker, and frames without the usual tables, which decoders know.
_MJPEG_USUAL = re.compile(
    r"Corrupt JPEG data: \d{1,2} extraneous bytes before marker 0xd[0-9]|(Huffman|Quantization) table .* not defined"
)
# Start of frame, ITU-T T.81 table B.1: 0xC0..0xCF without the tables DHT (C4), JPG (C8) and DAC (CC).
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
# Markers without a length: TEM, RST0..RST7.
_JPEG_BARE = frozenset({0x01, *range(0xD0, 0xD8)})
# Within the coded data every 0xFF is followed by 0x00 or a restart marker; this is what ends them.
_JPEG_MARKER = re.compile(rb"\xff([\xc0-\xcf\xd8-\xfe])")


def png_size_px(data: bytes) -> tuple[int, int]:
    """Height and width of the PNG in `data`, whose critical chunks are all there and undamaged.

    Raises:
        ValueError: If the file is cut short, or the checksum of a critical chunk is wrong; the message does
            not say where, so that the caller can add it.
    """
    size_px: tuple[int, int] | None = None
    position = len(PNG_SIGNATURE)
    while True:
        # A chunk: length (4 bytes), type (4), data, checksum of type and data (4). PNG specification, section 5.3.
        length = int.from_bytes(data[position : position + 4], "big")
        kind = data[position + 4 : position + 8]
        end = position + 12 + length
        if len(data) < end:
            raise ValueError(f"truncated PNG, expected the chunk IEND, ends at byte {len(data)}")
        is_critical = kind[:1].isupper()
        if is_critical and zlib.crc32(data[position + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
            raise ValueError(f"damaged PNG, wrong checksum of chunk {kind.decode('latin-1')!a} at byte {position}")
        if kind == b"acTL" and int.from_bytes(data[position + 8 : position + 12], "big") > 1:
            raise ValueError(ONE_IMAGE)
        if kind == b"IHDR" and length == _PNG_HEADER.size:
            width, height, depth, colour, *methods = _PNG_HEADER.unpack_from(data, position + 8)
            if depth not in _PNG_DEPTHS.get(colour, ()) or max(methods) > 1:  # libpng would write to stderr
                raise ValueError(f"damaged PNG, expected a kind of pixels, got colour type {colour}, {depth} bits")
            size_px = height, width
        if kind == b"IEND":
            break
        position = end
    if size_px is None:
        raise ValueError("damaged PNG, expected the chunk IHDR")
    return size_px


def without_asides(data: bytes) -> bytes:
    """A whole PNG without what is neither critical nor used, such as a profile of its colours: libpng, which reads it
    all, would write to stderr what it thinks of that.
    """
    kept, position = [data[: len(PNG_SIGNATURE)]], len(PNG_SIGNATURE)
    while position < len(data):
        end = position + 12 + int.from_bytes(data[position : position + 4], "big")
        kind = data[position + 4 : position + 8]
        chunk = data[position:end]
        if kind[:1].isupper() or (kind in _PNG_USED and zlib.crc32(chunk[4:-4]).to_bytes(4, "big") == chunk[-4:]):
            kept.append(chunk)
        if kind == b"IEND":
            break
        position = end
    return b"".join(kept)


def jpeg_size_px(data: bytes) -> tuple[int, int]:
    """Height and width of the JPEG in `data`, which has its end marker.

    Raises:
        ValueError: If the file is cut short or its segments are malformed; the message does not say where.
    """
    size_px: tuple[int, int] | None = None
    position = 2
    while True:
        if position + 4 > len(data):
            raise ValueError(f"truncated JPEG, expected a segment, ends at byte {len(data)}")
        if data[position] != 0xFF:
            raise ValueError(f"damaged JPEG, expected a marker at byte {position}")
        marker = data[position + 1]
        if marker == 0xFF:  # fill byte
            position += 1
            continue
        if marker in _JPEG_BARE:
            position += 2
            continue
        if marker in _JPEG_FRAMES:
            height = int.from_bytes(data[position + 5 : position + 7], "big")
            size_px = height, int.from_bytes(data[position + 7 : position + 9], "big")
        if marker == _JPEG_SCAN:
            break
        position += 2 + max(2, int.from_bytes(data[position + 2 : position + 4], "big"))
    check_scans(data)
    # The end marker is unmistakable within the coded data, as `_JPEG_MARKER` says.
    if data.rfind(_JPEG_END, position) < 0:
        raise ValueError("truncated JPEG, expected the end-of-image marker")
    if size_px is None:
        raise ValueError("damaged JPEG, expected a start-of-frame segment before the scan")
    return size_px


def check_scans(data: bytes) -> None:
    """Passes a JPEG that does not take long to decode for its size.

    Raises:
        ValueError: If it has more than `MAX_SCANS` scans; the message does not say where.
    """
    num_scans, position = 0, 2
    while found := _JPEG_MARKER.search(data, position):
        marker = found[1][0]
        if marker == _JPEG_LAST:
            return
        num_scans += marker == _JPEG_SCAN
        if num_scans > MAX_SCANS:
            raise ValueError(f"expected a JPEG of at most {MAX_SCANS} scans, got more")
        if marker == _JPEG_FIRST:
            position = found.end()
            continue
        position = found.end() + max(2, int.from_bytes(data[found.end() : found.end() + 2], "big"))


def check_jpeg(data: bytes) -> None:
    """Checks that the coded data of a JPEG are what an encoder writes, as far as they can tell: it has no checksum.

    Up to four bytes may lie between them and the end marker, with which some cameras fill their frames.

    Raises:
        ValueError: If libjpeg, which makes a picture of any data, has to leave some out or to guess; the message does
            not say where.
    """
    damage = _damage(data)
    if damage and not _JPEG_PADDING.fullmatch(damage):
        raise ValueError(f"damaged JPEG: {damage.removeprefix('Corrupt JPEG data: ')}")


def has_many_scans(data: bytes) -> bool:
    """Whether a frame of MJPEG may have more than `MAX_SCANS` scans in all its pictures, wherever they begin."""
    return data.count(bytes([0xFF, _JPEG_SCAN])) > MAX_SCANS


def is_damaged_mjpeg(data: bytes, max_pixels: int) -> bool:
    """Whether the coded data of a frame of MJPEG are not what an encoder writes, as for `check_jpeg`.

    False for a frame that libjpeg cannot begin with, or that has more pixels: the stream's own decoder will say so.
    """
    try:
        height, width, *_ = simplejpeg.decode_jpeg_header(data)
    except ValueError:
        return False
    damage = _damage(data) if height * width <= max_pixels else ""
    return bool(damage) and not _MJPEG_USUAL.fullmatch(damage)


def _damage(data: bytes) -> str:
    """What libjpeg says of a JPEG while it decodes it; empty if nothing."""
    try:
        simplejpeg.decode_jpeg(data, colorspace="GRAY")
    except ValueError as error:
        return str(error)
    return ""


def size_px(data: bytes) -> tuple[int, int] | None:
    """Height and width by the header of a PNG, JPEG, TIFF, BMP, PNM or WebP; None for another format, such as a GIF.

    Raises:
        ValueError: If the header cannot be followed; the message says only what is wrong.
    """
    if data.startswith(PNG_SIGNATURE):
        return png_size_px(data)
    if data.startswith(JPEG_SIGNATURE):
        return jpeg_size_px(data)
    try:
        if data.startswith((b"II", b"MM")):
            return _tiff_size_px(data)
        if data.startswith(b"BM"):
            width, height = struct.unpack_from("<ii" if data[14] >= 40 else "<HH", data, 18)
            return abs(height), abs(width)
        if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
            return _webp_size_px(data)
    except (struct.error, IndexError):
        raise ValueError("truncated or damaged, its header ends early") from None
    if data.startswith(GIF_SIGNATURES) and _has_gif_frames(data):
        raise ValueError(ONE_IMAGE)
    if found := _PNM.match(data):
        return int(found[2]), int(found[1])
    return None


def unread_kind(data: bytes) -> str:
    """What kind of image it is, whole or not, of those that nothing here decodes; empty for others."""
    if data[4:8] == b"ftyp" and data[8:12] in BRANDS_OF_PHONES:
        return "HEIC or AVIF"
    return next((kind for signature, kind in _UNREAD if data.startswith(signature)), "")


def odd_tiff(data: bytes) -> str:
    """What is unusual about the values in a TIFF, for which it may not be decoded; empty for other TIFFs and images."""
    if not data.startswith((b"II", b"MM")):
        return ""
    page = next(_tiff_pages(data, *_tiff_start(data)))
    bits, coding = page.get(_TIFF_BITS, 1), page.get(_TIFF_CODING, 1)
    is_float = page.get(_TIFF_FORMAT) == _TIFF_FLOAT
    if coding in _TIFF_CODINGS:
        return f"a TIFF that is compressed by {_TIFF_CODINGS[coding]}"
    if bits not in ((32, 64) if is_float else (1, 8, 16)):
        return f"a TIFF with {'floats' if is_float else 'values'} of {bits} bits"
    return ""


def at_full_scale(data: bytes) -> tuple[bytes, int | None]:
    """A PGM or PPM with 255 or 65535 as its maxval, and the maxval that it had: the value of white; None for others.

    OpenCV scales some values by the maxval and others not; with these it keeps all as they are.

    Raises:
        ValueError: If there is no such value; the message says only what is wrong.

    Source: the pages pgm(5) and ppm(5) of Netpbm.
    """
    if not data.startswith((b"P2", b"P3", b"P5", b"P6")):
        return data, None
    if data.startswith((b"P2", b"P3")):
        data += b"\n"  # OpenCV takes a last number that ends the file for a truncated one
    found = _PNM_WHITE.match(data)
    if found is None or not 1 <= int(found[1]) <= _PNM_MAX_WHITE:
        got = "none" if found is None else int(found[1])
        raise ValueError(f"damaged PGM or PPM, expected a maxval of 1 to {_PNM_MAX_WHITE}, got {got}")
    white = int(found[1])
    full_scale = 255 if white <= 255 else _PNM_MAX_WHITE
    if white == full_scale:
        return data, white
    return b"%s%d%s" % (data[: found.start(1)], full_scale, data[found.end(1) :]), white


def _tiff_size_px(data: bytes) -> tuple[int, int]:
    """Of the image, or of its tiles, decoded whole, if these are larger; smaller copies of it may follow.

    Source: TIFF 6.0, section 2; BigTIFF.
    """
    first, *others = _tiff_pages(data, *_tiff_start(data))
    for page in others:
        if not page.get(_TIFF_KIND, 0) & _TIFF_REDUCED:
            raise ValueError(ONE_IMAGE)
    if first.get(_TIFF_EXTRA) == _TIFF_ALPHA:  # OpenCV would darken what is not opaque
        raise ValueError("expected a TIFF without an opacity (alpha), got one with; save it without")
    if first.get(_TIFF_MEANING) == _TIFF_WHITE_IS_0 and first.get(_TIFF_BITS, 1) > 8:  # OpenCV inverts others
        raise ValueError("expected a TIFF in which 0 is black, got one in which it is white; save it the usual way")
    width, height, tile_width, tile_height = (first.get(tag, 0) for tag in _TIFF_SIZES)
    return max(height, tile_height), max(width, tile_width)


def _tiff_start(data: bytes) -> tuple[str, bool, int]:
    """Byte order, whether it is a BigTIFF, and where its first page is."""
    order = "<" if data.startswith(b"II") else ">"
    is_big = struct.unpack_from(order + "H", data, 2)[0] == 43
    return order, is_big, struct.unpack_from(order + ("Q" if is_big else "I"), data, 8 if is_big else 4)[0]


def _tiff_pages(data: bytes, order: str, is_big: bool, offset: int) -> Iterator[dict[int, int]]:
    """By tag, the sizes of each image of the file, and what kind of image it is."""
    head, step, inside = (8, 20, 12) if is_big else (2, 12, 8)
    for _ in range(_MAX_TIFF_PAGES):
        (num,) = struct.unpack_from(order + ("Q" if is_big else "H"), data, offset)
        num = min(num, len(data) // step)
        values = {}
        for entry in range(offset + head, offset + head + step * num, step):
            tag, kind = struct.unpack_from(order + "HH", data, entry)
            if tag in _TIFF_SIZES and kind not in _TIFF_TYPES:
                raise ValueError(f"damaged TIFF, expected a whole number as {_TIFF_SIZES[tag]}, got type {kind}")
            if tag in _TIFF_SIZES or (tag in _TIFF_OTHERS and kind in _TIFF_TYPES):
                place = entry + inside
                if tag in (_TIFF_BITS, _TIFF_FORMAT) and _tiff_is_apart(data, order, is_big, entry):
                    (place,) = struct.unpack_from(order + ("Q" if is_big else "I"), data, place)
                (values[tag],) = struct.unpack_from(order + _TIFF_TYPES[kind], data, place)
        yield values
        (offset,) = struct.unpack_from(order + ("Q" if is_big else "I"), data, offset + head + step * num)
        if not offset:
            return


def _tiff_is_apart(data: bytes, order: str, is_big: bool, entry: int) -> bool:
    """Whether the values of an entry, one of each channel, lie elsewhere, as they are too many to lie in it."""
    (num,) = struct.unpack_from(order + ("Q" if is_big else "I"), data, entry + 4)
    return bool(num * 2 > (8 if is_big else 4))


def _has_gif_frames(data: bytes) -> bool:
    """Whether a GIF has a second image, as far as it is whole.

    Source: GIF89a, sections 15 to 26.
    """
    num_images, position = 0, 13 + _gif_table_bytes(data[10:11])
    while position < len(data) and data[position] in (_GIF_EXTENSION, _GIF_IMAGE):
        is_image = data[position] == _GIF_IMAGE
        num_images += is_image
        if num_images > 1:
            return True
        position += 11 + _gif_table_bytes(data[position + 9 : position + 10]) if is_image else 2
        while position < len(data) and data[position]:  # parts of up to 255 bytes
            position += 1 + data[position]
        position += 1
    return False


def _gif_table_bytes(flags: bytes) -> int:
    """Bytes of the table of colours that follows, by a byte of flags."""
    has_table = bool(flags) and bool(flags[0] & _GIF_TABLE)
    return 3 << ((flags[0] & _GIF_TABLE_SIZE) + 1) if has_table else 0


def _webp_size_px(data: bytes) -> tuple[int, int]:
    """Source: RFC 9649, sections 2.5 to 2.7, and RFC 6386, section 9.1."""
    kind = data[12:16]
    if kind == b"VP8X":
        if data[20] & _WEBP_ANIMATION:
            raise ValueError(ONE_IMAGE)
        return int.from_bytes(data[27:30], "little") + 1, int.from_bytes(data[24:27], "little") + 1
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return (bits >> 14 & 0x3FFF) + 1, (bits & 0x3FFF) + 1
    width, height = struct.unpack_from("<HH", data, 26)
    return height & 0x3FFF, width & 0x3FFF
