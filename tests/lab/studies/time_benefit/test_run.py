"""The experiment on the time benefit, on the drive that ships, and its report."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest

from foreglow.config import TrackerConfig, preset
from foreglow.datasets import PVDN, shipped_drive
from foreglow.files import to_json
from foreglow.lab.studies.paper_chain import paper_chain
from foreglow.lab.studies.time_benefit import page
from foreglow.lab.studies.time_benefit.metrics import FalseTracks, Method, least_delay_s, time_benefit
from foreglow.lab.studies.time_benefit.page import benefit_figure, summary_lines, write_report
from foreglow.lab.studies.time_benefit.run import (
    FIVE_FRAMES,
    RULES,
    TRACKER_ROWS,
    TimeBenefitResults,
    run_experiment,
)
from foreglow.pipeline import Pipeline
from tests.datasets.tiny_pvdn import make_pvdn, write
from tests.lab.studies.detector_data import make_model

pytestmark = pytest.mark.slow


@pytest.fixture(name="results", scope="module")
def fixture_results() -> TimeBenefitResults:
    return run_experiment([PVDN(shipped_drive())], preset("foreglow"))


def test_every_method_has_a_row(results: TimeBenefitResults) -> None:
    (encounter,) = results.encounters
    assert [each.benefit.name for each in results.methods] == [
        "single frame", *TRACKER_ROWS, "human", "first lamp in sight", "production system",
    ]  # fmt: skip
    detected = {each.benefit.name: each.benefit.detected_s[0] for each in results.methods}
    assert detected["human"] == encounter.light_s + 0.8
    assert detected["first lamp in sight"] == encounter.sight_s
    assert detected["production system"] == encounter.production_s
    assert encounter.light_s <= detected["single frame"] <= detected["tracker, paper"] < encounter.production_s
    assert results.method("human").false is None


def test_our_tracker_is_the_one_that_the_pipeline_runs(results: TimeBenefitResults) -> None:
    dataset = PVDN(shipped_drive())
    plausible = set()
    for result in Pipeline().run(dataset):
        assert result.tracks is not None
        assert result.tracks.vehicles is not None
        plausible |= set(result.tracks.ids[result.tracks.is_plausible].tolist())
    false = results.method("tracker, ours").false
    assert false is not None
    assert false.num_plausible == len(plausible)
    assert false.num_groups <= false.num < false.num_plausible
    assert false.num_vehicles == 0
    paper = results.method("tracker, paper").false
    assert paper is not None
    assert paper.num_vehicles is None
    assert false.minutes == pytest.approx(len(dataset) / 18.0 / 60.0)
    assert 0.03 < false.km < 0.2


@pytest.mark.usefixtures("few_rules")
def test_splits_are_pooled(results: TimeBenefitResults, tmp_path: Path) -> None:
    """The drive and a second split, PVDN's layout alone; what either has alone stays as it is."""
    other = PVDN(make_pvdn(tmp_path))
    alone = [results, run_experiment([other], preset("foreglow"))]
    pooled = run_experiment([PVDN(shipped_drive()), other], preset("foreglow"))
    assert pooled.num_sequences == sum(part.num_sequences for part in alone)
    assert pooled.name == " and ".join(part.name for part in alone)
    for name in ("single frame", "tracker, ours", "production system"):
        detected_s = [time_s for part in alone for time_s in part.method(name).benefit.detected_s]
        np.testing.assert_array_equal(pooled.method(name).benefit.detected_s, detected_s)
    falses = [part.method("tracker, ours").false for part in (pooled, *alone)]
    numbers = [false.num_plausible for false in falses if false is not None]
    assert numbers[0] == numbers[1] + numbers[2]
    assert len({met.sequence for met in pooled.encounters}) == len(pooled.encounters)


def test_a_tracker_waits_after_a_single_frame(results: TimeBenefitResults) -> None:
    (single_s,) = results.method("single frame").benefit.detected_s
    (tracker_s,) = results.method("tracker, paper").benefit.detected_s
    assert results.method("tracker, paper").plausibility_s == (tracker_s - single_s,)
    assert results.method("human").plausibility_s == ()


def test_more_frames_confirm_later_and_less(tmp_path: Path) -> None:
    """Where every box is accepted, so that no trained model decides it."""
    everything = preset("baseline").changed("classifier", model=make_model(tmp_path / "model.onnx"))
    curves = run_experiment([PVDN(shipped_drive())], everything).curves
    assert set(curves) == set(RULES)
    frames = curves["frames"]
    numbers = [frame.false.num_plausible for frame in frames if frame.false is not None]
    times = [frame.benefit.detected_s[0] for frame in frames]
    assert numbers == sorted(numbers, reverse=True)
    assert times == sorted(times)
    assert times[0] < times[-1]
    assert numbers[0] > numbers[-1]
    assert any(frame.benefit.name == FIVE_FRAMES for frame in frames)


def method(name: str, num_groups: int, delay_s: float) -> Method:
    return Method(time_benefit(name, [], []), FalseTracks(99, 99, 2.0, math.nan, 0, 0.5, num_groups), delay_s)


def test_the_least_delay_at_a_rate() -> None:
    curve = [method("1", 8, 0.2), method("2", 4, 0.5), method("3", 3, 0.7)]
    assert least_delay_s(curve, 4.0) == 0.2
    assert least_delay_s(curve, 3.9) == 0.5
    assert least_delay_s(curve, 1.5) == 0.7
    assert math.isnan(least_delay_s(curve, 1.0))
    assert curve[0].false is not None
    assert math.isnan(curve[0].false.per_km)


def test_a_set_without_a_vehicle(tmp_path: Path) -> None:
    root = make_pvdn(tmp_path)
    for path in (root / "labels/keypoints").glob("*.json"):
        write(path, {"image_id": int(path.stem), "annotations": []})
    with pytest.raises(ValueError, match="expected a vehicle whose light is annotated, found none"):
        run_experiment([PVDN(root)], preset("foreglow"))


def test_a_configuration_without_a_model() -> None:
    with pytest.raises(ValueError, match=r"classifier\.model: expected one, the configuration has none"):
        run_experiment([PVDN(shipped_drive())], preset("paper"))


def test_the_report(results: TimeBenefitResults, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    report = write_report(results, tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {
        "results.json", "config.toml", "sequences.csv", "report.md", "benefit.png", "sequences.png", "confirmation.png",
        "timeline.png",
    }  # fmt: skip
    text = report.read_text()
    assert "| tracker, ours |" in text
    assert "| S00001 | curve | car |" in text
    assert "| single frame, paper on PVDN | – | 2.10 |" in text
    category_s = results.categories["6, first trigger low beam"][0]
    assert category_s == results.encounters[0].production_s
    assert f"| 6, first trigger low beam | 1 | {category_s - results.encounters[0].light_s:.2f} |" in text
    (row,) = csv.DictReader((tmp_path / "sequences.csv").read_text().splitlines())
    assert float(row["light_s"]) == pytest.approx(results.encounters[0].light_s, abs=1e-4)
    stored = json.loads((tmp_path / "results.json").read_text())
    assert stored["encounters"][0]["sequence"] == "S00001"
    assert len(stored["curves"]["evidence"]) == len(RULES["evidence"])
    assert stored["made_with"]["version"]
    assert "1 vehicle at 18 Hz, 1 of them occluded" in summary_lines(results)[0]
    assert "it is there in the first image" not in text
    assert stored["num_begun"] == 0


@pytest.mark.usefixtures("undrawn")
def test_a_set_that_is_not_simulated(tmp_path: Path) -> None:
    """PVDN's layout alone: nobody knows the speed, and the production system is a category of the images."""
    root = make_pvdn(tmp_path)
    lamp = {"pos": [20, 30], "iid": 0, "direct": True, "rear": False}
    vehicle = {"pos": [20, 30], "oid": 7, "direct": True, "instances": [lamp]}
    for image_id in (11, 12, 13):
        write(root / f"labels/keypoints/{image_id:06d}.json", {"image_id": image_id, "annotations": [vehicle]})
    results = run_experiment([PVDN(root)], preset("foreglow"))
    single = next(encounter for encounter in results.encounters if encounter.sequence == "S00003")
    assert (single.vehicle, single.scenario, single.production_s) == ("vehicle", "", 2 / 18)
    false = results.method("tracker, ours").false
    assert false is not None
    assert not results.notes
    assert math.isnan(false.per_km)
    assert results.num_begun == 1
    assert summary_lines(results)[0].startswith("in 1 of 1 sequences with a vehicle's light, it is there in the first")
    record = to_json(results)
    assert record["methods"][3]["false"]["per_km"] is None
    assert summary_lines(results)[0] in write_report(results, tmp_path / "report").read_text()


@pytest.mark.usefixtures("undrawn", "few_rules")
def test_labels_without_numbers_of_vehicles_are_named(tmp_path: Path) -> None:
    """A vehicle that is in one image only is missed by every tracker."""
    root = make_pvdn(tmp_path)
    lamp = {"pos": [20, 30], "iid": 0, "direct": True}
    for image_id in (11, 12, 13):
        vehicle = {"pos": [20, 30], "oid": image_id, "direct": True, "instances": [lamp]}
        write(root / f"labels/keypoints/{image_id:06d}.json", {"image_id": image_id, "annotations": [vehicle]})
    results = run_experiment([PVDN(root)], preset("foreglow"))
    (line,) = results.notes
    assert line.startswith(f"{root}: no vehicle has light in two images of its sequence")
    assert line in summary_lines(results)
    assert line in write_report(results, tmp_path / "report").read_text()


@pytest.mark.slow
@pytest.mark.usefixtures("few_rules")
def test_a_tracker_of_ones_own_has_a_row() -> None:
    own = TrackerConfig(min_hits=2)
    config = preset("foreglow").model_copy(update={"tracker": own})
    results = run_experiment([PVDN(shipped_drive())], config)
    two_frames, five_frames = (results.method(name).false for name in ("tracker, configured", "tracker, paper"))
    assert two_frames is not None
    assert five_frames is not None
    assert two_frames.num_plausible > five_frames.num_plausible


@pytest.mark.usefixtures("undrawn", "few_rules")
def test_the_papers_whole_chain_has_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its model accepts every proposal; all other rows stay as they are without it."""
    pytest.importorskip("onnx")
    root = make_pvdn(tmp_path)
    alone = run_experiment([PVDN(root)], preset("foreglow"))
    both = run_experiment([PVDN(root)], preset("foreglow"), paper=paper_chain(make_model(tmp_path / "all.onnx")))
    names = [method.benefit.name for method in both.methods]
    assert [name for name in names if name not in {each.benefit.name for each in alone.methods}] == [
        "single frame, paper's whole chain", "tracker, paper's whole chain",
    ]  # fmt: skip
    for method in alone.methods:
        np.testing.assert_array_equal(both.method(method.benefit.name).benefit.detected_s, method.benefit.detected_s)
    pytest.importorskip("matplotlib")
    assert "| tracker, paper's whole chain |" in write_report(both, tmp_path / "report").read_text()
    boxes: list[str] = []
    monkeypatch.setattr(page, "box_plot", lambda *_, **options: boxes.extend(options["tick_labels"]))
    benefit_figure(both)
    assert boxes.count("tracker,\npaper's\nwhole chain") == 2  # in either half
    with pytest.raises(FileNotFoundError, match=r"none\.onnx: no such model, given with --paper-model"):
        paper_chain(tmp_path / "none.onnx")
