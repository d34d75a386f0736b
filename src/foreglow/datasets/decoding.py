"""The pictures of a coded stream, and which of them its decoder knows to be damaged."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from av.codec.context import Flags
from av.error import EOFError as StreamEnd
from av.error import FFmpegError


def decoded(container: Any, stream: Any) -> Iterator[tuple[Any | None, bool]]:
    """Each picture, and whether it is damaged; then None if packets at the end gave no picture because of damage.

    Damaged are the pictures from a packet that is cut, incomplete or undecodable on, because each is coded as what
    differs from those before, until the next key frame. A demultiplexer may tell of a loss one packet early, hence a
    key frame counts only if the packet before it was whole, too. A stream without further key frames (intra refresh)
    stays damaged. A packet that cannot be decoded does not end the stream.

    Raises:
        FFmpegError: If the container cannot be read any further.
    """
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
