"""What cars are told that take the borders of gaps: never more light than that of the LEDs.

Such a car shines its high beam everywhere but in the gaps, and from low beam it brightens linearly in the ramp r. It is
told no levels. So it may follow a command only if the brightest LED, at the level m at the time t, is at full, or has
risen since the command before (m', t') no slower than the car brightens:

    m = 1   or   m - m' >= (t - t') / r                                                                         (1)

The car begins at 0, and so is never brighter than an LED that keeps (1). Nor may it follow commands once an LED was
dimmed in one without any gap, until all are at full again or there was low beam. In their place it gets low beam.
Our policies and the guard dim LEDs for gaps alone, and light that returns keeps (1).
"""

from __future__ import annotations

from foreglow.geometry import Floats
from foreglow.types import BeamCommand, BeamMode

FULL = 1.0 - 1.0 / 255.0
"""An LED is at full from here on: within a step of the message with levels."""

SLACK_S, LEVEL_SLACK = 1e-6, 1e-6
"""Of (1) and of levels: for what is lost in rounding."""


class GapLight:
    """Follows the commands for cars that take gaps.

    Attributes:
        num_darker: Commands with light so far in whose place such cars got low beam.
    """

    def __init__(self, ramp_s: float) -> None:
        """Takes the ramp that these cars are told."""
        self._ramp_s = ramp_s
        self._is_untold = False
        self._levels: Floats | None = None
        self._time_ns = 0
        self.num_darker = 0

    def told(self, command: BeamCommand) -> BeamCommand:
        """The command as such a car may be told: itself, or low beam."""
        levels, before = command.levels, self._levels
        step_s, self._time_ns, self._levels = (command.timestamp_ns - self._time_ns) / 1e9, command.timestamp_ns, levels
        if before is not None and before.shape != levels.shape:
            before = None
        if command.mode == BeamMode.LOW or levels.min() >= FULL:
            self._is_untold = False
            return command
        most = float(levels.max())
        is_rising = before is not None and 0.0 < step_s <= (most - float(before.max())) * self._ramp_s + SLACK_S  # (1)
        if not len(command.gaps_rad):
            self._is_untold |= before is None or bool((levels < before - LEVEL_SLACK).any())
        if not self._is_untold and (most >= FULL or is_rising):
            return command
        self.num_darker += 1
        return BeamCommand.low(command.timestamp_ns, levels.shape[1], *command.faults)
