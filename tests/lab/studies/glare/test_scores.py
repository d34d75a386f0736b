from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest

from foreglow.files import to_json
from foreglow.lab.studies.glare.drive import GlareDrive
from foreglow.lab.studies.glare.pooled import Interval, Moments
from foreglow.lab.studies.glare.scores import POLICY_ROWS, GlareResults, SensitivityPoint, score_glare, typical_drives
from tests.lab.studies.glare_drives import approach, empty_drive

DRIVES = (*(approach(seed) for seed in range(4)), approach(9, is_oncoming=False), empty_drive(0), empty_drive(1))


@pytest.fixture(scope="module")
def results() -> GlareResults:
    return score_glare("made up", iter(DRIVES))


def test_rows_come_in_their_order(results: GlareResults) -> None:
    assert [policy.name for policy in results.policies] == list(POLICY_ROWS)
    assert results.limits == "FMVSS 108"
    assert results.seconds == pytest.approx(5 * 14.0 + 2 * 10.0)
    renamed = [with_runs(drive, {"b": "paper", "oracle": "oracle", "a": "low"}) for drive in DRIVES]
    assert [policy.name for policy in score_glare("x", renamed).policies] == ["oracle", "b", "a"]
    with pytest.raises(ValueError, match=r"expected one of low, high, .*, got 'ours'"):
        results.policy("ours")


def with_runs(drive: GlareDrive, names: dict[str, str]) -> GlareDrive:
    """With other names for its runs."""
    runs = {name: dataclasses.replace(drive.runs[of], name=name) for name, of in names.items()}
    return dataclasses.replace(drive, runs=runs)


def test_low_high_and_production_are_what_they_are(results: GlareResults) -> None:
    low, high, production = (results.policy(name) for name in ("low", "high", "production"))
    assert low.oncoming.all_bins.over_low_lxs == 0.0
    assert low.oncoming.dose_vs_low == Interval(1.0, 1.0, 1.0)
    assert low.oncoming.first == Moments(4, 0.0, 0.0, 0.0, 1.0)
    assert low.present.own_lane.value == pytest.approx(low.present.low_own_lane)
    assert high.present.own_lane == high.passed.verge == Interval(1.0, 1.0, 1.0)
    assert high.oncoming.first.dark_share == 0.0
    assert low.smoothness.change_per_s == pytest.approx(0.0, abs=1e-6)
    assert high.smoothness.level_change_per_s == 0.0
    assert production.oncoming.dose_vs_production == Interval(1.0, 1.0, 1.0)
    assert (low.empty.num_events, low.empty.dimmed_share, low.empty.area_dimmed) == (0, 1.0, 1.0)
    assert math.isnan(high.empty.area_dimmed)


def test_the_figures_of_a_drive_that_dims_in_vain(results: GlareResults) -> None:
    paper = results.policy("paper").empty
    assert paper.num_events == 2
    assert paper.minutes == pytest.approx(20 / 60)
    assert dataclasses.astuple(paper.events_per_minute) == pytest.approx((6.0, 6.0, 6.0))
    assert paper.dimmed_share == pytest.approx(36 / 180)
    assert paper.area_dimmed == pytest.approx(5 / 28)
    assert results.policy("paper").between.num_events == 0


def test_bins_add_up(results: GlareResults) -> None:
    for policy in results.policies:
        for group, is_oncoming in ((policy.oncoming, True), (policy.preceding, False)):
            *bins, everything = group.bins
            assert everything.name == "all"
            assert math.fsum(part.glare.dose_lxs for part in bins) == pytest.approx(everything.glare.dose_lxs)
            drives_lxs = math.fsum(drive.dose_lxs(is_oncoming=is_oncoming) for drive in policy.drives)
            assert drives_lxs == pytest.approx(everything.glare.dose_lxs)
            assert everything.above_share == pytest.approx(everything.glare.above_s / everything.glare.in_sight_s)
    oncoming = results.policy("high").oncoming
    ratio = oncoming.all_bins.glare.dose_lxs / results.policy("production").oncoming.all_bins.glare.dose_lxs
    assert oncoming.dose_vs_production.value == pytest.approx(ratio)
    assert oncoming.dose_vs_production.low <= ratio <= oncoming.dose_vs_production.high


def test_a_darker_policy_is_never_worse_for_others() -> None:
    darker = []
    for drive in DRIVES:
        runs = {name: dataclasses.replace(run, levels=0.5 * run.levels) for name, run in drive.runs.items()}
        darker.append(dataclasses.replace(drive, runs=runs))
    for dark, bright in zip(score_glare("x", darker).policies, score_glare("x", DRIVES).policies, strict=True):
        for of_dark, of_bright in ((dark.oncoming, bright.oncoming), (dark.preceding, bright.preceding)):
            assert of_dark.all_bins.glare.dose_lxs <= of_bright.all_bins.glare.dose_lxs
            assert not of_dark.first_anywhere.mean > of_bright.first_anywhere.mean
        assert dark.present.own_lane.value <= bright.present.own_lane.value


def test_the_order_of_drives_does_not_matter(results: GlareResults) -> None:
    turned = score_glare("made up", DRIVES[::-1])
    for one, other in zip(results.policies, turned.policies, strict=True):
        assert one.oncoming.first == other.oncoming.first
        assert one.oncoming.all_bins.glare.dose_lxs == pytest.approx(other.oncoming.all_bins.glare.dose_lxs)
        assert one.present.verge.value == pytest.approx(other.present.verge.value)
        assert to_json(one.drives) == to_json(other.drives[::-1])  # a lead may be NaN
    assert typical_drives(results) == typical_drives(turned)


def test_what_nothing_is_set_beside_is_nan() -> None:
    alone = score_glare("x", [with_runs(drive, {"foreglow": "foreglow"}) for drive in DRIVES]).policies[0]
    assert all(math.isnan(one) for one in dataclasses.astuple(alone.oncoming.dose_vs_production))
    assert math.isnan(alone.oncoming.all_bins.vs_production)
    dark = score_glare("x", [with_runs(drive, {"production": "low", "high": "high"}) for drive in DRIVES])
    assert math.isnan(dark.policy("high").preceding.dose_vs_production.value)  # production has no dose at all
    empty = score_glare("x", [empty_drive()]).policy("high")
    assert math.isnan(empty.present.own_lane.value)
    assert math.isnan(empty.oncoming.all_bins.above_share)
    assert empty.oncoming.first.num == 0


def test_all_drives_need_the_same_policies() -> None:
    with pytest.raises(ValueError, match=r"drive approach_01: expected runs of low, high, .*, got low"):
        score_glare("x", [DRIVES[0], with_runs(DRIVES[1], {"low": "low"})])
    with pytest.raises(ValueError, match="x: expected at least one drive"):
        score_glare("x", [])


def test_a_point_of_a_curve(results: GlareResults) -> None:
    score = results.policy("foreglow")
    point = SensitivityPoint.of("latency", "ms", 100.0, score)
    assert (point.policy, point.dose_vs_production) == ("foreglow", score.oncoming.dose_vs_production.value)
    assert SensitivityPoint.of("latency", "ms", 100.0, score, "ours").policy == "ours"


def test_what_is_not_defined_is_null(results: GlareResults) -> None:
    record = to_json(results)
    json.dumps(record, allow_nan=False)
    assert record["policies"][1]["empty"]["area_dimmed"] is None


def test_moments() -> None:
    found = Moments.of([0.0, math.nan, 1.0, 0.0, 2.0, 0.0])
    assert (found.num, found.median, found.mean, found.dark_share) == (5, 0.0, 0.6, 0.6)
    assert found.p90 == pytest.approx(float(np.percentile([0, 0, 0, 1, 2], 90)))


def test_typical_drives_lie_at_the_quartiles(results: GlareResults) -> None:
    doses = {drive.drive: drive.dose_lxs(is_oncoming=True) for drive in results.policy("production").drives[:4]}
    ordered = sorted(doses, key=lambda name: doses[name])
    assert typical_drives(results) == (ordered[1], ordered[2])  # 0.75, 1.5 and 2.25 of the way
    assert typical_drives(score_glare("x", [empty_drive()])) == ()
