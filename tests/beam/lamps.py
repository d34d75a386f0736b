"""Commands to the lamps' receiver, and what it shines then."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from foreglow.beam.messages import CanFrame, encode_gaps, encode_levels
from foreglow.beam.receiver import LampReceiver, ReceiverConfig
from foreglow.photometry import NUM_LEDS
from foreglow.types import BeamCommand, BeamMode

MS = 1_000_000
PERIOD = 55 * MS
DEADLINE = 200 * MS
START = 65_500 * MS  # so that the messages' time comes round in most tests


def frames_of(
    number: int, *, counter: int | None = None, image: int | None = None, level: float = 1.0, fault: bool = False
) -> tuple[CanFrame, ...]:
    """The frames of command `number`, of an image `image` periods after the start."""
    time_ns = START + (number if image is None else image) * PERIOD
    if fault:
        command = BeamCommand.low(time_ns, NUM_LEDS, "camera_frozen")
    else:
        command = BeamCommand(time_ns, BeamMode.FULL, np.full((2, NUM_LEDS), float(level)))
    return encode_levels(command, (250 + number if counter is None else counter) % 256)


def arrival(number: int) -> int:
    """Each command arrives 20 ms after its image."""
    return START + number * PERIOD + 20 * MS


def feed(receiver: LampReceiver, frames: Iterable[CanFrame], arrival_ns: int) -> None:
    for frame in frames:
        receiver.receive(arrival_ns, *frame)


def running(count: int = 10, config: ReceiverConfig | None = None) -> LampReceiver:
    """A receiver that has taken commands 0 to `count - 1`."""
    receiver = LampReceiver(config)
    for number in range(count):
        feed(receiver, frames_of(number), arrival(number))
    return receiver


def brightness(receiver: LampReceiver, time_ns: int) -> float:
    levels, _ = receiver.shining(time_ns)
    assert levels.shape == (2, NUM_LEDS)
    assert (levels == levels[0, 0]).all()
    return float(levels[0, 0])


def is_dark_by(receiver: LampReceiver, taken_ns: int) -> bool:
    """Whether there is light up to the deadline after `taken_ns`, and none after it."""
    assert brightness(receiver, taken_ns + DEADLINE) > 0
    return brightness(receiver, taken_ns + DEADLINE + 1) == 0


def only_gaps(number: int) -> Sequence[CanFrame]:
    return [encode_gaps(BeamCommand.low(START + number * PERIOD, NUM_LEDS), number)]


def other_frames(number: int) -> Sequence[CanFrame]:
    return [CanFrame(0x123, data) for _, data in frames_of(number)]
