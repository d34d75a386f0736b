"""A path may be given as a text, to whatever is public: some took a `Path` only, and ended in a traceback."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import foreglow
from foreglow.datasets import PVDNWriter
from foreglow.datasets.bags import is_recording
from foreglow.datasets.exchange import LabelSet, check_target, is_labels, read_labels_file, write_labels_file
from foreglow.datasets.pvdn import is_pvdn, is_split
from foreglow.datasets.simulated import SimulatedTruth, has_truth, shares_path
from foreglow.datasets.simulated.light_maps import read_light_map
from foreglow.display.video import Movie, PictureSink, VideoSink
from foreglow.lab.simulation import DatasetConfig, Target, read_scene
from foreglow.runtime import OutputFolder
from foreglow.runtime.can_output import CanLogSink
from foreglow.runtime.live.vehicle_bus import VehicleBus
from foreglow.runtime.ros2.bag import BagRecorder
from tests.test_choices import functions_of, packages

DOCUMENTED = (CanLogSink, BagRecorder, VideoSink, PictureSink, Movie, VehicleBus, read_light_map)
"""What the pages name beside the names that the packages list."""

MADE_BY_US = {
    "DatasetSummary.__init__",
    "OutputFolder.join_parts",
    "RecordedRun.__init__",
    "SequenceTruth.__init__",
    "Target.__init__",  # turns it into a path itself
    "Tuning.__init__",
    "YoloRun.__init__",
}
"""These take paths that we have made; a user gives them none."""


def test_every_public_path_may_be_a_text() -> None:
    public = {
        function.__qualname__: function
        for entry in (
            *DOCUMENTED,
            *(getattr(each, name) for each in packages() for name in getattr(each, "__all__", ())),
        )
        for function in functions_of(entry)
    }
    found = [
        f"{name}: {argument}: {hint}"
        for name, function in public.items()
        for argument, hint in inspect.get_annotations(function).items()
        if "Path" in str(hint) and "str" not in str(hint) and argument != "return" and name not in MADE_BY_US
    ]
    assert found == []


def outcome(call: Callable[[Any], object], path: Path | str) -> str:
    """What a call gives or says, without the object's address."""
    try:
        found = call(path)
    except (OSError, ValueError) as error:
        return f"{type(error).__name__}: {error}"
    for name in ("discard", "close"):
        if hasattr(found, name):
            getattr(found, name)()
            break
    return f"{found}" if isinstance(found, bool | Path) else type(found).__name__


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("results", OutputFolder),
        ("a.xml", is_labels),
        ("a.xml", read_labels_file),
        ("a.xml", lambda path: check_target(path, "cvat")),
        ("a.xml", lambda path: write_labels_file(path, LabelSet(()), "cvat")),
        ("split", is_split),
        ("split", is_pvdn),
        ("drive", is_recording),
        ("split", has_truth),
        ("split", lambda path: shares_path(path, 1)),
        ("split", SimulatedTruth),
        ("map.png", read_light_map),
        ("split", lambda path: PVDNWriter(path, name=path)),
        ("scene.toml", read_scene),
        ("data", lambda path: Target(path, DatasetConfig()).root),
        ("a.mp4", VideoSink),
        ("a.png", PictureSink),
        ("absent", foreglow.open_source),
        ("absent", foreglow.read_run),
        ("absent", foreglow.read_config),
    ],
)
def test_a_text_does_what_its_path_does(
    name: str, call: Callable[[Any], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = []
    for kind in (Path, str):
        folder = tmp_path / kind.__name__
        folder.mkdir()
        monkeypatch.chdir(folder)
        found.append((outcome(call, kind(name)), sorted(path.name for path in folder.iterdir())))
    assert found[0] == found[1]


def test_outputs_that_need_an_extra(tmp_path: Path) -> None:
    pytest.importorskip("can")
    log = CanLogSink(str(tmp_path / "d.asc"))
    log.close()
    assert (tmp_path / "d.asc").is_file()
    mcap = pytest.importorskip("foreglow.runtime.mcap")
    recorder = mcap.McapRecorder(str(tmp_path / "a.mcap"))
    recorder.discard()
    pytest.importorskip("rerun")
    from foreglow.display.viewer import RrdFile
    from foreglow.display.viewer.blueprint import blueprint

    RrdFile(str(tmp_path / "a.rrd"), blueprint(has_lux=False)).discard()


@pytest.mark.torch
def test_what_the_lab_reads(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    from foreglow.lab.learning import import_weights
    from foreglow.lab.learning.yolo import YoloConfig, export_yolo, read_yolo_run, train_yolo

    absent = str(tmp_path / "absent")
    with pytest.raises(FileNotFoundError, match="no such file of weights"):
        import_weights(absent, str(tmp_path / "model.onnx"))
    for call in (
        lambda: export_yolo(absent, str(tmp_path / "export")),
        lambda: read_yolo_run(absent),
        lambda: train_yolo(absent, str(tmp_path / "run"), YoloConfig()),
    ):
        with pytest.raises((FileNotFoundError, ModuleNotFoundError), match=r"absent|libreyolo"):
            call()
