"""Beam commands as hypothesis draws them."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import strategies as st

from foreglow.photometry import NUM_LEDS
from foreglow.types import BeamCommand, BeamMode

levels = st.integers(0, 255).map(lambda code: code / 255) | st.floats(0, 1)
ranges_m = st.just(math.nan) | st.floats(0.1, 3000) | st.integers(1, 600).map(lambda code: 2.0 * code)
azimuths_rad = st.floats(-1.5, 1.5) | st.integers(-520, 520).map(lambda code: math.radians(0.04 * code))


@st.composite
def commands(draw: st.DrawFn) -> BeamCommand:
    """Any command for 2 x 84 LEDs."""
    mode = draw(st.sampled_from(BeamMode))
    timestamp_ns = draw(st.integers(-(10**12), 2 * 10**18))
    faults = tuple(draw(st.lists(st.sampled_from(["a", "b"]), max_size=1)))
    if mode == BeamMode.LOW:
        return BeamCommand.low(timestamp_ns, NUM_LEDS, *faults)
    few = draw(st.lists(levels, min_size=1, max_size=12))
    shuffled = np.random.default_rng(draw(st.integers(0, 2**16))).choice(few, (2, NUM_LEDS))
    max_borders = 14 if mode == BeamMode.GLARE_FREE else 0
    borders = sorted(draw(st.lists(azimuths_rad, max_size=max_borders, unique=True)))
    gaps = np.array(borders[: len(borders) // 2 * 2], np.float64).reshape(-1, 2)
    told_m = draw(st.lists(ranges_m, min_size=len(gaps), max_size=len(gaps)))
    return BeamCommand(timestamp_ns, mode, shuffled, gaps, np.array(told_m, np.float64), faults)
