"""The pictures of a coded stream, upright and grey, and which of them its decoder knows to be damaged."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from foreglow.types import Image

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


def decoded(container: Any, stream: Any) -> Iterator[tuple[Any | None, bool]]:
    """Each picture, and whether it is damaged; then None if packets at the end gave no picture because of damage.

    Damaged are the pictures from a packet that is cut, incomplete or undecodable on, because each is coded as what
    differs from those before, until the next key frame. A demultiplexer may tell of a loss one packet early, hence a
    key frame counts only if the packet before it was whole, too. A stream without further key frames (intra refresh)
    stays damaged. A packet that cannot be decoded does not end the stream.

    Raises:
        FFmpegError: If the container cannot be read any further.
    """
    from av.codec.context import Flags
    from av.error import EOFError as StreamEnd
    from av.error import FFmpegError

    stream.codec_context.flags |= Flags.copy_opaque  # pictures carry the number of their packet
    damaged, key, latest = -math.inf, -1, -1  # numbers of packets
    for number, packet in enumerate(container.demux(stream)):
        packet.opaque = number
        if packet.is_corrupt:
            damaged = number
        try:
            pictures = packet.decode()
        except StreamEnd:
            break
        except FFmpegError:
            damaged = number
            continue
        for picture in pictures:
            origin = number if picture.opaque is None else picture.opaque
            if picture.is_corrupt:
                damaged = max(damaged, origin)
            if picture.key_frame:
                key = origin
            latest = max(latest, origin)
            yield picture, damaged >= key - 1
    if damaged > latest:
        yield None, True


def grey_image(picture: Any) -> Image:
    """The picture as it is shown, turned and mirrored by its display matrix: uint8, or uint16 if it has more bits.

    Raises:
        ValueError: If the display matrix is more than quarter turns and mirroring; the message does not say where.
    """
    from av.sidedata.sidedata import SideDataContainer

    deep = max(component.bits for component in picture.format.components) > 8
    image: Any = picture.to_ndarray(format="gray16le" if deep else "gray")
    # Not `picture.side_data`, by which the two hold each other: pictures would pile up until Python looks for cycles.
    matrix = SideDataContainer(picture).get("DISPLAYMATRIX")  # type: ignore[call-arg]
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
