"""The closed loop: its delays, and the policies to compare with."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest

from foreglow.beam import Gap, GapWriter
from foreglow.config import BeamConfig
from foreglow.geometry import Floats
from foreglow.lab.simulation import DriveFrame
from foreglow.lab.studies.glare.loop import Delays, Shone, both, closed_loops, exact_gaps
from foreglow.photometry import NUM_LEDS, read_headlamps
from foreglow.types import BeamCommand, BeamMode, FrameResult, Proposals
from tests.lab.studies.glare_scenes import first_frame, scene

pytestmark = [pytest.mark.renderer, pytest.mark.slow]


class Constant:
    """A car that always wants the same levels."""

    def __init__(self, levels: Floats) -> None:
        self._levels = levels

    def step(self, known: DriveFrame) -> tuple[FrameResult, BeamCommand]:
        now_ns = known.frame.timestamp_ns
        result = FrameResult(known.frame.frame, now_ns, Proposals(np.zeros((0, 4), np.int32)), None)
        return result, BeamCommand(now_ns, BeamMode.GLARE_FREE, self._levels)

    def lit(self, known: DriveFrame, levels: Floats) -> Floats:  # noqa: ARG002
        return levels


@functools.cache
def loop(delays: Delays, num: int = 12) -> list[Shone]:
    car = Constant(np.full((2, NUM_LEDS), 0.6))
    return [shone for (shone,) in closed_loops(scene(num / 18), [car], delays, "fast")]


@pytest.mark.parametrize(("camera_s", "lamp_s"), [(0.02, 0.0), (0.02, 0.1), (0.0, 0.1)])
def test_light_follows_after_the_delays(camera_s: float, lamp_s: float) -> None:
    """The receiver wants four commands (one to compare with, three good ones), then the lamps' latency passes."""
    shone = loop(Delays(camera_s=camera_s, lamp_s=lamp_s))
    first = next(place for place, one in enumerate(shone) if one.levels.any())
    lit_s = 3 / 18 + camera_s + lamp_s
    assert first == math.ceil(lit_s * 18 - 1e-6)
    assert shone[first].levels.max() == pytest.approx(0.6, abs=1 / 255)
    assert shone[first].levels.max() <= 0.6


def test_light_follows_from_one_frame_of_a_pair_to_the_other() -> None:
    """Frames are where their times are: 0.02 s after the first of a pair its command is there, not before."""
    pairs = scene(12 / 10, rate_hz=10.0, pair_s=0.03)
    car = Constant(np.full((2, NUM_LEDS), 0.6))
    shone = [one for (one,) in closed_loops(pairs, [car], Delays(camera_s=0.02, lamp_s=0.0), "fast")]
    times_s = [one.known.frame.timestamp_ns / 1e9 for one in shone]
    first = next(place for place, one in enumerate(shone) if one.levels.any())
    assert times_s[:4] == [0.0, 0.03, 0.2, 0.23]
    assert first == 4  # 0.23 s + 0.02 s, by 0.4 s
    early = [one for (one,) in closed_loops(pairs, [car], Delays(camera_s=0.05, lamp_s=0.0), "fast")]
    assert next(place for place, one in enumerate(early) if one.levels.any()) == 4


def test_commands_may_take_longer_than_a_frame() -> None:
    assert loop(Delays(camera_s=0.12, lamp_s=0.0))[-1].levels.any()


def test_commands_that_come_too_late_end_in_low_beam() -> None:
    assert not any(one.levels.any() for one in loop(Delays(camera_s=0.4, lamp_s=0.0), num=14))


def test_images_are_lit_by_what_was_commanded() -> None:
    """The picture of the closed loop brightens when the light comes."""
    shone = loop(Delays(camera_s=0.02, lamp_s=0.0))
    means = [float(one.known.frame.image.mean()) for one in shone]
    first = next(place for place, one in enumerate(shone) if one.levels.any())
    assert means[first] > max(means[:first]) + 0.3


def test_exact_gaps_hold_the_body() -> None:
    known = first_frame()
    (gap,) = exact_gaps(known, known.vehicles[:1])
    x, y, _ = known.ego_pose.to_body(known.vehicles[0].eye_world_m)
    assert gap.right_rad < math.atan2(y, x) < gap.left_rad
    assert gap.near_m < math.hypot(x, y) < gap.far_m


def test_the_papers_lamps_obey_the_production_system_while_it_reports() -> None:
    writer = GapWriter(BeamConfig(), read_headlamps())
    production = writer.command(1, [Gap(0.0, 0.1, 50.0, 60.0)]).levels
    provident = np.full((2, NUM_LEDS), 0.5)
    assert both(production, True, provident) is production
    assert (both(production, False, provident) <= provident).all()
