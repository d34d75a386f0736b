"""The pictures of a coded stream, upright and grey, and which of them its decoder knows to be damaged."""

from __future__ import annotations

import errno
import functools
import math
import zlib
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.datasets.image_bytes import has_many_scans, is_damaged_mjpeg
from foreglow.datasets.images import MAX_SIDE_PX, Chroma, if_coloured, red_chroma
from foreglow.datasets.video.coded_units import has_forbidden_bytes, size_bytes_of
from foreglow.datasets.video.containers.transport import Losses, with_losses
from foreglow.datasets.video.h264_numbers import H264Numbers
from foreglow.datasets.video.unshown import Unshown
from foreglow.types import Image
from foreglow.types.frame import COLOURLESS

FILM_FORMATS = (
    *(
        "mov",
        "matroska",
        "avi",
        "mpegts",
        "mpeg",
        "asf",
        "flv",
        "mxf",
        "nut",
        "ogg",
        "ivf",
        "dv",
        "dhav",
        "cine",
        "mlv",
    ),
    *("mpegvideo", "m4v", "h264", "hevc", "av1", "obu", "mjpeg", "yuv4mpegpipe"),
)
"""FFmpeg's names of the containers and raw streams that cameras and recorders write. FFmpeg knows 300 more, among them
text art, which takes any prose for a video, and play lists, which open other files."""

CODEC_OPTIONS = {"max_pixels": str(MAX_SIDE_PX**2)}
"""A decoder takes memory for a picture before anyone can ask for its size; it refuses larger ones itself."""

_WHOLE_RANGE = 2
"""FFmpeg's number for pictures whose values reach from 0 to 255."""


def video_streams(container: Any) -> list[Any]:
    """The video streams but for cover pictures."""
    from av.stream import Disposition

    return [each for each in container.streams.video if not each.disposition & Disposition.attached_pic]


def video_stream(container: Any, name: str) -> Any:
    """The first video stream of what is called `name`, with `CODEC_OPTIONS`; a cover picture is none.

    Raises:
        ValueError: If there is none, or no decoder for it.
    """
    streams = video_streams(container)
    if not streams:
        raise ValueError(f"{name}: expected a video stream, it has none")
    stream = streams[0]
    if stream.codec_context is None:
        raise ValueError(f"{name}: expected a known video codec, no decoder here for stream {stream.index}")
    stream.codec_context.options = CODEC_OPTIONS
    return stream


def decoded(container: Any, stream: Any, losses: Losses | None = None) -> Iterator[tuple[Any | None, bool]]:
    """Each picture, and whether it is damaged; None if packets at the end gave no picture because of damage.

    Damaged are the pictures from a packet that is cut, incomplete or undecodable on, because each is coded as what
    differs from those before, until the next key frame. A demultiplexer may tell of a loss one packet early, hence a
    key frame counts only if the packet before it was whole, too. A stream without further key frames (intra refresh)
    stays damaged. A packet that cannot be decoded does not end the stream. Damaged are also the pictures before the
    first key frame, of a stream that is joined between two: some decoders take grey for what they have not seen. So is
    a picture of FFV1 with a wrong checksum, one of MJPEG of which libjpeg or FFmpeg has to guess a part, one of H.264
    or H.265 with bytes that may not be there, and those of H.264 after a missing frame; FFmpeg tells of none but in its
    log. Of the codecs that `Unshown` knows, None also comes for each picture that the decoder leaves out, with the next
    key frame. With `losses`, damaged are also the pictures from a packet on in whose part of the file something is
    lost; as this is known exactly, the next key frame ends it.

    One thread decodes: where several decode a frame each, FFmpeg gives a picture of H.264 away before it knows what is
    wrong with it, or not, as the threads have it; where they share a frame, it does not say at all.

    Raises:
        FFmpegError: If the container cannot be read any further.
    """
    from av.codec.context import Flags
    from av.error import EOFError as StreamEnd
    from av.error import FFmpegError

    codec = stream.codec_context
    if codec.name == "mjpeg":
        codec.options = {**codec.options, "err_detect": "explode"}
    codec.thread_type = "NONE"
    codec.flags |= Flags.copy_opaque  # pictures carry the number of their packet
    checksums = _Ffv1Checksums() if codec.name == "ffv1" else None
    numbers = H264Numbers(codec.extradata) if codec.name == "h264" else None
    damaged, broken, key, latest = -math.inf, -math.inf, -math.inf, -1  # numbers of packets
    first_keys: set[int] = set()
    has_units = codec.name in ("h264", "hevc")
    size_bytes = size_bytes_of(codec.name, codec.extradata)
    unshown = Unshown(codec.codec.canonical_name, codec.extradata)
    for number, (packet, is_broken) in enumerate(with_losses(_packets(container, stream), losses)):
        packet.opaque = (number,)  # PyAV knows it by its address, and a small number has the same one in every thread
        if is_broken:
            broken = number
        if key < 0 and packet.is_keyframe:
            first_keys.add(number)
            if packet.is_discard:  # an edit list shows only what comes later
                key = number
        data = bytes(packet) if packet.size else b""
        if codec.name == "mjpeg" and has_many_scans(data):
            damaged = number
            continue
        is_wrong = bool(packet.is_corrupt)
        if checksums is not None and data:
            is_wrong |= checksums.are_wrong(data)
        if numbers is not None and data:
            is_wrong |= numbers.are_broken(data)
        if has_units and data:
            is_wrong |= has_forbidden_bytes(data, size_bytes)
        if codec.name == "mjpeg" and data:
            is_wrong |= is_damaged_mjpeg(data, MAX_SIDE_PX**2)
        if is_wrong:
            damaged = number
        # Two fields are one picture.
        if data and not packet.is_discard and not (numbers is not None and numbers.is_field):
            unshown.await_picture(number, data)
        try:
            pictures = packet.decode()
        except StreamEnd:
            break
        except FFmpegError:
            damaged = number
            pictures = _leniently_decoded(codec, packet)
        for picture in pictures:
            origin = number if picture.opaque is None else picture.opaque[0]
            if picture.is_corrupt:
                damaged = max(damaged, origin)
            if picture.key_frame or (key < 0 and origin in first_keys):  # some decoders mark no picture
                key = origin
            latest = max(latest, origin)
            for _ in unshown.lost_before(origin, is_key=key == origin):
                yield None, True
            yield picture, damaged >= key - 1 or broken >= key
    if unshown.numbers:
        for _ in unshown.numbers:
            yield None, True
    elif max(damaged, broken) > latest:
        yield None, True


def _packets(container: Any, stream: Any) -> Iterator[Any]:
    """The packets of `stream`.

    Raises:
        FFmpegError: If the container cannot be read any further.
    """
    from av.error import InvalidDataError

    try:
        yield from container.demux(stream)
    except IndexError as error:  # PyAV does not know streams that begin later, such as where an encoder was restarted
        raise InvalidDataError(errno.EINVAL, "another stream begins") from error


def _leniently_decoded(codec: Any, packet: Any) -> list[Any]:
    """The picture of a packet that `codec`, which may be strict, has refused; only MJPEG has it in one packet."""
    from av import CodecContext
    from av.error import FFmpegError

    if codec.name != "mjpeg":
        return []
    lenient: Any = CodecContext.create("mjpeg", "r")
    lenient.options = {name: value for name, value in codec.options.items() if name != "err_detect"}
    lenient.flags |= codec.flags
    try:
        return list(lenient.decode(packet))
    except FFmpegError:
        return []


class _Ffv1Checksums:
    """The checksums of slices of FFV1, which its decoder notes in its log only: it fills the slice from before.

    Each slice ends in its size without this end (24 bits), an error status and a checksum, with which the checksum of
    the whole slice is what it began with. Streams without checksums end in the size alone.
    Source: RFC 9043, sections 4.9.1 to 4.9.3; a later version begins with another value.
    """

    _END = 8
    _BEGINNINGS = (0, 0x7A8C4079)
    _MIRRORED = bytes(int(f"{value:08b}"[::-1], 2) for value in range(256))

    def __init__(self) -> None:
        self._have_been_seen = False

    def are_wrong(self, data: bytes) -> bool:
        """Whether a slice of this packet is wrong; never before a packet has had slices with checksums."""
        slices, end = [], len(data)
        while end >= self._END:
            start = end - self._END - int.from_bytes(data[end - self._END : end - self._END + 3], "big")
            if start < 0:
                break
            slices.append(data[start:end])
            end = start
        if end:
            return self._have_been_seen
        self._have_been_seen = True
        return not all(self._is_right(each.translate(self._MIRRORED)) for each in slices)

    def _is_right(self, mirrored: bytes) -> bool:
        """By zlib's checksum, which takes bits in the other order and inverts them before and after."""
        for beginning in self._BEGINNINGS:
            value = int(f"{beginning:032b}"[::-1], 2)
            if zlib.crc32(mirrored, value ^ 0xFFFFFFFF) ^ 0xFFFFFFFF == value:
                return True
        return False


def grey_image(picture: Any) -> Image:
    """The picture as it is shown, turned and mirrored by its display matrix: uint8, or uint16 if it has more bits.

    Raises:
        ValueError: If the display matrix is more than quarter turns and mirroring; the message does not say where.
    """
    deep = max(component.bits for component in picture.format.components) > 8
    image: Image = _upright(picture, picture.to_ndarray(format="gray16le" if deep else "gray"))
    return image


def picture_chroma(picture: Any) -> Chroma | None:
    """As `images.red_chroma`, of a picture as it is shown; None for one without colour.

    Taken from the chroma as it was coded, whose matrix may be that of BT.709: what is red has up to a tenth less then.
    Pictures that were coded as R, G and B have that of an image.

    Raises:
        ValueError: If the display matrix is more than quarter turns and mirroring; the message does not say where.
    """
    if len(picture.format.components) < 3:
        return None
    if picture.format.is_rgb:
        deep = max(component.bits for component in picture.format.components) > 8
        return red_chroma(_upright(picture, picture.to_ndarray(format="rgb48le" if deep else "rgb24")))
    halved = picture if picture.format.name in ("yuv420p", "yuvj420p") else picture.reformat(format="yuv420p")
    size = (-(-picture.height // 2), -(-picture.width // 2))
    blue, red = (
        np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)[: size[0], : size[1]] for plane in halved.planes[1:]
    )
    is_whole = halved.format.name == "yuvj420p" or halved.color_range == _WHOLE_RANGE
    scale = 1.0 if is_whole else 255 / 224
    chroma = cv2.addWeighted(red, scale, blue, scale / 2, COLOURLESS * (1.0 - 1.5 * scale))
    return if_coloured(np.asarray(_upright(picture, chroma), np.uint8))


@functools.cache
def _side_data() -> Any:
    """PyAV's data beside a picture, also where some is of a kind that it does not know, as FFmpeg's newer one, Exif."""
    from av.sidedata.sidedata import SideDataContainer, Type

    Type._missing_ = classmethod(_of_unknown_kind)  # type: ignore[method-assign, assignment]
    return SideDataContainer


def _of_unknown_kind(kinds: Any, value: object) -> Any:
    """A member of an enumeration for a value that it does not name."""
    member = object.__new__(kinds)
    member._name_, member._value_ = f"UNKNOWN_{value}", value
    return member


def _upright(picture: Any, image: Any) -> NDArray[Any]:
    """An image of the picture, turned and mirrored by its display matrix."""
    # Not `picture.side_data`, by which the two hold each other: pictures would pile up until Python looks for cycles.
    matrix = _side_data()(picture).get("DISPLAYMATRIX")
    if matrix is not None:
        # A pixel at (x, y) is shown at (a x + c y, b x + d y), but for an offset. Source: libavutil/display.h.
        a, b, _, c, d, *_ = (np.frombuffer(bytes(matrix), np.int32) / (1 << 16)).tolist()
        if a == d == 0 and abs(b) == abs(c) == 1:
            image = image.T[:: int(b), :: int(c)]
        elif b == c == 0 and abs(a) == abs(d) == 1:
            image = image[:: int(d), :: int(a)]
        else:
            raise ValueError(f"display matrix: expected quarter turns and mirroring, got {[[a, c], [b, d]]}")
    return np.ascontiguousarray(image)
