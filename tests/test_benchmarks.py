"""The benchmarks run and write figures, and the OpenCV chain is an honest opponent. No test looks at a run-time."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from benchmarks import (
    beam,
    camera_halos,
    camera_looks,
    camera_sheet,
    distance,
    guard_sweep,
    lamps_in_proposals,
    pvdn_scenes,
    ros2,
    scale,
    simulator,
    tracking,
)
from benchmarks.opencv_chain import OpenCvProposer, one_opencv_thread
from benchmarks.synthetic_frames import night_frame
from benchmarks.timing import Contender
from foreglow.config import PRESETS, ProposalConfig
from foreglow.datasets import read_image, shipped_drive
from foreglow.lab.simulation import adapted, scenario
from foreglow.proposals import NativeProposer, ReferenceProposer
from tests.parallel.dask_cluster import SETTINGS
from tests.shared_data import SHARED

pytestmark = pytest.mark.process


@pytest.fixture(autouse=True)
def _once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is timed is called once a round."""
    monkeypatch.setattr(Contender, "calls", property(lambda _: 1, lambda *_: None))


@pytest.fixture(scope="module")
def frame() -> Any:
    return night_frame(seed=1, range_m=75.0)


@pytest.mark.parametrize("preset", PRESETS)
def test_opencv_chain_finds_the_same_boxes(preset: str, frame: Any) -> None:
    config = PRESETS[preset].proposals
    proposer = OpenCvProposer(config)
    expected = ReferenceProposer(config).propose(frame).boxes_xyxy_px
    assert len(expected)
    with one_opencv_thread():
        for _ in range(2):  # its buffers carry nothing over
            np.testing.assert_array_equal(proposer.propose(frame).boxes_xyxy_px, expected)
            assert len(proposer.propose(np.zeros_like(frame))) == 0


@pytest.mark.parametrize("size_px", [(640, 480), (96, 70)])
def test_opencv_chain_at_the_borders(size_px: tuple[int, int]) -> None:
    width_px, height_px = size_px
    config = ProposalConfig(reference_width_px=width_px, min_area_px=1, min_width_px=1)
    image = np.full((height_px, width_px), 20, np.uint8)
    for top, left in ((0, 0), (0, width_px - 8), (height_px - 6, 0), (height_px - 6, width_px - 8)):
        image[top : top + 6, left : left + 8] = 200
    image[height_px // 2, width_px // 2] = 250
    expected = NativeProposer(config).propose(image).boxes_xyxy_px
    assert len(expected) >= 4
    np.testing.assert_array_equal(OpenCvProposer(config, width_px, height_px).propose(image).boxes_xyxy_px, expected)


def test_opencv_chain_refuses_other_reductions() -> None:
    with pytest.raises(ValueError, match="reduced by two or four, got 640x480 by 1"):
        OpenCvProposer(ProposalConfig(), 640, 480)


def figures(value: Any) -> Iterator[float]:
    """All numbers in a value read from JSON."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        for part in value:
            yield from figures(part)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield value


@pytest.mark.torch
def test_benchmarks_write_their_figures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from benchmarks import classifier, detector, material

    monkeypatch.setattr(material, "VARIANTS", {"folded": 0.0})  # no probes, so no minute
    detector.main(["--quick", "--out", str(tmp_path / "new" / "detector.json")])
    classifier.main(["--quick", "--out", str(tmp_path / "classifier.json")])
    results = json.loads((tmp_path / "new" / "detector.json").read_text())
    results |= json.loads((tmp_path / "classifier.json").read_text())
    assert {row["preset"] for row in results["proposals"]} == set(PRESETS)
    assert all(row["equals_reference"] for row in results["proposals"])
    assert str(SHARED) not in json.dumps(results)
    assert results["machine"]["processor"]
    for part in ("proposals", "detector", "classifier"):
        assert all(math.isfinite(number) and number >= 0 for number in figures(results[part]))
        assert all(row["p99_ms"] >= row["median_ms"] > 0 for row in results[part])


def test_trackers_are_timed(tmp_path: Path) -> None:
    tracking.main(["--quick", "--out", str(tmp_path / "tracking.json")])
    rows = json.loads((tmp_path / "tracking.json").read_text())["tracking"]
    assert {row["tracker"] for row in rows} >= {"published", "paper", "ours"}
    assert all(row["p99_ms"] >= row["median_ms"] > 0 for row in rows)


def test_beam_commands_are_timed(tmp_path: Path) -> None:
    pytest.importorskip("cantools")
    beam.main(["--quick", "--out", str(tmp_path / "beam.json")])
    rows = json.loads((tmp_path / "beam.json").read_text())["beam"]
    assert {row["what"] for row in rows} >= {"policy, guard, encode: 4 lamps", beam.WHOLE, "encode", "decode"}
    assert all(row["p99_ms"] >= row["median_ms"] > 0 for row in rows)


def test_recordings_are_timed(tmp_path: Path) -> None:
    pytest.importorskip("foxglove")
    from benchmarks import recording

    recording.main(["--quick", "--out", str(tmp_path / "recording.json")])
    rows = json.loads((tmp_path / "recording.json").read_text())["recording"]
    assert {row["what"] for row in rows} == {"record", "encode PNG", "read", "decode PNG"}
    assert all(row["p99_ms"] >= row["median_ms"] > 0 for row in rows)
    assert all(row["megabytes_a_minute"] > 0 for row in rows if row["what"] in ("record", "encode PNG"))


def test_the_viewer_is_timed(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    from benchmarks import viewer

    viewer.main(["--quick", "--out", str(tmp_path / "viewer.json")])
    rows = json.loads((tmp_path / "viewer.json").read_text())["viewer"]
    assert len(rows) == 3
    assert all(math.isfinite(number) and number >= 0 for number in figures(rows))
    assert all(row["p99_ms"] >= row["median_ms"] > 0 for row in rows)


def test_many_processes_are_timed(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    import dask

    with dask.config.set({f"distributed.{name}": value for name, value in SETTINGS.items()}):
        scale.main(["--quick", "--out", str(tmp_path / "scale.json")])
    results = json.loads((tmp_path / "scale.json").read_text())
    names = ["this process", "--jobs 2", "--cluster, 2 workers"]
    assert [row["workers"] for row in results["run"]] == [row["workers"] for row in results["tasks"]] == names
    assert all(row["speed_up"] > 0 for row in results["run"])
    assert results["num_frames"] == 8


def test_the_guard_of_the_headlamps_that_ship_is_swept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Over a part of what `beam/test_guard.py` sweeps with lamps of fewer LEDs."""
    few = dataclasses.replace(
        guard_sweep.QUICK,
        azimuths_deg=(-12, 0.5, 5),
        elevations_deg=(0.5,),
        wanted=(1.0, math.nan, guard_sweep.DIPPED),
        speeds_mps=(20.0, 8.8),
    )
    monkeypatch.setattr(guard_sweep, "QUICK", few)
    guard_sweep.main(["--quick", "--out", str(tmp_path / "sweep.json")])
    results = json.loads((tmp_path / "sweep.json").read_text())
    assert results["num_states"] > 3_000
    assert results["num_lit"] > 300
    assert results["num_counter_examples"] == 0


@pytest.mark.ros
def test_the_ros_network_is_timed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """That of six processes is measured in `lab/studies/runtime/test_run.py`."""
    monkeypatch.setattr(ros2, "CONTENDERS", ros2.CONTENDERS[:1])
    ros2.main(["--quick", "--out", str(tmp_path / "ros2.json")])
    rows = json.loads((tmp_path / "ros2.json").read_text())["network"]
    assert [row["what"] for row in rows] == ["in process", "one node"]
    assert all(row["max_ms"] >= row["p99_ms"] >= row["median_ms"] > 0 for row in rows)


def test_estimators_are_timed(tmp_path: Path) -> None:
    distance.main(["--quick", "--out", str(tmp_path / "distance.json")])
    rows = json.loads((tmp_path / "distance.json").read_text())["distance"]
    assert {row["estimator"] for row in rows} >= {*distance.ESTIMATORS, distance.SPECIFICATION, distance.WITH_TRACKER}
    assert all(row["p99_ms"] >= row["median_ms"] > 0 for row in rows)


@pytest.mark.renderer
def test_the_simulator_is_timed_by_scenario() -> None:
    drawn = scenario("straight", 1)
    row = simulator.measure_drive(adapted(drawn, (64, 48), 2.0 / drawn.duration_s, "night"))
    assert row["scenario"] == "straight"
    assert 0 < row["haze_median_ms"] < row["render_median_ms"] < row["frame_median_ms"]


def test_the_halo_of_a_lamp_is_measured_over_its_angle() -> None:
    rows, columns = np.indices((240, 320))
    distances = np.hypot(columns - 160, rows - 100)
    focal_px = 300.0
    angles = np.degrees(np.arctan(distances / focal_px))
    grey = np.where(distances < 2, 255.0, np.minimum(150.0 / np.maximum(angles, 0.5), 200.0))
    (found,) = camera_looks.halos(grey, focal_px)
    middles = np.sqrt(camera_looks.ANGLES_DEG[1:] * camera_looks.ANGLES_DEG[:-1])
    is_known = np.isfinite(found) & (middles > 0.8)
    assert found[is_known] == pytest.approx(150.0 / middles[is_known], rel=0.12)


def test_figures_tell_noise_and_blocks() -> None:
    rng = np.random.default_rng(5)
    smooth = np.tile(np.linspace(0.0, 200.0, 128), (128, 1))
    noisy, blocky = smooth + rng.normal(0.0, 3.0, smooth.shape), np.repeat(smooth[:, ::8], 8, axis=1)
    plain = camera_looks.figures(smooth)
    assert camera_looks.figures(noisy)["noise"] > 2.0 > plain["noise"]
    assert camera_looks.figures(blocky)["blocks"] > 100 * plain["blocks"]
    assert plain["percentile 50"] == pytest.approx(100.0)


def test_lamps_in_proposals_are_counted(tmp_path: Path) -> None:
    lamps_in_proposals.main([str(shipped_drive()), "--preset", "foreglow", "--out", str(tmp_path / "lamps.json")])
    (row,) = json.loads((tmp_path / "lamps.json").read_text())
    assert row["number of lamps"] > 0
    assert 0.3 < row["front lamps"] <= 1.0
    boxes = np.array([[10, 10, 20, 20]], np.int32)
    assert lamps_in_proposals.holds(boxes, (21.0, 15.0), 2.0, 10.0)
    assert not lamps_in_proposals.holds(boxes, (21.0, 15.0), 0.0, 10.0)
    assert not lamps_in_proposals.holds(boxes, (15.0, 15.0), 2.0, 9.0)
    assert not lamps_in_proposals.holds(boxes[:0], (15.0, 15.0), 2.0, 10.0)


def test_errors_of_a_calibration_by_hand() -> None:
    from benchmarks.auto_calibration import summary

    errors, sigmas = (-0.1, 0.2, 0.3), (0.2, 0.15, 0.3)
    rows = [
        {
            "pitch_error_deg": error,
            "pitch_sigma_deg": sigma,
            "yaw_error_deg": 2 * error,
            "yaw_sigma_deg": sigma,
            "range_errors": [[sigma, 2 * sigma]],
        }
        for error, sigma in zip(errors, sigmas, strict=True)
    ]
    figures = summary(rows)
    assert figures["lamps"] == 3
    assert figures["ratio"] == pytest.approx(2.0)
    assert "ratio" not in summary([row | {"range_errors": []} for row in rows])
    assert (figures["calibrated"], figures["pitch_median_deg"]) == (3, 0.2)
    assert figures["pitch_within_sigma"] == pytest.approx(2 / 3)
    assert figures["yaw_within_sigma"] == pytest.approx(1 / 3)
    assert figures["yaw_90_deg"] == pytest.approx(0.56)


def test_halo_of_a_profile_is_its_own_and_not_that_of_another(tmp_path: Path) -> None:
    import cv2

    lamps = camera_halos.profile_lamps("dashcam_small")
    camera = lamps.camera
    rows, columns = np.indices((camera.height_px, camera.width_px)) + 0.5
    angles = np.degrees(np.arctan(np.hypot(columns - 200.5, rows - 150.5) / camera.focal_px[0]))
    offset = (np.array([200.5, 150.5]) - [camera.width_px / 2, camera.height_px / 2]) / camera.width_px
    middles = np.sqrt(camera_halos.EDGES_DEG[1:] * camera_halos.EDGES_DEG[:-1])
    light = np.interp(np.log(np.maximum(angles, 0.1)), np.log(middles), np.log(0.1 * lamps.luminances(offset, 0.0)))
    cv2.imwrite(str(tmp_path / "lamp.png"), np.rint(lamps.grey(np.exp(light))).astype(np.uint8))
    hfov_deg = 2 * np.degrees(np.arctan(camera.width_px / 2 / camera.focal_px[0]))
    worst = {}
    for profile in ("dashcam_small", "town_dashcam"):
        lamp = f"{profile}={tmp_path / 'lamp.png'}@200,150"
        camera_halos.main([lamp, "--hfov", str(hfov_deg), "--out", str(tmp_path)])
        (found,) = json.loads((tmp_path / "halos.json").read_text()).values()
        worst[profile] = found["worst"]
    assert worst["dashcam_small"] < 1.2 < 2.0 < worst["town_dashcam"]


@pytest.mark.parametrize("text", ["phone", "phone=clip.mp4", "phone=clip.mp4@1", "phone=clip.mp4#x@1,2", "phone@1,2"])
def test_halo_of_a_lamp_that_is_not_described(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        camera_halos.main([text])
    assert "expected PROFILE=FILE[#FRAME]@X,Y[,APART]" in capsys.readouterr().err


def test_the_key_of_a_sheet_says_where_the_real_images_are(tmp_path: Path) -> None:
    panels = np.full((3, 4, 90, 160), 200, np.uint8)
    panels[:, :, :9] = 255  # as a text
    cv2.imwrite(str(tmp_path / "real.png"), np.concatenate(np.concatenate(panels, 1), 1))
    (tmp_path / "simulated").mkdir()
    for number in range(12):
        cv2.imwrite(str(tmp_path / "simulated" / f"{number:02d}.png"), np.full((180, 320), 25, np.uint8))
    numbers = ",".join(str(number) for number in range(12))
    sources = [f"{tmp_path}/real.png#3x4:{numbers}", f"{tmp_path}/simulated~90*2.5"]
    camera_sheet.main([*sources, "--width=160", "--gamma=1", "--top=0.1", f"--out={tmp_path}"])
    key = json.loads((tmp_path / "key.json").read_text())
    assert set(key.values()) == {"left", "right"}
    sheet = read_image(tmp_path / "sheet.png")
    height, width = 81 + 2 * camera_sheet.BORDER_PX, 320 + 2 * camera_sheet.BORDER_PX
    for number, side in key.items():
        pair = read_image(tmp_path / f"pair_{int(number):02d}.png")
        assert (pair[:, :160] == {"left": 200, "right": 62}[side]).all()
        assert (pair[:, 160:] == {"left": 62, "right": 200}[side]).all()
        row, column = divmod(int(number) - 1, camera_sheet.PAIRS_PER_ROW)
        top, left = row * height + camera_sheet.BORDER_PX, column * width + camera_sheet.BORDER_PX
        assert (sheet[top + 40 : top + 81, left : left + 320] == pair[40:]).all()  # below its number


def test_a_sheet_pairs_frames_of_one_group() -> None:
    groups = [([np.full((9, 16), kind, np.uint8)] * 3, [np.full((9, 16), kind + 10, np.uint8)] * 3) for kind in (1, 2)]
    pairs = camera_sheet.drawn_pairs(groups, seed=1)
    assert [simulated[0, 0] - real[0, 0] for real, simulated in pairs] == [10] * 6
    with pytest.raises(SystemExit):
        camera_sheet.main(["only one"])


def test_scenes_like_the_real_frames_are_drawn_from_their_number() -> None:
    for drawn in (pvdn_scenes.snowfall, pvdn_scenes.dry_bend):
        assert drawn(3) == drawn(3)
        assert drawn(3) != drawn(4)
    assert {pvdn_scenes.snowfall(number).weather.snow_mm_h > 0 for number in range(20)} == {True}
