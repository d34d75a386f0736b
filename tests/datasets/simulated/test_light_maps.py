"""Light maps: what is stored is what was there, to the steps of the format."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from foreglow.datasets.simulated.light_maps import decoded, encoded, light_map_path, read_light_map, reduced


def test_light_comes_back_to_a_step(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    cells = (10.0 ** random.uniform(-3.0, 4.0, (6, 40, 70))).astype(np.float32)
    cells[2] = 0.0
    path = light_map_path(tmp_path, 10_000)
    path.parent.mkdir()
    cv2.imwrite(str(path), encoded(cells))
    found = read_light_map(path)
    np.testing.assert_allclose(found, cells, rtol=0.045, atol=1e-6)
    assert not found[2].any()


def test_cells_are_means_and_leave_out_what_fills_none() -> None:
    light = np.zeros((6, 9, 13), np.float32)
    light[0, :4, :4] = np.arange(16).reshape(4, 4)
    light[5, 8:] = light[5, :, 12:] = 100.0
    cells = reduced(light)
    assert cells.shape == (6, 2, 3)
    assert cells[0, 0, 0] == pytest.approx(7.5)
    assert cells.sum() == pytest.approx(7.5)


def test_light_that_is_too_bright_or_negative_ends_at_the_limits() -> None:
    cells = np.array([-1.0, 1e9], np.float32).reshape(1, 1, 2).repeat(6, 0)
    assert encoded(cells)[0].tolist() == [0, 255]


def test_another_image_is_no_light_map(tmp_path: Path) -> None:
    path = tmp_path / "other.png"
    cv2.imwrite(str(path), np.zeros((80, 64), np.uint8))
    with pytest.raises(ValueError, match=r"other.png: light map: expected a grey image of 8 bits and 6 parts, got"):
        read_light_map(path)
    with pytest.raises(ValueError, match="and 6 parts"):
        decoded(np.zeros((12, 4, 3), np.uint8))
