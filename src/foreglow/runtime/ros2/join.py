"""Joins the messages of one frame, which arrive on several topics, in any order, or not at all."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
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


class _Sample(NamedTuple):
    """A message with its stamp, and since when it is known: its stamp, but not later than its receipt."""

    stamp_ns: int
    since_ns: int
    message: Any


class _Ahead(NamedTuple):
    """How far a refused message was stamped ahead, and when that was noticed, by the caller's clock."""

    ahead_ns: int
    noticed_ns: int


class _Samples:
    """The latest messages on a sampled topic, each with its own time."""

    def __init__(self, capacity: int) -> None:
        self.messages: deque[_Sample] = deque(maxlen=capacity)
        self.received_ns = 0
        self.ahead: _Ahead | None = None

    def put(self, stamp_ns: int, message: Any, now_ns: int, clock_ns: int | None) -> None:
        """Keeps a message, unless it is stamped ahead of `clock_ns`."""
        if clock_ns is not None and stamp_ns - clock_ns > Join.AHEAD_NS:
            self.ahead = _Ahead(stamp_ns - clock_ns, now_ns)
            return
        self.messages.append(_Sample(stamp_ns, stamp_ns if clock_ns is None else min(stamp_ns, clock_ns), message))
        self.received_ns = now_ns

    def forget_ahead(self, now_ns: int, clock_ns: int) -> None:
        """Forgets the messages that are stamped ahead of a clock that was set back to `clock_ns`."""
        latest_ns = max((sample.stamp_ns for sample in self.messages), default=clock_ns)
        if latest_ns - clock_ns > Join.AHEAD_NS:
            self.ahead = _Ahead(latest_ns - clock_ns, now_ns)
            kept = [sample for sample in self.messages if sample.stamp_ns - clock_ns <= Join.AHEAD_NS]
            self.messages = deque(kept, self.messages.maxlen)


class Join:
    """Collects messages, and returns the newest complete frame.

    Messages on `exact` topics carry the frame's header; a frame is complete when it has one on each of them. Messages
    on `sampled` topics have times of their own: a frame takes the latest one that is not later than the frame and at
    most `HOLD_NS` older. If a sampled topic is active but its latest message is older than the frame, the frame waits
    for the next one, `patience_ns` at most, so that all nodes take the same sample. A frame that is complete meanwhile
    waits for its own, and holds up none that has waited.

    A sample that is stamped more than `AHEAD_NS` later than the headers' clock is never used: kept until its time
    comes, it would be believed long after its publisher died. One that is ahead by less ages from its receipt.

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
    AHEAD_NS = 100_000_000  # a simulated clock may tick at 10 Hz; clocks on a network differ by milliseconds
    PATIENCE_NS = 20_000_000

    def __init__(
        self,
        exact: Sequence[str],
        sampled: Sequence[str] = (),
        *,
        fast: Collection[str] = (),
        patience_ns: int = PATIENCE_NS,
        clock_ns: Callable[[], int] | None = None,
    ) -> None:
        """A join of messages on these topics.

        Args:
            exact: Topics whose messages have the frame's header.
            sampled: Topics whose messages have times of their own.
            fast: Those of the sampled topics that have small messages.
            patience_ns: How long a frame waits for a sample.
            clock_ns: The clock of all headers, such as ROS time; None where there is none, so that no stamp is ahead.
        """
        self._exact = tuple(exact)
        self._frames: dict[Header, _Parts] = {}  # in the order of their first message
        self._patience_ns = patience_ns
        self._sampled = {
            topic: _Samples(self.NUM_FAST_SAMPLES if topic in fast else self.NUM_SAMPLES) for topic in sampled
        }
        self._clock_ns = clock_ns
        self._clock_seen_ns: int | None = None
        self.num_dropped = 0
        self.is_waiting = False

    def put(self, topic: str, header: Header, message: Any, now_ns: int) -> None:
        """Adds a message that was received at `now_ns`."""
        samples = self._sampled.get(topic)
        if samples is not None:
            samples.put(header.timestamp_ns, message, now_ns, self._look_at_clock(now_ns))
            return
        parts = self._frames.setdefault(header, _Parts())
        parts.messages[topic] = message
        parts.received_ns = now_ns
        while len(self._frames) > self.CAPACITY:
            self._drop(next(iter(self._frames)))

    def take(self, now_ns: int) -> Joined | None:
        """The frame that arrived last of those that are complete and wait for no sample; None while there is none."""
        self._look_at_clock(now_ns)
        complete = [header for header, parts in self._frames.items() if len(parts.messages) == len(self._exact)]
        ready = [header for header in complete if not self._waits(header, now_ns)]
        self.is_waiting = complete[-1:] != ready[-1:]
        if not ready:
            return None
        header = ready[-1]
        parts = self._frames[header]
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

    def ahead_s(self, now_ns: int) -> dict[str, float]:
        """The sampled topics on which a message within `HOLD_NS` was stamped ahead, and by how many seconds."""
        return {
            topic: samples.ahead.ahead_ns / 1e9
            for topic, samples in self._sampled.items()
            if samples.ahead is not None and now_ns - samples.ahead.noticed_ns <= self.HOLD_NS
        }

    @property
    def missing(self) -> tuple[str, ...]:
        """The exact topics on which nothing was received for any of the kept frames."""
        return tuple(
            topic for topic in self._exact if not any(topic in parts.messages for parts in self._frames.values())
        )

    def _look_at_clock(self, now_ns: int) -> int | None:
        """The headers' clock; once it was set back, what is ahead of it by now is forgotten."""
        if self._clock_ns is None:
            return None
        clock_ns = self._clock_ns()
        if self._clock_seen_ns is not None and clock_ns < self._clock_seen_ns:
            for samples in self._sampled.values():
                samples.forget_ahead(now_ns, clock_ns)
        self._clock_seen_ns = clock_ns
        return clock_ns

    def _waits(self, header: Header, now_ns: int) -> bool:
        """Whether a complete frame waits for a sample."""
        parts = self._frames[header]
        return any(self._is_awaited(samples, header, parts, now_ns) for samples in self._sampled.values())

    def _is_awaited(self, samples: _Samples, header: Header, parts: _Parts, now_ns: int) -> bool:
        """Whether a sample nearer to the frame's time may still arrive."""
        if not samples.messages or now_ns - samples.received_ns > max(self.HOLD_NS, self._patience_ns):
            return False
        return samples.messages[-1].stamp_ns < header.timestamp_ns and now_ns - parts.received_ns < self._patience_ns

    def _drop(self, header: Header) -> None:
        del self._frames[header]
        self.num_dropped += 1


def _latest(samples: _Samples, time_ns: int) -> Any | None:
    """The latest sample that is not later than `time_ns`, unless it is too old."""
    for sample in reversed(samples.messages):
        if sample.stamp_ns <= time_ns:
            return sample.message if time_ns - sample.since_ns <= Join.HOLD_NS else None
    return None
