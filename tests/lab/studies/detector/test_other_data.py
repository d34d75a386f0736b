"""The table of detectors on data of a camera of few bits, and on none."""

from __future__ import annotations

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
