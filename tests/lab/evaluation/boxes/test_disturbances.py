"""Disturbed images: the same for the same seed and image, and what each one does."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from foreglow.lab.evaluation.boxes.robustness import (
    DISTURBANCES,
    UNDISTURBED,
    Disturbance,
    black_level,
    blur,
    gain,
    haze,
    noise,
    noise_level,
    rain,
)
from foreglow.types import EgoMotion, Frame, Image
from tests.stand_ins import night_image

IMAGE = night_image(3, 240, 640)
FRAME = Frame(IMAGE, timestamp_ns=5, frame=9, sequence="S00001", path="there")
DISTURBED = DISTURBANCES[1:]


def name_of(disturbance: Disturbance) -> str:
    return disturbance.name


@pytest.mark.parametrize("disturbance", DISTURBANCES, ids=name_of)
def test_laws(disturbance: Disturbance) -> None:
    changed = disturbance(FRAME)
    assert np.array_equal(changed.image, disturbance(FRAME).image)
    assert (changed.timestamp_ns, changed.frame, changed.sequence, changed.path) == (5, 9, "S00001", "there")
    assert changed.image.dtype == np.uint8
    assert np.array_equal(FRAME.image, night_image(3, 240, 640))
    wide = disturbance(Frame(IMAGE.astype(np.uint16) * 257, 5, frame=9))
    assert wide.image.dtype == np.uint16
    assert np.abs(wide.image / 257.0 - changed.image).max() < 2  # the same on its own scale


@pytest.mark.parametrize("disturbance", DISTURBED, ids=name_of)
def test_each_changes_the_image(disturbance: Disturbance) -> None:
    assert not np.array_equal(disturbance(FRAME).image, FRAME.image)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_the_undisturbed_image_is_the_image(dtype: type) -> None:
    every: Image = np.arange(np.iinfo(dtype).max + 1, dtype=dtype).reshape(-1, 256)
    assert np.array_equal(UNDISTURBED(Frame(every, 0)).image, every)


@pytest.mark.parametrize("disturbance", [noise(4.0), haze(0.5), rain(3000)], ids=name_of)
def test_seed_and_image_decide(disturbance: Disturbance) -> None:
    other = Frame(FRAME.image, 5, frame=10)
    assert not np.array_equal(disturbance(FRAME).image, disturbance(FRAME, seed=1).image)
    assert not np.array_equal(disturbance(FRAME).image, disturbance(other).image)


def test_gain_keeps_black_and_saturates() -> None:
    image = np.full((64, 64), 10, np.uint8)
    image[20:40, 20:40], image[0, 0] = 50, 200
    bright = gain(4.0)(Frame(image, 0)).image
    assert (bright[50, 50], bright[30, 30], bright[0, 0]) == (10, 10 + 4 * 40, 255)
    assert gain(0.25)(Frame(image, 0)).image[30, 30] == 20


def test_noise_has_its_strength() -> None:
    flat = np.full((200, 200), 100, np.uint8)
    noisy = noise(4.0)(Frame(flat, 0)).image.astype(float)
    assert noisy.std() == pytest.approx(4.0, rel=0.03)
    assert noisy.mean() == pytest.approx(100.0, abs=0.1)
    assert noise_level(noisy.astype(np.float32)) == pytest.approx(4.0, rel=0.2)


def test_haze_costs_contrast_and_keeps_noise() -> None:
    rng = np.random.default_rng(0)
    image = np.clip(rng.normal(20.0, 3.0, (240, 320)), 0, 255)
    image[100:104, 100:104] = 220
    hazy = haze(0.5)(Frame(image.astype(np.uint8), 0)).image.astype(float)
    lamp, around = hazy[100:104, 100:104].mean(), hazy[180:, 250:]
    assert around.mean() > 20 + 0.4 * 60  # half the veil, less half of what is above black
    assert lamp - around.mean() == pytest.approx(0.5 * 200, rel=0.1)
    assert around.std() == pytest.approx(3.0, rel=0.15)


def test_rain_only_adds_light() -> None:
    rained = rain(2000)(FRAME).image.astype(int) - FRAME.image
    assert rained.min() >= 0
    assert 0.01 < (rained > 0).mean() < 0.5
    assert (rain(300)(FRAME).image.astype(int) - FRAME.image > 0).mean() < (rained > 0).mean()


def test_blur_keeps_the_mean() -> None:
    blurred = blur(20.0)(FRAME).image.astype(float)
    assert blurred.mean() == pytest.approx(FRAME.image.mean(), abs=0.5)
    assert blurred.max() < FRAME.image.max()


def test_images_of_one_pixel() -> None:
    single = Frame(np.array([[7]], np.uint8), 0)
    for disturbance in DISTURBANCES:
        assert disturbance(single).image.shape == (1, 1)
    assert noise_level(np.zeros((1, 1), np.float32)) == 0.0
    assert black_level(np.full((3, 3), 4.0, np.float32)) == 4.0


@pytest.mark.parametrize("disturbance", DISTURBANCES, ids=name_of)
def test_all_else_that_a_frame_has_stays(disturbance: Disturbance) -> None:
    """Without the image before, a model that reads it was judged as at a drive's start, also as it is."""
    before = Frame(night_image(4, 240, 640), timestamp_ns=1, frame=9, path="before")
    motion = EgoMotion(speed_mps=20.0, yaw_rate_radps=0.0)
    changed = disturbance(dataclasses.replace(FRAME, earlier=before, motion=motion))
    assert changed.motion == motion
    assert changed.earlier is not None
    assert (changed.earlier.timestamp_ns, changed.earlier.path) == (1, "before")
    assert np.array_equal(changed.earlier.image, before.image) == (disturbance is UNDISTURBED)
    assert np.array_equal(changed.image, disturbance(FRAME).image)
    has_noise = disturbance.name.startswith(("noise", "haze", "rain"))
    assert np.array_equal(changed.earlier.image, disturbance(before).image) != has_noise, "noise of its own"
