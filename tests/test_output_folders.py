"""A folder for results has one writer at a time, and one kind of results; what is not of them stays."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

from foreglow.datasets import shipped_drive
from foreglow.folder_lock import FolderLock, locked
from foreglow.lab.learning.recipes import recipe, recipe_to_toml
from foreglow.outputs import check_outputs, running
from foreglow.own_folders import KINDS, TRAINING, TUNING, check_no_parts, check_own
from foreglow.runs.folder import OutputFolder
from foreglow.runs.tally import Tally
from foreglow.whole_files import claim_path, write_atomic
from tests.cli.commands import PNG, complaint, foreglow_command
from tests.datasets.tiny_pvdn import make_pvdn
from tests.stand_ins import REFERENCE

FRAME = '{"frame":0,"sequence":"","timestamp_ns":0}\n'


def test_a_folder_is_written_by_one(tmp_path: Path) -> None:
    first = OutputFolder(tmp_path / "out")
    with pytest.raises(ValueError, match="another run is writing into this folder"):
        OutputFolder(tmp_path / "out")
    first.discard()
    OutputFolder(tmp_path / "out").discard()
    assert not (tmp_path / "out").exists()


def test_a_command_and_what_it_calls_share_the_lock(tmp_path: Path) -> None:
    with locked({"--out": tmp_path / "out"}):
        folder = OutputFolder(tmp_path / "out")
        with pytest.raises(ValueError, match="another run"), locked({"--out": tmp_path / "out"}):
            pass
        folder.discard()
    assert not (tmp_path / "out").exists()


@pytest.fixture
def writer(tmp_path: Path) -> Iterator[subprocess.Popen[Any]]:
    code = (
        "import sys, time; from pathlib import Path; from foreglow.folder_lock import FolderLock\n"
        "lock = FolderLock(Path(sys.argv[1])); print('locked', flush=True); time.sleep(60)"
    )
    process = subprocess.Popen([sys.executable, "-c", code, str(tmp_path / "out")], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "locked\n"
    with process:
        yield process
        process.kill()


def test_the_lock_dies_with_its_process(writer: subprocess.Popen[Any], image: Path, tmp_path: Path) -> None:
    assert "another run is writing" in complaint("run", image, "--out", tmp_path / "out")
    writer.kill()
    writer.wait()
    result = foreglow_command("run", image, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.stderr


def test_a_file_is_written_by_one(tmp_path: Path) -> None:
    path = tmp_path / "run.html"
    with locked({}, {"--out": path}):
        with pytest.raises(ValueError, match=r"run\.html: another run is writing this file"), locked({}, {"RUN": path}):
            pass
        with locked({}, {"--out": tmp_path / "another.html"}):
            write_atomic(path, b"whole")  # what clears the folder leaves what is locked
        with pytest.raises(ValueError, match="another run"), locked({}, {"--out": path}):
            pass
    assert list(tmp_path.iterdir()) == [path]


def test_what_a_killed_writer_left_locks_nothing_and_goes(tmp_path: Path) -> None:
    path = tmp_path / "run.html"
    claim_path(path).touch()
    claim_path(tmp_path / "old.html").touch()
    with locked({}, {"--out": path}):
        assert list(tmp_path.iterdir()) == [claim_path(path)]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (("report", "RUN"), "RUN/report.html"),
        (("report", "RUN", "--out", "OUT.html"), "OUT.html"),
        (("stages", "IMAGE", "--out", "OUT.png"), "OUT.png"),
        (("record", "IMAGE", "--out", "OUT.mcap"), "OUT.mcap"),
        (("run", "IMAGE", "--out", "NEW", "--record", "OUT.mcap"), "OUT.mcap"),
    ],
)
def test_a_file_that_another_command_writes_is_refused_before_any_work(
    tmp_path: Path, image: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert foreglow_command("run", image, "--out", "RUN").exit_code == 0
    with locked({}, {"--out": tmp_path / name}):
        assert f"{name}: another run is writing this file" in complaint(
            *(str(image) if word == "IMAGE" else word for word in words)
        )
    assert not Path(name).exists()
    assert not Path("NEW").exists()
    done = foreglow_command(*(str(image) if word == "IMAGE" else word for word in words))
    assert done.exit_code == 0, done.output
    assert not list(tmp_path.rglob(".*.tmp"))


def test_a_report_on_no_run_says_so(tmp_path: Path) -> None:
    assert "gone/frames.jsonl: no such file, expected the folder of a run" in complaint("report", tmp_path / "gone")
    assert not list(tmp_path.iterdir())


def test_empty_folders_go_again(tmp_path: Path) -> None:
    with pytest.raises(KeyError), FolderLock(tmp_path / "a" / "b"):
        raise KeyError
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["overlay.mp4", "frames.jsonl", "beam.png", "report.html"])
def test_a_run_leaves_files_that_only_have_the_name_of_a_result(name: str, image: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / name).write_text("mine")
    refused = f"{out / name}: expected nothing there but earlier results of this command"
    assert refused in complaint("run", image, "--out", out)
    assert {path.name: path.read_text() for path in out.iterdir()} == {name: "mine"}


def test_a_training_leaves_a_model_that_is_not_of_it(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "model.onnx").write_text("mine")
    assert "model.onnx: expected nothing there" in complaint("train", tmp_path / "data", "--out", out)


@pytest.mark.parametrize("name", ["config.toml", "summary.json"])
def test_a_run_leaves_what_is_not_of_a_run(tmp_path: Path, name: str) -> None:
    """Such as the files of a training, or those of another program."""
    (tmp_path / name).write_text("mine")
    with pytest.raises(ValueError, match=f"{name}: expected nothing there but earlier results of this command"):
        OutputFolder(tmp_path)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {name: "mine"}
    (tmp_path / "frames.jsonl").write_text(FRAME)
    OutputFolder(tmp_path).discard()


@pytest.mark.parametrize("name", ["times.jsonl", "config.toml", "summary.json", "overlay.mp4", "report.html"])
@pytest.mark.parametrize("frames", ["", "mine", '{"frame": 1, "label": "mine"}', "[" * 9999, '{"frame": 1'])
def test_a_run_leaves_files_that_are_all_called_like_results(tmp_path: Path, name: str, frames: str) -> None:
    mine = {"frames.jsonl": frames, name: '{"is_complete": true}'}
    for other, text in mine.items():
        (tmp_path / other).write_text(text)
    with pytest.raises(ValueError, match="expected nothing there but earlier results of this command"):
        OutputFolder(tmp_path)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == mine


@pytest.mark.parametrize("mark", [TRAINING, TUNING])
def test_trainings_and_searches_leave_files_that_are_called_like_theirs(tmp_path: Path, mark: str) -> None:
    for name in KINDS[mark].parts:
        (tmp_path / name).write_text("mine = 1\n")
    with pytest.raises(ValueError, match="expected nothing there but earlier results of this command"):
        check_own(tmp_path, mark)


def test_a_training_and_a_search_leave_what_is_not_of_them(tmp_path: Path) -> None:
    data, run = tmp_path / "data", tmp_path / "run"
    run.mkdir()
    (run / "config.toml").write_text("of a run")
    for command in ("train", "tune"):
        complaints = complaint(command, data, "--out", run)
        assert "config.toml: expected nothing there but earlier results of this command" in complaints
    assert (run / "config.toml").read_text() == "of a run"
    data.mkdir()
    assert "expected each data set once" in complaint("train", data, data / ".", "--out", tmp_path / "model")


def test_a_file_in_place_of_a_shared_folder_is_told_with_its_option(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    refused = complaint("train", tmp_path / "data", "--out", tmp_path / "out", "--cache", tmp_path / "file")
    assert f"--cache {tmp_path / 'file'}: expected a folder to write into, got a file" in refused


@pytest.mark.parametrize("command", ["train", "tune"])
def test_a_folder_in_place_of_a_result_is_told(tmp_path: Path, command: str) -> None:
    (tmp_path / "recipe.toml").write_text(recipe_to_toml(recipe("compact")))
    (tmp_path / "config.toml").mkdir()
    out = tmp_path if command == "train" else tmp_path / "search"
    (tmp_path / "search" / "config.toml").mkdir(parents=True)
    refused = complaint(command, tmp_path / "data", "--out", out)
    assert f"{out / 'config.toml'}: expected a file to write, or nothing, got a folder" in refused


@pytest.mark.parametrize(("command", "inner"), [("train", "samples"), ("tune", "frames")])
def test_a_file_in_place_of_a_folder_of_results_is_told(tmp_path: Path, command: str, inner: str) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / inner).write_text("mine")
    refused = complaint(command, tmp_path / "data", "--out", out)
    assert f"{out / inner}: expected a folder to write into, or nothing, got a file" in refused
    assert (out / inner).read_text() == "mine"


@pytest.mark.parametrize("place", [".", "train", "day/val", "night/test"])
@pytest.mark.parametrize("command", ["run", "train", "tune", "evaluate", "experiment glare", "reproduce"])
def test_a_data_set_is_no_folder_for_results(tmp_path: Path, command: str, place: str) -> None:
    """Its split was the input, so that only the folder of all splits could be told from a new one by what it holds."""
    shutil.copytree(shipped_drive(), tmp_path / "set" / place, dirs_exist_ok=True)
    with running(command):
        check_outputs({}, {}, {"--out": tmp_path})  # such as a working folder with data beside
        with pytest.raises(
            ValueError, match=r"--out .*/set: expected another folder for the results than that of a data set"
        ):
            check_outputs({}, {}, {"--out": tmp_path / "set"})
    with running("simulate"), pytest.raises(ValueError, match="this is one") if place == "." else nullcontext():
        check_outputs({}, {}, {"--out": tmp_path / "set"})


@pytest.mark.parametrize(
    ("mark", "text", "part"),
    [
        ("recipe.toml", recipe_to_toml(recipe("compact")), "samples"),
        ("recipe.toml", recipe_to_toml(recipe("compact")), "samples/607ad3e0cf07471f"),
        ("study.journal", '{"op_code":0,"worker_id":"a"}', "frames"),
        ("frames.jsonl", FRAME, "calibration"),
    ],
)
def test_a_part_of_earlier_results_is_no_folder_for_others(tmp_path: Path, mark: str, text: str, part: str) -> None:
    (tmp_path / part).mkdir(parents=True)
    (tmp_path / mark).write_text(text)
    for command in ("train", "tune", "export-yolo"):
        refused = complaint(command, tmp_path / "data", "--out", tmp_path / part)
        assert f"--out {tmp_path / part}: expected a new folder for the results, not a part of {tmp_path}" in refused
    shared = {"--cache": tmp_path / part}
    if mark == TRAINING:
        check_no_parts(shared, is_shared=True)
    else:
        refused = complaint("train", tmp_path / "data", "--out", tmp_path / "new", "--cache", tmp_path / part)
        assert f"--cache {tmp_path / part}: expected a new folder for the results, not a part of {tmp_path}" in refused
    check_no_parts({"--out": tmp_path / "another"})
    (tmp_path / mark).unlink()
    check_no_parts({"--out": tmp_path / part})


def test_the_report_of_an_earlier_run_goes_with_it(tmp_path: Path) -> None:
    for name in ("config.toml", "report.html"):
        (tmp_path / name).touch()
    (tmp_path / "frames.jsonl").write_text(FRAME)
    with OutputFolder(tmp_path) as folder:
        folder.publish(REFERENCE, Tally().summary("images", [], REFERENCE, is_complete=True, dispatch=None))
    assert not (tmp_path / "report.html").exists()


def test_results_of_another_command_stay(tmp_path: Path) -> None:
    """Whatever both commands call their files: a folder has one kind of results."""
    image, run = tmp_path / "a.png", tmp_path / "run"
    image.write_bytes(PNG)
    assert foreglow_command("run", image, "--out", run).exit_code == 0
    before = {path.name: path.read_bytes() for path in run.iterdir()}
    assert json.loads(before["summary.json"])["command"] == "run"
    of_run = f"--out {run}: expected another folder for these results, {run / 'summary.json'} is of `foreglow run`"
    for words in (
        ("demo", image),
        ("evaluate", tmp_path, "--predictions", tmp_path / "other.jsonl"),
        ("evaluate", tmp_path),
        ("experiment", "runtime", tmp_path),
        ("experiment", "time-benefit", tmp_path),
        ("reproduce", tmp_path),
        ("tune", tmp_path),
        ("train", tmp_path),
        ("simulate",),
    ):
        assert of_run in complaint(*words, "--out", run)
    assert {path.name: path.read_bytes() for path in run.iterdir()} == before
    assert foreglow_command("run", image, "--out", run).exit_code == 0


@pytest.mark.parametrize(
    ("name", "text", "writer"),
    [
        ("results.json", '{"made_with": {"command": "experiment runtime"}}', "experiment runtime"),
        ("results.json", '{"made_with": {}}', "experiment"),
        ("frames.jsonl", "", "run"),
        ("recipe.toml", recipe_to_toml(recipe("compact")), "train"),
        ("study.journal", "", "tune"),
        ("plan.json", "[[[[", "experiment glare"),
        ("experiments.json", "{}", "reproduce"),
        ("export.json", '{"data": "", "boxes": "", "size_px": 64, "splits": []}', "export-yolo"),
        ("checksums.json", '{"gt/S00001/seqinfo.ini": [1]}', "export-mot"),
        ("preview.toml", "", "simulate"),
    ],
)
def test_who_wrote_a_folder(name: str, text: str, writer: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    for command in ("beam", "experiment runtime", "train"):
        with running(command):
            if command.startswith(writer) or (command, writer) == ("beam", "run"):
                check_outputs({}, {}, {"--out": tmp_path})
            else:
                with pytest.raises(ValueError, match=f"{name} is of `foreglow {writer}`"):
                    check_outputs({}, {}, {"--out": tmp_path})
    check_outputs({}, {}, {"--out": tmp_path})  # a program of the user's own may know better


RESULTS = ("run", "beam", "live", "demo", "train", "tune", "evaluate", "reproduce", "experiment glare", "yolo-train")
"""Commands with a folder for results."""


@pytest.mark.parametrize("command", [*RESULTS, "export-yolo", "export-mot", "simulate", "import"])
def test_data_sets_take_no_results(command: str, tmp_path: Path) -> None:
    """Nor do their images and labels; `simulate` and `labels import` add splits to them."""
    tiny = make_pvdn(tmp_path / "data")
    data = tiny.parents[1]
    refused = [tiny / "labels", tiny / "labels/new", tiny / "images/S00001"]
    refused += [data, data / "night"] if command not in ("simulate", "import") else []
    refused += [tiny] if command != "import" else []  # whose own check is of the files there
    for path in refused:
        with running(command), pytest.raises(ValueError, match=f"--out {path}: expected a(nother)? folder "):
            check_outputs({}, {}, {"--out": path})
    with running(command):
        check_outputs({}, {}, {"--out": data.with_name("new")})
        check_outputs({}, {}, {"--out": data / "results"})


def test_exports_take_no_results_of_other_commands(image: Path, tmp_path: Path) -> None:
    tiny = make_pvdn(tmp_path / "data")
    run, mot, yolo = (tmp_path / name for name in ("run", "mot", "yolo"))
    assert foreglow_command("run", tiny, "--out", run).exit_code == 0
    assert foreglow_command("export-mot", run, tiny, "--out", mot).exit_code == 0
    assert foreglow_command("export-yolo", tiny.parents[1], "--preset", "paper", "--out", yolo).exit_code == 0
    for folder, writer in ((mot, "export-mot"), (yolo, "export-yolo")):
        for words in (("run", image), ("demo", image), ("live", image), ("evaluate", tiny), ("train", tiny.parents[1])):
            told = complaint(*words, "--out", folder)
            assert f"--out {folder}: expected another folder for these results, " in told
            assert f"is of `foreglow {writer}`" in told
    for part in (mot / "gt", mot / "trackers/foreglow", yolo / "images"):
        assert "expected a new folder for the results, not a part of" in complaint("run", image, "--out", part)


def test_a_file_that_is_only_called_like_that_of_an_export(image: Path, tmp_path: Path) -> None:
    for name in ("export.json", "checksums.json"):
        (tmp_path / name).write_text("mine")
    assert foreglow_command("run", image, "--out", tmp_path).exit_code == 0
    assert (tmp_path / "checksums.json").read_text() == "mine"


@pytest.mark.parametrize("name", ["results.json", "report.md", "config.toml", "range.png"])
@pytest.mark.parametrize("command", ["experiment glare", "evaluate", "reproduce"])
def test_a_report_leaves_files_that_are_not_of_an_earlier_one(command: str, name: str, tmp_path: Path) -> None:
    """Such as the results of another program: what figures and tables are called is not known before the end."""
    (tmp_path / name).write_text('{"accuracy": 0.9}')
    (tmp_path / "notes.txt").touch()
    with running(command):
        with pytest.raises(ValueError, match=f"{name} is of something else"):
            check_outputs({}, {}, {"--out": tmp_path})
        (tmp_path / "results.json").write_text('{"made_with": {}}')
        check_outputs({}, {}, {"--out": tmp_path})


@pytest.mark.parametrize("command", ["experiment distance", "evaluate", "reproduce"])
def test_damaged_results_are_named_and_not_the_figures_beside_them(command: str, tmp_path: Path) -> None:
    for name, text in (("bins.png", "figure"), ("report.html", "page"), ("results.json", '{"made_with": {"comm')):
        (tmp_path / name).write_text(text)
    words = r"results\.json is of something else, or damaged: choose another folder, or remove what is there"
    with running(command), pytest.raises(ValueError, match=words):
        check_outputs({}, {}, {"--out": tmp_path})


def test_a_run_of_ones_own_leaves_the_results_of_another_program(tmp_path: Path) -> None:
    (tmp_path / "results.json").write_text("[0.9]")
    (tmp_path / "times.jsonl").write_text("mine")
    with pytest.raises(ValueError, match=r"times\.jsonl: expected nothing there but earlier results"):
        OutputFolder(tmp_path)


@pytest.mark.parametrize("name", ["plan.json", "experiments.json"])
def test_a_report_leaves_what_is_only_called_like_that_of_an_earlier_one(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text('{"mine": 1}')
    (tmp_path / "zones.csv").write_text("mine")
    command = "experiment glare" if name == "plan.json" else "reproduce"
    with running(command), pytest.raises(ValueError, match=f"{name} is of something else"):
        check_outputs({}, {}, {"--out": tmp_path})


def test_a_folder_whose_run_never_began_is_free_again(tmp_path: Path) -> None:
    """An error in the same line, as of another argument, locked it for the rest of a notebook."""
    OutputFolder(tmp_path / "out")
    with OutputFolder(tmp_path / "out"):
        pass
