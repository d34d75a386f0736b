"""What cars are told that take the borders of gaps: no more light than that of the LEDs."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.beam.gap_light import FULL, GapLight
from foreglow.beam.interface import BeamPolicy
from foreglow.beam.messages import CommandEncoder, decode_gaps
from foreglow.beam.stage import BeamStage
from foreglow.config import GuardConfig
from foreglow.types import BeamCommand, BeamMode, Frame, Tracks
from tests.beam.made_up import FRAME_NS, frame_at
from tests.beam.policy_scenes import CONFIG, LAMP, S, tracks_at

NUM_LEDS = 6
GAP = np.array([[-0.1, 0.1]])


def command(number: int, levels: Any, gaps_rad: Any = None) -> BeamCommand:
    """Glare-free, with levels for both lamps or one for all LEDs; low beam where all are off."""
    levels = np.broadcast_to(np.asarray(levels, np.float64), (2, NUM_LEDS)).copy()
    if not levels.any():
        return BeamCommand.low(number * FRAME_NS, NUM_LEDS)
    gaps_rad = np.zeros((0, 2)) if gaps_rad is None else gaps_rad
    return BeamCommand(number * FRAME_NS, BeamMode.GLARE_FREE, levels, gaps_rad, np.full(len(gaps_rad), np.nan))


def is_told(ramp_s: float, commands: Iterable[BeamCommand]) -> list[bool]:
    """Of each command, whether it is said as it is."""
    light = GapLight(ramp_s)
    told = [(light.told(one), one) for one in commands]
    assert all(said is one or said.mode == BeamMode.LOW for said, one in told)
    assert light.num_darker == sum(said is not one for said, one in told)
    return [said is one for said, one in told]


class Dimmed(BeamPolicy):
    """As in `docs/extending.md`: a third of high beam while there is a track, and no gaps."""

    def __init__(self, config: Any, headlamps: Any) -> None:  # noqa: ARG002
        self.num_leds = headlamps.num_leds

    def command(self, frame: Frame, tracks: Tracks) -> BeamCommand:
        level = 1 / 3 if tracks.is_plausible.any() else 1.0
        return BeamCommand(frame.timestamp_ns, BeamMode.GLARE_FREE, np.full((2, self.num_leds), level))


def modes(stage: BeamStage, *, is_there: range) -> list[tuple[BeamMode, BeamMode, float]]:
    """Over 80 frames: the mode commanded, that of the compact message, and the greatest level."""
    encoder, found = CommandEncoder(has_levels=False), []
    for number in range(80):
        passed = stage.command(frame_at(number), tracks_at(number, *([LAMP] if number in is_there else [])))
        (frame,) = encoder.frames(passed)
        found.append((passed.mode, decode_gaps(*frame).header.mode, float(passed.levels.max())))
    return found


def test_a_beam_that_is_dimmed_as_a_whole_is_low_beam_where_levels_are_not_told() -> None:
    found = modes(BeamStage(CONFIG, GuardConfig(), Dimmed), is_there=range(30, 50))
    assert {said for _, said, level in found[:30] if level} == {BeamMode.GLARE_FREE, BeamMode.FULL}
    assert {(wanted, said) for wanted, said, _ in found[30:50]} == {(BeamMode.GLARE_FREE, BeamMode.LOW)}
    assert BeamMode.LOW not in {said for _, said, _ in found[50:]}  # it returns within the ramp


@pytest.mark.parametrize(("name", "restore_s"), [("foreglow", 0.5), ("paper", 0.5), ("high", 0.5), ("foreglow", 0.2)])
def test_our_policies_and_light_that_returns_are_told_as_they_are(name: str, restore_s: float) -> None:
    config = CONFIG.model_copy(update={"policy": name, "restore_s": restore_s})
    for there in (range(30, 50), range(5, 50), range(0), range(80)):
        assert all(wanted == said for wanted, said, _ in modes(BeamStage(config, GuardConfig()), is_there=there))


def test_light_that_rises_more_slowly_than_the_ramp_is_told_once_it_is_full() -> None:
    levels = [0.0, *np.minimum(np.arange(1, 40) * S / 1.0, 1.0)]
    assert is_told(0.6, [command(number, level) for number, level in enumerate(levels)]) == [
        level in (0.0, 1.0) for level in levels
    ]
    assert all(is_told(1.0, [command(number, level) for number, level in enumerate(levels)]))


def test_an_led_that_is_dimmed_without_a_gap_cannot_be_told() -> None:
    """Until all are at full again, or there was low beam; a gap for something else changes nothing."""
    part = np.ones((2, NUM_LEDS))
    part[1, 2] = 0.2
    untold = [command(1, part), command(2, part), command(3, part, GAP)]
    assert is_told(0.6, [command(0, 1.0), *untold, command(4, 1.0)]) == [True, False, False, False, True]
    with_gap = [command(1, part, GAP), command(2, part, GAP), command(3, part)]  # it opens, and has closed
    assert is_told(0.6, [command(0, 1.0), *with_gap, command(4, 1.0)]) == [True] * 5
    assert is_told(0.6, [command(0, part)]) == [False]
    assert is_told(0.6, [command(0, 1.0), command(1, part), command(2, 0.0), command(3, 0.1)])[2:] == [True, True]


def test_lamps_of_another_number_of_leds_begin_anew() -> None:
    light = GapLight(0.6)
    light.told(command(0, 1.0))
    other = BeamCommand(FRAME_NS, BeamMode.GLARE_FREE, np.full((2, 3), 0.5), GAP, np.array([np.nan]))
    assert light.told(other).mode == BeamMode.LOW
    assert light.told(other).levels.shape == (2, 3)


@settings(derandomize=True, max_examples=200, deadline=None)
@given(
    st.lists(st.tuples(st.floats(0, 1), st.booleans(), st.integers(0, 300)), min_size=1, max_size=40),
    st.sampled_from([0.0, 0.2, 0.6, 3.0]),
)
def test_a_car_that_takes_gaps_is_never_brighter_than_the_brightest_led(
    steps: list[tuple[float, bool, int]], ramp_s: float
) -> None:
    """Whatever is commanded: at each command, before it acts on it, unless it then is told low beam; and after."""
    light, time_ms, shone, is_lit = GapLight(ramp_s), 0, 0.0, False
    for level, is_full, step_ms in steps:
        time_ms += step_ms
        one = BeamCommand.low(time_ms * 10**6, NUM_LEDS)
        if is_full or level:
            levels = np.full((2, NUM_LEDS), 1.0 if is_full else level)
            one = BeamCommand(time_ms * 10**6, BeamMode.GLARE_FREE, levels, GAP, np.array([50.0]))
        if is_lit:
            shone = min(shone + step_ms / 1e3 / ramp_s, 1.0) if ramp_s else 1.0
        is_lit = light.told(one).mode != BeamMode.LOW
        shone = shone if is_lit else 0.0
        most = 1.0 if one.levels.max() >= FULL else float(one.levels.max())
        assert shone <= most + 1e-3
