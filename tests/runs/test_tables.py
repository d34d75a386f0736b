"""A run's results as tables."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import pytest

import foreglow
from foreglow.runs.recorded_run import columns_of
from foreglow.types import Frame
from tests.runs.test_recorded_run import made_up, write_run
from tests.stand_ins import night_image, result_of


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_run(tmp_path / "run", [made_up(number) for number in range(3)])


def test_tables_have_a_row_for_each(folder: Path) -> None:
    run = foreglow.read_run(str(folder))
    frames, boxes, tracks = (columns_of(run.sequences, table) for table in ("frames", "boxes", "tracks"))
    assert frames["frame"] == [0, 1, 2]
    assert frames["time_s"] == [0.0, 0.05, 0.1]
    assert frames["sequence"] == ["S00001"] * 3
    assert len(boxes["score"]) == sum(frames["num_proposals"])
    assert tracks["range_m"] == [50.0, 49.0, 48.0]
    assert set(tracks["state"]) == {"confirmed"}
    assert len({len(column) for column in boxes.values()}) == 1
    with pytest.raises(ValueError, match="table: expected one of frames, boxes, tracks, got 'cars'"):
        columns_of(run.sequences, "cars")  # type: ignore[arg-type]


def test_what_did_not_run_is_unknown(tmp_path: Path) -> None:
    frame = Frame(night_image(), 0, 7)
    run = foreglow.read_run(write_run(tmp_path / "run", [(frame, result_of(frame, [[1, 2, 5, 9]]))]))
    boxes = columns_of(run.sequences, "boxes")
    assert math.isnan(boxes["score"][0])
    assert boxes["is_accepted"] == [None]
    assert boxes["x2_px"] == [5]
    assert columns_of(run.sequences, "tracks") == {"sequence": [], "frame": [], "time_s": []}
    untimed = dataclasses.replace(run.sequences[""][0], stage_ms={})
    assert math.isnan(columns_of({"": (untimed,)}, "frames")["time_ms"][0])


def test_parquet_holds_the_same(folder: Path, tmp_path: Path) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    run = foreglow.read_run(folder)
    run.write_parquet(tmp_path / "tracks.parquet", "tracks")
    assert pq.read_table(tmp_path / "tracks.parquet").to_pydict() == dict(columns_of(run.sequences, "tracks")) | {
        "direct": pytest.approx(columns_of(run.sequences, "tracks")["direct"], nan_ok=True)
    }


def test_pandas_or_what_to_install(folder: Path) -> None:
    run = foreglow.read_run(folder)
    try:
        import pandas  # noqa: F401
    except ModuleNotFoundError:
        with pytest.raises(ModuleNotFoundError, match=r"pip install 'foreglow\[pandas\]'"):
            run.to_pandas()
    else:
        assert list(run.to_pandas("frames")["frame"]) == [0, 1, 2]


def test_coco_s_results(folder: Path, tmp_path: Path) -> None:
    run = foreglow.read_run(folder)
    run.write_coco(tmp_path / "boxes.json")
    entries = json.loads((tmp_path / "boxes.json").read_text())
    boxes = columns_of(run.sequences, "boxes")
    assert [entry["score"] for entry in entries] == boxes["score"]
    assert [entry["bbox"][0] + entry["bbox"][2] for entry in entries] == boxes["x2_px"]
    assert {entry["image_id"] for entry in entries} <= {0, 1, 2}
