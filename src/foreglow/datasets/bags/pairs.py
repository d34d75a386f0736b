"""Which `FrameMessage` of our own recordings belongs to which image."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from foreglow.datasets.bags.containers import Message
from foreglow.datasets.bags.frame_message import FRAME_TYPE, FrameMessage

PAUSE_NS = 1_000_000_000
"""Recorders put sequences whose times do not follow on from each other this far apart."""


class Pair(NamedTuple):
    """An image and the message about it; one of them is None where it is missing."""

    image: Message | None
    record: Message | None


def pairs(messages: Iterable[Message], *, is_complete: bool) -> Iterator[Pair]:
    """Images with the messages of `FRAME_TYPE` next to them that are logged at the same time, before or after.

    The last message of a recording that is not complete may lack its image.
    """
    image: Message | None = None  # its record may come next
    record: Message | None = None  # its image may come next
    for message in messages:
        is_record = message.topic.type == FRAME_TYPE
        waiting = image if is_record else record
        if waiting is not None and waiting.log_time_ns == message.log_time_ns:
            yield Pair(waiting, message) if is_record else Pair(message, waiting)
            image = record = None
            continue
        if image is not None or record is not None:
            yield Pair(image, record)
        image, record = (None, message) if is_record else (message, None)
    if image is not None or (record is not None and is_complete):
        yield Pair(image, record)


class TimeShift:
    """Checks that messages are about their images: in a sequence, all images are later by the same time.

    That time is 0, unless the recorder had to put the sequence `PAUSE_NS` behind the one before.
    """

    def __init__(self) -> None:
        self._latest: tuple[str, int, int] | None = None  # sequence, time of the image, shift

    def check(self, record: FrameMessage, image_ns: int) -> None:
        """Passes a message whose image was taken at `image_ns`.

        Raises:
            ValueError: If it is about an image of another time; the message starts with the field.
        """
        sequence, latest_ns, expected_ns = self._latest or ("", 0, 0)
        shift_ns = image_ns - record.timestamp_ns
        if self._latest is None or record.sequence != sequence:
            expected_ns = 0
            if shift_ns > 0 and image_ns - latest_ns >= PAUSE_NS and (self._latest or shift_ns >= PAUSE_NS):
                expected_ns = shift_ns
        if shift_ns != expected_ns:
            raise ValueError(
                f"{FRAME_TYPE}: timestamp_ns: expected {image_ns - expected_ns}, as its image has, "
                f"got {record.timestamp_ns}"
            )
        self._latest = record.sequence, image_ns, shift_ns
