"""Whether a light is our own: scenes in closed loop, in which a light follows our lamps or does not."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections import deque
from typing import Any

import numpy as np
import pytest

from foreglow.beam.own_light import OURS, evidence
from foreglow.beam.policy import ForeglowPolicy
from foreglow.beam.questions import AGAIN_S, ASK_S, DIP
from foreglow.beam.stage import BeamStage
from foreglow.config import BeamConfig, GuardConfig
from foreglow.photometry import read_headlamps
from foreglow.types import BeamCommand, BeamMode, EgoMotion, Frame, Image, Tracks, TrackState
from foreglow.types.kinds import kinds_of_direct
from tests.beam.made_up import FRAME_NS, IMAGES, box_around, frame_at, tracks_of

LAMPS = read_headlamps()
CONFIG = BeamConfig(policy="foreglow", ask=True)
LATENCY = math.ceil(CONFIG.latency_s * 1e9 / FRAME_NS)
AZIMUTH_RAD, RANGE_M = 0.04, 80.0
SIGN_RAD, ROAD_RAD = 0.02, -0.03


def grey_of(light: float) -> float:
    """The response of the configuration, forwards."""
    black, knee, slope = CONFIG.response
    return black + (light if light <= knee else knee + slope * math.log1p((light - knee) / slope))


def share_shone(levels: np.ndarray[Any, Any], elevation_rad: float) -> float:
    """The share of our full light at the place of the light."""
    along = RANGE_M * math.cos(elevation_rad)
    place = (along * math.cos(AZIMUTH_RAD), along * math.sin(AZIMUTH_RAD), 1.35 + RANGE_M * math.sin(elevation_rad))
    base, leds = LAMPS.illuminance_lx([place])
    return float((base[0] + (leds[0] * levels).sum()) / (base[0] + leds[0].sum()))


def image_with(light: float, elevation_rad: float, seed: int) -> tuple[Image, Any]:
    box = box_around(AZIMUTH_RAD, elevation_rad, 0.012)
    image = IMAGES[seed] // 6
    x1, y1, x2, y2 = np.rint(box).astype(int)
    image[y1:y2, x1:x2] = min(round(grey_of(light)), 240)
    return image, box


class Drive:
    """A light ahead, and the policy's lamps, in closed loop."""

    def __init__(
        self, *, ours: bool, elevation_rad: float = SIGN_RAD, tells: bool = True, flicker: float = 0.0, **fields: Any
    ) -> None:
        self.policy = ForeglowPolicy(CONFIG.model_copy(update=fields), LAMPS)
        self._ours, self._elevation_rad, self._tells = ours, elevation_rad, tells
        self._flicker = flicker * np.random.default_rng(5).standard_normal(200)
        self._levels = deque([np.ones((2, LAMPS.num_leds))] * LATENCY)
        self.number = 0

    def step(self, direct: float = 0.05, state: TrackState = TrackState.CONFIRMED) -> BeamCommand:
        """The command for the next frame."""
        shone = self._levels.popleft()
        grown = 90.0 * math.exp(0.01 * self.number + self._flicker[self.number])
        share = share_shone(shone, self._elevation_rad) if self._ours else 1.0
        image, box = image_with(grown * share, self._elevation_rad, self.number % 3)
        frame = dataclasses.replace(frame_at(self.number), image=image)
        command = self.policy.command(frame, self._tracks(frame, box, direct, state))
        if self._tells:
            self.policy.shone(command)
        self._levels.append(command.levels)
        self.number += 1
        return command

    def _tracks(self, frame: Frame, box: Any, direct: float, state: TrackState) -> Tracks:
        tracks = tracks_of([box], [RANGE_M], ages_s=1.0 + frame.timestamp_ns / 1e9, states=[state])
        confidence = 0.9 if self.number > 12 else 0.1
        return dataclasses.replace(
            tracks, light_kinds=kinds_of_direct(np.array([direct])), confidences=np.full(1, confidence)
        )

    def commands(self, num: int = 40) -> list[BeamCommand]:
        return [self.step() for _ in range(num)]


def gaps_of(commands: list[BeamCommand]) -> list[int]:
    return [number for number, command in enumerate(commands) if len(command.gaps_rad)]


def dips_of(commands: list[BeamCommand]) -> list[int]:
    return [number for number, command in enumerate(commands) if command.levels.min() < 1 and not len(command.gaps_rad)]


def test_what_follows_our_lamps_gets_a_dip_and_no_gap() -> None:
    commands = Drive(ours=True).commands()
    assert not gaps_of(commands)
    dips = dips_of(commands)
    assert 2 <= len(dips) <= ASK_S * 18 + 1
    assert min(commands[number].levels.min() for number in dips) == pytest.approx(1 - DIP)
    assert all(commands[number].mode == BeamMode.GLARE_FREE for number in dips)


def test_a_question_is_put_to_its_end() -> None:
    """Also where the light is no longer plausible: it may be the dip that does it."""
    drive = Drive(ours=True)
    drive.commands(13)
    asked = [drive.step(), *(drive.step(state=TrackState.TENTATIVE) for _ in range(5))]
    assert [command.levels.min() < 1 for command in asked] == [True, True, True, False, False, False]


def test_it_is_asked_again_after_a_while() -> None:
    dips = dips_of(Drive(ours=True).commands(110))
    pauses = [later - earlier for earlier, later in itertools.pairwise(dips) if later - earlier > 1]
    assert pauses
    assert min(pauses) >= AGAIN_S * 18 - 1


def test_the_light_of_a_vehicle_gets_its_gap_after_the_answer() -> None:
    asking, plain = Drive(ours=False).commands(), Drive(ours=False, ask=False).commands()
    delay_s = (gaps_of(asking)[0] - gaps_of(plain)[0]) / 18
    assert dips_of(asking)
    assert 0 < delay_s <= CONFIG.latency_s + ASK_S + 1 / 18 + 1e-6
    assert gaps_of(asking)[-1] == gaps_of(plain)[-1]  # and keeps it, as the gap is a dip as well


def test_a_lamp_never_waits() -> None:
    drive = Drive(ours=False)
    assert len(drive.commands(13)[-1].gaps_rad) == 0
    assert dips_of([drive.step()]) == [0]  # the question is put
    command = drive.step(direct=0.95)
    assert len(command.gaps_rad) == 1
    fresh = Drive(ours=False)
    assert gaps_of([fresh.step(direct=0.95) for _ in range(20)]) == gaps_of(
        [plain.step(direct=0.95) for plain in [Drive(ours=False, ask=False)] for _ in range(20)]
    )


def test_in_the_light_of_the_low_beam_nothing_is_asked() -> None:
    """It is known beforehand that the answer would say nothing."""
    asking, plain = (Drive(ours=True, elevation_rad=ROAD_RAD, ask=ask).commands() for ask in (True, False))
    assert not dips_of(asking)
    assert gaps_of(asking) == gaps_of(plain)


def test_a_light_that_flickers_gets_its_gap_at_once() -> None:
    """As that of a vehicle does that runs along a rail: the answer would be lost in it."""
    asking, plain = (Drive(ours=False, flicker=0.4, ask=ask).commands() for ask in (True, False))
    assert not dips_of(asking)
    assert gaps_of(asking) == gaps_of(plain)


def test_without_knowing_what_was_shone_every_question_ends_in_a_gap() -> None:
    assert gaps_of(Drive(ours=True, tells=False).commands())


def test_without_ask_the_policy_is_what_it_was() -> None:
    assert not dips_of(Drive(ours=True, ask=False).commands())


def test_a_reset_forgets_all_questions() -> None:
    drive = Drive(ours=True)
    drive.commands()
    drive.policy.reset()
    drive.number = 0
    again, fresh = drive.commands(30), Drive(ours=True).commands(30)
    assert dips_of(again) == dips_of(fresh)


@pytest.mark.parametrize("fault", ["slow", "damaged", "no camera"])
def test_a_fault_during_a_question_means_low_beam(fault: str) -> None:
    """The policy is told so, and goes on."""
    stage = BeamStage(CONFIG, GuardConfig())
    asked: list[int] = []
    for number in range(60):
        image, box = image_with(90.0, SIGN_RAD, number % len(IMAGES))
        frame = dataclasses.replace(frame_at(number), image=image)
        tracks = tracks_of([box], [RANGE_M], ages_s=1.0 + number / 18)
        confidences = np.full(1, 0.9 if number > 30 else 0.1)
        tracks = dataclasses.replace(tracks, light_kinds=kinds_of_direct(np.array([0.05])), confidences=confidences)
        is_bad = bool(asked)
        if is_bad:
            frame = {
                "slow": dataclasses.replace(frame, motion=EgoMotion(5.0, 0.0)),
                "damaged": dataclasses.replace(frame, is_damaged=True),
                "no camera": dataclasses.replace(frame, camera=None),
            }[fault]
        command = stage.command(frame, tracks)
        assert (command.mode == BeamMode.LOW) == (is_bad or number == 0)
        if number > 25 and not is_bad and command.levels.min() < 1:
            asked.append(number)
    assert len(asked) == 1


def test_nonsense_is_no_answer() -> None:
    """Time that stands still or runs back, lights beside us, behind the image's border, and of any range."""
    policy = ForeglowPolicy(CONFIG, LAMPS)
    rng = np.random.default_rng(3)
    for number in range(400):
        boxes = [box_around(azimuth, 0.01, 0.02) for azimuth in rng.uniform(-0.6, 0.6, 3)]
        tracks = tracks_of(boxes, rng.choice([math.nan, 0.1, 3.0, 1e5], 3).tolist(), ages_s=1.0)
        tracks = dataclasses.replace(tracks, light_kinds=kinds_of_direct(np.zeros(3)))
        time_ns = (5 if number > 300 else number if number % 50 else 0) * FRAME_NS
        command = policy.command(frame_at(number, timestamp_ns=time_ns), tracks)
        policy.shone(command)
        assert np.isfinite(command.levels).all()


def test_no_answer_proves_a_vehicle() -> None:
    """Fixed lamps answer as vehicles do; what follows our lamps counts against one without limit."""
    assert evidence(-1e4) == pytest.approx(-math.log(1 - OURS))
    assert evidence(0.0) == pytest.approx(0.0)
    assert evidence(1e4) == pytest.approx(-1e4 - math.log(OURS))


def test_a_broken_response() -> None:
    with pytest.raises(ValueError, match="response"):
        BeamConfig(response=(7.6, 0.0, 14.0))
