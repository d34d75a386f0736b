"""A covered lens is known from the first image on, whatever noise whole rows and columns have in common."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.image_faults import CODINGS, as_coded, faults_of
from foreglow.beam.faults import GuardFault
from foreglow.beam.image_pieces import ImagePieces
from foreglow.types import Image
from tests.beam.watched import road_ahead

NUM_IMAGES = 6

FORMS = {"rows": (1, 0.0), "pairs of rows": (2, 0.0), "bands of 8 rows": (8, 0.0), "rows and columns": (1, 1.0)}
"""Adjacent rows with the same noise, and how strong that of columns is, in shares of it."""


def covered(
    shape: tuple[int, int], level: float, common: float, own: float, *, adjacent: int = 1, columns: float = 0.0
) -> list[Image]:
    """Images of nothing but noise: of whole rows and columns, and of each pixel, in grey levels; all new each time."""
    rng = np.random.default_rng(5)
    height, width = shape
    images: list[Image] = []
    for _ in range(NUM_IMAGES):
        rows = np.repeat(rng.normal(0.0, common, (-(-height // adjacent), 1)), adjacent, axis=0)[:height]
        noise = rows + rng.normal(0.0, columns * common, (1, width)) + rng.normal(0.0, own, shape)
        images.append(np.clip(np.round(level + noise), 0, 255).astype(np.uint8))
    return images


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("common", "own"), [(1.5, 3.0), (3.0, 1.5), (8.0, 1.0), (3.0, 0.0)])
@pytest.mark.parametrize("level", [8, 200])
def test_noise_of_rows_and_columns(level: int, common: float, own: float, form: str) -> None:
    adjacent, columns = FORMS[form]
    for shape in ((240, 320), (480, 640)):
        images = covered(shape, level, common, own, adjacent=adjacent, columns=columns)
        assert all(GuardFault.BLACK in found for found in faults_of(images, is_moving=None))


def test_columns_alone() -> None:
    images = [image.T for image in covered((640, 480), 60, 5.0, 0.5)]
    assert all(GuardFault.BLACK in found for found in faults_of(images, is_moving=None))


@pytest.mark.slow
@pytest.mark.parametrize("coding", CODINGS)
@pytest.mark.parametrize(("common", "own"), [(1.5, 1.5), (3.0, 1.5), (3.0, 3.0)])
def test_behind_encoders(common: float, own: float, coding: str) -> None:
    images = as_coded(covered((480, 640), 30, common, own), CODINGS[coding])
    assert all(GuardFault.BLACK in found for found in faults_of(images, is_moving=None))


@pytest.mark.slow
def test_a_road_under_such_noise_is_none_also_at_half_its_light() -> None:
    drive = road_ahead()[:NUM_IMAGES]
    for share in (1.0, 0.5):
        noisy = [
            np.clip(share * image + noise - 30.0, 0, 255).astype(np.uint8)
            for image, noise in zip(drive, covered((320, 480), 30, 3.0, 1.5, columns=1.0), strict=True)
        ]
        assert not any(GuardFault.BLACK in found for found in faults_of(noisy))


def measures_of(rows: NDArray[np.uint8]) -> tuple[float, float]:
    measures = ImagePieces().update(rows, 255)
    return measures.own_contrast, measures.contrast


def test_what_a_piece_has_of_its_own() -> None:
    rng = np.random.default_rng(2)
    common = (60 + rng.integers(0, 12, (28, 1)) + rng.integers(0, 12, (1, 640))).astype(np.uint8)
    own, whole = measures_of(common)
    assert own == pytest.approx(0.0, abs=1e-9)
    assert whole > 0.03
    lit = common.copy()
    lit[10:14, 160:480] += 20
    assert measures_of(lit)[0] > 0.05
    few = common[:5]
    assert measures_of(few)[0] == measures_of(few)[1]
