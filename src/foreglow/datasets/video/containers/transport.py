"""What a transport stream in a file has lost: packets that are missing, or no packets any more.

FFmpeg's demultiplexer counts, too, but tells only of a loss within what it hands on: not where the beginning of a frame
is missing, nor where it had to look for the next packet. Source: ISO/IEC 13818-1, sections 2.4.3.2 to 2.4.3.5.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

SYNC = 0x47
PACKET_BYTES = 188
PACKETS = ((188, 0), (192, 4), (204, 0))
"""Sizes of a transport stream's packets and where 0x47 stands in them. Source: ISO/IEC 13818-1; BDAV (M2TS); DVB."""

_FILLED = 0x20  # of the fourth byte: there is an adaptation field, which is what fills packets up
_PIECE = 1 << 20  # bytes read at a time
_NUM_SYNCS = 4  # so many packets in a row begin with 0x47 where packets begin again
_LAYOUT_BYTES = 1 << 16  # of the beginning, by which the packets' size is known
_FOREVER = 1 << 62
_MOST_HELD = 256  # packets of video whose place is unknown until that of a later one is known


class Losses(Protocol):
    """Where something of a file is lost."""

    def are_between(self, start: int, stop: int) -> bool:
        """Whether something is lost within these bytes of the file; `start` never goes back."""


class TransportLosses:
    """Where one stream of a file has lost something; reads the file once, in pieces, as far as it is asked for.

    A loss is a packet whose counter does not follow the one before, a packet that the receiver marked as wrong, and
    whatever is no packet. A packet may be there twice, and the counter may begin anew where a packet says so
    (`discontinuity_indicator`). Losses of 16 packets, or multiples, leave no trace in the counter. What the end of a
    frame leaves of its last packet is filled up; so a last packet that is full is one of a frame that was cut, or, by
    chance, of one whole frame in 184.
    """

    def __init__(self, path: Path, pid: int, *, must_be_filled: bool = False) -> None:
        """Opens nothing yet.

        Args:
            path: A file of a transport stream.
            pid: The number of the stream's packets (PID), which FFmpeg calls its id.
            must_be_filled: Whether there is a loss behind a last packet that is full.
        """
        self._path, self._must_be_filled = path, must_be_filled
        self._pid = pid
        self._size = path.stat().st_size
        with path.open("rb") as file:
            self._length, self._offset = _layout(file.read(_LAYOUT_BYTES))
        self._end = 0  # of what has been read
        self._losses: list[tuple[int, int]] = []  # half-open intervals of bytes, in order
        self._last: NDArray[np.uint8] | None = None  # packet of this stream
        self._last_start = 0

    def are_between(self, start: int, stop: int) -> bool:
        """Whether something is lost within these bytes of the file; `start` never goes back."""
        while self._end < min(stop + 2 * self._length, self._size):  # the next packet shows what is lost before it
            self._read_piece()
        self._losses = [loss for loss in self._losses if loss[1] > start]
        return any(loss[0] < stop for loss in self._losses)

    def _read_piece(self) -> None:
        """Looks at the packets of one more piece."""
        base, length = self._end, self._length
        with self._path.open("rb") as file:
            file.seek(base)
            data = np.frombuffer(file.read(_PIECE), np.uint8)
        is_last = base + data.size >= self._size or not data.size
        is_sync = data[self._offset :] == SYNC
        position, stop = 0, data.size - length
        # Packets begin where some in a row begin so; only looked for when it is needed.
        beginnings: NDArray[np.int64] | None = None
        while position <= stop:
            syncs = is_sync[position : stop + 1 : length]
            num_packets = syncs.size if syncs.all() else int(syncs.argmin())
            end = position + num_packets * length
            self._count(data[position:end].reshape(num_packets, length), base + position)
            position = end
            if position > stop:
                break
            if beginnings is None:
                beginnings = _beginnings(is_sync, length)
            index = int(np.searchsorted(beginnings, position))
            if index < beginnings.size:
                position = int(beginnings[index])
                self._lose(base + end, base + position)
                continue
            # The last few may yet be the beginning of a row.
            position = data.size if is_last else max(position + 1, data.size - _NUM_SYNCS * length)
            self._lose(base + end, base + position)
            break
        self._end = self._size if is_last else base + position
        if is_last and self._must_be_filled and self._last is not None and not self._last[3] & _FILLED:
            self._lose(self._last_start, self._size + self._length)

    def _count(self, packets: NDArray[np.uint8], start: int) -> None:
        """Follows the counter of the stream's packets among `packets`, (N, size), which begin at byte `start`."""
        packets = packets[:, self._offset : self._offset + PACKET_BYTES]
        pids = (packets[:, 1] & 0x1F).astype(np.uint16) << 8 | packets[:, 2]
        indices = np.flatnonzero(pids == self._pid)
        ours = packets[indices]
        has_payload = ours[:, 3] & 0x10 != 0
        is_anew = (ours[:, 3] & 0x20 != 0) & (ours[:, 4] > 0) & (ours[:, 5] & 0x80 != 0)
        is_counted = has_payload | is_anew
        indices, ours, is_anew = indices[is_counted], ours[is_counted], is_anew[is_counted]
        if not indices.size:
            return
        starts = start + indices * self._length
        first = ours[0] if self._last is None else self._last
        before = np.concatenate([first[None], ours[:-1]])
        befores = np.concatenate([[starts[0] if self._last is None else self._last_start], starts[:-1]])
        steps = (ours[:, 3] - before[:, 3]) & 0xF
        is_wrong = ours[:, 1] & 0x80 != 0  # transport_error_indicator
        is_lost = ~is_anew & (steps > 1)
        for index in np.flatnonzero(~is_anew & (steps == 0)):  # twice, but for the clock in bytes 6 to 11
            is_same = (ours[index, 12:] == before[index, 12:]).all() and (ours[index, :6] == before[index, :6]).all()
            is_lost[index] = not is_same
        is_lost[0] &= self._last is not None
        for index in np.flatnonzero(is_lost | is_wrong):
            stop = starts[index] + self._length if is_wrong[index] else starts[index]
            self._lose(int(befores[index]), int(stop))
        self._last, self._last_start = ours[-1].copy(), int(starts[-1])

    def _lose(self, start: int, stop: int) -> None:
        """Notes a loss, as one with the loss before if they touch."""
        stop -= self._length - self._offset - PACKET_BYTES  # so much too early FFmpeg places those of 204 bytes
        if self._losses and start <= self._losses[-1][1]:
            before = self._losses.pop()
            start, stop = min(start, before[0]), max(stop, before[1])
        self._losses.append((start, stop))


def with_losses(packets: Iterable[Any], losses: Losses | None) -> Iterator[tuple[Any, bool]]:
    """Each packet of a demultiplexer, one later than it comes, and whether something is lost in its part of the file.

    A packet reaches up to the next whose place is known. Without `losses`, packets come at once, and none is lost.

    Raises:
        FFmpegError: If the container cannot be read any further, after all packets until there.
    """
    from av.error import FFmpegError

    if losses is None:
        yield from ((packet, False) for packet in packets)
        return
    held: list[Any] = []
    start: int | None = None  # what is lost before the first packet is none of its
    error: FFmpegError | None = None
    try:
        for packet in packets:
            place = packet.pos
            if start is None:
                start = place
            elif (place is not None and place > start) or len(held) >= _MOST_HELD:
                stop = start + sum(each.size for each in held) if place is None else max(start, place)
                is_lost = losses.are_between(start, stop)
                yield from ((each, is_lost) for each in held)
                held, start = [], stop
            held.append(packet)
    except FFmpegError as raised:
        error = raised
    is_lost = start is not None and losses.are_between(start, _FOREVER)
    yield from ((each, is_lost and each.size > 0) for each in held)
    if error is not None:
        raise error


def _layout(data: bytes) -> tuple[int, int]:
    """Size of the packets, and where the sync byte stands in them: that by which most of the data begins with one."""
    is_sync = np.frombuffer(data, np.uint8) == SYNC
    shares = []
    for length, offset in PACKETS:
        whole = is_sync[: is_sync.size // length * length].reshape(-1, length)
        shares.append((float(whole.mean(0).max()) if whole.size else 0.0, -length, offset))
    _, length, offset = max(shares)
    return -length, offset


def _beginnings(is_sync: NDArray[np.bool_], length: int) -> NDArray[np.int64]:
    """Where some packets in a row begin with their sync byte."""
    num = max(0, is_sync.size - (_NUM_SYNCS - 1) * length)
    is_row = is_sync[:num].copy()
    for number in range(1, _NUM_SYNCS):
        is_row &= is_sync[number * length : number * length + num]
    return np.flatnonzero(is_row)
