"""The command to our headlamps."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from foreglow.numbers import checked_whole
from foreglow.types.arrays import Value, checked_array, checked_time_ns
from foreglow.wording import shortened

_FLOAT64 = np.dtype(np.float64)

MAX_BORDER_RAD = 2 * math.pi
"""A full turn: every bearing, and every gap around one, ends before it."""


MAX_FAULTS, MAX_FAULT_LENGTH = 100, 100
"""Names of faults in a command, and characters of each: they are stored with every frame."""


def fault_name(name: str) -> str:
    r"""A name that a command takes, for any text.

    >>> fault_name("map_lost"), fault_name(""), fault_name("a\nb")
    ('map_lost', 'unnamed', 'a?b')
    """
    return "".join(letter if letter.isprintable() else "?" for letter in name[:MAX_FAULT_LENGTH]) or "unnamed"


class BeamMode(IntEnum):
    """The kind of beam."""

    LOW = 0
    """Low beam alone: all LEDs above it are off."""
    GLARE_FREE = 1
    """High beam with dark gaps, or with LEDs that are dimmed or not back yet."""
    FULL = 2
    """High beam without gaps, all LEDs at 1."""


@dataclass(frozen=True, slots=True, eq=False)
class BeamCommand(Value):
    """The command to our matrix headlamps.

    Attributes:
        timestamp_ns: Time of exposure of the frame that it follows from, nanoseconds.
        mode: A `BeamMode`; with LOW all levels are 0, and only GLARE_FREE has gaps.
        levels: Shape (2, L), float64 in [0, 1], left and right lamp, one for each LED above the low beam, numbered as
            in the lamp description.
        gaps_rad: Shape (G, 2), float64, right and left border of each dark gap: azimuths to the left in the vehicle's
            frame, at most a full turn; right < left, gaps from right to left, without overlap.
        gap_ranges_m: Shape (G,), float64, from the vehicle's origin to the vehicle that each gap protects, not
            negative; NaN where unknown.
        faults: Names of the faults for which low beam replaces the wanted beam; empty without faults.

    Raises:
        ValueError: If a type, a shape or a dtype is wrong, the time is no whole number of 64 bits, there is no such
            mode, a level is outside [0, 1] or NaN, gaps are not in order, a range is negative or infinite, a fault is
            no name of a line of at most `MAX_FAULT_LENGTH` characters, there are more than `MAX_FAULTS`, LOW has light
            above the low beam, or FULL has gaps.
    """

    timestamp_ns: int
    mode: BeamMode
    levels: NDArray[np.float64]
    gaps_rad: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    gap_ranges_m: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    faults: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        timestamp_ns = checked_time_ns("BeamCommand.timestamp_ns", self.timestamp_ns)
        if not isinstance(self.mode, BeamMode):
            raise ValueError(f"BeamCommand.mode: expected a BeamMode, got {shortened(self.mode)}")
        if not isinstance(self.faults, tuple) or not all(isinstance(fault, str) for fault in self.faults):
            raise ValueError(f"BeamCommand.faults: expected a tuple of names, got {shortened(self.faults)}")
        if len(self.faults) > MAX_FAULTS:
            raise ValueError(f"BeamCommand.faults: expected at most {MAX_FAULTS} names, got {len(self.faults)}")
        for fault in self.faults:
            if not (fault.isprintable() and 0 < len(fault) <= MAX_FAULT_LENGTH):
                expected = f"names of 1 to {MAX_FAULT_LENGTH} characters on a line"
                raise ValueError(f"BeamCommand.faults: expected {expected}, got {shortened(fault)}")
        levels = checked_array("BeamCommand.levels", self.levels, _FLOAT64, (2, None))
        gaps = checked_array("BeamCommand.gaps_rad", self.gaps_rad, _FLOAT64, (None, 2))
        ranges_m = checked_array("BeamCommand.gap_ranges_m", self.gap_ranges_m, _FLOAT64, (len(gaps),))
        if not levels.size:
            raise ValueError("BeamCommand.levels: expected at least one LED, got none")
        if not (np.minimum.reduce(levels, axis=None) >= 0.0 and np.maximum.reduce(levels, axis=None) <= 1.0):
            raise ValueError("BeamCommand.levels: expected values in [0, 1], got NaN or a value outside")
        if len(gaps):
            _check_gaps(gaps, ranges_m)
        if self.mode == BeamMode.LOW and (len(gaps) or levels.any()):
            raise ValueError("BeamCommand.levels: expected 0 everywhere, and no gaps, with low beam")
        if self.mode == BeamMode.FULL and len(gaps):
            raise ValueError(f"BeamCommand.gaps_rad: expected none with full beam, got {len(gaps)}")
        object.__setattr__(self, "timestamp_ns", timestamp_ns)
        for name, array in (("levels", levels), ("gaps_rad", gaps), ("gap_ranges_m", ranges_m)):
            object.__setattr__(self, name, array)

    @classmethod
    def low(cls, timestamp_ns: int, num_leds: int, *faults: str) -> BeamCommand:
        """Low beam, with the faults that it is commanded for, the first `MAX_FAULTS` of them.

        Raises:
            ValueError: If the time, the number of LEDs a lamp or a fault is none.
        """
        num_leds = checked_whole("num_leds", num_leds, 1)
        return cls(timestamp_ns, BeamMode.LOW, np.zeros((2, num_leds)), faults=faults[:MAX_FAULTS])


def _check_gaps(gaps_rad: NDArray[np.float64], ranges_m: NDArray[np.float64]) -> None:
    borders = gaps_rad.ravel()
    if not (borders[1:] > borders[:-1]).all() or not (borders[0] >= -MAX_BORDER_RAD and borders[-1] <= MAX_BORDER_RAD):
        raise ValueError(
            f"BeamCommand.gaps_rad: expected borders in order and apart, at most a full turn, got {shortened(gaps_rad)}"
        )
    if (ranges_m < 0).any() or np.isinf(ranges_m).any():
        raise ValueError(f"BeamCommand.gap_ranges_m: expected numbers of at least 0, or NaN, got {shortened(ranges_m)}")
