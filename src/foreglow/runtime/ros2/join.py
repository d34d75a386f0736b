"""Puts together what belongs to one frame, out of messages that come on several topics, in any order, or not at all."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from foreglow.runtime.ros2.header import Header


class Joined(NamedTuple):
    """The messages of one frame.

    Attributes:
        header: Theirs.
        messages: By topic; a sampled one is missing where none is known.
        received_ns: When the last of those that are needed came, by the caller's clock.
    """

    header: Header
    messages: Mapping[str, Any]
    received_ns: int


class _Parts:
    """What has come of a frame."""

    def __init__(self) -> None:
        self.messages: dict[str, Any] = {}
        self.received_ns = 0


class _Samples:
    """The latest messages of a topic with a time of its own."""

    def __init__(self, capacity: int) -> None:
        self.messages: deque[tuple[int, Any]] = deque(maxlen=capacity)
        self.received_ns = 0


class Join:
    """Gathers messages, and hands out the newest frame that is whole.

    Those on `exact` topics have the header of the image. Those on `sampled` topics have times of their own; a frame
    gets the latest that is not later than it, and not older than `HOLD_NS`. Where a sampled topic is alive but has not
    come up to the frame's time, it is waited for, `PATIENCE_NS` at most: so all nodes take the same sample.

    When a frame is handed out, those that came before it are dropped: the newest wins, and a frame of which a part was
    lost stalls none that follows. No more than `CAPACITY` frames are kept. All times are the caller's clock's, but for
    the headers'.

    Attributes:
        num_dropped: Frames of which something came, and that were passed over.
        is_waiting: Whether a whole frame waits for a sample.
    """

    CAPACITY = 8
    NUM_SAMPLES = 64
    HOLD_NS = 500_000_000
    PATIENCE_NS = 20_000_000

    def __init__(self, exact: Sequence[str], sampled: Sequence[str] = ()) -> None:
        """Takes the names of the topics."""
        self._exact = tuple(exact)
        self._frames: dict[Header, _Parts] = {}  # in the order of their first part
        self._sampled = {topic: _Samples(self.NUM_SAMPLES) for topic in sampled}
        self.num_dropped = 0
        self.is_waiting = False

    def put(self, topic: str, header: Header, message: Any, now_ns: int) -> None:
        """Takes one message that came at `now_ns`."""
        samples = self._sampled.get(topic)
        if samples is not None:
            samples.messages.append((header.timestamp_ns, message))
            samples.received_ns = now_ns
            return
        parts = self._frames.setdefault(header, _Parts())
        parts.messages[topic] = message
        parts.received_ns = now_ns
        while len(self._frames) > self.CAPACITY:
            self._drop(next(iter(self._frames)))

    def take(self, now_ns: int) -> Joined | None:
        """The newest whole frame, by the order of coming; None while there is none, or a sample is waited for."""
        whole = [header for header, parts in self._frames.items() if len(parts.messages) == len(self._exact)]
        if not whole:
            return None
        header = whole[-1]
        parts = self._frames[header]
        self.is_waiting = any(self._is_awaited(one, header, parts, now_ns) for one in self._sampled.values())
        if self.is_waiting:
            return None
        for earlier in list(self._frames):
            if earlier == header:
                break
            self._drop(earlier)
        del self._frames[header]
        messages = dict(parts.messages)
        for topic, samples in self._sampled.items():
            sample = _latest(samples, header.timestamp_ns)
            if sample is not None:
                messages[topic] = sample
        return Joined(header, messages, parts.received_ns)

    @property
    def missing(self) -> tuple[str, ...]:
        """Topics without which no frame that is kept is whole."""
        return tuple(
            topic for topic in self._exact if not any(topic in parts.messages for parts in self._frames.values())
        )

    def _is_awaited(self, samples: _Samples, header: Header, parts: _Parts, now_ns: int) -> bool:
        """Whether a sample nearer to the frame's time is still to be expected."""
        if not samples.messages or now_ns - samples.received_ns > self.HOLD_NS:
            return False
        return samples.messages[-1][0] < header.timestamp_ns and now_ns - parts.received_ns < self.PATIENCE_NS

    def _drop(self, header: Header) -> None:
        del self._frames[header]
        self.num_dropped += 1


def _latest(samples: _Samples, time_ns: int) -> Any | None:
    """The latest sample up to `time_ns` that still holds."""
    for stamp_ns, message in reversed(samples.messages):
        if stamp_ns <= time_ns:
            return message if time_ns - stamp_ns <= Join.HOLD_NS else None
    return None
