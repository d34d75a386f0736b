from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.photometry import NUM_LEDS, IntensityTable, low_beam, matrix_beam
from foreglow.photometry.matrix import measured_lamp, with_mirrored_base

Side: TypeAlias = Literal["left", "right"]
SIDES: tuple[Side, ...] = ("left", "right")


@settings(max_examples=20)
@given(led=st.integers(0, NUM_LEDS - 1), other=st.integers(0, NUM_LEDS - 1), share=st.floats(0, 1))
def test_linear_in_the_levels(led: int, other: int, share: float) -> None:
    lamp = matrix_beam("left")
    lit, other_lit = np.eye(NUM_LEDS)[led], np.eye(NUM_LEDS)[other]
    mixed, first, second = (
        lamp.table(x).intensities_cd for x in (share * lit + (1 - share) * other_lit, lit, other_lit)
    )
    np.testing.assert_allclose(mixed, share * first + (1 - share) * second, rtol=1e-5, atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("side", SIDES)
def test_all_on_is_the_sum_of_each_one(side: Side) -> None:
    lamp = matrix_beam(side)
    total = lamp.base.intensities_cd.astype(np.float64)
    for led in np.eye(NUM_LEDS):
        total += lamp.table(led).intensities_cd - lamp.base.intensities_cd
    np.testing.assert_allclose(lamp.table(np.ones(NUM_LEDS)).intensities_cd, total, rtol=1e-4, atol=0.5)


def test_all_off_is_the_low_beam() -> None:
    assert (matrix_beam("left").table(np.zeros(NUM_LEDS)).intensities_cd == low_beam().intensities_cd).all()


def test_each_led_shines_where_it_says() -> None:
    lamp = matrix_beam("right")
    azimuths, elevations = lamp.base.azimuths_deg[lamp.columns], lamp.base.elevations_deg[lamp.rows]
    for led, table in enumerate(lamp.leds_cd):
        assert np.average(azimuths, weights=table.sum(0)) == pytest.approx(lamp.azimuths_deg[led], abs=0.02)
        assert np.average(elevations, weights=table.sum(1)) == pytest.approx(lamp.elevations_deg[led], abs=0.02)
    assert lamp.azimuths_deg[0] < lamp.azimuths_deg[27]
    assert lamp.elevations_deg[0] < lamp.elevations_deg[-1]


@pytest.mark.parametrize("span_deg", [(-90.0, 90.0), (-40.0, 30.0), (-25.0, 60.1)])
def test_a_mirrored_low_beam_leaves_the_leds_where_they_are(span_deg: tuple[float, float]) -> None:
    """In a table that reaches further to one side, they were mirrored by half: off by the difference."""
    azimuths, elevations = np.linspace(*span_deg, 721), np.linspace(-10.0, 10.0, 201)
    directions = np.radians(np.stack(np.meshgrid(np.arange(-20.0, 21.0), [-3.0, 1.0]), -1).reshape(-1, 2))
    ahead, left, up = np.cos(directions[:, 0]), np.sin(directions[:, 0]), np.tan(directions[:, 1])
    azimuth, elevation = np.meshgrid(azimuths, elevations)
    base = IntensityTable(azimuths, elevations, (5000 + 100 * azimuth + 50 * elevation).astype(np.float32).clip(0))
    led = IntensityTable(azimuths, elevations, 900 * np.exp(-((azimuth - 5) ** 2) - (elevation - 1) ** 2))
    lamp = measured_lamp(base, [led], 1)
    mirrored = with_mirrored_base(lamp)
    for levels in ([0.0], [1.0]):
        own = led.towards(np.stack([ahead, left, up], -1)) * levels[0]
        shone = mirrored.table(levels).towards(np.stack([ahead, left, up], -1))
        np.testing.assert_allclose(shone, base.towards(np.stack([ahead, -left, up], -1)) + own, atol=20.0)


def test_no_gaps_between_the_columns_and_the_lamps_mesh() -> None:
    row = np.searchsorted(low_beam().elevations_deg, 0.3)
    left, right = (matrix_beam(side).table(np.ones(NUM_LEDS)).intensities_cd[row] for side in SIDES)
    middle = np.abs(low_beam().azimuths_deg) < 8
    both = (left + right)[middle].astype(np.float64)
    assert np.abs(np.diff(both)).max() < 0.1 * both.max()
    assert both.min() > 10_000


@pytest.mark.parametrize("levels", [np.ones(83), np.full(84, 1.1), np.full(84, -0.1), np.full(84, np.nan)])
def test_bad_levels(levels: np.ndarray) -> None:
    with pytest.raises(ValueError, match="84 numbers from 0 to 1"):
        matrix_beam("left").table(levels)


@pytest.mark.parametrize(("side", "columns"), [("left", slice(287, 437)), ("right", slice(285, 435))])
def test_the_leds_part_of_the_table_stays(side: Side, columns: slice) -> None:
    """Of another size, sums over the LEDs round differently where BLAS has threads, and drives look different."""
    lamp = matrix_beam(side)
    assert (lamp.rows, lamp.columns) == (slice(276, 356), columns)
    assert lamp.leds_cd.shape == (NUM_LEDS, 80, 150)


@pytest.mark.parametrize(("sigma_deg", "is_kept"), [(0.04, False), (0.15, True)])
def test_leds_lose_no_peak_between_the_angles_of_the_table(sigma_deg: float, is_kept: bool) -> None:
    """A guard would let more light than it knows of shine at a vehicle."""
    azimuths, elevations = np.arange(-3.0, 3.01, 0.1) + 0.04, np.arange(-1.0, 2.01, 0.1) + 0.05
    square = (azimuths - azimuths[30]) ** 2 + (elevations[:, np.newaxis] - elevations[10]) ** 2
    led = IntensityTable(azimuths, elevations, (30_000.0 * np.exp(-0.5 * square / sigma_deg**2)).astype(np.float32))
    if is_kept:
        assert measured_lamp(low_beam(), [led], 1).leds_cd.max() > 0.75 * 30_000.0
    else:
        with pytest.raises(ValueError, match=r"^LED 0: expected light that a table in steps of 0\.083 x 0\.1 degrees"):
            measured_lamp(low_beam(), [led], 1)
