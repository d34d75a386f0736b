from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from foreglow.files import to_json
from foreglow.lab.studies.simulator.metrics import compare_images, image_statistics
from tests.shared_data import shared_file


def noisy(sigma: float = 2.0, column_sigma: float = 0.0, level: float = 30.0, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    image = level + sigma * rng.standard_normal((480, 1280)) + column_sigma * rng.standard_normal(1280)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def test_known_noise() -> None:
    statistics = image_statistics(noisy(2.0))
    assert statistics.dark_grey == pytest.approx(30.0, abs=0.05)
    assert statistics.noise_grey == pytest.approx(math.hypot(2.0, 12**-0.5), rel=0.02)
    for correlation in (statistics.correlation_x, statistics.correlation_y, statistics.correlation_y2):
        assert correlation == pytest.approx(0, abs=0.02)
    assert statistics.percentiles_grey[3] == 30


def test_known_columns() -> None:
    assert image_statistics(noisy(2.0, 1.5)).column_grey == pytest.approx(1.5, rel=0.1)
    assert image_statistics(noisy(2.0)).column_grey == pytest.approx(2.0 / 192**0.5, rel=0.15)


def test_alternating_rows() -> None:
    image = noisy(1.0)
    image[::2, ::2] += 4
    image[1::2, 1::2] += 4
    statistics = image_statistics(image)
    assert statistics.row_parity_grey == pytest.approx(2.0, rel=0.05)
    assert statistics.correlation_y < 0 < statistics.correlation_y2


def test_row_noise() -> None:
    image = noisy(1.0) + np.random.default_rng(1).integers(0, 5, (480, 1), np.uint8)
    assert image_statistics(image).row_grey == pytest.approx(2**0.5, rel=0.15)


def test_lamp_profile_and_saturation() -> None:
    image = np.full((480, 1280), 10, np.uint8)
    cv2.circle(image, (700, 400), 5, 255, -1)
    statistics = image_statistics(image)
    assert statistics.num_saturated == (image == 255).sum()
    assert statistics.lamp_grey[:4] == (255, 255, 255, 255)
    assert statistics.lamp_grey[4:] == (10,) * 7


def test_mean_of_several() -> None:
    alone, two = noisy(seed=1), noisy(sigma=4.0, seed=2)
    both, first, second = image_statistics([alone, two]), image_statistics(alone), image_statistics(two)
    assert both.num_images == 2
    assert both.noise_grey == pytest.approx((first.noise_grey + second.noise_grey) / 2)
    assert both.percentiles_grey[0] == pytest.approx((first.percentiles_grey[0] + second.percentiles_grey[0]) / 2)


def test_the_real_frame() -> None:
    image = cv2.imread(str(shared_file("data/pvdn_frame_047433.png")), cv2.IMREAD_UNCHANGED)
    assert image is not None
    statistics = image_statistics(np.asarray(image, np.uint8))
    assert statistics.dark_grey == pytest.approx(7.6, abs=0.05)
    assert statistics.column_grey == pytest.approx(1.3, abs=0.05)
    assert statistics.noise_grey == pytest.approx(1.5, abs=0.05)
    assert statistics.correlation_x == pytest.approx(0.23, abs=0.01)
    assert 0.14 < statistics.correlation_y < statistics.correlation_y2 < 0.19
    assert statistics.lamp_grey[0] == 228
    assert statistics.num_saturated == 0
    assert statistics.num_proposals == 7


def test_compare_and_json() -> None:
    real, simulated = image_statistics(noisy(2.0)), image_statistics(noisy(3.0))
    rows = {row.name: row for row in compare_images(real, simulated)}
    assert rows["noise grey"].ratio == pytest.approx(simulated.noise_grey / real.noise_grey)
    assert rows["grey level, percentile 50"].real == 30
    assert "lamp, 4 to 6 px" in rows
    assert math.isnan(rows["num saturated"].ratio)
    assert to_json(real)["noise_grey"] == real.noise_grey
    flat = to_json(image_statistics(np.full((64, 64), 7, np.uint8)))
    assert flat["correlation_x"] is None
    assert flat["percentiles_grey"] == [7.0] * 8


@pytest.mark.parametrize(
    "images", [[], np.zeros((8, 8), np.uint8), [np.zeros((64, 64))], np.zeros((2, 64, 64, 3), np.uint8)]
)
def test_bad_images(images: list[np.ndarray]) -> None:
    with pytest.raises(ValueError, match="image_statistics: expected"):
        image_statistics(images)
