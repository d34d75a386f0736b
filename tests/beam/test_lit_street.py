"""Lit streets, as bright spots high in made-up images, and what the beam stage makes of them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from foreglow.beam import BeamStage
from foreglow.beam.lit_street import ROAD_LIT, LitStreet
from foreglow.config import BeamConfig, GuardConfig, LitStreetConfig
from foreglow.types import BeamMode, Frame, Image
from tests.beam.made_up import CAMERA, FRAME_NS, IMAGES, box_around, frame_at, tracks_of

CONFIG = LitStreetConfig()
RATE_HZ = 1e9 / FRAME_NS
SPEED_MPS = 14.0
ABOVE_CAMERA_M = 5.0


def image_of(*spots: tuple[float, float], size_rad: float = 0.006, value: int = 200, ground: int = 12) -> Image:
    """A grey image with spots at azimuths and elevations, radians."""
    image = np.full((960, 1280), ground, np.uint8)
    for azimuth, elevation in spots:
        x1, y1, x2, y2 = np.rint(box_around(azimuth, elevation, size_rad)).astype(int)
        image[max(y1, 0) : max(y2, 0), max(x1, 0) : max(x2, 0)] = value
    return image


def street(number: int, lamps_m: list[float], side_m: float = 5.0) -> Frame:
    """A frame of a drive past lamps at these distances from where it begins."""
    ahead_m = [lamp_m - number * SPEED_MPS / RATE_HZ for lamp_m in lamps_m]
    spots = [(math.atan2(side_m, x), math.atan2(ABOVE_CAMERA_M, x)) for x in ahead_m if x > 8.0]
    return frame_at(number, image=image_of(*spots))


def decisions(lamps_m: list[float], seconds: float) -> list[bool]:
    lit = LitStreet(CONFIG)
    return [lit.update(street(number, lamps_m)) for number in range(round(seconds * RATE_HZ))]


def test_a_row_of_lamps_is_a_lit_street_until_it_ends() -> None:
    """The last lamp is passed at 168 m, after 12 s; its row is in view from the beginning."""
    found = np.array(decisions([28.0 * number for number in range(1, 7)], 20.0))
    changes_s = (np.flatnonzero(np.diff(found.astype(int))) + 1) / RATE_HZ
    assert len(changes_s) == 2
    assert CONFIG.on_s <= changes_s[0] < 2.0
    assert 11.0 < changes_s[1] < 12.0 + CONFIG.off_s + 0.5


@pytest.mark.parametrize("lamps_m", [[], [90.0], [90.0, 250.0]])
def test_lamps_far_from_each_other_light_no_street(lamps_m: list[float]) -> None:
    assert not any(decisions(lamps_m, 20.0))


LAMPS = ((0.1, math.radians(6)), (-0.15, math.radians(9)))


def found_in(image: Image) -> int:
    return LitStreet(CONFIG).num_lamps(image, CAMERA)


def test_what_is_counted() -> None:
    assert found_in(image_of(*LAMPS)) == 2
    assert found_in(image_of(*LAMPS, value=80)) == 0  # too dark
    assert found_in(image_of(*LAMPS, ground=110)) == 0  # no contrast
    assert found_in(image_of(LAMPS[0], size_rad=math.radians(8))) == 0  # a wall
    assert found_in(image_of((0.0, LAMPS[0][1]), LAMPS[0])) == 1  # marker lamps of a lorry
    post = [(-0.165, math.radians(8.4 - 0.3 * step)) for step in range(10)]
    assert found_in(image_of(LAMPS[1], *post)) == 1  # a lamp and its lit post
    assert found_in(image_of((0.0, 0.0), (0.1, math.radians(2)))) == 0  # vehicles, or lamps far away
    assert found_in(image_of(*LAMPS).astype(np.uint16) * 4) == 2  # 10 bits
    assert found_in(image_of(*LAMPS)[:, ::-1][:, ::-1]) == 2  # other strides


def test_dark_spots_are_no_lamps_of_a_camera_whose_white_is_known() -> None:
    """A quarter of white is the brightest so far."""
    deep = image_of(*LAMPS, value=64).astype(np.uint16) * np.uint16(16)
    assert LitStreet(CONFIG, 4080).num_lamps(deep, CAMERA) == found_in(image_of(*LAMPS, value=64)) == 0
    assert LitStreet(CONFIG, 1023).num_lamps(deep, CAMERA) == 2


def test_without_camera_or_when_it_is_not_wanted_no_road_is_lit() -> None:
    image = image_of(*LAMPS)
    for config, has_camera, expected in (
        (CONFIG, True, True),
        (CONFIG, False, False),
        (LitStreetConfig(enabled=False), True, False),
    ):
        lit = LitStreet(config)
        found = [lit.update(frame_at(number, image=image, with_camera=has_camera)) for number in range(40)]
        assert found[-1] == expected


def test_time_that_jumps_decides_nothing() -> None:
    lit, image = LitStreet(CONFIG), image_of(*LAMPS)
    assert not lit.update(frame_at(0, image=image))
    for time_ns in (10**12, 0, 0):
        assert not lit.update(frame_at(1, image=image, timestamp_ns=time_ns))
    assert lit.update(frame_at(1, image=image, timestamp_ns=10**12))


def test_a_camera_that_looks_at_the_road_alone_sees_no_lamps() -> None:
    frame = frame_at(0, image=image_of(*LAMPS))
    assert frame.camera is not None
    mount = frame.camera.vehicle_from_camera
    down = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]]) @ mount.rotation
    looking_down = dataclasses.replace(
        frame.camera, vehicle_from_camera=dataclasses.replace(mount, rotation=mount.rotation @ down.T @ mount.rotation)
    )
    assert LitStreet(CONFIG).num_lamps(frame.image, looking_down) in range(3)


def test_the_stage_commands_low_beam_there_and_says_why() -> None:
    stage = BeamStage(BeamConfig(policy="high"), GuardConfig(), lit_street=CONFIG)
    commands = []
    for number in range(110):
        lamps = image_of(*(LAMPS if number < 40 else ()))
        frame = frame_at(number, image=np.maximum(IMAGES[number % len(IMAGES)], lamps))
        commands.append(stage.command(frame, tracks_of([], [])))
    assert commands[10].mode == BeamMode.FULL
    assert (commands[39].mode, commands[39].faults) == (BeamMode.LOW, (ROAD_LIT,))
    assert not commands[39].levels.any()
    assert commands[-1].mode == BeamMode.FULL
    assert commands[-1].faults == ()
    stage.reset()
    assert ROAD_LIT not in stage.command(frame_at(0), tracks_of([], [])).faults
