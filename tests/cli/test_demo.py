"""`foreglow demo`, as a user types it; on the tiny set, since a video of the shipped drive takes seconds."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest
from typer.testing import CliRunner, Result

from benchmarks.shipped_drive import TRUTH_NAMES, compress
from foreglow import datasets
from foreglow.cli import app
from foreglow.config import read_config
from foreglow.datasets import PVDN
from foreglow.datasets.simulated import read_truth
from foreglow.lab.simulation.writing.dataset import simulate_dataset
from foreglow.runs.summary_file import read_summary
from tests.datasets.tiny_pvdn import make_pvdn
from tests.lab.simulation.stub_drive import drive, scene

pytestmark = pytest.mark.slow


def demo(*arguments: object) -> Result:
    result = CliRunner().invoke(app, ["demo", *(str(argument) for argument in arguments)])
    assert result.exit_code == 0, result.output
    return result


def test_without_a_source_it_runs_on_the_shipped_drive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = make_pvdn(tmp_path)
    monkeypatch.setattr(datasets, "shipped_drive", lambda: root)
    result = demo("--out", tmp_path / "out")
    assert result.stdout.startswith("5 frames, ")
    *_, first, sight, reported, conclusion, paper = result.stdout.splitlines()
    assert first.startswith("first light of the vehicle visible")
    assert (sight.split()[:3], reported.split()[-2:]) == (["vehicle", "in", "sight"], ["0.11", "s"])
    assert conclusion == "=> not detected"
    assert "the paper's scene" in paper
    assert "moments.png" in result.stdout
    summary = read_summary(tmp_path / "out" / "summary.json")
    assert Path(summary.source) == root, "by which `beam` finds the frames again"
    assert summary.source_digest is not None
    assert cv2.imread(str(tmp_path / "out" / "moments.png")) is not None
    assert (tmp_path / "out" / "overlay.mp4").is_file()


def test_frames_without_labels_have_no_story(tmp_path: Path) -> None:
    root = make_pvdn(tmp_path)
    out = tmp_path / "out"
    demo(root, "--out", out)
    result = demo(root / "images" / "S00001" / "000005.png", "--out", out)
    assert "look in" in result.stdout.splitlines()[-1]
    assert not (out / "moments.png").exists()  # that of the run before
    for path in (root / "labels" / "keypoints").iterdir():
        path.unlink()
    (root / "labels" / "keypoints").rmdir()
    assert "look in" in demo(root, "--out", out).stdout.splitlines()[-1]


def test_frames_with_calibration_and_speed_have_a_beam(tmp_path: Path) -> None:
    made = simulate_dataset(tmp_path / "data", (scene(1),), drive)
    result = demo(made.root, "--out", tmp_path / "out")
    assert "beam, of the frames: " in result.stdout
    assert (tmp_path / "out" / "beam.mp4").is_file()
    assert read_config(tmp_path / "out" / "config.toml").beam.policy == "foreglow"


def test_the_shipped_drive_is_made_of_a_simulated_split(tmp_path: Path) -> None:
    made = simulate_dataset(tmp_path / "data", (scene(1),), drive)
    folder = tmp_path / "drives" / "stub"
    (folder / "images" / "old").mkdir(parents=True)
    num_bytes = compress(made.root, folder, quality=95)
    assert num_bytes == sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    lossless, small = PVDN(made.root), PVDN(folder)
    assert sorted(path.name for path in (folder / "images").iterdir()) == ["S00001"]
    assert {path.name for path in (folder / "simulation" / "S00001").iterdir()} == set(TRUTH_NAMES)
    assert small.rate_hz == lossless.rate_hz
    for image_id in lossless.frame_ids:
        assert small.image_path(image_id).suffix == ".jpg"
        assert small.annotations(image_id) == lossless.annotations(image_id)
        assert abs(small.read(image_id).image.astype(int) - lossless.read(image_id).image).mean() < 25
    assert len(read_truth(folder).sequence(1).frames) == small.num_frames
    assert compress(made.root, folder, quality=95) == num_bytes
