"""A calibration that is not exact makes every range less sure, and leaves the range itself alone."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from foreglow.distance import ESTIMATORS
from foreglow.geometry import MountSigmas
from tests.distance.places import aimed, camera, frame, range_m, ranges, straight_road

UNSURE = MountSigmas(yaw_rad=math.radians(2.0), pitch_rad=math.radians(2.0), height_m=0.2)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_every_range_is_less_sure(name: str) -> None:
    known = aimed([30.0, 1.6, 0.0])
    exact, unsure = (
        ranges(name, frame(each, straight_road())) for each in (known, replace(known, mount_sigmas=UNSURE))
    )
    assert unsure.sigmas_m[0] > 1.02 * exact.sigmas_m[0]
    if name != "road_surface":  # which weighs its hypotheses anew
        assert unsure.ranges_m[0] == exact.ranges_m[0]


@pytest.mark.parametrize("name", ESTIMATORS)
def test_an_exact_mount_changes_nothing(name: str) -> None:
    seen = aimed([30.0, 1.6, 0.0])
    before, after = (
        ranges(name, frame(each, straight_road())) for each in (seen, replace(seen, mount_sigmas=MountSigmas()))
    )
    assert (before.ranges_m, before.sigmas_m) == (after.ranges_m, after.sigmas_m)


@pytest.mark.parametrize("sigma_deg", [2.0, 3.0])
def test_sigma_reaches_what_a_wrong_pitch_hides(sigma_deg: float) -> None:
    """Light on the road that seems near, since the pitch is wrong by one sigma, is within one sigma of the estimate."""
    depression = math.radians(4.0)
    unsure = camera(pitch_rad=-depression)
    right = camera(pitch_rad=math.radians(sigma_deg) - depression)
    seen = frame(replace(unsure, mount_sigmas=MountSigmas(pitch_rad=math.radians(sigma_deg))))
    error_m = range_m("gp", frame(right)) - range_m("gp", seen)
    assert ranges("gp", seen).sigmas_m[0] >= error_m * (1 - 1e-9)


def test_light_that_may_be_at_the_horizon_has_an_unknown_error() -> None:
    seen = camera(pitch_rad=-math.radians(0.5))
    unsure = replace(seen, mount_sigmas=MountSigmas(pitch_rad=math.radians(0.6)))
    assert math.isinf(ranges("gp", frame(unsure)).sigmas_m[0])
    assert math.isfinite(ranges("gp", frame(seen)).sigmas_m[0])


def test_the_height_by_hand() -> None:
    """A height that is wrong by a tenth makes a range on the road wrong by a tenth."""
    seen = camera(pitch_rad=-0.05)
    before = ranges("gp", frame(seen)).sigmas_m[0]
    unsure = ranges("gp", frame(replace(seen, mount_sigmas=MountSigmas(height_m=0.125))))
    assert unsure.sigmas_m[0] == pytest.approx(math.hypot(before, 0.1 * unsure.ranges_m[0]), rel=1e-12)


@pytest.mark.parametrize("value", [-0.1, math.inf, math.nan])
def test_a_standard_deviation_is_finite_and_not_negative(value: float) -> None:
    with pytest.raises(ValueError, match=r"^MountSigmas.pitch_rad: expected a number of at least 0"):
        MountSigmas(pitch_rad=value)
