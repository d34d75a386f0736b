from __future__ import annotations

import cv2
import numpy as np
import pytest

from foreglow.lab.simulation.camera.optics import LampPoints, Optics
from foreglow.lab.simulation.camera.profile import (
    CameraProfile,
    CarSpec,
    GhostSpec,
    ImagerSpec,
    LensSpec,
    StreakSpec,
    VeilSpec,
)
from foreglow.lab.simulation.camera.windscreen import Windscreen
from foreglow.lab.simulation.scenes.scene import SensorSpec
from tests.lab.simulation.cameras import camera

CAMERA = camera(640, 480)


def windscreen(lens: LensSpec, car: CarSpec | None = None) -> Windscreen:
    return Windscreen(CameraProfile(name="own", lens=lens, car=car or CarSpec()), SensorSpec(), CAMERA)


def lamp(x: float, y: float) -> LampPoints:
    return LampPoints(np.array([[x, y]]), np.array([1.0]), np.array([0.3]))


def flux() -> float:
    """Sum over all pixels of a lamp in the middle that gives 1 lx."""
    return 1.0 / CAMERA.pixel_solid_angle_sr


def test_a_veil_falls_as_its_exponent_says_over_decades() -> None:
    optics = windscreen(LensSpec(veils=(VeilSpec(share=0.1, angle_deg=0.2, exponent=2.5),)))
    image = optics.draw_points(lamp(320.0, 240.0))
    deg_px = np.radians(1.0) * CAMERA.focal_px[0]
    for near_deg, far_deg in ((1.5, 3.0), (3.0, 6.0), (6.0, 12.0)):
        near, far = (float(image[240, 320 + round(angle * deg_px)]) for angle in (near_deg, far_deg))
        assert near / far == pytest.approx(2**2.5, rel=0.12)


def test_light_is_only_moved_by_veils_and_streaks() -> None:
    lens = LensSpec(veils=(VeilSpec(share=0.02, angle_deg=0.2, exponent=4.0),), streaks=(StreakSpec(share=0.05),))
    image = windscreen(lens).draw_points(lamp(320.0, 240.0))
    assert float(image.sum()) == pytest.approx(flux(), rel=0.01)


def test_an_extended_source_has_the_veil_of_a_lamp() -> None:
    optics = windscreen(LensSpec(veils=(VeilSpec(share=0.1, angle_deg=0.5),)))
    square = np.zeros((480, 640), np.float32)
    square[236:244, 316:324] = flux() / 64
    spread, drawn = optics.spread(square), optics.draw_points(lamp(320.0, 240.0))
    for shift in (60, 120, 240):
        assert spread[240, 320 + shift] == pytest.approx(drawn[240, 320 + shift], rel=0.05)


def test_without_additions_it_is_the_exact_lens_within_a_bound() -> None:
    """For surfaces over four decades, a reflector, and lamps near and far."""
    rng = np.random.default_rng(2)
    drawn = np.exp(3.0 * rng.standard_normal((480, 640))).astype(np.float32)
    light = np.asarray(cv2.GaussianBlur(drawn, (0, 0), 3.0), np.float32)
    light[:240] *= np.float32(1e-3)
    light[300:303, 400:403] = 100.0
    lamps = LampPoints(np.array([[100.2, 50.7], [500.5, 250.1]]), np.array([1.0, 1e-3]), np.array([2.0, 0.2]))
    spec = SensorSpec(middle_px=1.0)
    quick = Windscreen(CameraProfile(name="own", imager=ImagerSpec(model="scene")), spec, CAMERA)
    for found, exact in zip(
        (quick.spread(light), quick.draw_points(lamps)),
        (Optics(spec, CAMERA).spread(light), Optics(spec, CAMERA).draw_points(lamps)),
        strict=True,
    ):
        errors = np.abs(found / exact - 1.0)
        assert float(errors.max()) < 0.08
        assert float(np.percentile(errors, 98)) < 0.02


@pytest.mark.parametrize(
    ("ghost", "expected"),
    [
        (GhostSpec(strength=0.01, scale=-1.0, radius_deg=(0.3, 0.3)), (440.0, 280.0)),
        (
            GhostSpec(strength=0.01, shift_deg=(0.0, 3.0), radius_deg=(0.3, 0.3)),
            (200.0, 200.0 + np.tan(np.radians(3)) * 656),
        ),
        (GhostSpec(strength=0.01, scale=-1.0, radius_deg=(3.0, 2.5), softness=1.0), (440.0, 280.0)),
    ],
)
def test_a_ghost_is_where_it_belongs_and_as_strong(ghost: GhostSpec, expected: tuple[float, float]) -> None:
    at = lamp(200.0, 200.0)
    difference = windscreen(LensSpec(ghosts=(ghost,))).draw_points(at) - windscreen(LensSpec()).draw_points(at)
    rows, columns = np.indices(difference.shape)
    weight = difference / difference.sum()
    middle = float(((columns + 0.5) * weight).sum()), float(((rows + 0.5) * weight).sum())
    assert middle == pytest.approx(expected, abs=0.6)
    strength = float(difference.sum()) / float(windscreen(LensSpec()).draw_points(at).sum())
    assert strength == pytest.approx(0.01, rel=0.1)


def test_the_bonnet_hides_what_is_behind_it_and_stands_still() -> None:
    optics = windscreen(LensSpec(), CarSpec(bonnet_share=0.2, num_reflections=2))
    assert optics.static_cd_m2 is not None
    light = np.ones((480, 640), np.float32)
    assert float(optics.spread(light)[470, 320]) < 0.01
    assert float(optics.spread(light)[200, 320]) > 0.9
    assert float(optics.draw_points(lamp(320.0, 470.0)).max()) == 0.0
    again = windscreen(LensSpec(), CarSpec(bonnet_share=0.2, num_reflections=2))
    assert again.static_cd_m2 is not None
    assert np.array_equal(optics.static_cd_m2, again.static_cd_m2)


def test_the_edge_of_the_bonnet_shines_in_places() -> None:
    profile = CameraProfile(name="own", car=CarSpec(bonnet_share=0.2, bonnet_cd_m2=0.02))
    static = Windscreen(profile, SensorSpec(), camera(640, 480)).static_cd_m2
    assert static is not None
    brightest = static[320:460].max(axis=0)
    assert brightest.max() > 0.04
    assert (brightest < 0.021).mean() > 0.2


def test_every_drive_has_its_own_dirt() -> None:
    veil = VeilSpec(share=0.05)
    rough = GhostSpec(strength=0.01, shift_deg=(0.0, 4.0), radius_deg=(1.0, 1.0), roughness=0.3)
    profile = CameraProfile(name="own", lens=LensSpec(veils=(veil,), ghosts=(rough,), variety=0.4))
    first, again, other = (
        Windscreen(profile, SensorSpec(), CAMERA, seed).draw_points(lamp(320.0, 240.0)) for seed in (1, 1, 2)
    )
    assert np.array_equal(first, again)
    assert abs(float(first[240, 400] / other[240, 400]) - 1.0) > 0.02
    assert np.isfinite(other).all()


def test_bright_surfaces_have_streaks_where_asked() -> None:
    streak = StreakSpec(share=0.05, num_arms=2, angle_deg=90, length_deg=1.0)
    square = np.zeros((480, 640), np.float32)
    square[238:242, 318:322] = flux() / 16
    without = windscreen(LensSpec(streaks=(streak,))).spread(square)
    optics = windscreen(LensSpec(streaks=(streak.model_copy(update={"of_surfaces": True}),)))
    spread, drawn = optics.spread(square), optics.draw_points(lamp(320.0, 240.0))
    assert float(spread.sum()) == pytest.approx(flux(), rel=0.02)
    assert float(without.sum()) == pytest.approx(0.95 * flux(), rel=0.02)
    for y in (200, 225, 255, 280):
        assert spread[y, 300:340].sum() == pytest.approx(drawn[y, 300:340].sum(), rel=0.25)
