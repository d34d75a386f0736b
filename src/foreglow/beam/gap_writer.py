"""From gaps to commands."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from foreglow.beam.dimming import Dimmer, Ramp
from foreglow.beam.gaps import Gap, merged
from foreglow.beam.questions import DIP
from foreglow.config import BeamConfig
from foreglow.photometry import Headlamps
from foreglow.types import BeamCommand, BeamMode
from foreglow.types.arrays import check_kind
from foreglow.wording import shortened


class GapWriter:
    """Turns gaps into commands, frame by frame: dims the LEDs at once and lets them return slowly."""

    def __init__(self, config: BeamConfig, headlamps: Headlamps) -> None:
        self._dimmer = Dimmer(headlamps, config.led_limit_lx)
        self._ramp = Ramp(config.hold_s, config.restore_s)

    def reset(self) -> None:
        """Forgets earlier levels."""
        self._ramp.reset()

    def command(self, timestamp_ns: int, gaps: Sequence[Gap], dips: Sequence[Gap] = ()) -> BeamCommand:
        """High beam with `gaps`, and with shallow `dips`, which end at once.

        Raises:
            ValueError: If there is something else than gaps, or borders or ranges of one are not in order, or one is
                NaN, as ranges of tracks may be.
        """
        for gap in (*gaps, *dips):
            check_kind("gaps", gap, Gap)
            if not (gap.right_rad < gap.left_rad and 0.0 <= gap.near_m <= gap.far_m):
                expected = "right_rad < left_rad and 0 <= near_m <= far_m, infinite where unknown"
                raise ValueError(f"gaps: expected {expected}, got {shortened(gap)}")
        apart = merged(list(gaps))
        levels = self._ramp.step(self._dimmer.levels(apart), timestamp_ns)
        if dips:
            levels = np.minimum(levels, np.maximum(self._dimmer.levels(dips), 1.0 - DIP))
        mode = BeamMode.FULL if not apart and levels.min() >= 1.0 else BeamMode.GLARE_FREE
        borders = np.array([gap[:2] for gap in apart], np.float64).reshape(-1, 2)
        is_known = [gap.has_range and math.isfinite(gap.near_m) for gap in apart]
        ranges_m = np.where(is_known, np.array([gap.near_m for gap in apart], np.float64), math.nan)
        return BeamCommand(timestamp_ns, mode, levels, borders, ranges_m)
