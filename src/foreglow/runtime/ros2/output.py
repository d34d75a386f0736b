"""Sends beam commands to their topic and to the CAN bus, and low beam when no input comes in time."""

from __future__ import annotations

import time
from typing import Any

from foreglow.config import PipelineConfig
from foreglow.photometry import read_headlamps
from foreglow.runtime.can_output import CanBus
from foreglow.runtime.live import LiveFault
from foreglow.runtime.live.outlet import Outlet
from foreglow.runtime.ros2 import topics
from foreglow.runtime.ros2.header import Header
from foreglow.runtime.ros2.node import INPUT_MISSING, STAMPED_AHEAD, UNHEARD, FrameNode
from foreglow.runtime.ros2.results import beam_message
from foreglow.types import BeamCommand

DEADLINE_FRAMES = 1.9
"""Low beam after so many frame periods without input: less than two."""


class BeamOutput:
    """Sends beam commands; once input is overdue, sends low beam once a frame period until input comes again."""

    def __init__(
        self,
        node: FrameNode[Any],
        config: PipelineConfig,
        *,
        can: CanBus | None = None,
        deadline_s: float | None = None,
    ) -> None:
        """Makes the publisher, and starts the deadline.

        Args:
            node: The node that commands; its `faults` are kept up to date.
            config: The pipeline's configuration; `tracker.rate_hz` is the frame rate.
            can: The bus; None without one.
            deadline_s: Longest time without input; None for `DEADLINE_FRAMES`.
        """
        self._num_leds = read_headlamps(config.beam.headlamps).num_leds
        self._publisher = node.publisher(topics.BEAM)
        self._faults, self._note = node.faults, node.note
        self._clock_ns = node.clock_ns
        self._can = None if can is None else Outlet(can)
        self._frame_ns = round(1e9 / config.tracker.rate_hz)
        self._deadline_ns = round(DEADLINE_FRAMES * self._frame_ns if deadline_s is None else deadline_s * 1e9)
        self._due_ns = time.monotonic_ns() + self._deadline_ns

    def arrived(self) -> tuple[str, ...]:
        """Restarts the deadline, as input has come; the faults that this ends, or that last, for the guard to know."""
        missed = tuple(
            fault for fault in (INPUT_MISSING, LiveFault.BUS, UNHEARD, STAMPED_AHEAD) if fault in self._faults
        )
        self._faults.discard(INPUT_MISSING)
        self._due_ns = time.monotonic_ns() + self._deadline_ns
        return missed

    def update(self, now_ns: int) -> None:
        """Commands low beam if input is overdue at `now_ns`, by the steady clock."""
        if now_ns >= self._due_ns:
            self._faults.add(INPUT_MISSING)
            self._due_ns = now_ns + self._frame_ns
            self.low(Header(self._clock_ns()), INPUT_MISSING)

    def low(self, header: Header, fault: str) -> None:
        """Commands low beam because of `fault`."""
        self.send(header, BeamCommand.low(header.timestamp_ns, self._num_leds, fault))

    def send(self, header: Header, command: BeamCommand) -> None:
        """Sends a command, to the bus first."""
        if self._can is not None:
            self._send_can(self._can, command)
        self._publisher.publish(beam_message(header, command))

    def close(self) -> None:
        """Commands low beam and closes the bus."""
        self.low(Header(self._clock_ns()), "stopped")
        if self._can is not None:
            self._can.close()

    def _send_can(self, can: Outlet, command: BeamCommand) -> None:
        failure = can.send(command)
        if failure:
            self._note(LiveFault.BUS, OSError(failure))
        else:
            self._faults.discard(LiveFault.BUS)
