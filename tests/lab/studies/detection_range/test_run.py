"""The experiment on detection ranges: who is in sight, how far away, and whether a box holds a lamp."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from foreglow.config import preset
from foreglow.geometry import Camera
from foreglow.lab.simulation.drive_frame import DriveFrame
from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.lab.simulation.writing.dataset import DatasetConfig, simulate_dataset
from foreglow.lab.studies.detection_range.metrics import REQUIREMENTS, View, group, groups
from foreglow.lab.studies.detection_range.page import summary_lines, write_report
from foreglow.lab.studies.detection_range.run import run_experiment
from tests.cli.commands import complaint, foreglow_command
from tests.lab.simulation.truths import lamp, vehicle
from tests.lab.studies import ranged_drives
from tests.lab.studies.detector_data import make_model

ONCOMING_PX, AHEAD_PX, HIDDEN_PX = (100.0, 120.0), (200.0, 120.0), (260.0, 60.0)


def drive(scene: Scene) -> Iterator[DriveFrame]:
    """An oncoming lamp, 100 m ahead, that the image shows, a rear lamp that it does not, and a lamp behind a hill."""
    for known in ranged_drives.drive(scene):
        lamps = (
            lamp(position_px=ONCOMING_PX, position_world_m=ahead_m(known, 100.0)),
            lamp("rear_left", is_rear=True, position_px=AHEAD_PX, position_world_m=ahead_m(known, 60.0)),
            lamp(position_px=HIDDEN_PX, visible_share=0.1, position_world_m=ahead_m(known, 300.0)),
        )
        yield dataclasses.replace(
            known,
            frame=dataclasses.replace(known.frame, image=image()),
            vehicles=tuple(vehicle(number, lamps=(its_lamp,)) for number, its_lamp in enumerate(lamps)),
        )


def ahead_m(known: DriveFrame, range_m: float) -> np.ndarray:
    camera: Camera = known.camera
    return known.ego_pose.to_outer(camera.vehicle_from_camera.position_m + np.array([range_m, 0.0, 0.0]))


def image() -> np.ndarray:
    rows, columns = np.mgrid[: ranged_drives.HEIGHT_PX, : ranged_drives.WIDTH_PX] + 0.5
    spot = np.exp(-((columns - ONCOMING_PX[0]) ** 2 + (rows - ONCOMING_PX[1]) ** 2) / (2 * 3.0**2))
    return np.asarray((6.0 + 200.0 * spot).round(), np.uint8)


@pytest.fixture(scope="module")
def split(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("drives")
    scenes = [ranged_drives.scene(seed) for seed in (0, 1)]
    return simulate_dataset(root, scenes, drive, DatasetConfig(split="test")).root


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_model(tmp_path_factory.mktemp("model") / "model.onnx")


def test_vehicles_in_sight_are_viewed_at_the_range_of_their_lamps(split: Path, model: Path) -> None:
    views = run_experiment([split], preset("paper").changed("classifier", model=model))
    assert {(view.vehicle_id, view.direction, view.is_detected) for view in views} == {
        (0, "oncoming", True),
        (1, "ahead", False),
    }
    for view in views:
        assert view.range_m == pytest.approx(100.0 if view.direction == "oncoming" else 60.0)
        assert view.camera == "scene"
    assert {view.seed for view in views} == {0, 1}


def test_an_experiment_without_a_model_is_refused(split: Path) -> None:
    with pytest.raises(ValueError, match="expected a configuration with a model"):
        run_experiment([split], preset("paper"))


def view(range_m: float, is_detected: bool, **fields: object) -> View:
    usual = View("pvdn_day", "dry", 1, 10_000, 0, "oncoming", range_m, is_detected)
    return dataclasses.replace(usual, **fields)  # type: ignore[arg-type]


def test_views_are_grouped_by_range_weather_and_camera() -> None:
    views = [
        view(370.0, True),
        view(430.0, False, weather="rain", seed=2),
        view(441.0, False, camera="phone"),
        view(100.0, True, direction="ahead"),
    ]
    found = groups(views, REQUIREMENTS[0])
    (whole,) = found["all"]
    assert (whole.num_drives, whole.num_at, whole.share_at) == (2, 2, 0.5)
    assert whole.counts == (0, 0, 0, 0, 1, 2, 0)
    assert [(row.name, row.num_at) for row in found["weather"]] == [("dry", 1), ("rain", 1)]
    assert [(row.name, row.num_at) for row in found["camera"]] == [("pvdn_day", 2), ("phone", 0)]
    assert group("none", [], REQUIREMENTS[1]).counts == (0,) * 7


def test_the_report_has_a_table_and_a_figure_for_each_requirement(tmp_path: Path) -> None:
    views = [view(400.0, True), view(50.0, False, direction="ahead")]
    text = write_report(views, [Path("r48")], tmp_path).read_text()
    assert "| all | 1 | **100%** (1) |" in text
    assert "| all | 1 | **–** (0) | – (0) | – (0) | 0% (1) |" in text
    assert {"oncoming.png", "ahead.png", "views.csv", "results.json"} <= {path.name for path in tmp_path.iterdir()}
    assert json.loads((tmp_path / "results.json").read_text())["groups"]["oncoming"]["all"][0]["share_at"] == 1.0
    assert summary_lines(views) == [
        "oncoming at 400 m (UN R48): 100% of 1 views detected, in 1 drives",
        "ahead at 100 m (UN R48): – of 0 views detected, in 0 drives",
    ]


@pytest.mark.usefixtures("undrawn")
def test_the_command_writes_a_report(split: Path, model: Path, tmp_path: Path) -> None:
    out = tmp_path / "report"
    command = ["experiment", "detection-range", split, "--preset", "paper", "--model", model, "--out", out]
    assert f"look in {out / 'report.md'}" in foreglow_command(*command).stdout
    assert "none: no such" in complaint("experiment", "detection-range", tmp_path / "none", "--out", out)
