"""The most that LEDs shine in each cell: never less than anything in it, whatever the tables are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.geometry import Floats, Pose, rotation
from foreglow.photometry import Headlamp, Headlamps, IntensityTable, MatrixLamp, read_headlamps

AZIMUTHS_DEG = np.concatenate([[-180.0], np.arange(-7.0, 7.1, 0.2), [180.0]])
ELEVATIONS_DEG = np.concatenate([[-90.0], np.arange(-4.0, 5.1, 0.2), [90.0]])


def spotted(rng: np.random.Generator, step_deg: float) -> MatrixLamp:
    """Three LEDs with light in single nodes of their tables, dark between them."""
    azimuths = np.arange(-4.0, 4.0, step_deg) + rng.uniform(0, step_deg)
    elevations = np.arange(-2.0, 3.0, step_deg) + rng.uniform(0, step_deg)
    shape = 3, len(elevations), len(azimuths)
    leds_cd = np.where(rng.random(shape) < 0.1, 1e4 * rng.random(shape), 0.0).astype(np.float32)
    base = IntensityTable(azimuths, elevations, np.zeros(shape[1:], np.float32))
    return MatrixLamp(base, slice(0, shape[2]), slice(0, shape[1]), leds_cd, np.zeros(3), np.zeros(3), 3)


def shone(lamps: Headlamps, azimuths_deg: Floats, elevations_deg: Floats) -> Floats:
    azimuths, elevations = np.radians(azimuths_deg), np.radians(elevations_deg)
    across = np.cos(elevations)
    directions = np.stack([across * np.cos(azimuths), across * np.sin(azimuths), np.sin(elevations)], axis=-1)
    return lamps.intensities_cd(directions)[1]


@settings(derandomize=True, max_examples=12, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.05, 0.13, 0.2, 0.3, 1.0]), st.booleans())
def test_nothing_is_brighter(seed: int, step_deg: float, is_turned: bool) -> None:
    rng = np.random.default_rng(seed)
    matrix = spotted(rng, step_deg)
    left, right = (
        Pose(np.array([3.6, y_m, 0.7]), rotation(*(np.radians(rng.uniform(-5, 5, 2)) * is_turned)))
        for y_m in (0.6, -0.6)
    )
    lamps = Headlamps("spots", Headlamp(left, matrix), Headlamp(right, matrix))
    azimuths, elevations = rng.uniform(-15, 15, 5000), rng.uniform(-8, 9, 5000)
    found = shone(lamps, azimuths, elevations)
    columns, rows = np.digitize(azimuths, AZIMUTHS_DEG) - 1, np.digitize(elevations, ELEVATIONS_DEG) - 1
    assert (found > 100).sum() > 100
    for side, table in enumerate(lamps.greatest_cd(AZIMUTHS_DEG, ELEVATIONS_DEG)):
        assert table.shape == (len(ELEVATIONS_DEG) - 1, len(AZIMUTHS_DEG) - 1, 3)
        assert (found[:, side] <= table[rows, columns] * 1.00001 + 1e-3).all()


def test_not_far_above_what_is_shone() -> None:
    lamps = read_headlamps()
    table = lamps.greatest_cd(AZIMUTHS_DEG, ELEVATIONS_DEG)[0]
    for row, column in [(20, 30), (25, 40), (15, 50)]:
        azimuths, elevations = np.meshgrid(
            np.linspace(AZIMUTHS_DEG[column] - 0.15, AZIMUTHS_DEG[column + 1] + 0.15, 40),
            np.linspace(ELEVATIONS_DEG[row] - 0.15, ELEVATIONS_DEG[row + 1] + 0.15, 40),
        )
        around = shone(lamps, azimuths.ravel(), elevations.ravel())[:, 0].max(axis=0)
        assert (table[row, column] <= around * 1.001 + 1e-3).all()
        assert table[row, column].max() > 1000


def test_light_beyond_a_grid_is_in_its_outermost_cells() -> None:
    lamps = read_headlamps()
    wide, narrow = (
        lamps.greatest_cd(np.array([-180.0, *edges, 180.0]), np.array([-90.0, *edges, 90.0]))[0]
        for edges in ((-60.0, 60.0), (-1.0, 1.0))
    )
    assert wide[[0, -1]].max() == wide[:, [0, -1]].max() == 0.0
    assert narrow[:, 0].max() == pytest.approx(lamps.left.matrix.leds_cd[:, :, :].max(), rel=0.5)
    assert wide[1, 1].max() == pytest.approx(lamps.left.matrix.leds_cd.max())
