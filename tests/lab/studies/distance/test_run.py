from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from foreglow.config import ClassifierConfig, DistanceConfig, preset
from foreglow.distance import ESTIMATORS
from foreglow.distance.pixelwise import PixelwiseEstimator
from foreglow.files import to_json
from foreglow.lab.studies.distance.metrics import Finding, find
from foreglow.lab.studies.distance.run import (
    BOX_ALONE,
    OWN_RULE,
    TILTS_DEG,
    TRACKER_ROWS,
    DistancePlan,
    DistanceResults,
    Method,
    run_experiment,
)
from foreglow.types import Detections, Frame, Ranges
from tests.lab.studies.ranged_drives import known_range_m, make_split

CENTRE_GP = Method("gp", "centre")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("drives")
    make_split(root)
    return root


@pytest.fixture(scope="module")
def results(data: Path) -> DistanceResults:
    return run_experiment(data, DistancePlan())


@pytest.fixture(scope="module")
def findings(results: DistanceResults) -> tuple[Finding, ...]:
    return find(results)


def finding_of(findings: tuple[Finding, ...], axis: str, method: Method, light: str, group: str) -> Finding:
    found = [f for f in findings if (f.axis, f.method, f.light, f.group) == (axis, method, light, group)]
    assert len(found) == 1
    return found[0]


@pytest.mark.slow
def test_lights_with_a_box_and_a_range_count(results: DistanceResults) -> None:
    assert (results.name, results.num_images, results.rate_hz) == ("night/test", 6, 18.0)
    assert [(light.sequence_id, light.instance_id) for light in results.lights] == [(1, 0), (1, 1)] * 3 + [
        (2, 0),
        (2, 1),
    ] * 3
    assert results.left_out == {"doubtful": 2, "without a depth": 2, "in no box": 2}
    assert results.column("truth_m") == pytest.approx([known_range_m(n, k) for k in range(3) for n in (0, 1)] * 2)
    assert results.column("scenario").tolist() == ["straight"] * 6 + ["sag"] * 6


def test_a_lamp_above_the_road_seems_too_far_and_light_on_it_does_not(results: DistanceResults) -> None:
    """By the box's centre, which is the spot's to a pixel."""
    errors = results.ranges_m[CENTRE_GP] / results.column("truth_m") - 1
    assert errors[::2] == pytest.approx(np.full(6, 1.0), abs=0.25)  # at half the camera's height
    assert errors[1::2] == pytest.approx(np.zeros(6), abs=0.12)


def test_every_method_has_every_light(results: DistanceResults) -> None:
    assert {method.estimator for method in results.methods} == set(ESTIMATORS)
    assert len(results.methods) == sum(6 if issubclass(each, PixelwiseEstimator) else 1 for each in ESTIMATORS.values())
    assert len(results.main_methods) == len(ESTIMATORS)
    for method in results.ranges_m:
        assert results.ranges_m[method].shape == results.sigmas_m[method].shape == (12,)
    assert {method.tilt_deg for method in results.ranges_m} == set(TILTS_DEG)


def test_a_claimed_pitch_upwards_makes_it_farther(results: DistanceResults) -> None:
    tilted = [results.ranges_m[Method("gp", "centre", tilt)] for tilt in TILTS_DEG]
    assert all((a < b).all() for a, b in itertools.pairwise(tilted))
    # Of light on the road r m away, 0.1 degrees are about r / 1.3 m times 0.1 degrees.
    truth = results.column("truth_m")[1]
    share = tilted[TILTS_DEG.index(0.1)][1] / tilted[TILTS_DEG.index(0.0)][1] - 1
    assert share == pytest.approx(truth / 1.3 * np.radians(0.1), rel=0.3)


def test_series_follow_the_instances(results: DistanceResults) -> None:
    ranges = results.ranges_m[CENTRE_GP]
    mean, median = (results.series_m[f"{name} of five frames", CENTRE_GP] for name in ("mean", "median"))
    for first in (0, 1, 6, 7):
        track = ranges[first : first + 6 : 2][:3]
        assert mean[first : first + 6 : 2][:3] == pytest.approx([track[0], track[:2].mean(), track.mean()])
        assert median[first : first + 6 : 2][2] == pytest.approx(np.median(track))


def test_findings_are_those_of_their_lights(results: DistanceResults, findings: tuple[Finding, ...]) -> None:
    truth, ranges = results.column("truth_m"), results.ranges_m[CENTRE_GP]
    direct = finding_of(findings, "range", CENTRE_GP, "direct", "all").errors
    assert direct.num == 6
    assert direct.median == pytest.approx(np.median((ranges / truth - 1)[::2]))
    assert direct.absolute_low <= direct.median_absolute <= direct.absolute_high
    assert finding_of(findings, "range", CENTRE_GP, "all", "0-30 m").errors.num == 12
    assert finding_of(findings, "range", CENTRE_GP, "all", "200-400 m").errors.num == 0
    assert finding_of(findings, "terrain", CENTRE_GP, "indirect", "sag").errors.num == 3
    assert finding_of(findings, "kind", CENTRE_GP, "all", "lamp").errors.num == 6
    to_vehicle = finding_of(findings, "vehicle", CENTRE_GP, "indirect", "all").errors
    assert to_vehicle.median == pytest.approx(np.median((ranges / results.column("vehicle_range_m") - 1)[1::2]))
    level, up = (
        finding_of(findings, "pitch", Method("gp", "centre", t), "all", f"{t:+.1f}°").errors for t in (0.0, 0.5)
    )
    assert up.median > level.median
    assert sum(f.axis == "localisation" and f.light == "all" and f.method == CENTRE_GP for f in findings) in (1, 2)
    json.dumps(to_json(findings), allow_nan=False)


def test_another_time_gives_the_same(data: Path, results: DistanceResults) -> None:
    calls: list[tuple[str, int, int]] = []
    again = run_experiment(data, DistancePlan(estimators=("gp",)), lambda *told: calls.append(told))
    assert again.lights == results.lights
    assert calls == [("images", number, 6) for number in range(1, 7)]
    for method, ranges in again.ranges_m.items():
        np.testing.assert_array_equal(ranges, results.ranges_m[method])


class Constant:
    """An estimator with a rule of its own."""

    def __init__(self, config: DistanceConfig) -> None:
        self.config = config

    def estimate(self, frame: Frame, detections: Detections) -> Ranges:
        assert frame.road is not None
        assert frame.motion is not None
        return Ranges(detections, np.full(len(detections), 50.0), np.full(len(detections), 5.0))

    def reset(self) -> None:
        pass


def test_a_new_entry_of_the_table_takes_part(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ESTIMATORS, "constant", Constant)
    results = run_experiment(data, DistancePlan(estimators=("constant",)))
    assert results.methods == results.main_methods == (Method("constant", OWN_RULE),)
    assert len(find(results)) > 0


@pytest.mark.parametrize("names", [(), ("gp", "lidar")])
def test_unknown_estimators(names: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match="estimators: expected some of gp, psd_3d"):
        DistancePlan(estimators=names)


def test_a_set_without_truth_is_an_error(data: Path, tmp_path: Path) -> None:
    (tmp_path / "night").mkdir()
    (tmp_path / "night" / "test").mkdir()
    for name in ("images", "labels"):
        (tmp_path / "night" / "test" / name).symlink_to(data / "night" / "test" / name)
    with pytest.raises(ValueError, match=r"test: expected the range of each light, .* found none"):
        run_experiment(tmp_path, DistancePlan())


def test_tracks_have_the_ranges_of_their_boxes(data: Path) -> None:
    """Without a model all boxes have the score 1: from its first image on, a plausible track follows each light."""
    config = preset("foreglow").model_copy(update={"classifier": ClassifierConfig()})
    results = run_experiment(data, DistancePlan(estimators=("gp",), config=config))
    assert {name for name, _ in results.tracked} == {*TRACKER_ROWS, BOX_ALONE}
    ranges_m, sigmas_m = results.tracked[BOX_ALONE, CENTRE_GP]
    is_followed = ~np.isnan(ranges_m)
    assert is_followed.any()
    np.testing.assert_array_equal(ranges_m[is_followed], results.ranges_m[CENTRE_GP][is_followed])
    np.testing.assert_array_equal(np.isinf(sigmas_m[~is_followed]), True)
    filtered_m, _ = results.tracked["mean of the last five", CENTRE_GP]
    np.testing.assert_array_equal(np.isnan(filtered_m), ~is_followed)
    first = int(np.flatnonzero(is_followed)[0])
    assert filtered_m[first] == pytest.approx(ranges_m[first])


def test_up_to_two_hundred_metres_all_methods_answer_the_same_lights(results: DistanceResults) -> None:
    findings = [each for each in find(results) if each.axis == "reach" and each.light == "all"]
    numbers = {
        group: {finding.errors.num for finding in findings if finding.group == group} for group in ("all", COMMON)
    }
    assert numbers["all"] == {len(results.lights)}  # none is farther
    (common,) = numbers[COMMON]
    assert common <= len(results.lights)
    assert all(finding.errors.missing == 0.0 for finding in findings if finding.group == COMMON and finding.errors.num)


COMMON = "with a range by all methods"
