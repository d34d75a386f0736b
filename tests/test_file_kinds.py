"""A file that an option names takes the place of nothing but what the same option wrote, whatever it is called."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foreglow import outputs, own_files
from foreglow.datasets import shipped_drive
from foreglow.distance.hypotheses import read_hypotheses
from foreglow.lab.learning.ranges import PRIOR, write_hypotheses
from foreglow.models import BUNDLED, model_path
from foreglow.own_files import FileKind
from foreglow.runs.predictions import Predictions, write_predictions
from foreglow.runs.recorded_run import read_run
from foreglow.whole_files import replaces_only
from tests.cli.commands import complaint, foreglow_command
from tests.datasets.tiny_pvdn import make_pvdn

KINDS = {name: kind for name, kind in vars(own_files).items() if isinstance(kind, FileKind)}
IMAGE = next((shipped_drive() / "images").glob("*/*"))
CAMERA = shipped_drive() / "simulation" / "S00001" / "camera.toml"
MOUNT = ("--mount-forward", 1, "--mount-height", 1)


def done(*words: object) -> None:
    result = foreglow_command(*words)
    assert result.exit_code == 0, result.output


@pytest.fixture(scope="module", name="home")
def fixture_home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run, a split with a report about it, and what the options of the commands write, each called `made_KIND`."""
    pytest.importorskip("matplotlib")
    home = tmp_path_factory.mktemp("home")
    split = make_pvdn(home / "data")
    done("run", split, "--out", home / "run", "--record", home / "made_RECORDING.mcap")
    done("report", home / "run", "--out", home / "made_RUN_PAGE.html")
    done("stages", IMAGE, "--out", home / "made_STAGE_PICTURE.png")
    done("calibrate", "check", CAMERA, IMAGE, "--out", home / "made_CHECK_PICTURE.png")
    done("calibrate", "convert", CAMERA, "--out", home / "made_CALIBRATION.toml", *MOUNT)
    scored = ("evaluate", split, "--predictions", home / "run" / "frames.jsonl")
    done(*scored, "--json", home / "made_QUALITY.json", "--out", home / "report")
    (split / "labels/bounding_boxes").rename(home / "boxes")  # annotate replaces only its own
    done("annotate", split, "--json", home / "made_ANNOTATION.json")
    for name in ("cvat", "cvat-video", "coco", "label-studio"):
        suffix = ".xml" if name.startswith("cvat") else ".json"
        source = split if name != "cvat-video" else shipped_drive()
        done("labels", "export", source, "--format", name, "--out", home / f"made_LABELS-{name}{suffix}")
    guess = ("--run", home / "run", "--format", "label-studio")
    done("labels", "export", split, *guess, "--out", home / "made_LABELS-guess.json")
    write_predictions(home / "made_PREDICTIONS.json", Predictions({1: np.zeros((1, 4))}, {1: np.ones(1)}))
    read_run(home / "run").write_coco(home / "made_COCO_RESULTS.json")
    write_hypotheses(home / "made_RANGE_MODEL.toml", read_hypotheses(PRIOR))
    (home / "made_MODEL.onnx").write_bytes(model_path(Path(BUNDLED)).read_bytes())
    return home


def made(home: Path) -> dict[Path, FileKind]:
    return {path: KINDS[path.stem.partition("-")[0].removeprefix("made_")] for path in home.glob("made_*")}


def test_what_an_option_wrote_it_writes_again(home: Path) -> None:
    for path, kind in made(home).items():
        assert path.suffix in kind.suffixes, path
        assert kind.may_replace(path), path
    done("stages", IMAGE, "--out", home / "made_STAGE_PICTURE.png")
    done("calibrate", "convert", CAMERA, "--out", home / "made_CALIBRATION.toml", *MOUNT)


def test_nothing_else_is_overwritten(home: Path) -> None:
    """Neither what another option wrote nor any file of a folder of results."""
    files = made(home)
    folders = [path for name in ("run", "report", "data") for path in (home / name).rglob("*") if path.is_file()]
    assert len(folders) > 20
    for path in (*files, *folders, model_path(Path(BUNDLED)).with_suffix(".md"), IMAGE, CAMERA):
        replacing = {kind.words for kind in KINDS.values() if kind.may_replace(path)}
        assert replacing == ({files[path].words} if path in files else set()), path


@pytest.mark.parametrize(
    "text",
    ["mine", "{", "{}", '{"mine": 1}', "[1]", "[[", "[" * 9999, "null", "a = 1", "\0", "\x89PNG\r\n", "# \n", "é"],
)
@pytest.mark.parametrize("name", KINDS)
def test_files_of_users_stay(name: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / f"mine{KINDS[name].suffixes[0]}"
    path.write_bytes(text.encode("latin-1"))
    if (name, text) != ("PREDICTIONS", "{}"):  # of no image
        assert not KINDS[name].may_replace(path)
    path.write_bytes(b"")
    assert KINDS[name].may_replace(path)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("CALIBRATION.toml", lambda text: text.replace("position_m", "position_m  ")),
        ("RANGE_MODEL.toml", lambda text: text.replace("box_shares = [", "box_shares = [  # mine")),
        ("RANGE_MODEL.toml", lambda text: text.partition("\n")[2]),
        ("LABELS-cvat.xml", lambda text: text.replace("<task>", "<task>\n<id>7</id>")),
        ("LABELS-cvat.xml", lambda text: text.replace(' points="', ' points="1', 1)),
        ("LABELS-cvat-video.xml", lambda text: text.replace(' points="', ' points="1', 1)),
        ("LABELS-coco.json", lambda text: json.dumps(json.loads(text))),
        ("LABELS-coco.json", lambda text: re.sub(r'"keypoints": \[\s+\d', '"keypoints": [1', text, count=1)),
        ("LABELS-coco.json", lambda text: text.replace("Written by", "By", 1)),
        ("LABELS-label-studio.json", lambda text: text.replace('"x": ', '"x": 1', 1)),
        ("LABELS-label-studio.json", lambda text: json.dumps(json.loads(text)[1:])),
        ("LABELS-guess.json", lambda text: text.replace('"predictions"', '"annotations"', 1)),
        ("LABELS-guess.json", lambda text: text + "\n"),
    ],
)
def test_what_was_corrected_since_stays(name: str, change: Callable[[str], str], home: Path, tmp_path: Path) -> None:
    """A calibration or a model of the ranges by hand, as its comment asks for, and labels in a tool."""
    path, kind = tmp_path / name, KINDS[re.split(r"[-.]", name)[0]]
    before = (home / f"made_{name}").read_text()
    path.write_text(before)
    assert kind.may_replace(path)
    path.write_text(change(before))
    assert path.read_text() != before
    assert not kind.may_replace(path)


@pytest.mark.parametrize("name", ["cvat", "cvat-video", "coco", "label-studio"])
@pytest.mark.parametrize("is_guess", [False, True])
def test_labels_that_were_corrected_are_not_exported_over(
    name: str, is_guess: bool, home: Path, tmp_path: Path
) -> None:
    source = home / "data" / "night" / "val" / "images" / "S00001"
    run = ("--run", tmp_path / "run") if is_guess else ()
    if is_guess:
        done("run", source, "--out", tmp_path / "run")
    path = tmp_path / ("mine.xml" if name.startswith("cvat") else "mine.json")
    words = ("labels", "export", source, "--format", name, "--out", path, *run)
    done(*words)
    written = path.read_bytes()
    done(*words)
    assert path.read_bytes() == written
    others = {"cvat": "cvat-video", "cvat-video": "cvat", "coco": "label-studio", "label-studio": "coco"}
    other = ("labels", "export", source, "--format", others[name], "--out", path, *run)
    assert f"{path}: expected nothing there but labels as {others[name]}, got {name}" in complaint(*other)
    path.write_bytes(changed := re.sub(rb"(\d)(\D*)$", rb"7\1\2", written))
    assert f"{path}: expected nothing there but unchanged labels that Foreglow wrote" in complaint(*words)
    assert path.read_bytes() == changed != written


def test_the_commands_refuse(home: Path, tmp_path: Path) -> None:
    """With one line, before any work; they ended with exit code 0, and the file was lost."""
    split, frames = home / "data" / "night" / "val", home / "run" / "frames.jsonl"
    report = {path: path.read_bytes() for path in (home / "report").iterdir()}
    mine = {suffix: tmp_path / f"mine.{suffix}" for suffix in ("json", "html", "mcap", "rrd", "toml", "png")}
    for path in mine.values():
        path.write_text("mine")
    of_report: Any = (home / "report" / name for name in ("results.json", "curve.png"))
    results, curve = of_report
    for words, paths in (
        (("evaluate", split, "--predictions", frames, "--json"), (results, mine["json"])),
        (("annotate", split, "--json"), (results, mine["json"])),
        (("labels", "export", split, "--format", "coco", "--out"), (results, mine["json"])),
        (("stages", IMAGE, "--out"), (curve, mine["png"])),
        (("calibrate", "check", CAMERA, IMAGE, "--out"), (curve, mine["png"])),
        (("calibrate", "convert", CAMERA, *MOUNT, "--out"), (mine["toml"],)),
        (("report", home / "run", "--out"), (mine["html"],)),
        (("live", IMAGE, "--record"), (mine["mcap"],)),
        (("run", IMAGE, "--out", tmp_path / "new", "--save"), (mine["rrd"],)),
        (("record", IMAGE, "--out"), (mine["mcap"],)),
    ):
        for path in paths:
            assert f"{path}: expected nothing there but" in complaint(*words, path)
    assert {path: path.read_bytes() for path in (home / "report").iterdir()} == report
    assert {path.read_text() for path in mine.values()} == {"mine"}


def test_a_page_in_the_folder_of_another_run(home: Path, tmp_path: Path) -> None:
    page, other = home / "run" / "report.html", tmp_path / "other"
    done("report", home / "run")
    done("report", home / "run", "--out", page)
    done("run", IMAGE, "--out", other)
    assert "does not overwrite a part of" in complaint("report", other, "--out", page)
    (other / "report.html").write_text("mine")
    assert "report.html: expected nothing there but a page about a run" in complaint("report", other)


def test_the_calibration_of_a_run(home: Path) -> None:
    path = home / "run" / "calibration" / "camera.toml"
    path.parent.mkdir()
    path.write_bytes((home / "made_CALIBRATION.toml").read_bytes())
    words = ("calibrate", "convert", CAMERA, "--out", path, *MOUNT)
    assert f"does not overwrite a part of {home / 'run'}" in complaint(*words)
    path.write_text("mine")
    run = ("run", IMAGE.parent, "--out", home / "run", "--calibration", "auto", "--fov", 50)
    assert "camera.toml: expected nothing there but an unchanged calibration" in complaint(*run)
    assert path.read_text() == "mine"


def test_a_file_that_somebody_writes_meanwhile_stays(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A command may take an hour; what is there at its end is not what was looked at in the beginning."""

    def found(path: Path) -> None:
        replaces_only(path)
        path.write_text("notes")

    monkeypatch.setattr(outputs, "replaces_only", found)
    scored = ("evaluate", home / "data" / "night" / "val", "--predictions", home / "run" / "frames.jsonl")
    for words, name in (
        ((*scored, "--json"), "quality.json"),
        (("annotate", home / "data" / "night" / "val", "--json"), "numbers.json"),
        (("labels", "export", home / "data" / "night" / "val", "--format", "coco", "--out"), "labels.json"),
        (("stages", IMAGE, "--out"), "stages.png"),
        (("calibrate", "convert", CAMERA, *MOUNT, "--out"), "camera.toml"),
    ):
        path = tmp_path / name
        others = path.with_name(f"{name}.partial")
        others.write_text("of somebody else")
        kept = path.with_name(f"{path.stem}.1{path.suffix}.partial")
        said = foreglow_command(*words, path)
        assert said.exit_code == 2, (name, said.output)
        assert f"{path}: somebody wrote another file there meanwhile; the new one is in {kept}" in said.stderr
        assert path.read_text() == "notes", name
        assert others.read_text() == "of somebody else", name
        path.unlink()
        kept.rename(path)
        kinds = [kind for kind in KINDS.values() if path.suffix in kind.suffixes]
        assert any(kind.may_replace(path) for kind in kinds), name
