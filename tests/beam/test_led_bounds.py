"""Bounds over spans of directions: above all that is shone there, and not far above."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.beam.led_bounds import LedBounds, led_bounds
from foreglow.geometry import Floats
from tests.beam.made_up import FakeLamps

LAMPS = FakeLamps()
BOUNDS = LedBounds(LAMPS)


def shone(least_deg: Floats, most_deg: Floats, count: int = 40) -> Floats:
    """The greatest of each LED over a fine grid of a span, shape (2, L)."""
    azimuths, elevations = np.radians(
        np.meshgrid(np.linspace(least_deg[0], most_deg[0], count), np.linspace(least_deg[1], most_deg[1], count))
    )
    directions = np.stack(
        [np.cos(elevations) * np.cos(azimuths), np.cos(elevations) * np.sin(azimuths), np.sin(elevations)], -1
    )
    return np.asarray(LAMPS.intensities_cd(directions.reshape(-1, 3))[1].max(axis=0))


def bound(least_deg: Floats, most_deg: Floats) -> Floats:
    span = np.radians([least_deg[0], most_deg[0], least_deg[1], most_deg[1]])
    return np.asarray(BOUNDS.towards(np.broadcast_to(span, (1, 2, 4)))[0], np.float64)


@pytest.mark.slow
@settings(derandomize=True, max_examples=120, deadline=None)
@given(st.floats(-30, 30), st.floats(-6, 10), st.floats(0, 12), st.floats(0, 8))
def test_above_what_is_shone(azimuth: float, elevation: float, width: float, height: float) -> None:
    least = np.array([azimuth, elevation])
    most = least + np.array([width, height])
    bounded = bound(least, most)
    assert (bounded * 1.00001 + 1e-3 >= shone(least, most)).all()
    # A span of more than eight cells is looked up in larger ones, up to a quarter as large as the span.
    grown = 0.2 + np.array([width, height]).max() / 3.5
    assert (bounded <= shone(least - grown, most + grown, 160) * 1.02 + 1e-3).all()


@pytest.mark.parametrize("azimuth", [-60.0, -44.95, 44.95, 60.0, 179.0])
def test_far_aside_there_is_nothing(azimuth: float) -> None:
    assert bound(np.array([azimuth, 0.0]), np.array([azimuth, 0.1])).max() < 1.0


def test_everything_at_once() -> None:
    bounded = bound(np.array([-180.0, -90.0]), np.array([180.0, 90.0]))
    np.testing.assert_allclose(bounded, 20_000.0, rtol=0.02)


def test_each_span_and_lamp_on_its_own() -> None:
    spans = np.radians(np.random.default_rng(0).uniform(-8, 8, (7, 2, 4)))
    spans[..., [0, 1]].sort(axis=-1)
    spans[..., 1], spans[..., 3] = spans[..., 0] + 0.02, spans[..., 2] + 0.01
    together = BOUNDS.towards(spans)
    assert together.shape == (7, 2, LAMPS.num_leds)
    for number in range(7):
        for lamp in range(2):
            alone = BOUNDS.towards(np.broadcast_to(spans[number, lamp], (1, 2, 4)))
            np.testing.assert_array_equal(together[number, lamp], alone[0, lamp])


def test_made_once() -> None:
    assert led_bounds(LAMPS) is led_bounds(LAMPS)
    assert led_bounds(LAMPS) is not led_bounds(FakeLamps())


def test_no_spans() -> None:
    assert BOUNDS.towards(np.zeros((0, 2, 4))).shape == (0, 2, LAMPS.num_leds)
