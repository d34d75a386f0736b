"""Lights whose ranges a LiDAR measured: by hand, and a set that is told as boxes and depth images."""

from __future__ import annotations

import dataclasses
import json
import math
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from foreglow.datasets import PVDN
from foreglow.datasets.simulated.files import encoded_depth
from foreglow.lab.studies.distance.lights import LidarLights, lidar_range_m
from foreglow.lab.studies.distance.metrics import beside_paper, find
from foreglow.lab.studies.distance.page import distance_figures
from foreglow.lab.studies.distance.run import DistancePlan, DistanceResults, run_experiment
from tests.cli.commands import complaint, foreglow_command
from tests.lab.studies.ranged_drives import HEIGHT_PX, WIDTH_PX, make_split

PLAN = DistancePlan(estimators=("gp", "psd_2d"))


@pytest.fixture(name="split", scope="module")
def fixture_split(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_split(tmp_path_factory.mktemp("drives"))


@pytest.fixture(name="simulated", scope="module")
def fixture_simulated(split: Path) -> DistanceResults:
    return run_experiment(split, PLAN)


def told(results: DistanceResults, folder: Path) -> tuple[Path, Path]:
    """The lights of `results` as a file of boxes and depth images that are 10 m everywhere."""
    depth = folder / "depth"
    depth.mkdir(parents=True)
    lines = []
    for light in results.lights:
        stored = encoded_depth(np.full((HEIGHT_PX, WIDTH_PX), 10.0))
        assert cv2.imwrite(str(depth / f"{light.image_id:06d}.png"), stored)
        fields: dict[str, Any] = {"scene": light.sequence_id, "frame": light.image_id, "instance": light.instance_id}
        lines.append(json.dumps(fields | {"direct": light.is_direct, "box_xyxy_px": light.box_xyxy_px}))
    (folder / "boxes.jsonl").write_text("\n".join(lines) + "\n")
    return folder / "boxes.jsonl", depth


def test_the_median_of_a_box() -> None:
    depth_m = np.full((4, 6), np.nan)
    depth_m[1, 1:4] = (30.0, 50.0, 90.0)
    assert lidar_range_m(depth_m, np.array([0, 0, 4, 2])) == 50.0
    assert lidar_range_m(depth_m, np.array([2, 1, 4, 2])) == 70.0  # half-open: the pixel at x = 4 is outside
    assert math.isnan(lidar_range_m(depth_m, np.array([4, 0, 6, 4])))


def test_simulated_light_has_the_depth_of_the_scanner(simulated: DistanceResults) -> None:
    """The stub's scanner sees 20 m everywhere, with some noise, whatever the light's own range is."""
    lidar_m = simulated.column("lidar_m")
    assert (~np.isnan(lidar_m)).any()
    assert lidar_m[~np.isnan(lidar_m)] == pytest.approx(20.0, abs=0.1)
    found = [finding for finding in find(simulated) if finding.axis == "lidar" and finding.light == "all"]
    assert {finding.method.estimator for finding in found} == {"gp", "psd_2d"}
    ranges_m = simulated.ranges_m[found[0].method]
    assert found[0].errors.median == pytest.approx(np.nanmedian(ranges_m[~np.isnan(lidar_m)] / 20.0 - 1), abs=0.01)
    assert simulated.example is not None
    assert simulated.example.depth_m is not None


@pytest.mark.usefixtures("undrawn")
def test_the_picture_of_the_lidar_is_cut_around_the_boxes(simulated: DistanceResults) -> None:
    pytest.importorskip("matplotlib")
    files = {figure.file: figure.data for figure in distance_figures(simulated, find(simulated))}
    picture = cv2.imdecode(np.frombuffer(files["lidar.jpg"], np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    height_px, width_px = picture.shape[:2]
    assert width_px / height_px == pytest.approx(4.0, rel=0.02)
    middle = np.array_split(picture, 3, axis=1)[1].astype(int)
    assert (np.ptp(middle, axis=2) > 80).any()  # coloured boxes on a grey image


def test_a_split_without_depth_images(split: Path, tmp_path: Path) -> None:
    copy = tmp_path / "test"
    shutil.copytree(split, copy)
    for folder in copy.glob("simulation/*/depth"):
        shutil.rmtree(folder)
    results = run_experiment(copy, DistancePlan(estimators=("gp",)))
    assert np.isnan(results.column("lidar_m")).all()
    assert results.example is None
    assert not [finding for finding in find(results) if finding.axis == "lidar"]


def test_boxes_and_depth_images(split: Path, simulated: DistanceResults, tmp_path: Path) -> None:
    """The same frames and boxes give the same estimates; the truth is the LiDAR's."""
    boxes, depth = told(simulated, tmp_path)
    lights = LidarLights(PVDN(split), boxes, depth)
    results = run_experiment(lights, PLAN)
    assert (results.num_images, len(results.lights)) == (6, len(simulated.lights))
    assert results.column("truth_m") == pytest.approx(10.0)
    for method, ranges_m in results.ranges_m.items():
        np.testing.assert_array_equal(ranges_m, simulated.ranges_m[method])
    axes = {finding.axis for finding in find(results)}
    assert "lidar" in axes
    assert not axes & {"vehicle", "terrain", "localisation"}
    assert next(beside_paper(results, find(results))) == (
        "Mean range: 10 m direct (paper 83 m), 10 m indirect (paper 63 m)"
    )


@pytest.mark.parametrize(
    ("gp", "said"),
    [
        (0.35, "gp has the least median absolute error, 0.35. As in the paper"),
        (0.5, "psd_2d has the least median absolute error, 0.40; gp 0.50. This contradicts the paper"),
    ],
)
def test_the_best_method_is_said_once(simulated: DistanceResults, gp: float, said: str) -> None:
    medians = {"gp": gp, "psd_2d": 0.4}
    findings = [
        dataclasses.replace(
            found, errors=dataclasses.replace(found.errors, median_absolute=medians[found.method.estimator])
        )
        for found in find(simulated)
        if found.method.estimator in medians
    ]
    _, direct, *_ = beside_paper(simulated, findings)
    assert direct == f"Of the paper's methods, direct light: {said}, in which gp is the best"


def test_a_camera_of_few_bits_is_seen_at_full_scale(split: Path, simulated: DistanceResults, tmp_path: Path) -> None:
    boxes, depth = told(simulated, tmp_path)
    found = []
    for factor, white_level in ((257, None), (16, 4080)):
        frames = [
            dataclasses.replace(frame, image=frame.image.astype(np.uint16) * np.uint16(factor)) for frame in PVDN(split)
        ]
        config = PLAN.config.changed("guard", white_level=white_level)
        plan = DistancePlan(estimators=("road_surface",), config=config)
        results = run_experiment(LidarLights(frames, boxes, depth), plan)  # type: ignore[arg-type]
        found.append(list(results.ranges_m.values()))
    np.testing.assert_array_equal(found[1], found[0])


def test_light_without_a_depth_is_left_out(split: Path, simulated: DistanceResults, tmp_path: Path) -> None:
    boxes, depth = told(simulated, tmp_path)
    empty = next(iter(sorted(depth.iterdir())))
    assert cv2.imwrite(str(empty), np.zeros((HEIGHT_PX, WIDTH_PX), np.uint16))
    results = run_experiment(LidarLights(PVDN(split), boxes, depth), DistancePlan(estimators=("gp",)))
    assert results.left_out == {"without a depth": 2}
    assert len(results.lights) == len(simulated.lights) - 2


@pytest.mark.usefixtures("undrawn")
def test_the_command(split: Path, simulated: DistanceResults, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    boxes, depth = told(simulated, tmp_path)
    out = tmp_path / "out"
    files = ("--boxes", boxes, "--depth", depth)
    result = foreglow_command(
        "experiment", "distance", split, "--out", out, *files, "--estimators", "gp", "--all-pixels"
    )
    assert result.exit_code == 0, result.output
    assert (out / "lidar.jpg").stat().st_size > 0
    assert "Mean range: 10 m direct" in (out / "tables.md").read_text()
    assert "all_pixels = true" in (out / "config.toml").read_text()


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ({"box_xyxy_px": [4, 4, 4, 9]}, "line 1: box_xyxy_px: expected x1 < x2"),
        ({"box_xyxy_px": [4, 4, 9999, 9]}, "box_xyxy_px: expected boxes inside 320x240 px"),
        ({"direct": 1}, "line 1: direct: "),
        ({"frame": 7}, "frame: expected images of the source, it has no 7"),
    ],
)
def test_bad_boxes(
    line: dict[str, Any], expected: str, split: Path, simulated: DistanceResults, tmp_path: Path
) -> None:
    boxes, depth = told(simulated, tmp_path)
    first, *others = boxes.read_text().splitlines()
    boxes.write_text("\n".join([json.dumps(json.loads(first) | line), *others]))
    options = ("--boxes", boxes, "--depth", depth, "--estimators", "gp")
    assert expected in complaint("experiment", "distance", split, "--out", tmp_path / "out", *options)


def test_bad_depth(split: Path, simulated: DistanceResults, tmp_path: Path) -> None:
    boxes, depth = told(simulated, tmp_path)
    experiment = ("experiment", "distance", split, "--out", tmp_path / "out", "--boxes", boxes)
    assert "--boxes and --depth: expected both or none" in complaint(*experiment)
    assert "no such folder, expected depth images" in complaint(*experiment, "--depth", tmp_path / "none")
    calibrated = ("experiment", "distance", split, "--out", tmp_path / "out", "--calibration", boxes)
    assert "--boxes: expected with a calibration or vehicle data" in complaint(*calibrated)
    path = sorted(depth.iterdir())[0]
    assert cv2.imwrite(str(path), np.zeros((HEIGHT_PX, WIDTH_PX), np.uint8))
    assert "expected 16 bits and 320x240 px" in complaint(*experiment, "--depth", depth)


def test_images_need_a_calibration(split: Path, simulated: DistanceResults, tmp_path: Path) -> None:
    boxes, depth = told(simulated, tmp_path)
    frames = [dataclasses.replace(frame, camera=None) for frame in PVDN(split)]
    with pytest.raises(ValueError, match=r"boxes\.jsonl: frame \d+: expected a calibration of its camera, got none"):
        run_experiment(LidarLights(frames, boxes, depth), PLAN)  # type: ignore[arg-type]
