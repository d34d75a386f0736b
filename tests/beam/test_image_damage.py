"""Damage of images: parts, rows, columns and pixels that are stuck, old, filled, repeated or noise."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.image_faults import CODINGS, NUM_GOOD, RATE_HZ, as_coded, faults_of
from foreglow.beam.faults import GuardFault
from foreglow.beam.image_damage import RELEARN_S
from foreglow.types import Image
from tests.beam.watched import part_of_an_old_image, road_ahead, with_noise

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def drive() -> list[Image]:
    return road_ahead()


@pytest.mark.parametrize("value", [0, 8, 128])
@pytest.mark.parametrize("width", [0.25, 0.5])
def test_a_part_filled_with_one_value(drive: list[Image], width: float, value: int) -> None:
    good, later = drive[:NUM_GOOD], [image.copy() for image in drive[NUM_GOOD:]]
    for image in later:
        image[: image.shape[0] // 2, : round(width * image.shape[1])] = value
    faults = faults_of([*good, *later])
    assert not any(faults[:NUM_GOOD])
    assert all(GuardFault.DAMAGED in found for found in faults[NUM_GOOD + 1 :])


@pytest.mark.parametrize("value", [235, 255])
@pytest.mark.parametrize("place", [np.s_[:, :40], np.s_[:, 400:], np.s_[:50], np.s_[120:180, 100:300]])
def test_a_part_that_is_suddenly_white(drive: list[Image], place: Any, value: int) -> None:
    """Also where an encoder has removed the noise, so that nothing else tells it."""
    images = [(image // 4 * 4).astype(np.uint8) for image in drive]
    for image in images[NUM_GOOD:]:
        image[place] = value
    faults = faults_of(images)
    assert not any(faults[:NUM_GOOD])
    assert all(GuardFault.DAMAGED in found for found in faults[NUM_GOOD:])


@pytest.mark.parametrize("first", [0, 1])
def test_a_half_image_that_is_stuck(drive: list[Image], first: int) -> None:
    """Every other row, as where one field of an interlaced camera comes no more."""
    images = with_noise(drive)
    for image in images[NUM_GOOD:]:
        image[first::2] = images[NUM_GOOD - 1][first::2]
    faults = faults_of(images)
    assert not any(faults[:NUM_GOOD])
    assert all(GuardFault.DAMAGED in found for found in faults[NUM_GOOD + 1 :])


@pytest.mark.parametrize("is_moving", [True, None])
@pytest.mark.parametrize("repeated", [24, 30, 38, 39])
@pytest.mark.parametrize("part", [0.25, 0.5])
def test_a_stuck_part_soon_after_a_repeated_image(
    drive: list[Image], part: float, repeated: int, is_moving: bool | None
) -> None:
    good = [*drive[: repeated + 1], *drive[repeated:NUM_GOOD]]
    later = part_of_an_old_image(drive[NUM_GOOD:], good[-1], part)
    faults = faults_of([*good, *later], is_moving=is_moving)
    assert not any(faults[: len(good)])
    assert all(GuardFault.DAMAGED in found for found in faults[len(good) + 1 :])


@pytest.mark.parametrize("part", [0.7, 0.8, 0.9, 0.95, 0.99])
@pytest.mark.parametrize("side", ["columns", "rows"])
def test_the_greater_part_is_stuck(drive: list[Image], side: str, part: float) -> None:
    images = with_noise(drive)
    height, width = images[0].shape
    place: Any = np.s_[:, : round(part * width)] if side == "columns" else np.s_[: round(part * height)]
    for image in images[NUM_GOOD:]:
        image[place] = images[NUM_GOOD - 1][place]
    faults = faults_of(images)
    assert not any(faults[:NUM_GOOD])
    assert all(faults[NUM_GOOD + 1 :])


@pytest.mark.parametrize("num_buffers", [2, 3, 5])
@pytest.mark.parametrize("part", [0.5, 0.8, 0.95])
def test_a_part_that_shows_old_images_in_turn(drive: list[Image], part: float, num_buffers: int) -> None:
    images = with_noise(drive)
    for number in range(NUM_GOOD, len(images)):
        old = images[NUM_GOOD - num_buffers + (number - NUM_GOOD) % num_buffers]
        images[number] = part_of_an_old_image([images[number]], old, part)[0]
    faults = faults_of(images)
    assert not any(faults[:NUM_GOOD])
    assert all(faults[NUM_GOOD + 1 :])


@pytest.mark.parametrize("every", [2, 3, 6])
@pytest.mark.parametrize("place", ["columns", "rows"])
def test_an_old_part_of_single_images_with_intact_ones_between(drive: list[Image], place: str, every: int) -> None:
    images = with_noise(drive)
    height, width = images[0].shape
    part: Any = np.s_[:, : width // 3] if place == "columns" else np.s_[: height // 3]
    for number in range(NUM_GOOD, len(images), every):
        images[number][part] = images[NUM_GOOD - 1][part]
    faults = faults_of(images)
    assert not any(faults[:NUM_GOOD])
    assert all(faults[NUM_GOOD + 2 * every :])


STRIPES = [f"{form} {px}" for form in ("even", "uneven") for px in (8, 24, 48)]


SCATTERED = [
    *itertools.product(STRIPES, (None, 0, 3)),
    *itertools.product(["tiles 8", "tiles 16", "tiles 32"], (None,)),
    *itertools.product(["tiles 64"], (0, 3)),
]
"""Upright stripes and tiles of so many pixels, together about a fifth of the image, that are stuck or have a value."""


def scattered(form: str, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Which pixels of an image the parts have."""
    rng = np.random.default_rng(7)
    name, side = form.split()
    px, (height, width) = int(side), shape
    is_part = np.zeros(shape, np.bool_)
    if name == "even":
        is_part[:, np.arange(width) % (5 * px) < px] = True
    while is_part.mean() < 0.2:
        row, column = rng.integers(0, height // px) * px, rng.integers(0, width - px)
        is_part[slice(None) if name == "uneven" else slice(row, row + px), column : column + px] = True
    return is_part


@pytest.mark.parametrize(("form", "value"), SCATTERED)
def test_scattered_parts_that_are_stuck_or_dark(drive: list[Image], form: str, value: int | None) -> None:
    images = with_noise(drive)
    is_part = scattered(form, images[0].shape)
    for image in images[NUM_GOOD:]:
        image[is_part] = images[NUM_GOOD - 1][is_part] if value is None else value
    faults = faults_of(images)
    assert not any(faults[:NUM_GOOD])
    assert all(GuardFault.DAMAGED in found for found in faults[NUM_GOOD + 1 :])


@pytest.mark.parametrize("share", [0.2, 0.5])
@pytest.mark.parametrize("px", [8, 16, 32, 64])
def test_tiles_of_the_image_just_before_at_new_places_each_time(drive: list[Image], px: int, share: float) -> None:
    """As of a decoder that fills what it misses from its last image."""
    images = with_noise(drive)
    height, width = images[0].shape
    rng = np.random.default_rng(3)
    for number in range(NUM_GOOD, len(images)):
        is_tile = rng.permutation(height // px * (width // px + 1)) < share * (height // px * (width // px + 1))
        is_old = np.kron(is_tile.reshape(height // px, -1), np.ones((px, px)))[:, :width] > 0
        images[number][is_old] = images[number - 1][is_old]
    faults = faults_of(images)
    assert not any(faults[:NUM_GOOD])
    assert all(GuardFault.DAMAGED in found for found in faults[NUM_GOOD + 1 :])


@pytest.mark.parametrize("px", [16, 32, 64])
def test_a_chessboard_whose_halves_are_renewed_in_turn(drive: list[Image], px: int) -> None:
    images = with_noise(drive)
    for number in range(NUM_GOOD, len(images)):
        is_old = (Y // px + X // px + number) % 2 == 0
        images[number][is_old] = images[number - 1][is_old]
    faults = faults_of(images)
    assert not any(faults[:NUM_GOOD])
    assert all(GuardFault.DAMAGED in found for found in faults[NUM_GOOD + 1 :])


@pytest.mark.parametrize("part", [np.s_[:, 240:], np.s_[80:240, 120:360], np.s_[160:, :240]])
def test_a_part_whose_rows_repeat_its_first_one(drive: list[Image], part: Any) -> None:
    images = with_noise(drive)
    for image in images[NUM_GOOD:]:
        image[part] = image[part][:1]
    faults = faults_of(images)
    assert not any(faults[:NUM_GOOD])
    assert all(GuardFault.DAMAGED in found for found in faults[NUM_GOOD + 1 :])


@pytest.mark.parametrize("num", [1, 10, 25])
def test_light_that_fades_to_a_tenth_is_no_damage(drive: list[Image], num: int) -> None:
    """In one image or in several: with the light, the noise ends in the dark, and words become alike."""
    rates = [1.0 - 0.9 * min(1.0, max(0.0, (number - NUM_GOOD + 1) / num)) for number in range(len(drive))]
    images = [(image * rate).astype(np.uint8) for image, rate in zip(with_noise(drive), rates, strict=True)]
    assert not any(GuardFault.DAMAGED in found for found in faults_of(images))


Y, X = np.indices((320, 480))

STUCK_PIXELS = {
    "even columns": X % 2 == 0,
    "odd columns": X % 2 == 1,
    "a lane of four": X % 4 == 1,
    "all lanes of eight but one": X % 8 != 3,
    "half of each eight columns": X % 8 < 4,
    "two of three columns": X % 3 != 0,
    "all rows but every eighth": Y % 8 != 4,
    "all rows but every 17th": Y % 17 != 0,
    "a chessboard": (X + Y) % 2 == 0,
    "a colour of a Bayer pattern": (X % 2 == 0) & (Y % 2 == 0),
    "seven of ten pixels": (X * 7919 + Y * 104729) % 1009 < 706,
}


@pytest.mark.parametrize("form", STUCK_PIXELS)
def test_pixels_of_any_pattern_that_are_stuck(drive: list[Image], form: str) -> None:
    images = with_noise(drive)
    is_stuck = STUCK_PIXELS[form]
    for image in images[NUM_GOOD:]:
        image[is_stuck] = images[NUM_GOOD - 1][is_stuck]
    faults = faults_of(images)
    assert not any(faults[:NUM_GOOD])
    assert all(faults[NUM_GOOD + 1 :])


@pytest.mark.parametrize("value", [None, 3])
def test_scattered_parts_for_as_long_as_they_last(drive: list[Image], value: int | None) -> None:
    """Until they count as the scene, 10 s later."""
    scene = np.concatenate([drive, drive[::-1]])
    images = with_noise([scene[number % len(scene)] for number in range(NUM_GOOD + 10 * RATE_HZ)])
    is_part = scattered("even 16", images[0].shape)
    for image in images[NUM_GOOD:]:
        image[is_part] = images[NUM_GOOD - 1][is_part] if value is None else value
    faults = faults_of(images)
    assert not any(faults[:NUM_GOOD])
    assert all(GuardFault.DAMAGED in found for found in faults[NUM_GOOD + 1 :])


@pytest.mark.parametrize("value", [0, 10, 30, 80])
@pytest.mark.parametrize(("first", "every"), [(0, 2), (1, 2), (2, 3), (3, 4)])
def test_rows_that_are_dead(drive: list[Image], first: int, every: int, value: int) -> None:
    images = with_noise(drive)
    for image in images[NUM_GOOD:]:
        image[first::every] = value
    faults = faults_of(images)
    assert not any(faults[:NUM_GOOD])
    assert all(faults[NUM_GOOD:])


def test_a_dark_part_of_single_images_with_intact_ones_between(drive: list[Image]) -> None:
    images = with_noise(drive)
    for number in range(NUM_GOOD, len(images), 5):
        images[number] = part_of_an_old_image([images[number]], np.zeros_like(images[number]), 0.5)[0]
    faults = faults_of(images)
    assert not any(faults[:NUM_GOOD])
    assert all(faults[NUM_GOOD + 5 :])


@pytest.mark.parametrize(("every", "rate_hz"), [(1, 36.0), (2, 30.0), (3, 24.0), (5, 30.0), (6, 18.0)])
def test_a_stuck_part_where_images_are_repeated_in_a_rhythm(drive: list[Image], every: int, rate_hz: float) -> None:
    later = part_of_an_old_image(drive[NUM_GOOD:], drive[NUM_GOOD - 1], 0.5)
    repeated = [[image] * (2 if number % every == 0 else 1) for number, image in enumerate([*drive[:NUM_GOOD], *later])]
    num_good, num_not_seen = (sum(map(len, repeated[:number])) for number in (NUM_GOOD, NUM_GOOD + 1))
    faults = faults_of(itertools.chain.from_iterable(repeated), rate_hz=rate_hz)
    assert not any(faults[:num_good])
    assert all(GuardFault.DAMAGED in found for found in faults[num_not_seen:])


def test_a_part_that_stays_stuck_while_the_image_stands_still_and_after_a_torn_one(drive: list[Image]) -> None:
    (torn,) = part_of_an_old_image(drive[NUM_GOOD : NUM_GOOD + 1], drive[NUM_GOOD - 1], 0.5)
    good = [*drive[:NUM_GOOD], torn, drive[NUM_GOOD + 1]]
    stuck = part_of_an_old_image(drive[NUM_GOOD + 2 :], good[-1], 0.5)
    stuck[20:20] = [stuck[19]]
    faults = faults_of([*good, *stuck])
    assert not any(faults[: len(good)])
    assert all(GuardFault.DAMAGED in found for found in faults[len(good) + 1 :])


def test_black_images_are_no_time_in_which_damage_becomes_usual(drive: list[Image]) -> None:
    half = part_of_an_old_image(drive[NUM_GOOD:], np.zeros_like(drive[0]), 0.5)
    black = [np.zeros_like(drive[0])] * (round(RELEARN_S * RATE_HZ) + 10)
    faults = faults_of([*drive[:NUM_GOOD], *half[:6], *black, *half[6:]])[-len(half[6:]) :]
    assert all(GuardFault.DAMAGED in found for found in faults[2:])


@pytest.mark.parametrize("place", ["quarter", "half", "every fourth row", "every other image"])
def test_nothing_but_noise_in_a_part(drive: list[Image], place: str) -> None:
    """A link that has lost its bits: noise far above that of any camera."""
    rng = np.random.default_rng(5)
    later = [image.copy() for image in drive[NUM_GOOD:]]
    height, width = drive[0].shape
    parts: dict[str, Any] = {
        "quarter": np.s_[height // 2 :, width // 2 :],
        "half": np.s_[height // 2 :],
        "every fourth row": np.s_[::4],
        "every other image": np.s_[:],
    }
    for image in later[:: 2 if place == "every other image" else 1]:
        image[parts[place]] = rng.integers(0, 64 if place == "every other image" else 256, image[parts[place]].shape)
    faults = faults_of([*drive[:NUM_GOOD], *later])
    assert not any(faults[:NUM_GOOD])
    assert all(GuardFault.DAMAGED in found for found in faults[NUM_GOOD:])


def test_the_same_half_twice(drive: list[Image]) -> None:
    later = [image.copy() for image in drive[NUM_GOOD:]]
    for image in later:
        image[:, 240:] = image[:, :240]
    faults = faults_of([*drive[:NUM_GOOD], *later])
    assert not any(faults[:NUM_GOOD])
    assert all(faults[NUM_GOOD:])
    assert (
        sum(GuardFault.DAMAGED in found for found in faults[NUM_GOOD:]) >= len(later) - 1
    )  # one half shows too little


@pytest.mark.parametrize("num_buffers", [1, 2, 3, 8])
@pytest.mark.parametrize("top", [0.05, 0.5])
def test_images_that_arrive_in_part(drive: list[Image], num_buffers: int, top: float) -> None:
    """A decoder fills the upper part of one of its old buffers."""
    good = with_noise(drive[: NUM_GOOD + 1])
    later = with_noise(drive[NUM_GOOD + 1 : NUM_GOOD + 9])
    for index, image in enumerate(later):
        first = round(top * image.shape[0])
        image[first:] = good[len(good) - num_buffers + index % num_buffers][first:]
    faults = faults_of([*good, *later])
    assert not any(faults[: len(good)])
    assert all(faults[len(good) + 1 :])


def test_rows_repeated_from_the_second_on(drive: list[Image]) -> None:
    good, later = drive[:NUM_GOOD], [image.copy() for image in drive[NUM_GOOD:]]
    for image in later:
        image[2::2] = image[1:-1:2]
    faults = faults_of(as_coded([*good, *later], CODINGS["MJPEG"]))
    assert not any(faults[:NUM_GOOD])
    assert all(faults[NUM_GOOD + 1 :])


@pytest.mark.parametrize("part", [0.5, 1.0])
@pytest.mark.parametrize("times", [2, 4, 8, 16])
def test_repeated_columns(drive: list[Image], times: int, part: float) -> None:
    images = with_noise(drive)
    for image in images[NUM_GOOD:]:
        left = image[:, : round(part * image.shape[1])]
        left[...] = left[:, np.arange(left.shape[1]) // times * times]
    faults = faults_of(images)
    assert not any(faults[:NUM_GOOD])
    assert all(GuardFault.DAMAGED in found for found in faults[NUM_GOOD:])


@pytest.mark.parametrize("divisor", [1, 4, 16])
def test_columns_that_are_alike_without_damage(drive: list[Image], divisor: int) -> None:
    """A black border beside images whose dark parts have no noise, as where they are cut to another shape."""
    images = [image // divisor for image in drive]
    for image in images:
        image[:, :80] = image[:, -80:] = 0
    assert not any(GuardFault.DAMAGED in found for found in faults_of(images))
