"""The light of our lamps at eyes and on the road against the simulator's own."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from foreglow.lab.simulation import Drive, Scene, with_beam
from foreglow.lab.simulation.scenes.scenarios import mirrored
from foreglow.lab.simulation.scenes.scene import EgoSpec, RoadSpec
from foreglow.lab.studies.glare.light import OurLight, seen_lamps
from foreglow.photometry import NUM_LEDS, read_headlamps
from foreglow.photometry.headlamps_file import SHIPPED
from tests.lab.studies.glare_scenes import first_frame, scene

pytestmark = [pytest.mark.renderer, pytest.mark.slow]


@pytest.mark.parametrize("driven", [scene(), mirrored(scene())], ids=["right", "left"])
def test_light_at_an_eye_is_the_simulators(driven: Scene) -> None:
    """Base and LEDs apart give what the simulator sums up, with mis-aim, brightness and body motion."""
    levels = np.random.default_rng(3).uniform(size=(2, NUM_LEDS))
    source = Drive(with_beam(driven, "matrix"), "fast")
    source.set_led_levels(levels)
    for known in source.frames():
        oncoming = known.vehicles[0]
        eye = OurLight(source.scene).at_eye(known, oncoming, levels)
        assert eye.is_in_sight
        assert eye.base_lx + (levels * eye.leds_lx).sum() == pytest.approx(oncoming.eye_lx["ego"], rel=1e-4)
        x, y, _ = known.ego_pose.to_body(oncoming.eye_world_m)
        assert (eye.range_m, eye.azimuth_rad) == pytest.approx((math.hypot(x, y), math.atan2(y, x)))


def test_mirrors_of_a_vehicle_ahead_are_lit_from_behind() -> None:
    known = first_frame()
    eye = OurLight(scene()).at_eye(known, known.vehicles[1], np.ones((2, NUM_LEDS)))
    assert eye.is_in_sight
    assert known.vehicles[1].eye_lx["ego"] == 0.0  # its driver looks away from us
    assert eye.base_lx > 0.1


@pytest.mark.parametrize("is_seen", [[False, False], [True, False], [False, True], [True, True]])
def test_seen_lamps_are_told_by_their_sum(is_seen: list[bool]) -> None:
    expected_lx = np.array([0.4, 0.7])
    assert seen_lamps(expected_lx, float(expected_lx @ is_seen) * 1.01).tolist() == is_seen


def test_road_light_is_linear_and_less_far_away() -> None:
    known = first_frame()
    base, leds = OurLight(scene()).on_road(known)
    assert base.shape == (2,)
    assert leds.shape == (2, 2, NUM_LEDS)
    dark, bright = (OurLight(scene(ego=EgoSpec(brightness=one))).on_road(known)[1] for one in (0.5, 1.0))
    np.testing.assert_allclose(bright, 2.0 * dark, rtol=1e-6, atol=1e-12)


def test_road_light_is_that_of_our_own_side() -> None:
    """A mirror image of a drive has the same low beam on its own lane and verge; its LEDs are not mirrored."""
    known = first_frame()
    base, _ = OurLight(scene()).on_road(known)
    other = mirrored(scene())
    left, _ = OurLight(other).on_road(next(iter(Drive(with_beam(other, "matrix"), "fast").frames())))
    np.testing.assert_allclose(left, base, rtol=0.02)


@pytest.mark.parametrize("number", [None, 0])
def test_our_lane_is_the_one_that_we_drive_on(number: int | None) -> None:
    """Beside a median, with three lanes, it is as bright as on a road with one: it is straight ahead of us."""
    road = RoadSpec(length_m=300.0, num_lanes=3, median="rails", median_m=3.0, shoulders_m=(0.8, 2.5))
    wide = scene(road=road, ego=scene().ego.model_copy(update={"lane_number": number}), vehicles=())
    base, _ = OurLight(wide).on_road(next(iter(Drive(with_beam(wide, "matrix"), "fast").frames())))
    assert base[0] == pytest.approx(OurLight(scene()).on_road(first_frame())[0][0], rel=0.05)


def test_lamps_of_our_own_are_those_that_shine(tmp_path: Path) -> None:
    lamps = tmp_path / "lamps.toml"
    text = SHIPPED.read_text().replace("num_columns = 28", "num_columns = 14")
    lamps.write_text(text.replace("pitch_deg = 1.2", "pitch_deg = 2.4"))
    headlamps = read_headlamps(lamps)
    _, leds = OurLight(scene(), headlamps).on_road(first_frame())
    assert headlamps.num_leds < NUM_LEDS
    assert leds.shape == (2, 2, headlamps.num_leds)
