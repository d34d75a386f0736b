"""The paper's policy and the plain beams, beside ours."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from foreglow.beam import POLICIES, make_policy
from foreglow.beam.policy import PaperPolicy, brightness
from foreglow.beam.stage import BeamStage
from foreglow.config import BeamConfig, GuardConfig
from foreglow.types import BeamMode, Frame
from tests.beam.made_up import FRAME_NS, box_around
from tests.beam.policy_scenes import (
    CONFIG,
    LAMP,
    LAMPS,
    LIGHT,
    TENTATIVE,
    S,
    Seen,
    frame,
    holding,
    policy,
    tracks_at,
)


def lit(number: int, *lights: tuple[Seen, int]) -> Frame:
    """A frame in which each light has a brightness."""
    image = np.full((960, 1280), 10, np.uint8)
    for seen, value in lights:
        x1, y1, x2, y2 = box_around(seen.azimuth_rad, -0.005, 0.006).astype(int)
        image[y1:y2, x1:x2] = value
    return dataclasses.replace(frame(number), image=image)


@pytest.mark.parametrize("is_first_brighter", [True, False])
def test_the_paper_sends_the_brightest_plausible_track_alone(is_first_brighter: bool) -> None:
    light = Seen(-0.1, direct=0.1, number=1)
    unproven = Seen(0.2, state=TENTATIVE, number=2)
    values = (220, 140) if is_first_brighter else (140, 220)
    seen = lit(0, (LAMP, values[0]), (light, values[1]), (unproven, 255))
    (gap,) = policy(PaperPolicy).gaps(seen, tracks_at(0, LAMP, light, unproven))
    chosen = LAMP if is_first_brighter else light
    assert holding([gap], chosen.azimuth_rad)
    assert gap.left_rad - gap.right_rad == pytest.approx(0.006 + 2 * math.radians(CONFIG.margin_deg), rel=0.1)
    assert not policy(PaperPolicy).gaps(seen, tracks_at(0, unproven))


@pytest.mark.parametrize(("is_reported", "num_gaps"), [(True, 0), (False, 1), (None, 1)])
def test_the_paper_is_silent_while_the_production_system_reports(is_reported: bool | None, num_gaps: int) -> None:
    seen = dataclasses.replace(lit(0, (LAMP, 220)), is_reported=is_reported)
    assert len(policy(PaperPolicy).gaps(seen, tracks_at(0, LAMP))) == num_gaps


def test_the_paper_has_a_gap_for_a_box_wholly_beside_the_image_without_any_margin() -> None:
    config = BeamConfig(policy="paper", margin_deg=0.0)
    tracks = dataclasses.replace(tracks_at(0, LAMP), boxes_xyxy_px=np.array([[1300.0, 470.0, 1310.0, 480.0]]))
    command = make_policy(config, LAMPS).command(lit(0), tracks)
    assert command.gaps_rad.shape == (1, 2)


def test_brightness_of_boxes() -> None:
    image = np.zeros((20, 30), np.uint8)
    image[5, 7], image[19, 29] = 100, 200
    assert brightness(image, np.array([6.5, 4.2, 8.0, 6.0])) == 100.0
    assert brightness(image, np.array([-5.0, -5.0, 7.5, 5.5])) == 100.0
    assert brightness(image, np.array([25.0, 15.0, 99.0, 99.0])) == 200.0
    assert brightness(image, np.array([31.0, 2.0, 40.0, 9.0])) == 0.0


@pytest.mark.parametrize(("name", "mode", "level"), [("low", BeamMode.LOW, 0.0), ("high", BeamMode.FULL, 1.0)])
def test_plain_beams_look_at_nothing(name: str, mode: BeamMode, level: float) -> None:
    made = make_policy(BeamConfig(policy=name), LAMPS)
    for seen in ((), (LAMP, LIGHT)):
        command = made.command(frame(3), tracks_at(3, *seen))
        assert (command.mode, command.timestamp_ns) == (mode, 3 * FRAME_NS)
        assert (command.levels == level).all()
        assert len(command.gaps_rad) == 0
    made.reset()


def test_policies_have_names() -> None:
    assert isinstance(make_policy(CONFIG, LAMPS), POLICIES["foreglow"])
    with pytest.raises(ValueError, match=r"beam\.policy: expected one of low, high, paper, foreglow, .*got 'none'"):
        make_policy(BeamConfig(), LAMPS)


@pytest.mark.parametrize("name", ["paper", "foreglow"])
@pytest.mark.parametrize("seen", [LAMP, LIGHT], ids=["lamp", "light"])
def test_a_gap_for_what_has_no_range_has_none(name: str, seen: Seen) -> None:
    """It said 40 m, the nearest that such a light is taken to be, and so did the CAN message."""
    for range_m in (100.0, math.nan):
        command = make_policy(CONFIG.model_copy(update={"policy": name}), LAMPS).command(
            frame(0, road=None), tracks_at(0, seen._replace(range_m=range_m))
        )
        assert np.isnan(command.gap_ranges_m).tolist() == [math.isnan(range_m)]
        assert (command.levels < 1.0).any()  # dark as for the nearest


@pytest.mark.parametrize(("restore_s", "brightening_s"), [(2.0, 0.5), (0.5, 2.0), (2.0, 2.0)])
@pytest.mark.parametrize("name", ["high", "paper", "foreglow"])
def test_light_returns_after_low_beam_by_the_slower_of_the_two_times(
    name: str, restore_s: float, brightening_s: float
) -> None:
    config = CONFIG.model_copy(update={"policy": name, "restore_s": restore_s})
    stage = BeamStage(config, GuardConfig(brightening_s=brightening_s))
    for is_damaged in (False, True):  # at the start, and after a fault
        for number in range(40):
            now = 40 * is_damaged + number
            seen = dataclasses.replace(frame(now), is_damaged=is_damaged and not number)
            level = stage.command(seen, tracks_at(now)).levels.max()
            assert level == pytest.approx(min(number * S / 2.0, 1.0), abs=1e-6)
