"""What runs in the network, in one line: frames, losses, the beam, faults, and the slowest parts."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray

from foreglow.plugins import printable, words_of
from foreglow.runtime.ros2 import topics
from foreglow.runtime.ros2.node import Receiver, make_ros_node
from foreglow.runtime.ros2.results import read_beam

PREFIX = "foreglow: "
"""What the names of our nodes begin with in diagnostics."""

STALE_S = 3.0
"""A node that has not reported for so long is `silent`; without a command, or frames, for so long there are none."""

NO_COMMAND = "no command"

MAX_DIGITS = 20
"""Of a number of frames: years of them have fewer."""


class StatusLine:
    """Listens to the nodes' reports and to the beam."""

    def __init__(self, names: Sequence[str], ros_arguments: Sequence[str] = ()) -> None:
        """Joins the network.

        Args:
            names: The nodes that are expected to report.
            ros_arguments: The command line from `--ros-args` on.
        """
        self.ros = make_ros_node("status", ros_arguments)
        self._reports: dict[str, tuple[float, Mapping[str, str]]] = {}
        self._names = names
        self._mode = NO_COMMAND + " yet"
        self._is_commanded, self._commanded_s = False, math.inf
        self._counted: tuple[str, float, int] | None = None  # whose frames, and when there were so many
        self._rate_hz = 0.0
        self.ros.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, self._report, topics.NUM_KEPT)
        beam_quality = topics.subscriber_quality(topics.BEAM, 1)
        self.ros.create_subscription(topics.TYPES[topics.BEAM], topics.BEAM, self._command, beam_quality)
        self._receiver = Receiver(self.ros)

    def receive(self, timeout_s: float) -> None:
        """Takes what comes within `timeout_s`; returns early when something has come."""
        self._receiver.receive(timeout_s)

    def close(self) -> None:
        """Leaves the network."""
        self.ros.destroy_node()

    def text(self, now_s: float) -> str:
        """The line, as of the steady clock's time `now_s`."""
        known = {name: values for name, (at_s, values) in self._reports.items() if now_s - at_s < STALE_S}
        counts = {name: _count_of(values.get("frames", "0")) for name, values in known.items()}
        last = next((name for name in reversed(self._names) if name in counts), None)
        if last is None:
            self._counted, self._rate_hz = None, 0.0
        else:
            self._count(last, now_s, counts[last])
        if self._is_commanded:
            self._is_commanded, self._commanded_s = False, now_s
        elif now_s - self._commanded_s >= STALE_S:
            self._mode = NO_COMMAND
        dropped = {name: values["dropped"] for name, values in known.items() if values.get("dropped", "0") != "0"}
        faults = sorted({fault for values in known.values() for fault in values.get("faults", "").split()})
        starting = [name for name in self._names if name not in self._reports]
        silent = [name for name in self._names if name in self._reports and name not in known]
        parts = [
            f"{0 if last is None else counts[last]} frames, {self._rate_hz:.1f} a second",
            self._mode,
            *([f"dropped {', '.join(f'{name} {number}' for name, number in dropped.items())}"] if dropped else []),
            *([f"faults {', '.join(faults)}"] if faults else []),
            *([f"starting {', '.join(starting)}"] if starting else []),
            *([f"silent {', '.join(silent)}"] if silent else []),
        ]
        return printable("; ".join(parts))

    def _count(self, name: str, now_s: float, count: int) -> None:
        """Brings the rate up to date by the frames of a node: 0 until they were counted twice, and once none come."""
        known = self._counted
        if known is None or known[0] != name or count < known[2]:
            self._counted, self._rate_hz = (name, now_s, count), 0.0
        elif now_s > known[1] and (count > known[2] or now_s - known[1] >= STALE_S):
            self._counted, self._rate_hz = (name, now_s, count), (count - known[2]) / (now_s - known[1])

    def _report(self, message: Any) -> None:
        for status in message.status:
            name = status.name.removeprefix(PREFIX)
            if status.name.startswith(PREFIX) and name in self._names:  # anybody may report
                values = {value.key: value.value for value in status.values}
                self._reports[name] = time.monotonic(), values

    def _command(self, message: Any) -> None:
        self._is_commanded = True
        try:
            self._mode = read_beam(message, topics.BEAM)[1].mode.name.lower().replace("_", "-")
        except ValueError as error:
            self._mode = f"unreadable ({words_of(error)})"


def _count_of(text: str) -> int:
    """The number of frames in a report; 0 where somebody has sent another text."""
    return int(text) if text.isascii() and text.isdecimal() and len(text) < MAX_DIGITS else 0
