from __future__ import annotations

import csv
import dataclasses
import json
import math
from pathlib import Path

import pytest

from foreglow.config import preset, read_config
from foreglow.lab.studies.distance.metrics import find
from foreglow.lab.studies.distance.page import headline, write_report
from foreglow.lab.studies.distance.run import DistancePlan, DistanceResults, run_experiment
from tests.lab.studies.ranged_drives import make_split

pytestmark = pytest.mark.slow

pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> DistanceResults:
    root = tmp_path_factory.mktemp("drives")
    make_split(root)
    return run_experiment(root, DistancePlan(estimators=("gp", "psd_2d")))


@pytest.fixture(scope="module")
def report(results: DistanceResults, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a report whose folder did not exist."""
    return write_report(results, tmp_path_factory.mktemp("report") / "out")


def test_the_folder(results: DistanceResults, report: Path) -> None:
    assert (report.parent.name, report.name) == ("out", "report.html")
    figures = {"methods", "series", "range", "localisation", "terrain", "pitch", "heuristics_gp", "heuristics_psd_2d"}
    files = {"report.html", "results.json", "lights.csv", "config.toml", "tables.md"}
    assert {path.name for path in report.parent.iterdir()} == files | {f"{name}.png" for name in figures} | {
        "lidar.jpg"
    }
    assert read_config(report.parent / "config.toml") == preset("foreglow")
    record = json.loads((report.parent / "results.json").read_text())
    assert (record["num_lights"], record["made_with"]["seed"], len(record["findings"])) == (12, 1, len(find(results)))
    page = report.read_text()
    assert page.count("<img ") == len(figures) + 1
    assert "positive where the light seems too far" in page
    assert "paper +0.12" in page


def test_a_line_for_each_light(results: DistanceResults, report: Path) -> None:
    with (report.parent / "lights.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 12
    assert rows[0]["kind"] == "lamp"
    for row, light, range_m in zip(rows, results.lights, results.ranges_m[results.methods[0]], strict=True):
        assert int(row["image_id"]) == light.image_id
        assert (int(row["x1_px"]), int(row["y2_px"])) == (light.box_xyxy_px[0], light.box_xyxy_px[3])
        assert float(row["gp, centre: range_m"]) == pytest.approx(range_m, abs=1e-3)
        assert (row["lidar_m"] == "") == math.isnan(light.lidar_m)


def test_the_same_results_give_the_same_files(results: DistanceResults, report: Path, tmp_path: Path) -> None:
    assert write_report(results, tmp_path).read_bytes() == report.read_bytes()


def test_what_is_not_made_again_goes_with_the_report_before(results: DistanceResults, tmp_path: Path) -> None:
    """Figures of other methods stayed beside the new report."""
    stale, mine = ("heuristics_psd_3d.png", "lidar.jpg"), ("heuristics_mine.png", "notes.txt")
    for name in (*stale, *mine):
        (tmp_path / name).touch()
    write_report(dataclasses.replace(results, example=None), tmp_path)
    there = {path.name for path in tmp_path.iterdir()}
    assert there.isdisjoint(stale)
    assert there >= {*mine, "heuristics_gp.png"}


def test_the_headline_stands_beside_the_paper(results: DistanceResults) -> None:
    lines = headline(find(results))
    assert [line.split(":")[0] for line in lines] == ["GP, direct", "GP, indirect"]
    assert lines[1].endswith("(paper -0.32)")
    assert headline([finding for finding in find(results) if finding.method.estimator != "gp"]) == []
