"""Joins the messages of one frame, which arrive on several topics, in any order, or not at all."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

from foreglow.runtime.ros2.header import Header


class Joined(NamedTuple):
    """The messages of one frame.

    Attributes:
        header: The frame's header.
        messages: The messages by topic; a sampled topic is missing where no sample is known.
        received_ns: When the last exact message was received, by the caller's clock.
    """

    header: Header
    messages: Mapping[str, Any]
    received_ns: int


class _Parts:
    """The exact messages of a frame that have been received so far."""

    def __init__(self) -> None:
        self.messages: dict[str, Any] = {}
        self.received_ns = 0


class _Samples:
    """The latest messages on a sampled topic, each with its own time."""

    def __init__(self, capacity: int) -> None:
        self.messages: deque[tuple[int, Any]] = deque(maxlen=capacity)
        self.received_ns = 0


class Join:
    """Collects messages, and returns the newest complete frame.

    Messages on `exact` topics carry the frame's header; a frame is complete when it has one on each of them. Messages
    on `sampled` topics have times of their own: a frame takes the latest one that is not later than the frame and at
    most `HOLD_NS` older. If a sampled topic is active but its latest message is older than the frame, the frame waits
    for the next one, `patience_ns` at most, so that all nodes take the same sample.

    When a frame is returned, all older ones are dropped: a frame with a lost message never delays those that follow.
    At most `CAPACITY` frames are kept, and `NUM_SAMPLES` of a sampled topic, or `NUM_FAST_SAMPLES` where they are small
    and may come a thousand times a second: a frame that is late needs one from before those that came since. All times
    are by the caller's clock, except those in headers.

    Attributes:
        num_dropped: Frames that were dropped although some of their messages were received.
        is_waiting: Whether a complete frame waits for a sample.
    """

    CAPACITY = 8
    NUM_SAMPLES, NUM_FAST_SAMPLES = 64, 1000
    HOLD_NS = 500_000_000
    PATIENCE_NS = 20_000_000

    def __init__(
        self,
        exact: Sequence[str],
        sampled: Sequence[str] = (),
        *,
        fast: Collection[str] = (),
        patience_ns: int = PATIENCE_NS,
    ) -> None:
        """A join of messages on these topics; `fast` are those of the sampled ones that have small messages."""
        self._exact = tuple(exact)
        self._frames: dict[Header, _Parts] = {}  # in the order of their first message
        self._patience_ns = patience_ns
        self._sampled = {
            topic: _Samples(self.NUM_FAST_SAMPLES if topic in fast else self.NUM_SAMPLES) for topic in sampled
        }
        self.num_dropped = 0
        self.is_waiting = False

    def put(self, topic: str, header: Header, message: Any, now_ns: int) -> None:
        """Adds a message that was received at `now_ns`."""
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
        """The complete frame that arrived last; None while there is none, or while it waits for a sample."""
        complete = [header for header, parts in self._frames.items() if len(parts.messages) == len(self._exact)]
        if not complete:
            return None
        header = complete[-1]
        parts = self._frames[header]
        self.is_waiting = any(self._is_awaited(samples, header, parts, now_ns) for samples in self._sampled.values())
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
        """The exact topics on which nothing was received for any of the kept frames."""
        return tuple(
            topic for topic in self._exact if not any(topic in parts.messages for parts in self._frames.values())
        )

    def _is_awaited(self, samples: _Samples, header: Header, parts: _Parts, now_ns: int) -> bool:
        """Whether a sample nearer to the frame's time may still arrive."""
        if not samples.messages or now_ns - samples.received_ns > max(self.HOLD_NS, self._patience_ns):
            return False
        return samples.messages[-1][0] < header.timestamp_ns and now_ns - parts.received_ns < self._patience_ns

    def _drop(self, header: Header) -> None:
        del self._frames[header]
        self.num_dropped += 1


def _latest(samples: _Samples, time_ns: int) -> Any | None:
    """The latest sample that is not later than `time_ns`, unless it is too old."""
    for stamp_ns, message in reversed(samples.messages):
        if stamp_ns <= time_ns:
            return message if time_ns - stamp_ns <= Join.HOLD_NS else None
    return None
