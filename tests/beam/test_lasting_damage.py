"""Damage that was never otherwise: from the first image on, with a change of the images' size, or growing slowly."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.image_faults import CODINGS, NUM_GOOD, RATE_HZ, Coding, as_coded, faults_of
from foreglow.beam.camera_watch import NUM_UNKNOWN, CameraWatch
from foreglow.beam.faults import GuardFault
from foreglow.config import GuardConfig
from foreglow.types import Image
from tests.beam.watched import road_ahead, with_noise

pytestmark = pytest.mark.slow

NUM_IMAGES = 160

HEIGHT, WIDTH = 320, 480

PLACES = {
    "left": np.tile(np.arange(WIDTH) / WIDTH, (HEIGHT, 1)),
    "top": np.tile(np.arange(HEIGHT)[:, None] / HEIGHT, (1, WIDTH)),
    "columns": np.tile(np.random.default_rng(1).permutation(WIDTH) / WIDTH, (HEIGHT, 1)),
    "tiles": np.kron(np.random.default_rng(2).permutation(600).reshape(20, 30) / 600, np.ones((16, 16))),
}
"""By the place of a damage, at which share of the image it has reached each pixel."""

Damage = Callable[[Image, Image, NDArray[np.bool_]], None]

DAMAGES: dict[str, Damage] = {
    "stuck": lambda image, first, part: np.copyto(image, first, where=part),
    "black": lambda image, _, part: np.copyto(image, 0, where=part),
    "grey": lambda image, _, part: np.copyto(image, 128, where=part),
    "noise": lambda image, _, part: np.copyto(image, _noise(image), where=part),
}


def _noise(image: Image) -> Image:
    return np.random.default_rng(int(image.sum())).integers(0, 256, image.shape, np.uint8)


@pytest.fixture(scope="module")
def images() -> list[Image]:
    there = road_ahead()
    scene = [*there, *there[::-1]]
    return with_noise([scene[number % len(scene)] for number in range(NUM_IMAGES)])


def damaged(images: Sequence[Image], damage: str, place: str, shares: Sequence[float]) -> list[Image]:
    """The images with a damage that has reached the given share of each."""
    wrong = [image.copy() for image in images]
    for image, share in zip(wrong, shares, strict=True):
        DAMAGES[damage](image, images[0], PLACES[place] < share)
    return wrong


def smaller(images: Sequence[Image]) -> list[Image]:
    """The images at half the size, with noise of their own."""
    return with_noise([np.asarray(cv2.resize(image, (WIDTH // 2, HEIGHT // 2)), np.uint8) for image in images])


# Growing


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("step", [0.01, 0.03, 0.06])
def test_damage_that_grows_is_found_before_it_has_half_of_the_image(
    images: list[Image], damage: str, place: str, step: float
) -> None:
    shares = np.minimum(0.9, step * np.arange(1, NUM_IMAGES - NUM_GOOD + 1))
    faults = faults_of([*images[:NUM_GOOD], *damaged(images[NUM_GOOD:], damage, place, list(shares))])
    assert not any(faults[:NUM_GOOD])
    assert all(faults[NUM_GOOD + int(np.argmax(shares > 0.5)) :])


# Of another size


@pytest.mark.parametrize("period", [1, 2, 5, 17, 19, 30, 40])
def test_low_beam_while_sizes_alternate(images: list[Image], period: int) -> None:
    """Even while the camera works, as nothing tells that from a frozen one."""
    small = smaller(images)
    mixed = [(images, small)[number // period % 2][number] for number in range(NUM_IMAGES)]
    faults = faults_of(mixed)
    assert not any(faults[:period])
    assert all(GuardFault.RESIZED in found for found in faults[period:])


def test_light_again_some_images_after_a_change_of_size(images: list[Image]) -> None:
    faults = faults_of([*images[:NUM_GOOD], *smaller(images[NUM_GOOD:])])
    assert [found for each in faults for found in each] == [GuardFault.RESIZED] * NUM_UNKNOWN
    assert not any(faults[NUM_GOOD + NUM_UNKNOWN :])


def test_another_type_is_another_camera(images: list[Image]) -> None:
    deeper = [image.astype(np.uint16) * 16 for image in images[NUM_GOOD:]]
    faults = faults_of([*images[:NUM_GOOD], *deeper], white_level=4080)
    assert all(GuardFault.RESIZED in found for found in faults[NUM_GOOD : NUM_GOOD + NUM_UNKNOWN])


@pytest.mark.parametrize("damage", ["stuck", "grey", "noise", "frozen"])
def test_damage_that_arrives_with_another_size(images: list[Image], damage: str) -> None:
    small = smaller(images[NUM_GOOD:])
    part = np.arange(WIDTH // 2) < WIDTH // 4
    for image in small[1:]:
        if damage == "frozen":
            image[:] = small[0]
        else:
            DAMAGES[damage](image, small[0], np.broadcast_to(part, image.shape))
    assert all(faults_of([*images[:NUM_GOOD], *small])[NUM_GOOD:])


@pytest.mark.parametrize("damage", ["black", "rows repeated"])
def test_damage_that_arrives_with_another_size_and_lasts(images: list[Image], damage: str) -> None:
    small = smaller(images[NUM_GOOD:])
    for image in small[1:]:
        if damage == "black":
            image[:, : WIDTH // 4] = 0
        else:
            image[1::2] = image[::2]
    assert all(faults_of([*images[:NUM_GOOD], *small])[NUM_GOOD:])


# After a pause


@pytest.mark.parametrize("num_before", [0, 1, 3])
@pytest.mark.parametrize("pause_s", [1.0, 11.0, 3600.0])
@pytest.mark.parametrize("damage", ["black", "stuck", "rows repeated"])
def test_a_pause_makes_no_damage_usual(images: list[Image], damage: str, pause_s: float, num_before: int) -> None:
    watch = CameraWatch(GuardConfig())
    found = []
    for number, good in enumerate(images):
        image = good.copy()
        if number >= NUM_GOOD:
            if damage == "rows repeated":
                image[1::2] = image[::2]
            else:
                DAMAGES[damage](image, images[NUM_GOOD - 1], PLACES["left"] < 0.7)
        paused_s = pause_s if number >= NUM_GOOD + num_before else 0.0
        found.append(watch.faults(image, round((number / RATE_HZ + paused_s) * 1e9), is_moving=True))
    assert not any(found[:NUM_GOOD])
    assert all(GuardFault.DAMAGED in each for each in found[NUM_GOOD + num_before + 1 :])


@pytest.mark.parametrize("step_s", [-11.0, -0.3, -0.07, 0.3, 11.0])
@pytest.mark.parametrize("num_wrong", [1, NUM_IMAGES])
@pytest.mark.parametrize("damage", ["black", "stuck"])
def test_wrong_times_make_no_damage_usual(images: list[Image], damage: str, num_wrong: int, step_s: float) -> None:
    watch = CameraWatch(GuardConfig())
    wrong = damaged(images[NUM_GOOD:], damage, "left", [0.6] * (NUM_IMAGES - NUM_GOOD))
    found = []
    for number, image in enumerate([*images[:NUM_GOOD], *wrong]):
        stray_s = step_s if NUM_GOOD + 4 <= number < NUM_GOOD + 4 + num_wrong else 0.0
        found.append(watch.faults(image, round((100 + number / RATE_HZ + stray_s) * 1e9), is_moving=True))
    assert not any(found[:NUM_GOOD])
    assert all(GuardFault.DAMAGED in each for each in found[NUM_GOOD + 2 :])


# From the first image on


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("share", [0.15, 0.5, 0.8])
def test_what_is_stuck_from_the_first_image_on(images: list[Image], share: float, place: str) -> None:
    faults = faults_of(damaged(images, "stuck", place, [share] * NUM_IMAGES))
    assert all(GuardFault.DAMAGED in found for found in faults[NUM_UNKNOWN:])


@pytest.mark.parametrize("share", [0.3, 0.5, 0.8])
@pytest.mark.parametrize("damage", ["grey", "noise"])
@pytest.mark.parametrize("place", ["left", "top"])
def test_what_no_camera_shows_from_the_first_image_on(
    images: list[Image], place: str, damage: str, share: float
) -> None:
    faults = faults_of(damaged(images, damage, place, [share] * NUM_IMAGES))
    assert all(GuardFault.DAMAGED in found for found in faults[3:])


@pytest.mark.parametrize("coding", [*CODINGS.values(), Coding("libx264", 0.15), Coding("libx264", 0.02)])
@pytest.mark.parametrize("size", [1, 2])
def test_no_alarm_in_streams_of_any_size_and_rate(images: list[Image], size: int, coding: Coding | None) -> None:
    """Encoders leave out what changes little, the more the smaller and the less noisy images are."""
    sized = images if size == 1 else [image[::2, ::2] for image in images]
    blurred: list[Image] = [np.asarray(cv2.GaussianBlur(image, (0, 0), 0.8), np.uint8) for image in sized]
    assert not any(faults_of(as_coded(blurred, coding)))
