from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from foreglow.distance.hypotheses import (
    FEATURES,
    BoxEvidence,
    Cells,
    Hypotheses,
    Kind,
    Parameters,
    cells_along,
    log_weights,
    parameters_of,
    read_hypotheses,
)
from foreglow.distance.ribbon import PLACES_M, Alignment, Ribbon, ribbon
from foreglow.distance.weighing import BELOW_ONE_SIGMA, weighted_quantiles
from foreglow.geometry import Floats, rotation
from tests.distance.roads import HALF_WIDTH_M, line, road, straight

CAMERA_M = np.array([2.0, 0.0, 1.25])
BELIEVED = Alignment(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
SLOPE = 0.05


def model(*kinds: Kind) -> Parameters:
    return parameters_of(Hypotheses(kinds=kinds))


def kind(**fields: float | bool | str) -> Kind:
    return Kind.model_validate({"name": "kind", "offset_sigma_m": 0.5, "height_sigma_m": 0.1} | fields)


LAMP = kind(side=0.5, height_m=0.65, is_lamp=True)


def directions(points_m: Floats) -> tuple[Floats, Floats, Floats]:
    x, y, z = (points_m - CAMERA_M).T
    return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y)), np.sqrt(x * x + y * y + z * z)


def assert_seen_at(cells: Cells, points_m: Floats, tolerance_rad: float, select: slice = slice(None)) -> None:
    azimuths, elevations, ranges_m = directions(points_m)
    np.testing.assert_allclose(cells.azimuths_rad[select], azimuths[select], atol=tolerance_rad)
    np.testing.assert_allclose(cells.elevations_rad[select], elevations[select], atol=tolerance_rad)
    np.testing.assert_allclose(np.exp(cells.log_ranges)[select], ranges_m[select], rtol=2e-3)


def test_a_lamp_over_a_flat_straight_road_is_where_geometry_has_it() -> None:
    cells = cells_along(model(LAMP), ribbon(straight(), BELIEVED), CAMERA_M, 0.0)
    lamps = np.stack([PLACES_M, np.full(len(PLACES_M), HALF_WIDTH_M), np.full(len(PLACES_M), 0.65)], -1)
    assert_seen_at(cells, lamps, 1e-9)


def test_light_over_a_crest_is_where_geometry_has_it() -> None:
    s = np.arange(451.0)
    hill = road(line(np.zeros(450), -(s**2) / 2 / 2500.0))
    cells = cells_along(model(kind()), ribbon(hill, BELIEVED), CAMERA_M, 0.0)
    points = np.stack([PLACES_M, np.full(len(PLACES_M), HALF_WIDTH_M / 2), -(PLACES_M**2) / 5000.0], -1)
    # Places are measured along the slope, which is 1 % longer after 350 m.
    assert_seen_at(cells, points, 1e-3, slice(0, 38))


def test_the_rail_of_a_banked_bend_is_where_geometry_has_it() -> None:
    radius_m = 200.0
    banked = road(line(np.full(450, 1 / radius_m)), -SLOPE)  # falls to the left, into the bend
    rail = kind(side=-1.0, offset_m=-0.8, height_m=0.6)
    cells = cells_along(model(rail), ribbon(banked, BELIEVED), CAMERA_M, 0.0)
    # Level coordinates about the centre line's beginning; the car stands half a lane to the right, on the slope.
    angle = PLACES_M / radius_m
    reach_m = radius_m + HALF_WIDTH_M + 0.8
    level = np.stack(
        [reach_m * np.sin(angle), radius_m - reach_m * np.cos(angle), np.full(len(angle), SLOPE * HALF_WIDTH_M + 0.6)],
        -1,
    )
    car_m = np.array([0.0, -HALF_WIDTH_M / 2, SLOPE * HALF_WIDTH_M / 2])
    points = (level - car_m) @ rotation(roll_rad=-math.atan(SLOPE))
    # The lean is taken as small: what is 0.8 m up is 4 cm further aside, which counts nearer than 12 m.
    assert_seen_at(cells, points, 3e-3, slice(12, 34))


def test_without_a_road_light_is_over_our_plane_in_any_direction() -> None:
    cells = cells_along(model(LAMP), None, CAMERA_M, 0.0)
    distances_m = PLACES_M - CAMERA_M[0]
    np.testing.assert_allclose(np.tan(cells.elevations_rad), (0.65 - 1.25) / distances_m)
    assert (cells.variances_across > 0.3**2).all()


def test_no_place_beyond_the_maps_end_has_weight() -> None:
    cells = cells_along(model(LAMP), ribbon(straight(100), BELIEVED), CAMERA_M, 0.0)
    is_beyond = PLACES_M > 100.0
    assert (cells.log_priors[is_beyond] < -1e5).all()
    assert (cells.log_priors[~is_beyond] > -100).all()


def test_a_bend_that_may_be_elsewhere_is_less_sharp() -> None:
    bend = road(line(np.r_[np.zeros(60), np.full(390, 1 / 150.0)]))
    sure, unsure = (
        cells_along(model(LAMP), ribbon(bend, BELIEVED._replace(shift_sigma_m=sigma)), CAMERA_M, 0.0)
        for sigma in (0.0, 10.0)
    )
    is_in_bend = PLACES_M > 70.0
    growth = np.sqrt(unsure.variances_across - sure.variances_across)
    # Ten metres of way turn the road by 10 m times the angle that lies between here and there, over the distance.
    turned = np.abs(np.sin((PLACES_M - 60.0) / 150.0)) * 10.0 / (PLACES_M - 2.0)
    np.testing.assert_allclose(growth[is_in_bend][:7], turned[is_in_bend][:7], rtol=0.1)
    np.testing.assert_allclose(growth[PLACES_M < 50.0], 0.0, atol=1e-6)


def evidence(
    directions_rad: Floats, features: Floats | None = None, pair_log_ranges: Floats | None = None
) -> BoxEvidence:
    count = len(directions_rad)
    return BoxEvidence(
        directions_rad,
        np.full((count, 2), 0.006),
        np.zeros((count, len(FEATURES))) if features is None else features,
        np.full(count, np.nan) if pair_log_ranges is None else pair_log_ranges,
    )


def median_m(cells: Cells, weights: Floats) -> float:
    return float(np.exp(weighted_quantiles(cells.log_ranges, weights, [0.5]))[0, 0])


def test_features_choose_between_kinds() -> None:
    near = kind(log_range=2.5, features=(1.0, 0.0, 0.0))  # type: ignore[arg-type]
    far = kind(log_range=5.0, features=(-1.0, 0.0, 0.0))  # type: ignore[arg-type]
    parameters = model(near, far)
    cells = cells_along(parameters, None, CAMERA_M, 1.0)  # a camera whose pitch is not known at all
    found = [
        median_m(cells, log_weights(parameters, cells, evidence(np.zeros((1, 2)), np.array([[size, 0.0, 0.0]]))))
        for size in (2.0, -2.0)
    ]
    assert found[0] < 25.0 < 80.0 < found[1]


def test_a_pair_tells_the_range_of_lamps_alone() -> None:
    seen = evidence(np.zeros((1, 2)), pair_log_ranges=np.log([40.0]))
    lamp, other = (model(kind(is_lamp=is_lamp)) for is_lamp in (True, False))
    cells = cells_along(lamp, None, CAMERA_M, 1.0)
    assert median_m(cells, log_weights(lamp, cells, seen)) == pytest.approx(40.0, rel=0.05)
    alone = log_weights(other, cells, evidence(np.zeros((1, 2))))
    np.testing.assert_allclose(log_weights(other, cells, seen) - alone, 0.0, atol=1e-9)


def test_sigmas_are_honest_where_the_model_holds() -> None:
    """Light drawn from the model's own mixture: kind and place by the prior, direction and features about theirs."""
    shipped = read_hypotheses()
    parameters = parameters_of(shipped)
    bend = road(line(np.r_[np.zeros(60), np.full(390, 1 / 250.0)]))
    ahead: Ribbon = ribbon(bend, Alignment(0.0, 0.0, 0.0, 0.003, 0.2, 3.0))
    cells = cells_along(parameters, ahead, CAMERA_M, 0.002)
    rng = np.random.default_rng(3)
    shares = np.exp(cells.log_priors - cells.log_priors.max())
    drawn = rng.choice(len(shares), 3000, p=shares / shares.sum())
    blur = (0.006 * np.asarray(parameters.box_shares)) ** 2
    across, up = cells.variances_across[drawn] + blur[0], cells.variances_up[drawn] + blur[1]
    covariances = np.stack([across, cells.covariances[drawn], cells.covariances[drawn], up], -1).reshape(-1, 2, 2)
    noise = np.einsum("nij,nj->ni", np.linalg.cholesky(covariances), rng.normal(size=(len(drawn), 2)))
    seen = np.stack([cells.azimuths_rad[drawn], cells.elevations_rad[drawn]], -1) + noise
    kinds = drawn % len(shipped.kinds)
    means = parameters.features[kinds] + parameters.feature_slopes[kinds] * (cells.log_ranges[drawn, None] - 4.0)
    features = means + parameters.feature_sigmas * rng.normal(size=means.shape)
    alone = shipped.model_copy(
        update={"kinds": tuple(kind.model_copy(update={"pair_logit": -20.0}) for kind in shipped.kinds)}
    )
    weights = log_weights(parameters_of(alone), cells, evidence(seen, features))
    near_m, range_m, far_m = np.exp(
        weighted_quantiles(cells.log_ranges, weights, [BELOW_ONE_SIGMA, 0.5, 1.0 - BELOW_ONE_SIGMA])
    )
    offs = np.abs(range_m - np.exp(cells.log_ranges[drawn])) / (0.5 * (far_m - near_m))
    assert 0.60 < (offs <= 1.0).mean() < 0.76
    assert 0.90 < (offs <= 2.0).mean() < 0.98


def test_a_models_errors_name_file_and_field(tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    with pytest.raises(FileNotFoundError, match=r"model\.toml"):
        read_hypotheses(path)
    path.write_text('[[kinds]]\nname = "lamp"\noffset_sigma_m = 0.0\nheight_sigma_m = 0.1\n')
    with pytest.raises(ValueError, match=r"model\.toml: kinds\.0\.offset_sigma_m"):
        read_hypotheses(path)
    for field in ("offset_sigma_m", "height_sigma_m", "height_m", "log_range", "log_share", "size_slope", "pair_logit"):
        usual = {"offset_sigma_m": 0.5, "height_sigma_m": 0.1} | {field: 1e4}
        lines = [f"{name} = {value}" for name, value in usual.items()]
        path.write_text('[[kinds]]\nname = "lamp"\n' + "\n".join(lines))
        with pytest.raises(ValueError, match=rf"model\.toml: kinds\.0\.{field}"):
            read_hypotheses(path)
    path.write_text("kinds = []\n")
    with pytest.raises(ValueError, match=r"model\.toml: kinds"):
        read_hypotheses(path)
