from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.lab.simulation.camera.optics import TAIL_RADIUS_PX, TAIL_SOFTENING_PX, LampPoints, Optics
from foreglow.lab.simulation.scenes.scene import SensorSpec
from tests.lab.simulation.cameras import camera

SPEC = SensorSpec()
CAMERA = camera()
OPTICS = Optics(SPEC, CAMERA)
FULL = camera(1280, 960)


def lamp(x: float, y: float, illuminance_lx: float = 1e-3, radius_px: float = 0.0) -> LampPoints:
    return LampPoints(np.array([[x, y]]), np.array([illuminance_lx]), np.array([radius_px]))


def flux(illuminance_lx: float) -> float:
    return illuminance_lx / CAMERA.pixel_solid_angle_sr


def centroid(image: np.ndarray) -> np.ndarray:
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]] + 0.5
    return np.average(np.stack([columns, rows]), axis=(1, 2), weights=np.stack([image, image]))


def tail_within(radius_px: float) -> float:
    """Share of the light in the tail within a radius, pixels of 1280 columns, in closed form."""
    whole = np.log1p((TAIL_RADIUS_PX / TAIL_SOFTENING_PX) ** 2)
    return float(SPEC.tail_share * np.log1p((radius_px / TAIL_SOFTENING_PX) ** 2) / whole)


def test_point_keeps_its_energy() -> None:
    image = OPTICS.draw_points(lamp(160.3, 120.6))
    rows, columns = np.mgrid[:240, :320] + 0.5
    within = np.hypot(columns - 160.3, rows - 120.6) < 100
    expected = 1.0 - SPEC.tail_share + tail_within(400)
    assert float(image[within].sum()) / flux(1e-3) == pytest.approx(expected, abs=5e-4)


def test_tail_falls_by_the_square_without_an_end() -> None:
    image = Optics(SPEC, FULL).draw_points(lamp(200.5, 480.5, 1.0)).astype(np.float64)
    profile = image[480, 200:] * np.arange(1080.0) ** 2
    far = profile[100:]
    assert far.min() / far.max() > 0.9
    steps = np.abs(np.diff(np.log(image[480, 220:])))
    assert steps.max() < 0.12  # nowhere an edge, not even that of a window
    assert (np.diff(image[480, 202:]) < 0).all()


def test_no_square_around_a_lamp() -> None:
    """On a ring the tail is the same in all directions."""
    image = Optics(SPEC, FULL).draw_points(lamp(640.0, 480.0, 1.0))
    rows, columns = np.mgrid[:960, :1280] + 0.5
    distances = np.hypot(columns - 640, rows - 480)
    for radius in (15, 40, 90, 180, 350):
        ring = (image * distances**2)[np.abs(distances - radius) < 0.5]
        assert ring.std() / ring.mean() < 0.02


@settings(max_examples=20)
@given(x=st.floats(40, 1240), y=st.floats(40, 60))
def test_centroid_of_a_point(x: float, y: float) -> None:
    """Without the tail, which the image's borders would cut unevenly."""
    optics = Optics(SensorSpec(tail_share=0.0), camera(1280, 100))
    assert centroid(optics.draw_points(lamp(x, y))) == pytest.approx(np.array([x, y]), abs=0.01)


def test_point_and_tiny_extended_source_agree() -> None:
    """The two ways to draw light meet: a pixel of luminance L is a lamp of L times its solid angle."""
    luminance = np.zeros((240, 320), np.float32)
    luminance[120, 160] = 1000.0
    spread = OPTICS.spread(luminance)
    drawn = OPTICS.draw_points(lamp(160.5, 120.5, 1000.0 * CAMERA.pixel_solid_angle_sr))
    # The extended source is a pixel wide before the lens, the lamp is a point.
    blurred = cv2.blur(drawn, (3, 3))[120, 160]
    assert cv2.blur(spread, (3, 3))[120, 160] == pytest.approx(blurred, rel=0.1)
    assert spread.sum() == pytest.approx(drawn.sum(), rel=2e-3)
    assert spread[60, 100] == pytest.approx(drawn[60, 100], rel=0.06)  # the glare's cells are 4 px wide


def test_disc_is_wider_and_equally_bright() -> None:
    optics = Optics(SPEC, FULL)
    small, large = (optics.draw_points(lamp(640.2, 480.4, 1.0, radius)) for radius in (0.0, 6.0))
    assert large.sum() == pytest.approx(small.sum(), rel=3e-3)
    assert large.max() < 0.1 * small.max()
    middle = large[477:484, 637:644]
    assert middle.std() / middle.mean() < 0.02  # flat, without the grain of its points


def test_light_of_lamps_adds() -> None:
    first, second = lamp(100.2, 80.0, 2e-3), lamp(150.7, 90.0, 1e-4, 2.0)
    both = LampPoints(
        np.concatenate([first.positions_px, second.positions_px]),
        np.concatenate([first.illuminances_lx, second.illuminances_lx]),
        np.concatenate([first.radii_px, second.radii_px]),
    )
    total = OPTICS.draw_points(first) + OPTICS.draw_points(second)
    np.testing.assert_allclose(OPTICS.draw_points(both), total, rtol=1e-4)


def test_glare_comes_from_outside_the_image() -> None:
    image = OPTICS.draw_points(lamp(-30.0, 120.0, 1.0))
    assert image[120, 0] > image[120, 100] > image[120, 300] > 0


def test_no_lamps() -> None:
    nobody = LampPoints(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    assert not OPTICS.draw_points(nobody).any()


def test_uniform_surface_stays() -> None:
    spread = OPTICS.spread(np.full((240, 320), 7.0, np.float32))
    # In the middle the tail of what lies outside the image is missing.
    assert 7.0 * (1 - SPEC.tail_share + tail_within(480)) * 0.999 < spread[120, 160] < 7.0
    assert np.abs(np.diff(spread[120])).max() < 0.005


def test_spread_does_not_wrap() -> None:
    luminance = np.zeros((240, 320), np.float32)
    luminance[:, :4] = 100.0
    spread = OPTICS.spread(luminance)
    assert (np.diff(cv2.blur(spread, (9, 9))[120, 20:]) <= 1e-6).all()


def test_spread_is_linear_and_leaves_its_input() -> None:
    rng = np.random.default_rng(3)
    first, second = rng.random((2, 240, 320), np.float32)
    kept = first.copy()
    np.testing.assert_allclose(
        OPTICS.spread(first + 3 * second), OPTICS.spread(first) + 3 * OPTICS.spread(second), rtol=1e-4
    )
    assert (first == kept).all()


@pytest.mark.parametrize("share", [0.5, 0.25])
def test_fewer_pixels_see_the_average(share: float) -> None:
    fine = Optics(SPEC, FULL).draw_points(lamp(641.3, 478.6))
    small = camera(int(1280 * share), int(960 * share))
    coarse = Optics(SPEC, small).draw_points(lamp(641.3 * share, 478.6 * share))
    averaged = cv2.resize(fine, (small.width_px, small.height_px), interpolation=cv2.INTER_AREA)
    np.testing.assert_allclose(coarse, averaged, rtol=0.05, atol=1e-3 * float(averaged.max()))


def test_fall_off_is_cos_to_the_fourth() -> None:
    cosine = float(CAMERA.rays([[0.5, 0.5]])[0, 0])
    assert OPTICS.fall_off[0, 0] == pytest.approx(cosine**4, rel=0.01)
    assert OPTICS.fall_off[120, 160] == pytest.approx(1.0, abs=1e-3)
    none = Optics(SensorSpec(vignetting=0.0), CAMERA)
    assert (none.fall_off == 1).all()


def test_bad_points() -> None:
    with pytest.raises(ValueError, match=r"LampPoints\.illuminances_lx: expected at least 0"):
        lamp(0, 0, -1.0)
    with pytest.raises(ValueError, match=r"LampPoints\.positions_px: expected finite"):
        lamp(np.nan, 0)
    with pytest.raises(ValueError, match=r"LampPoints\.radii_px: expected finite numbers of shape \(1,\)"):
        LampPoints(np.zeros((1, 2)), np.ones(1), np.ones(2))


def test_shares_above_one() -> None:
    with pytest.raises(ValueError, match="at most 1"):
        Optics(SensorSpec(middle_share=0.9, tail_share=0.2), CAMERA)
