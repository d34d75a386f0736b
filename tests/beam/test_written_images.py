"""A clock that a recorder writes into the image runs on where the camera sees nothing: that hides no fault."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.image_faults import CODINGS, NUM_GOOD, as_coded, faults_of
from foreglow.beam.faults import GuardFault
from foreglow.types import Image
from tests.beam.watched import road_ahead, with_clock

pytestmark = pytest.mark.slow

NUM_LATER = 40

CASES = [
    *((picture, coding) for picture in ("black", "covered", "noisy cover", "frozen") for coding in ("raw", "MJPEG")),
    *((picture, "H.264, 0.36 bits a pixel") for picture in ("black", "covered", "frozen")),
    ("still under noise", "raw"),
    ("still under noise", "MJPEG"),
]


@pytest.fixture(scope="module")
def drive() -> list[Image]:
    return road_ahead()


def wrong_images(picture: str, good: Image) -> list[Image]:
    rng = np.random.default_rng(5)
    if picture in ("black", "frozen"):
        return [np.zeros_like(good) if picture == "black" else good] * NUM_LATER
    level, noise = {"covered": (5.0, 1.5), "noisy cover": (12.0, 3.0), "still under noise": (good, 5.0)}[picture]
    shape = good.shape
    return [rng.normal(np.broadcast_to(level, shape), noise).clip(0, 255).astype(np.uint8) for _ in range(NUM_LATER)]


@pytest.mark.parametrize("is_at_top", [False, True])
@pytest.mark.parametrize(("picture", "coding"), CASES)
def test_a_running_clock_hides_no_fault(drive: list[Image], picture: str, coding: str, is_at_top: bool) -> None:
    shown = with_clock([*drive[:NUM_GOOD], *wrong_images(picture, drive[NUM_GOOD - 1])], is_at_top=is_at_top)
    faults = faults_of(as_coded(shown, CODINGS[coding]))
    assert not any(faults[:NUM_GOOD])
    assert all(faults[NUM_GOOD + 2 :])


@pytest.mark.parametrize("coding", list(CODINGS))
def test_a_camera_that_is_covered_from_the_first_image_on(drive: list[Image], coding: str) -> None:
    shown = with_clock(wrong_images("covered", drive[0]))
    assert all(GuardFault.BLACK in found for found in faults_of(as_coded(shown, CODINGS[coding])))


@pytest.mark.parametrize("spot", ["reflection", "name", "hot row", "hot column"])
@pytest.mark.parametrize("coding", ["raw", "MJPEG"])
def test_a_bright_spot_is_no_sight(drive: list[Image], spot: str, coding: str) -> None:
    """Behind a covered lens, of which speed and picture do not say that it stands still."""
    place = {
        "reflection": np.s_[150:159, 200:209],
        "name": np.s_[100:110, 40:80],
        "hot row": np.s_[119:120, :],
        "hot column": np.s_[:, 77:78],
    }[spot]
    later = wrong_images("covered", drive[0])
    for image in later:
        image[place] = 255
    faults = faults_of(as_coded([*drive[:NUM_GOOD], *later], CODINGS[coding]), is_moving=None)
    assert not any(faults[:NUM_GOOD])
    assert all(faults[NUM_GOOD + 1 :])


@pytest.mark.parametrize("coding", list(CODINGS))
def test_a_clock_alone_is_no_fault(drive: list[Image], coding: str) -> None:
    assert not any(faults_of(as_coded(with_clock(drive), CODINGS[coding])))
