from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from foreglow.datasets.simulated import Artifact
from foreglow.lab.simulation.labels.artifacts import (
    MAX_CANDIDATES,
    SMOOTHING_PX,
    Surroundings,
    VehicleLight,
    apply_rule,
    direct_artifacts,
    indirect_artifacts,
    scaled_rule,
    strength,
)
from foreglow.lab.simulation.scenes.scene import LabelRule
from foreglow.lab.simulation.world.materials import NO_MATERIAL, material_number
from tests.lab.simulation.truths import artifact, lamp

HEIGHT_PX, WIDTH_PX = 240, 400
RULE = LabelRule(
    min_grey=2.0,
    min_contrast=5.0,
    doubtful_factor=2.0,
    min_distance_px=30.0,
    max_instances=4,
    max_hidden_instances=4,
    relative_strength=0.25,
)


def added_light(*blobs: tuple[float, float, float], sigma_px: float = 6.0) -> NDArray[np.float32]:
    """Gaussian blobs, each from x, y and grey levels."""
    y, x = np.mgrid[:HEIGHT_PX, :WIDTH_PX]
    total = np.zeros((HEIGHT_PX, WIDTH_PX))
    for cx, cy, grey in blobs:
        total += grey * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * sigma_px**2))
    return total.astype(np.float32)


def light_of(added: NDArray[np.float32], background: float | NDArray[np.float32] = 10.0, **fields: Any) -> VehicleLight:
    dark = np.broadcast_to(np.float32(background), added.shape).astype(np.float32)
    return dataclasses.replace(VehicleLight(dark + added, dark, dark), **fields)


def surroundings(**fields: Any) -> Surroundings:
    shape = (HEIGHT_PX, WIDTH_PX)
    usual = Surroundings(
        noise_grey=np.full(shape, 1.5, np.float32),
        materials=np.full(shape, material_number("rail"), np.uint8),
        depth_m=np.full(shape, 50, np.float32),
        haze_share=np.zeros(shape, np.float32),
    )
    return dataclasses.replace(usual, **fields)


def marked(artifacts: tuple[Artifact, ...]) -> list[Artifact]:
    return [each for each in artifacts if not each.is_doubtful]


def found(light: VehicleLight, rule: LabelRule = RULE, **fields: Any) -> tuple[Artifact, ...]:
    return indirect_artifacts(light, surroundings(**fields), rule)[0]


def test_one_blob_in_the_dark() -> None:
    (only,) = found(light_of(added_light((150, 90, 20))))
    assert only.position_px == (150.0, 90.0)
    assert only.kind == "rail"
    assert only.depth_m == 50.0
    assert (only.instance_id, only.is_direct, only.is_rear, only.is_doubtful) == (-1, False, False, False)
    # A Gaussian smoothed by a Gaussian.
    assert only.grey == pytest.approx(20 * 6**2 / (6**2 + SMOOTHING_PX**2), rel=0.01)
    sensor = 1.5 / (2 * math.sqrt(math.pi) * SMOOTHING_PX)
    assert only.contrast == pytest.approx(only.grey / math.hypot(sensor, 0.35), rel=0.02)
    # Half height of a Gaussian lies at 1.18 sigma.
    assert only.area_px == pytest.approx(math.pi * (6**2 + SMOOTHING_PX**2) * 2 * math.log(2), rel=0.05)


@pytest.mark.parametrize("x", [150.4, 150.6, 151.4, 151.6, 152.4])
def test_the_peak_is_found_to_the_pixel(x: float) -> None:
    (only,) = found(light_of(added_light((x, x - 60, 20))))
    assert only.position_px == (round(x), round(x - 60))


def test_no_light_is_no_artifact() -> None:
    assert indirect_artifacts(light_of(added_light()), surroundings(), RULE) == ((), ())


def test_threshold_on_grey_levels() -> None:
    grey_of_one = found(light_of(added_light((150, 90, 20))))[0].grey / 20
    sharp = RULE.model_copy(update={"min_contrast": 0.1})
    for grey, is_marked in ((2.05 / grey_of_one, True), (1.95 / grey_of_one, False)):
        assert bool(marked(found(light_of(added_light((150, 90, grey))), sharp))) == is_marked


def test_texture_noise_and_own_halo_hide_light() -> None:
    added = added_light((150, 90, 4))
    texture = np.random.default_rng(1).normal(40, 15, added.shape).astype(np.float32)
    halo = light_of(added)
    halo = dataclasses.replace(halo, grey_without=halo.grey_without - added_light((150, 90, 60), sigma_px=20))
    assert len(marked(found(light_of(added)))) == 1
    assert not marked(found(light_of(added, texture)))
    assert not marked(found(halo))
    assert not marked(found(light_of(added), noise_grey=np.full(added.shape, 30, np.float32)))


@pytest.mark.parametrize("width_scale", [1.0, 0.5])
def test_image_size_scales_lengths(width_scale: float) -> None:
    apart_px = 1.2 * RULE.min_distance_px * width_scale
    sigma_px = 6 * width_scale
    pair = added_light((150, 90, 30), (150 + apart_px, 90, 25), sigma_px=sigma_px)
    near = added_light((150, 90, 30), (150 + 0.8 * apart_px, 90, 25), sigma_px=sigma_px)
    assert len(marked(indirect_artifacts(light_of(pair), surroundings(), RULE, width_scale)[0])) == 2
    assert len(marked(indirect_artifacts(light_of(near), surroundings(), RULE, width_scale)[0])) == 1


def test_light_at_the_border_of_the_image() -> None:
    (only,) = found(light_of(added_light((0, HEIGHT_PX - 1, 20))))
    assert only.position_px == (0.0, HEIGHT_PX - 1.0)


def test_sky_and_scattered_light_are_haze_without_depth() -> None:
    light = light_of(added_light((150, 90, 20)))
    sky = np.full((HEIGHT_PX, WIDTH_PX), NO_MATERIAL, np.uint8)
    for fields in ({"materials": sky}, {"haze_share": np.full((HEIGHT_PX, WIDTH_PX), 0.6, np.float32)}):
        (only,) = found(light, **fields)
        assert only.kind == "haze"
        assert math.isnan(only.depth_m)


def test_kind_is_what_most_of_the_light_falls_on() -> None:
    materials = np.full((HEIGHT_PX, WIDTH_PX), material_number("grass_blade"), np.uint8)
    materials[:, 149:] = material_number("leaf")
    depth_m = np.where(materials == material_number("leaf"), 30, 80).astype(np.float32)
    (only,) = found(light_of(added_light((150, 90, 20))), materials=materials, depth_m=depth_m)
    assert (only.kind, only.depth_m) == ("foliage", 30.0)


def test_a_glow_cut_up_by_trees_is_one_instance() -> None:
    glow = added_light((200, 100, 40), sigma_px=90)
    for column in range(10, WIDTH_PX, 45):
        glow[:, column : column + 18] = 0
    sky = np.full((HEIGHT_PX, WIDTH_PX), NO_MATERIAL, np.uint8)
    artifacts = found(light_of(glow), materials=sky)
    assert len(marked(artifacts)) == 1
    assert len(artifacts) > 1
    assert len(marked(found(light_of(glow)))) > 1


def test_rear_light_gives_rear_artifacts() -> None:
    (only,) = found(light_of(added_light((150, 90, 20)), is_rear=True))
    assert only.is_rear
    assert not only.is_direct


def speckles(seed: int, num: int = 25) -> VehicleLight:
    rng = np.random.default_rng(seed)
    blobs = np.column_stack([rng.uniform(0, WIDTH_PX, num), rng.uniform(0, HEIGHT_PX, num), rng.uniform(1, 40, num)])
    return light_of(added_light(*map(tuple, blobs), sigma_px=5))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("factor", [0.5, 1.0, 1.4, 2.0])
def test_a_scaled_rule_needs_no_image(seed: int, factor: float) -> None:
    light, other = speckles(seed), scaled_rule(RULE, factor)
    _, candidates = indirect_artifacts(light, surroundings(), RULE)
    direct = indirect_artifacts(light, surroundings(), other)[0]
    stored = apply_rule(candidates, other)
    assert len(stored) > 3
    assert [(each.position_px, each.kind, each.is_doubtful) for each in stored] == [
        (each.position_px, each.kind, each.is_doubtful) for each in direct
    ]
    assert [each.grey for each in stored] == pytest.approx([each.grey for each in direct], rel=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_rules_of_selection(seed: int) -> None:
    artifacts, candidates = indirect_artifacts(speckles(seed, 150), surroundings(), RULE)
    strengths = [strength(each, RULE) for each in marked(artifacts)]
    assert len(candidates) == MAX_CANDIDATES
    assert len(strengths) == RULE.max_instances
    assert strengths == sorted(strengths, reverse=True)
    assert min(strengths) > max(1, RULE.relative_strength * strengths[0])
    for is_doubtful in (False, True):
        same = [each for each in artifacts if each.is_doubtful == is_doubtful]
        gaps = [math.dist(a.position_px, b.position_px) for a in same for b in same if a is not b]
        assert min(gaps) >= RULE.min_distance_px
    assert apply_rule(candidates, RULE) == artifacts


def test_one_instance_while_hidden_and_more_once_a_lamp_is_seen() -> None:
    rule = LabelRule(max_instances=3, max_hidden_instances=1)
    light = light_of(added_light(*((x, 90, 20 + x / 100) for x in (50, 150, 250, 350))))
    for has_direct, num in ((False, 1), (True, 3)):
        artifacts, candidates = indirect_artifacts(light, surroundings(), rule, has_direct=has_direct)
        assert [each.position_px[0] for each in marked(artifacts)] == [350, 250, 150][:num]
        assert apply_rule(candidates, rule, has_direct=has_direct) == artifacts
        assert len(artifacts) == 4


def test_doubtful_between_both_thresholds() -> None:
    candidates = [
        artifact(x, 0, grey=grey, contrast=99.0) for x, grey in ((0, 2.1), (100, 1.9), (200, 1.1), (300, 0.9))
    ]
    chosen = apply_rule(candidates, RULE)
    assert [(each.grey, each.is_doubtful) for each in chosen] == [(2.1, False), (1.9, True), (1.1, True)]


def test_too_small_is_nothing() -> None:
    assert apply_rule([artifact(area_px=24)], RULE) == ()
    # 25 px at 1280 columns are 6.25 px at 640.
    assert len(apply_rule([artifact(area_px=7)], RULE, width_scale=0.5)) == 1
    assert apply_rule([artifact(area_px=6)], RULE, width_scale=0.5) == ()


@given(
    st.lists(st.tuples(st.floats(0, 1280), st.floats(0.1, 50), st.floats(0.1, 50)), max_size=12),
    st.floats(0.5, 2),
)
def test_lower_thresholds_never_lose_the_first_sight(peaks: list[tuple[float, float, float]], factor: float) -> None:
    candidates = [artifact(x, grey=grey, contrast=contrast) for x, grey, contrast in peaks]
    lower, higher = (bool(marked(apply_rule(candidates, scaled_rule(RULE, f)))) for f in (factor, factor * 1.3))
    assert lower >= higher


def direct(*lamps: Any, peak_grey: float = 100.0, **fields: Any) -> tuple[Artifact, ...]:
    return direct_artifacts(lamps, [peak_grey] * len(lamps), surroundings(), np.zeros(3), RULE, **fields)


def test_a_lamp_that_is_seen() -> None:
    (only,) = direct(lamp("low_right"))
    assert (only.lamp, only.kind, only.is_direct, only.is_rear, only.is_doubtful) == (
        "low_right",
        "lamp",
        True,
        False,
        False,
    )
    assert only.position_px == (50.0, 40.0)
    assert only.depth_m == pytest.approx(math.hypot(100, 0.7))
    assert only.contrast == pytest.approx(100 / 1.5)


def test_a_hidden_or_dark_lamp_is_no_artifact() -> None:
    assert len(direct(lamp(visible_share=0.2))) == 1
    assert direct(lamp(visible_share=0.19)) == ()
    assert direct(lamp(), peak_grey=RULE.min_grey) == ()
    assert direct(lamp(visible_share=0.0, position_px=(math.nan, math.nan)), peak_grey=0.0) == ()


def test_lamps_far_away_are_seen_as_one() -> None:
    left, right = lamp("low_left"), lamp("low_right", position_world_m=np.array([100, 1.2, 0.7]))
    assert [each.lamp for each in direct(left, right)] == ["low_left"]
    near = dataclasses.replace(right, position_px=(52.0, 40.0))
    (only,) = direct_artifacts([left, near], [100.0, 300.0], surroundings(), np.zeros(3), RULE)
    assert only.position_px == (51.5, 40.0)
    assert only.grey == 300.0
    assert len(direct(left, near, width_scale=0.5)) == 2
    assert len(direct(left, dataclasses.replace(right, position_px=(53.0, 40.0)))) == 2


def test_low_and_high_beam_share_a_housing_but_not_with_rear_lamps() -> None:
    low, high = lamp("low_left"), lamp("high_left", position_px=(60.0, 40.0))
    assert [each.lamp for each in direct(low, high)] == ["low_left"]
    assert [each.is_rear for each in direct(low, dataclasses.replace(high, is_rear=True))] == [False, True]
