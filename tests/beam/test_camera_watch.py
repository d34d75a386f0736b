"""The watch of the camera: frozen, damaged, white and black images, raw and coded, and no alarm where all is well."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.image_faults import (
    CODINGS,
    FAULTS,
    NUM_GOOD,
    NUM_WRONG,
    as_coded,
    faults_of,
    lost_packets,
    with_fault,
)
from benchmarks.soak import reduced
from foreglow.beam.faults import GuardFault
from foreglow.datasets import open_source, shipped_drive
from foreglow.types import Image
from tests.beam.watched import part_of_an_old_image, road_ahead, with_noise

pytestmark = pytest.mark.slow

H264 = [coding for coding in CODINGS.values() if coding is not None and coding.codec == "libx264"]

NOT_SEEN = {
    ("half stuck", "H.264, 0.045 bits a pixel"),  # without noise, a dark half that does not change may well be alive
    ("rows repeated", "H.264, 0.045 bits a pixel"),  # rows are hardly more alike than the encoder makes them anyway
}

NAMES = {
    "frozen": {GuardFault.FROZEN},
    "black": {GuardFault.BLACK},
    "white": {GuardFault.SATURATED},
    "half stuck": {GuardFault.DAMAGED, GuardFault.FROZEN},
    "quarter dark": {GuardFault.DAMAGED},
    "rows repeated": {GuardFault.DAMAGED},
    "every other row stuck": {GuardFault.DAMAGED},
    "every other row black": {GuardFault.DAMAGED},
    "cut JPEG": {GuardFault.DAMAGED},
}


@pytest.fixture(scope="module")
def drive() -> list[Image]:
    return road_ahead()


# Faults


@pytest.mark.parametrize(
    ("fault", "coding"), [case for case in itertools.product(FAULTS, CODINGS) if case not in NOT_SEEN]
)
def test_low_beam_with_the_second_wrong_image(drive: list[Image], fault: str, coding: str) -> None:
    faults = with_fault(drive, fault, CODINGS[coding])
    assert not any(faults[:NUM_GOOD])
    assert set(faults[NUM_GOOD + 1]) & NAMES[fault]
    assert all(faults[NUM_GOOD + 1 :])


@pytest.mark.parametrize("coding", CODINGS)
@pytest.mark.parametrize(("level", "noise"), [(8, 3.0), (16, 1.5), (16, 3.0), (60, 2.0)])
def test_a_covered_lens_whatever_its_black_is(drive: list[Image], level: int, noise: float, coding: str) -> None:
    rng = np.random.default_rng(3)
    covered = [rng.normal(level, noise, drive[0].shape).clip(0, 255).astype(np.uint8) for _ in range(NUM_WRONG)]
    faults = faults_of(as_coded([*drive[:NUM_GOOD], *covered], CODINGS[coding]), is_moving=None)
    assert not any(faults[:NUM_GOOD])
    assert all(GuardFault.BLACK in found for found in faults[NUM_GOOD + 1 :])


@pytest.mark.parametrize(("level", "noise"), [(8, 3.0), (10, 6.0), (25, 8.0), (40, 8.0), (30, 12.0)])
def test_a_covered_lens_under_any_noise_at_the_first_image(drive: list[Image], level: int, noise: float) -> None:
    rng = np.random.default_rng(3)
    covered = [rng.normal(level, noise, drive[0].shape).clip(0, 255).astype(np.uint8) for _ in range(NUM_WRONG)]
    faults = faults_of([*drive[:NUM_GOOD], *covered])
    assert not any(faults[:NUM_GOOD])
    assert all(faults[NUM_GOOD:])


@pytest.mark.parametrize("coding", ["raw", "MJPEG"])
@pytest.mark.parametrize("picture", ["frozen", "test pattern", "none"])
@pytest.mark.parametrize("noise", [2.0, 5.0])
def test_nothing_but_the_noise_changes(drive: list[Image], picture: str, noise: float, coding: str) -> None:
    rng = np.random.default_rng(3)
    bars = np.tile(np.linspace(16, 235, 8).repeat(60), (320, 1))
    still = {"frozen": drive[NUM_GOOD - 1], "test pattern": bars, "none": np.full((320, 480), 90.0)}[picture]
    later = [rng.normal(still, noise).clip(0, 255).astype(np.uint8) for _ in range(NUM_WRONG)]
    faults = faults_of(as_coded([*drive[:NUM_GOOD], *later], CODINGS[coding]))
    assert not any(faults[:NUM_GOOD])
    assert all(faults[NUM_GOOD + 2 :])


@pytest.mark.parametrize(("read_out", "of_light"), [(1.0, 0.1), (1.0, 0.4), (1.0, 1.0), (2.0, 0.4), (2.0, 1.0)])
def test_nothing_but_the_noise_of_light_changes(read_out: float, of_light: float) -> None:
    """The noise of a linear sensor grows with the light, so that bright pieces change by more than dark ones."""
    drive = [frame.image for frame in open_source(shipped_drive())]
    rng = np.random.default_rng(5)
    images = [*drive[:NUM_GOOD], *[drive[NUM_GOOD]] * NUM_WRONG]
    images = [
        rng.normal(image, np.sqrt(read_out**2 + of_light * image)).clip(0, 255).astype(np.uint8) for image in images
    ]
    faults = faults_of(images)
    assert not any(faults[:NUM_GOOD])
    assert all(GuardFault.FROZEN in found for found in faults[NUM_GOOD + 2 :])


def test_a_car_that_stands_sees_nothing_but_noise(drive: list[Image]) -> None:
    assert not any(faults_of(with_noise([drive[0]] * 40), is_moving=False))


def test_an_old_image_between_new_ones(drive: list[Image]) -> None:
    images = with_noise(drive)
    images[NUM_GOOD + 1 :: 2] = [images[NUM_GOOD - 1]] * len(images[NUM_GOOD + 1 :: 2])
    faults = faults_of(images)
    assert not any(faults[: NUM_GOOD + 1])
    assert all(GuardFault.FROZEN in found for found in faults[NUM_GOOD + 1 :: 2])


def test_an_encoder_that_sends_next_to_nothing_of_some_images() -> None:
    images = [frame.image for frame in open_source(shipped_drive())]
    assert not any(faults_of(as_coded(images, CODINGS["H.264, 0.045 bits a pixel"])))


def test_nothing_but_the_noise_changes_in_images_that_come_twice(drive: list[Image]) -> None:
    rng = np.random.default_rng(3)
    noisy = [rng.normal(drive[NUM_GOOD - 1], 5.0).clip(0, 255).astype(np.uint8) for _ in range(NUM_WRONG)]
    later = [image for image in noisy for _ in range(2)]
    good = [image for image in drive[:NUM_GOOD] for _ in range(2)]
    faults = faults_of([*good, *later], rate_hz=36.0)
    assert not any(faults[: len(good)])
    assert all(faults[len(good) + 4 :])


@pytest.mark.parametrize("bits", [10, 12])
def test_without_its_white_level_no_image_of_a_camera_of_few_bits_counts(drive: list[Image], bits: int) -> None:
    top = 2**bits - 1
    images = [(image * (top / 255)).astype(np.uint16) for image in drive]
    for image in images:
        image[100:200, 100:300] = top
    assert all(GuardFault.BLACK in found for found in faults_of(images))


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
@pytest.mark.parametrize("is_moving", [True, None])
def test_cameras_of_more_bits(drive: list[Image], bits: int, is_moving: bool | None) -> None:
    """Their images are not compared in levels of the type's greatest value, but of `white_level`."""
    rng = np.random.default_rng(4)
    top = 2**bits - 1
    pixel_type = np.uint8 if bits == 8 else np.uint16
    images = [np.clip(rng.normal(image * (top / 255), top / 255), 0, top).astype(pixel_type) for image in drive]
    assert not any(faults_of(images, is_moving=is_moving, white_level=top))
    latest, later = images[NUM_GOOD - 1], images[NUM_GOOD : NUM_GOOD + NUM_WRONG]
    wrong = {
        "frozen": [latest] * NUM_WRONG,
        "half": part_of_an_old_image(later, latest, 0.5),
        "quarter": part_of_an_old_image(later, latest, 0.25),
    }
    for fault, shown in wrong.items():
        faults = faults_of([*images[:NUM_GOOD], *shown], is_moving=is_moving, white_level=top)
        assert not any(faults[:NUM_GOOD]), fault
        assert all(faults[NUM_GOOD + 1 :]), fault


@pytest.fixture(scope="module")
def small_camera() -> list[Image]:
    """The drive that ships, 320x240."""
    return [reduced(frame, 320).image for frame in open_source(shipped_drive())]


@pytest.mark.parametrize("coding", CODINGS)
@pytest.mark.parametrize("fault", ["cut JPEG", "rows repeated"])
def test_damage_in_images_of_a_small_camera(small_camera: list[Image], fault: str, coding: str) -> None:
    faults = with_fault(small_camera, fault, CODINGS[coding])
    assert not any(faults[:NUM_GOOD])
    assert all(set(found) & NAMES[fault] for found in faults[NUM_GOOD + 1 :])


@pytest.mark.parametrize("num_buffers", [2, 3, 8, 19, 32])
@pytest.mark.parametrize("is_moving", [True, None])
def test_a_driver_that_shows_its_old_buffers_in_turn(
    drive: list[Image], num_buffers: int, is_moving: bool | None
) -> None:
    good = with_noise(drive[:NUM_GOOD])
    faults = faults_of([*good, *(good[-num_buffers:] * 8)[:NUM_WRONG]], is_moving=is_moving)
    assert not any(faults[:NUM_GOOD])
    assert all(GuardFault.FROZEN in found for found in faults[NUM_GOOD + 1 :])


@pytest.mark.parametrize("coding", CODINGS)
def test_no_alarm_when_driving(drive: list[Image], coding: str) -> None:
    images = as_coded(drive, CODINGS[coding])
    for is_moving in (True, None):
        assert not any(faults_of(images, is_moving=is_moving))


@pytest.mark.parametrize("coding", H264)
def test_a_stream_that_loses_packets(drive: list[Image], coding: Any, tmp_path: Path) -> None:
    count = lost_packets(drive, coding, tmp_path)
    assert count["damaged"] > 0.5 * count["frames"]
    assert count["missed"] == 0


# Standing still


@pytest.mark.parametrize("coding", CODINGS)
def test_a_standing_car_whose_speed_is_known(drive: list[Image], coding: str) -> None:
    assert not any(faults_of(as_coded(with_noise([drive[0]] * 40), CODINGS[coding]), is_moving=False))


@pytest.mark.parametrize("coding", ["raw", "MJPEG"])
def test_a_standing_car_with_new_noise(drive: list[Image], coding: str) -> None:
    stood = as_coded([*drive[:NUM_GOOD], *with_noise([drive[NUM_GOOD]] * 30)], CODINGS[coding])
    assert not any(faults_of(stood, is_moving=None))


def test_nothing_but_noise_changes_although_we_drive(drive: list[Image]) -> None:
    """A camera whose window is covered."""
    stood = [*drive[:NUM_GOOD], *with_noise([drive[NUM_GOOD]] * 30)]
    assert faults_of(stood)[NUM_GOOD + 3 :] == [[GuardFault.FROZEN]] * 27


# Scenes that become calmer at once


@pytest.mark.parametrize("coding", ["raw", "MJPEG", "H.264, 0.36 bits a pixel"])
def test_out_of_the_light(drive: list[Image], coding: str) -> None:
    """Light that ends within an image, as at the end of a lit town or at the entry of a tunnel."""
    darker = with_noise([image // 4 for image in drive[NUM_GOOD:]])
    images = as_coded([*drive[:NUM_GOOD], *darker], CODINGS[coding])
    for rate_hz in (5.0, 18.0, 60.0):
        assert not any(faults_of(images, is_moving=True, rate_hz=rate_hz))


@pytest.mark.parametrize("share", [0.1, 0.25, 2.0])
@pytest.mark.parametrize("num", [1, 3, 10])
def test_exposure_and_tunnels(drive: list[Image], share: float, num: int) -> None:
    """Light that falls or rises within some images, and comes back."""
    fall, rise = np.geomspace(1.0, share, num + 1)[1:], np.geomspace(share, 1.0, num + 1)[1:]
    gains = np.concatenate([np.ones(30), fall, np.full(20, share), rise, np.ones(90)])
    scene = [np.clip(image * gain, 0, 255) for image, gain in zip(drive, gains, strict=False)]
    assert not any(GuardFault.DAMAGED in found for found in faults_of(with_noise(scene)))


def test_a_vehicle_that_has_passed(drive: list[Image]) -> None:
    rng = np.random.default_rng(1)
    images = [image.copy() for image in drive]
    for image in images[:NUM_GOOD]:
        image[100:260, 300:460] = rng.integers(0, 200, (160, 160), np.uint8)
    assert not any(faults_of(images))


def test_frozen_at_60_hz_only_after_90_ms(drive: list[Image]) -> None:
    """Cameras of 60 Hz may bring an image twice, and then once more with an encoder's refinement."""
    twice = [image for image in drive for _ in range(2)]
    assert not any(faults_of(twice, rate_hz=60.0))
    coded = as_coded([*drive[:NUM_GOOD], *[drive[NUM_GOOD - 1]] * NUM_WRONG], H264[0])
    first = next(number for number, found in enumerate(faults_of(coded, rate_hz=60.0)) if found)
    assert 0.09 <= (first - NUM_GOOD + 1) / 60.0 <= 0.09 + 1 / 60.0


# White


@pytest.mark.parametrize("value", [235, 254, 255])
@pytest.mark.parametrize("noise", [0.0, 4.0])
def test_white_of_eight_bits(value: int, noise: float) -> None:
    rng = np.random.default_rng(2)
    images = np.clip(rng.normal(value, noise, (3, 96, 128)), 0, 255).astype(np.uint8)
    assert all(GuardFault.SATURATED in found for found in faults_of(images))


@pytest.mark.parametrize("bits", [10, 12, 14, 16])
def test_white_of_more_bits(bits: int) -> None:
    rng = np.random.default_rng(2)
    top = 2**bits - 1
    images = np.clip(rng.normal(0.95 * top, 0.01 * top, (3, 96, 128)), 0, top).astype(np.uint16)
    assert all(GuardFault.SATURATED in found for found in faults_of(images))


def test_grey_is_not_white_and_bright_lamps_are_no_saturation(drive: list[Image]) -> None:
    assert not any(GuardFault.SATURATED in found for found in faults_of([np.full((96, 128), 200, np.uint8)] * 2))
    lamps = [image.copy() for image in drive[:3]]
    for image in lamps:
        image[:60] = 255
    assert not any(faults_of(lamps))
