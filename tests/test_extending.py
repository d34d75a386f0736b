"""The page on extending: its own examples, in the files and with the lines that it names, do what it says."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import itertools
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import foreglow
import foreglow._native as native
from foreglow.beam import policy_class
from foreglow.config import PipelineConfig, preset, read_config
from foreglow.pipeline import Pipeline
from foreglow.runtime.live.cameras import CameraOptions
from foreglow.runtime.live.opening import SOURCES, open_camera, open_live
from foreglow.types import TrackState
from tests.test_plugins import shipped_frames

PAGE = (Path(__file__).parents[1] / "docs" / "extending.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    """The code blocks of the page in a language."""
    found = re.findall(rf"^( *)```{language}\n(.*?)^ *```$", PAGE, re.MULTILINE | re.DOTALL)
    return [re.sub(rf"^{indent}", "", text, flags=re.MULTILINE) for indent, text in found]


def block(language: str, part: str) -> str:
    """The one block that has `part` in it."""
    (found,) = [text for text in blocks(language) if part in text]
    return found


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, with the page's modules under the names in their first lines."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry])
    for text in blocks("python"):
        name = text.splitlines()[0].removeprefix("# ")
        (tmp_path / name).write_text(text)
        monkeypatch.delitem(sys.modules, name.removesuffix(".py"), raising=False)
    return tmp_path


@pytest.fixture
def config(folder: Path) -> PipelineConfig:
    """The page's configuration file on top of the preset."""
    (folder / "car.toml").write_text(block("toml", "[beam]"))
    return read_config(folder / "car.toml", preset("foreglow"))


def test_policy_tracker_and_estimator(config: PipelineConfig) -> None:
    levels = []
    for result in Pipeline(config).run(shipped_frames(30)):
        assert result.detections is not None
        assert result.ranges is not None
        assert result.tracks is not None
        assert result.beam is not None
        assert set(result.ranges.ranges_m.tolist()) <= {80.0}
        np.testing.assert_array_equal(result.tracks.boxes_xyxy_px, result.detections.accepted_boxes_xyxy_px)
        assert (result.tracks.states == TrackState.CONFIRMED).all()
        if len(result.tracks):
            levels.append(result.beam.levels.max())
    assert levels[-1] == pytest.approx(1 / 3)
    assert max(levels) <= levels[-1]


@pytest.mark.usefixtures("folder")
def test_a_class_in_python() -> None:
    sys.path.append(str(Path.cwd()))
    policy = importlib.import_module("dimmed_beam").DimmedBeam
    results = Pipeline(policy=policy).run(shipped_frames(2))
    assert [result.beam is not None for result in results] == [True, True]


def test_an_entry_point(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    groups = tomllib.loads(block("toml", "entry-points"))["project"]["entry-points"]
    about = folder / "dimmed_beam-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: dimmed-beam\nVersion: 1.0\n")
    lines = [
        f"[{group}]\n" + "".join(f"{name} = {value}\n" for name, value in of.items()) for group, of in groups.items()
    ]
    (about / "entry_points.txt").write_text("".join(lines))
    monkeypatch.syspath_prepend(folder)
    assert policy_class("dimmed").__name__ == "DimmedBeam"


def test_a_camera_source(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (line,) = blocks("text")
    added = ast.literal_eval("{" + line + "}")
    module = f"foreglow.{added['noise'].partition(':')[0]}"
    spec = importlib.util.spec_from_file_location(module, folder / "noise.py")
    assert spec is not None
    assert spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, module, loaded)
    monkeypatch.setattr(sys.modules["foreglow.runtime.live"], "noise", loaded, raising=False)
    spec.loader.exec_module(loaded)
    with pytest.raises(FileNotFoundError):
        open_live("noise:7", CameraOptions())
    monkeypatch.setitem(SOURCES, "noise", added["noise"])
    camera = open_live("noise:7", CameraOptions(rate_hz=500.0))
    first, second = itertools.islice(camera, 2)
    assert first.frame == 0
    assert second.timestamp_ns > first.timestamp_ns
    assert first.image.std() > 0
    again = open_camera("noise:7", CameraOptions(rate_hz=500.0))
    assert again is not None
    assert (next(iter(again)).image == first.image).all()


def test_the_tables_are_where_the_page_says() -> None:
    package = Path(foreglow.__file__).parent
    tables = re.findall(r"`(\w+)` in `([\w/]+\.py)`", PAGE.partition("## Plug-ins")[0])
    assert {"POLICIES", "TRACKERS", "ESTIMATORS", "SOURCES", "STUDIES", "FORMATS"} <= {name for name, _ in tables}
    for name, file in tables:
        text = (package / file).read_text(encoding="utf-8")
        assert re.search(rf"^({name}\b.* = |class {name}\b)", text, re.MULTILINE), f"{file}: {name}"


def test_the_files_of_the_page_are_there() -> None:
    """A file without a folder is beside another of its row."""
    package = Path(foreglow.__file__).parent
    rows = [line for line in PAGE.partition("Smaller changes")[0].splitlines() if line.startswith("| ")]
    for row in rows:
        files = re.findall(r"`([\w/]+\.(?:py|dbc|toml))`", row)
        folders = {package, *((package / file).parent for file in files)}
        for file in (file for file in files if "NAME" not in file):
            assert any((folder / file).exists() for folder in folders), f"{row}: {file}"


@pytest.mark.parametrize(
    ("room", "base", "module"),
    [
        ("beam", "BeamPolicy", "dimmed_beam"),
        ("tracking", "Tracker", "one_frame"),
        ("distance", "RangeEstimator", "fixed_range"),
    ],
)
def test_the_examples_as_part_of_the_package(tmp_path: Path, room: str, base: str, module: str) -> None:
    """A copy of the package has the page's module, and the table's file imports it before all else."""
    copied = shutil.copytree(
        Path(foreglow.__file__).parent, tmp_path / "foreglow", ignore=shutil.ignore_patterns("lab", "shipped_drives")
    )
    text = block("python", f"# {module}.py")
    names = re.findall(r"^from foreglow import (.*)$", text, re.MULTILINE)[0].split(", ")
    others = ", ".join(name for name in names if name != base)
    own = f"from foreglow.{room}.interface import {base}\nfrom foreglow.types import {others}"
    (copied / room / f"{module}.py").write_text(re.sub(r"^from foreglow import .*$", own, text, flags=re.MULTILINE))
    table = copied / room / ("policy.py" if room == "beam" else "__init__.py")
    line = f"import foreglow.{room}.{module}"
    table.write_text(table.read_text().replace("\nfrom foreglow.", f"\n{line}\nfrom foreglow.", 1))
    shutil.copy(native.__file__, copied)
    code = (
        "import sys; from importlib.machinery import BuiltinImporter, FrozenImporter, PathFinder; "
        "sys.meta_path[:] = [BuiltinImporter, FrozenImporter, PathFinder]; "  # no finder of an editable installation
        f"import foreglow.{room}; print(foreglow.__file__, 'foreglow.{room}.{module}' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stdout.split() == [str(copied / "__init__.py"), "True"], done.stderr
