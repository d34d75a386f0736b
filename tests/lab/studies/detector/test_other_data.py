"""The table of detectors on data of a camera of few bits, on none, and on some that change meanwhile."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from foreglow.config import PipelineConfig, config_to_toml, preset
from foreglow.datasets import PVDNWriter
from foreglow.lab.studies.detector.rows import DetectorPlan
from foreglow.lab.studies.detector.run import run_experiment
from foreglow.lab.studies.paper_chain import paper_chain
from foreglow.lab.studies.runtime.run import run_experiment as run_on_networks
from tests.lab.studies.detector_data import make_data, make_model


def test_all_rows_of_a_table_see_the_same_white(tmp_path: Path) -> None:
    folder = make_model(tmp_path / "model.onnx").parent
    config: PipelineConfig = preset("paper").changed("guard", white_level=4095)
    (folder / "config.toml").write_text(config_to_toml(config.changed("classifier", model=folder / "model.onnx")))
    for white_level in (None, 1023):
        with pytest.raises(ValueError, match=rf"white_level: expected that of the table, {white_level}, got 4095"):
            DetectorPlan(rows=("paper",), given={"paper": folder}, may_train=False, white_level=white_level)
    DetectorPlan(rows=("paper",), given={"paper": folder}, may_train=False, white_level=4095)
    assert paper_chain(folder, 4095).guard.white_level == 4095


def test_a_split_without_an_image(tmp_path: Path) -> None:
    data = make_data(tmp_path / "data", ("train", "val"))
    with PVDNWriter(data / "test"):
        pass
    models = {"paper": make_model(tmp_path / "paper.onnx")}
    with pytest.raises(ValueError, match="test: expected images to measure on, found none"):
        run_experiment(data, tmp_path / "out", DetectorPlan(rows=("paper",), given=models))
    with pytest.raises(ValueError, match="test: expected images to run on, found none"):
        run_on_networks(data / "test", preset("foreglow"), ["process"], 1, lambda *_: None)


@pytest.mark.parametrize("kind", ["labels", "model"])
def test_no_row_is_of_files_that_change_while_it_is_made(kind: str, tmp_path: Path) -> None:
    """Labels are read once for all rows: a later one would be kept for labels that it was not measured by."""
    data = make_data(tmp_path / "data")
    models = {row: make_model(tmp_path / f"{row}.onnx") for row in ("paper", "compact")}
    plan = DetectorPlan(rows=("paper", "compact"), given=models, may_train=False)

    def meanwhile(step: str, num_done: int, num_all: int) -> None:
        if step == "paper: images" and num_done == num_all:
            if kind == "model":
                make_model(tmp_path / "compact.onnx", bias=-1.0)
                return
            label = min((data / "test/labels/keypoints").glob("*.json"))
            label.write_text(label.read_text() + "\n")

    with pytest.raises(ValueError, match=f"^{re.escape(str(data))}: expected .* as they were when this began"):
        run_experiment(data, tmp_path / "out", plan, progress=meanwhile)
    kept = [path.name for path in (tmp_path / "out/rows").glob("*.json")]
    assert kept == (["paper.json"] if kind == "model" else [])
    paper, compact = run_experiment(data, tmp_path / "out", plan).rows
    assert paper.num_boxes > 0
    assert (compact.num_boxes == 0) == (kind == "model")
