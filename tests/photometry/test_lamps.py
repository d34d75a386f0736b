"""The tables that ship meet the regulations' points as public notes give them; H to the right, V upwards, degrees."""

from __future__ import annotations

import numpy as np
import pytest

from foreglow.photometry import (
    IntensityTable,
    high_beam,
    low_beam,
    matrix_beam,
    position_lamp,
    rear_lamp,
    street_lamp,
    window,
)


def at(table: IntensityTable, right_deg: float, up_deg: float) -> float:
    right, up = np.radians(right_deg), np.radians(up_deg)
    return float(table.towards([np.cos(up) * np.cos(right), -np.cos(up) * np.sin(right), np.sin(up)]))


@pytest.mark.parametrize(
    ("point", "least_cd", "most_cd"),
    [
        ((-3.43, 0.57), 0, 350),  # B50L
        ((1.15, -0.57), 12_100, np.inf),  # 75R
        ((1.72, -0.86), 10_100, np.inf),  # 50R
        ((0.0, -0.86), 5_100, np.inf),  # 50V
        ((-3.43, -0.86), 0, 13_200),  # 50L
        ((-9.0, -1.72), 1_700, np.inf),  # 25L
        ((9.0, -1.72), 1_700, np.inf),  # 25R
    ],
)
def test_low_beam_points(point: tuple[float, float], least_cd: float, most_cd: float) -> None:
    assert least_cd <= at(low_beam(), *point) <= most_cd


@pytest.mark.parametrize("point", [(-9.0, -1.72), (9.0, -1.72)])  # 25L, 25R
def test_an_old_low_beam_meets_class_a_and_leaves_the_foreground_dark(point: tuple[float, float]) -> None:
    old = low_beam(0.4)
    assert at(old, *point) >= 1_250
    assert at(old, 1.15, -0.57) >= 5_100  # 75R
    assert at(old, 0.0, -8.0) < 0.25 * at(low_beam(), 0.0, -8.0)
    assert at(old, 0.0, 1.0) == pytest.approx(at(low_beam(), 0.0, 1.0), rel=1e-3)  # the same above the cut-off


def test_slush_on_a_lamp_scatters_light_above_the_cut_off() -> None:
    clean, dirty = low_beam(), low_beam(stray=5.0)
    assert at(dirty, 0.0, 5.0) == pytest.approx(5.0 * at(clean, 0.0, 5.0), rel=0.01)
    assert at(dirty, 1.15, -1.0) < 1.1 * at(clean, 1.15, -1.0)


def test_low_beam_dazzles_nobody() -> None:
    """Zone III: above the horizon on the left, above the 15 degrees arm, at most 1 degree up, on the right."""
    table = low_beam()
    azimuths, elevations = np.meshgrid(table.azimuths_deg, table.elevations_deg)
    border = np.clip(-azimuths * np.tan(np.radians(15.0)), 0.0, 1.0)
    assert table.intensities_cd[elevations >= border].max() <= 625


def test_low_beam_has_a_cut_off_with_a_kink_to_the_right() -> None:
    table = low_beam()
    assert at(table, -3.0, -0.1) < 0.1 * at(table, -3.0, -1.0)
    assert at(table, 3.0, -0.1) > 0.5 * at(table, 3.0, -1.0)
    assert 600 <= table.luminous_flux_lm <= 1200


def test_high_beam_points() -> None:
    table = high_beam()
    peak = float(table.intensities_cd.max())
    assert 40_000 <= peak <= 215_000
    assert at(table, 0, 0) >= 0.8 * peak
    for angle_deg, least_cd in ((3, 17_500), (6, 5_000), (9, 3_400), (12, 1_500)):
        assert min(at(table, angle_deg, 0), at(table, -angle_deg, 0)) >= least_cd


@pytest.mark.parametrize("table", [low_beam(), high_beam(), position_lamp(), rear_lamp()])
def test_lamps_are_seen_from_the_side(table: IntensityTable) -> None:
    for right_deg in (-60, -30, 30, 60):
        assert 0.05 < at(table, right_deg, 1.0) < at(table, 0.0, 1.0)


@pytest.mark.parametrize("table", [low_beam(), high_beam(), matrix_beam("left").table(np.ones(84))])
def test_headlamps_fade_to_dark_at_the_border_of_the_table(table: IntensityTable) -> None:
    intensities = table.intensities_cd
    for border in (intensities[0], intensities[-1], intensities[:, 0], intensities[:, -1]):
        assert border.max() == 0
    for inner in (intensities[3], intensities[-4], intensities[:, 3], intensities[:, -4]):
        assert inner.max() < 5


def test_signal_lamps_are_as_bright_as_they_may_be() -> None:
    assert at(position_lamp(), 0, 0) == pytest.approx(20)
    assert 4 <= at(rear_lamp(), 0, 0) <= 17


def test_tables_to_be_scaled_have_one_candela_ahead() -> None:
    assert at(street_lamp(), 0, 0) == pytest.approx(1, abs=0.01)
    assert at(street_lamp(), 55, 0) > 1.5
    assert at(window(), 0, 0) == pytest.approx(1)
    assert window().luminous_flux_lm == pytest.approx(np.pi, rel=1e-3)  # Lambert's law
