"""A model of the lamps' end of the bus: what they shine at any time, and low beam when the commands are not right."""

from __future__ import annotations

from collections import Counter, deque
from typing import Annotated

import numpy as np
from pydantic import Field

from foreglow.beam.messages import (
    LEVELS_IDS,
    NUM_COUNTS,
    NUM_TIMES_MS,
    Header,
    LevelsMessage,
    LevelsPart,
    LinkFault,
    MessageError,
    check_frame,
    decode_part,
    join_levels,
    time_ms,
)
from foreglow.config import FrozenModel
from foreglow.geometry import Floats
from foreglow.photometry import NUM_LEDS
from foreglow.types.arrays import check_optional, checked_time_ns


class ReceiverConfig(FrozenModel):
    """Parameters of the lamps' end.

    Attributes:
        deadline_s: Time from the latest valid and fresh command until the lamps go to low beam.
        max_age_s: A command whose image is older on arrival is late, by a clock that lamps and camera share. None
            without such a clock: then only the order is checked. Together with the deadline it makes the 0.5 s within
            which an approval text for adaptive beams wants them dimmed.
        max_counter_step: Largest step of the counter from one command to the next; a command after a larger step is
            not carried out, but the one after it may be.
        num_good: Valid and fresh commands in a row that end low beam, after a first one to compare with.
        latency_s: Time from the arrival of a command to its light.
        brightening_s: Time of an LED from dark to full, linear; 0 for at once. Dimming is at once.
    """

    deadline_s: Annotated[float, Field(gt=0, le=10)] = 0.2
    max_age_s: Annotated[float | None, Field(gt=0, le=10)] = 0.3
    max_counter_step: Annotated[int, Field(ge=1, lt=NUM_COUNTS // 2)] = 3
    num_good: Annotated[int, Field(ge=1, le=100)] = 3
    latency_s: Annotated[float, Field(ge=0, le=10)] = 0.0
    brightening_s: Annotated[float, Field(ge=0, le=60)] = 0.0


class LampReceiver:
    """Both lamps; takes the frames of the bus in the order of arrival. All times are of one clock and never go back.

    Attributes:
        noticed: Number of times that each fault has been noticed.
    """

    def __init__(self, config: ReceiverConfig | None = None) -> None:
        """Lamps at low beam; without a configuration, with the defaults.

        Raises:
            ValueError: If the configuration is none.
        """
        check_optional("config", config, ReceiverConfig)
        self._config = config or ReceiverConfig()
        self._deadline_ns = round(self._config.deadline_s * 1e9)
        self._latency_ns = round(self._config.latency_s * 1e9)
        self._now_ns: int | None = None
        self.noticed: Counter[LinkFault] = Counter()
        self._faults: dict[LinkFault, None] = {LinkFault.TIMEOUT: None}
        self._parts: dict[int, LevelsPart] = {}
        self._latest: Header | None = None
        self._num_good = 0
        self._taken_ns: int | None = None
        self._coming: deque[tuple[int, Floats]] = deque()
        self._target = np.zeros((2, NUM_LEDS))
        self._levels = np.zeros((2, NUM_LEDS))

    @property
    def is_low(self) -> bool:
        """Whether the lamps are at low beam because no valid and fresh commands come."""
        return self._taken_ns is None

    def receive(self, arrival_ns: int, frame_id: int, data: bytes | bytearray | memoryview) -> None:
        """Takes a frame; frames other than those with levels are ignored.

        Raises:
            ValueError: If the time goes back, or is no whole number of nanoseconds, the identifier is no whole number
                or the data are no bytes; then nothing changes.
        """
        frame_id = check_frame(frame_id, data)
        self._advance(arrival_ns)
        if frame_id not in LEVELS_IDS:
            return
        try:
            message = self._collected(decode_part(frame_id, bytes(data)))
        except MessageError as error:
            self._notice(error.fault)
            self._num_good = 0
            return
        if message is not None:
            self._judge(message, arrival_ns)

    def shining(self, time_ns: int) -> tuple[Floats, tuple[LinkFault, ...]]:
        """The LEDs' levels at a time, shape (2, L), and the faults noticed since the command behind them.

        Raises:
            ValueError: If the time goes back, or is no whole number of nanoseconds.
        """
        self._advance(time_ns)
        return self._levels.copy(), tuple(self._faults)

    def _advance(self, time_ns: int) -> None:
        """Advances to a time: low beam if the deadline has passed by then, and changes of light that are due."""
        time_ns = checked_time_ns("time_ns", time_ns)
        if self._now_ns is not None and time_ns < self._now_ns:
            raise ValueError(f"time_ns: expected {self._now_ns} or later, got {time_ns}")
        if self._taken_ns is not None and time_ns - self._taken_ns > self._deadline_ns:
            self._coming.append((self._taken_ns + self._deadline_ns + self._latency_ns, np.zeros_like(self._target)))
            self._notice(LinkFault.TIMEOUT)
            self._taken_ns, self._latest = None, None
        while self._coming and self._coming[0][0] <= time_ns:
            change_ns, target = self._coming.popleft()
            self._brighten(change_ns)
            self._target, self._levels = target, np.minimum(self._levels, target)
        self._brighten(time_ns)

    def _brighten(self, time_ns: int) -> None:
        if not self._config.brightening_s:
            self._levels = self._target.copy()
        elif self._now_ns is not None:
            step = (time_ns - self._now_ns) / (self._config.brightening_s * 1e9)
            self._levels = np.minimum(self._levels + step, self._target)
        self._now_ns = time_ns

    def _collected(self, part: LevelsPart) -> LevelsMessage | None:
        """The whole command if `part` completes it, else None.

        Raises:
            MessageError: If the part belongs to no acceptable command, or leaves another command incomplete.
        """
        if part.header == self._latest:
            raise MessageError(LinkFault.REPEATED, f"part {part.number}: expected another command")
        known = next(iter(self._parts.values())).header if self._parts else part.header
        step = (part.header.counter - known.counter) % NUM_COUNTS
        if step >= NUM_COUNTS // 2 and not self.is_low:  # at low beam, the sender may have been restarted
            raise MessageError(LinkFault.DISORDER, f"part {part.number}: expected no older command")
        if part.header != known:
            self._parts = {part.number: part}
            raise MessageError(LinkFault.TORN, f"part {part.number}: expected the rest of the command before")
        if part.number in self._parts:
            raise MessageError(LinkFault.REPEATED, f"part {part.number}: expected it once")
        self._parts[part.number] = part
        if len(self._parts) < len(LEVELS_IDS):
            return None
        message = join_levels(self._parts.values())
        self._parts.clear()
        return message

    def _judge(self, message: LevelsMessage, arrival_ns: int) -> None:
        """Accepts a whole command, or notices what is wrong with it."""
        header, fault = message.header, self._fault(message.header, arrival_ns)
        if self.is_low or self._latest is None:
            is_good = fault is None and self._latest is not None
            self._num_good = self._num_good + 1 if is_good else 0
            self._latest = header
        elif fault is None or fault == LinkFault.LOST:
            self._latest = header
        elif fault == LinkFault.STALE:  # the next command has to be newer than the newest so far
            self._latest = header._replace(time_ms=self._latest.time_ms)
        if fault is not None:
            self._notice(fault)
        elif not self.is_low or self._num_good >= self._config.num_good:
            self._taken_ns = arrival_ns
            self._coming.append((arrival_ns + self._latency_ns, message.levels))
            self._faults = {LinkFault.SENDER: None} if header.has_faults else {}

    def _fault(self, header: Header, arrival_ns: int) -> LinkFault | None:
        """What is wrong with a command's counter or time; None if it is the next command, and fresh."""
        age_ms = (time_ms(arrival_ns) - header.time_ms) % NUM_TIMES_MS
        if self._config.max_age_s is not None and age_ms > self._config.max_age_s * 1e3:
            return LinkFault.LATE
        if self._latest is None:
            return None
        step = (header.counter - self._latest.counter) % NUM_COUNTS
        if step == 0:
            return LinkFault.REPEATED
        if step >= NUM_COUNTS // 2:
            return LinkFault.DISORDER
        if not 0 < (header.time_ms - self._latest.time_ms) % NUM_TIMES_MS < NUM_TIMES_MS // 2:
            return LinkFault.STALE
        if step > self._config.max_counter_step:
            return LinkFault.LOST
        if step > 1:  # tolerated, but counted
            self.noticed[LinkFault.LOST] += 1
        return None

    def _notice(self, fault: LinkFault) -> None:
        self.noticed[fault] += 1
        self._faults[fault] = None
