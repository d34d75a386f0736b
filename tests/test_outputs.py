"""Outputs never destroy inputs, whatever these are called and wherever they are named."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from foreglow.folder_lock import locked
from foreglow.outputs import check_outputs
from foreglow.runs.folder import OutputFolder
from foreglow.runs.tally import Tally
from foreglow.whole_files import open_atomic
from tests.cli.commands import complaint, foreglow_command, names
from tests.datasets.tiny_pvdn import make_pvdn
from tests.stand_ins import REFERENCE


def test_an_output_that_is_an_input(tmp_path: Path) -> None:
    read, link, hard = tmp_path / "read", tmp_path / "link", tmp_path / "hard"
    read.touch()
    link.symlink_to(read)
    hard.hardlink_to(read)
    for written in (read, link, hard, tmp_path / "." / "read", tmp_path / "x" / ".." / "read"):
        (tmp_path / "x").mkdir(exist_ok=True)
        with pytest.raises(ValueError, match=r"--out .*expected a file that does not overwrite --config"):
            check_outputs({"--config": read}, {"--out": written}, {})
    check_outputs({"--config": read}, {"--out": tmp_path / "other"}, {})


def test_a_part_of_a_folder_that_is_read(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    (tmp_path / "link").symlink_to(run)
    for name in ("frames.jsonl", "report.html"):
        (run / name).touch()
    for written in (run / "frames.jsonl", tmp_path / "link" / "frames.jsonl"):
        with pytest.raises(ValueError, match="expected a file that does not overwrite a part of RUN"):
            check_outputs({"RUN": run}, {"--out": written}, {})
    check_outputs({"RUN": run}, {"--out": run / "report.html"}, {})
    check_outputs({"RUN": run}, {"--json": run / "new.json"}, {})


def test_no_new_file_in_a_data_set(tmp_path: Path) -> None:
    """The same command would be refused when the file is there."""
    split = make_pvdn(tmp_path / "data")
    for read in (tmp_path / "data", split):
        for written in (read / "new.json", split / "labels" / "new.json", split / "images" / "new.json"):
            with pytest.raises(ValueError, match="expected a file that does not lie in the data set DATA"):
                check_outputs({"DATA": read}, {"--json": written}, {})
    check_outputs({"DATA": tmp_path / "data"}, {"--json": tmp_path / "new.json"}, {})


def test_nothing_lands_in_a_data_set_that_is_not_read(tmp_path: Path) -> None:
    """An image, and the list of sequences, were overwritten."""
    split = make_pvdn(tmp_path / "data")
    for part in ("labels/sequences.json", "labels/new.json", "images/S00003/000001.png", "simulation/x.toml"):
        with pytest.raises(ValueError, match=r"^--out .*: expected a file that does not lie in a data set$"):
            check_outputs({}, {"--out": split / part}, {})
    check_outputs(
        {}, {"--out": split / "x.json", "--report": split / "labels" / "x.html"}, {"the folder": split / "out"}
    )
    (tmp_path / "images").mkdir()  # not beside labels
    check_outputs({}, {"--out": tmp_path / "images" / "x.png"}, {})


@pytest.mark.parametrize("is_there", [False, True])
def test_a_file_and_a_folder_of_one_name(is_there: bool, tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    if is_there:
        path.mkdir()
    with pytest.raises(
        ValueError, match=rf"^--record {path}: expected a file to write, --out is a folder of that name$"
    ):
        check_outputs({}, {"--record": path}, {"--out": path})


def test_a_picture_whose_name_nobody_gave(image: Path) -> None:
    """It has that of the calibration, which may be that of an image of the drive."""
    before = image.read_bytes()
    words = ("calibrate", "auto", image.parent, "--fov", 50, "--out", image.with_suffix(".toml"))
    assert f"--picture {image}: expected a file that does not overwrite a part of SOURCE" in complaint(*words)
    assert image.read_bytes() == before


def test_a_recipe_in_the_folder_of_its_training(tmp_path: Path) -> None:
    (tmp_path / "recipe.toml").touch()
    with pytest.raises(ValueError, match=r"--out .*: expected a folder whose results do not overwrite --recipe-file"):
        check_outputs({"--recipe-file": tmp_path / "recipe.toml"}, {}, {"--out": tmp_path})


@pytest.mark.parametrize("name", ["frames.jsonl", "summary.json", "times.jsonl.partial", "results.json"])
def test_an_output_in_place_of_a_result(tmp_path: Path, name: str) -> None:
    (tmp_path / "link").symlink_to("out")
    for folder in ("out", "link"):
        with pytest.raises(ValueError, match=rf"--save .*{name}: expected another file than the results in --out"):
            check_outputs({}, {"--save": tmp_path / folder / name}, {"--out": tmp_path / "out"})
    check_outputs({}, {"--save": tmp_path / "out" / "all.rrd"}, {"--out": tmp_path / "out"})


def test_a_file_that_is_written_in_parts(tmp_path: Path) -> None:
    read = tmp_path / "a.mcap.partial"
    read.touch()
    with pytest.raises(ValueError, match="overwrite SOURCE"):
        check_outputs({"SOURCE": read}, {"--record": tmp_path / "a.mcap"}, {})


def test_folders(tmp_path: Path) -> None:
    config = tmp_path / "run" / "config.toml"
    config.parent.mkdir()
    config.touch()
    with pytest.raises(ValueError, match=r"--out .*expected another folder for the results than SOURCE"):
        check_outputs({"SOURCE": config.parent}, {}, {"--out": config.parent})
    with pytest.raises(ValueError, match="expected a folder whose results do not overwrite --config"):
        check_outputs({"--config": config}, {}, {"--out": config.parent})
    check_outputs({"--config": config}, {}, {"--out": config.parent / "again"})


def test_what_is_no_file_is_not_replaced(tmp_path: Path) -> None:
    """A file would take the place of the pipe, and root's `--json /dev/stdout` that of the device."""
    pipe, link = tmp_path / "pipe.json", tmp_path / "link.json"
    os.mkfifo(pipe)
    link.symlink_to(pipe)
    for written in (pipe, link, Path("/dev/null"), Path("/dev/foreglow.json")):
        with pytest.raises(ValueError, match=r"--json .*: expected a file to write, got a device, a pipe or a socket"):
            check_outputs({}, {"--json": written}, {})
    with pytest.raises(OSError, match=r"pipe\.json: expected a regular file to overwrite"), open_atomic(pipe):
        pass
    assert pipe.is_fifo()


def test_a_folder_inside_an_input(tmp_path: Path) -> None:
    data, label = tmp_path / "data", r"--out .*expected a new folder for the results, not a part of SOURCE"
    (data / "images").mkdir(parents=True)
    (data / "images" / "a.png").touch()
    with pytest.raises(ValueError, match=label):
        check_outputs({"SOURCE": data}, {}, {"--out": data / "images"})
    check_outputs({"SOURCE": data}, {}, {"--out": data / "out"})
    (data / "out").mkdir()
    check_outputs({"SOURCE": data}, {}, {"--out": data / "out"})
    for name in ("frames.jsonl", "frames.jsonl.partial"):  # an earlier run's
        (data / "out" / name).touch()
        check_outputs({"SOURCE": data}, {}, {"--out": data / "out"})
        (data / "out" / name).unlink()


def test_a_split_of_an_input_is_no_folder_for_results(tmp_path: Path) -> None:
    """Though it has the names of results, those of `simulate`."""
    split = tmp_path / "data" / "test"
    (split / "labels").mkdir(parents=True)
    for name in ("labels/sequences.json", "scenes.jsonl"):
        (split / name).touch()
    with pytest.raises(ValueError, match="expected a new folder for the results, not a part of DATA"):
        check_outputs({"DATA": tmp_path / "data"}, {}, {"--out": split})


def test_no_results_among_the_splits_of_a_data_set(tmp_path: Path) -> None:
    """What `reproduce` and `simulate` write has splits, too, which the next command would find beside the others."""
    data = make_pvdn(tmp_path).parents[1]
    for folder in (data / "x", data / "night" / "x", data / "x" / "deeper"):
        with pytest.raises(ValueError, match=r"--out .*: expected a folder that does not lie in the data set DATA"):
            check_outputs({"DATA": data}, {}, {"--out": folder})
        assert "does not lie in the data set DATA" in complaint("reproduce", data, "--out", folder)
        assert not folder.exists()
    check_outputs({"--images": data}, {}, {"--out": data / "x"})  # such as the working folder, with a data set in it


def test_the_images_of_a_split_are_no_place_for_results(tmp_path: Path) -> None:
    split = make_pvdn(tmp_path)
    for source in (split, split.parents[1], split / "images/S00003"):
        for part in ("images/S00003/out", "images/S00003/deeper/out"):
            with pytest.raises(ValueError, match=r"--out .*expected a new folder for the results, not a part of"):
                check_outputs({"SOURCE": source}, {}, {"--out": split / part})
        with pytest.raises(ValueError, match=r"--out .*: expected a file that does not lie in the data set SOURCE"):
            check_outputs({"SOURCE": source}, {"--out": split / "images/S00003/x.json"}, {})
    for part in ("images/out", "labels/out", "simulation/out"):
        with pytest.raises(ValueError, match=r"--out .*expected a new folder for the results, not a part of"):
            check_outputs({"SOURCE": split}, {}, {"--out": split / part})
    check_outputs({"SOURCE": split}, {"--json": tmp_path / "x.json"}, {"--out": split / "out"})
    check_outputs({"SOURCE": split / "images/S00003"}, {}, {"the folder": split / "images/S00003_foreglow"})


def test_files_that_cannot_be_written_are_told_at_the_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for length in (230, 250, 300):
        with pytest.raises((ValueError, OSError), match="File name too long"):
            check_outputs({}, {"--json": tmp_path / f"{'x' * length}.json"}, {})
    check_outputs({}, {"--json": tmp_path / f"{'x' * 200}.json"}, {})
    for path in (tmp_path / "nodir" / "report.html", tmp_path / "nodir" / "ca.toml"):
        words = f"^--out {path}: No such file or directory: expected a folder {path.parent} "
        with pytest.raises(ValueError, match=words):
            check_outputs({}, {"--out": path}, {})
    for parent in (path.parent, tmp_path):  # which are made for the command
        check_outputs({}, {"--json": path}, {"--out": parent})
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match=r"--out .*: expected a file in a folder, .*file is none"):
        check_outputs({}, {"--out": tmp_path / "file" / "ca.toml"}, {})
    monkeypatch.setattr("os.access", lambda *_: False)
    with pytest.raises(ValueError, match=r"--out .*: Permission denied: expected a folder that one may write into"):
        check_outputs({}, {"--out": tmp_path / "ca.toml"}, {})


def test_a_file_that_cannot_be_written_costs_no_work(image: Path, tmp_path: Path) -> None:
    path = tmp_path / "nodir" / "ca.toml"
    line = complaint("calibrate", "auto", image.parent, "--fov", 50, "--out", path)
    assert line == f"foreglow: --out {path}: No such file or directory: expected a folder {path.parent} that is there\n"
    long = tmp_path / f"{'x' * 240}.json"
    line = complaint("evaluate", tmp_path, "--json", long)
    assert line.startswith(f"foreglow: --json {long}: expected a shorter name")


def test_a_link_to_a_folder_that_is_gone(image: Path, tmp_path: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to("gone")
    for out in (link, link / "out"):
        line = complaint("run", image, "--out", out)
        assert line == f"foreglow: {link}: expected a folder, got a link to gone, which is not there\n"


def test_a_file_of_an_input_folder(tmp_path: Path) -> None:
    labels = tmp_path / "data" / "labels" / "sequences.json"
    labels.parent.mkdir(parents=True)
    for path in (labels, labels.with_name("report.html")):
        path.touch()
    with pytest.raises(ValueError, match="expected a file that does not overwrite a part of SPLIT"):
        check_outputs({"SPLIT": tmp_path / "data"}, {"--json": labels}, {})
    check_outputs({"SPLIT": tmp_path / "data"}, {"--json": tmp_path / "quality.json"}, {})
    check_outputs({"RUN": tmp_path / "data"}, {"--out": labels.with_name("report.html")}, {})


@pytest.mark.parametrize("result", ["frames.jsonl", "overlay.png", "summary.json"])
def test_links_with_the_name_of_an_unfinished_result(result: str, image: Path, tmp_path: Path) -> None:
    before, out = image.read_bytes(), tmp_path / "out"
    (tmp_path / "images").mkdir()
    source = image.rename(tmp_path / "images" / image.name)
    for make in (Path.symlink_to, Path.hardlink_to):
        out.mkdir(exist_ok=True)
        make(out / f"{result}.partial", source)
        assert "overwrite SOURCE" in complaint("run", source, "--out", out)
        run = ("run", source.parent, "--out", out, "--video")
        assert f"{result}.partial: expected nothing there but what an interrupted run left" in complaint(*run)
        assert source.read_bytes() == before
        (out / f"{result}.partial").unlink()
        assert not list(out.iterdir())


def test_a_folder_that_was_replaced(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with locked({"--out": out}), OutputFolder(out) as folder:
        out.rename(tmp_path / "moved")
        out.mkdir()
        with pytest.raises(OSError, match="it was moved or replaced"):
            folder.publish(REFERENCE, Tally().summary("here", [], REFERENCE, is_complete=True, dispatch=None))
        assert not list(out.iterdir())


def test_two_outputs_of_one_file(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"--save .*expected another file than that of --record"):
        check_outputs({}, {"--record": tmp_path / "a", "--save": tmp_path / "b" / ".." / "a"}, {})


@pytest.mark.parametrize("option", ["--record", "--save"])
def test_every_command_checks(option: str, image: Path, tmp_path: Path) -> None:
    before = image.read_bytes()
    assert "overwrite" in complaint("run", image, "--out", tmp_path / "out", option, image)
    assert image.read_bytes() == before


def test_labels_and_configurations_are_inputs_too(image: Path, tmp_path: Path) -> None:
    config = tmp_path / "own.toml"
    config.write_text("[guard]\nneeds_speed = false\n", encoding="utf-8")
    assert "--config" in complaint("run", image, "--out", tmp_path / "out", "--config", config, "--record", config)
    assert "needs_speed" in config.read_text(encoding="utf-8")
    assert "SPLIT" in complaint("evaluate", image, "--json", image)


def test_files_that_a_configuration_names_are_inputs_too(image: Path, tmp_path: Path) -> None:
    config, model = tmp_path / "own.toml", tmp_path / "model.onnx"
    config.write_text(f"[classifier]\nmodel = {str(model)!r}\n", encoding="utf-8")
    model.write_text("a model", encoding="utf-8")
    assert "model.onnx" in complaint("evaluate", image, "--config", config, "--json", model)
    assert model.read_text(encoding="utf-8") == "a model"


@pytest.fixture
def drive(image: Path, tmp_path: Path) -> Path:
    """A folder of two images, of which there is a run in `run`."""
    folder = tmp_path / "drive"
    folder.mkdir()
    for name in ("1.png", "2.png"):
        (folder / name).write_bytes(image.read_bytes())
    result = foreglow_command("run", folder, "--out", tmp_path / "run")
    assert result.exit_code == 0, result.stderr
    return folder


def test_what_a_run_was_made_from_is_an_input_too(drive: Path, tmp_path: Path) -> None:
    run, before = tmp_path / "run", (drive / "1.png").read_bytes()
    written = drive / "1.png"
    refused = f"{written}: expected a file that does not overwrite a part of the source of"
    results = run / "frames.jsonl"
    for words in (
        ("report", run, "--out"),
        ("beam", run, "--out", tmp_path / "beam", "--save"),
        ("evaluate", tmp_path / "new", "--predictions", results, "--json"),
        ("labels", "export", tmp_path / "elsewhere", "--run", run, "--out"),
        ("run", tmp_path / "other", "--config", run / "config.toml", "--out", tmp_path / "new", "--record"),
    ):
        assert refused in complaint(*words, written)
    assert "expected another folder for the results than the source of" in complaint("beam", run, "--out", drive)
    copy = tmp_path / "copy"
    copy.mkdir()
    (copy / "summary.json").write_text(json.dumps({"source": str(run)}))
    assert "a part of the source of the source of" in complaint("report", copy, "--out", written)
    assert written.read_bytes() == before
    assert names(drive) == {"1.png", "2.png"}


def test_files_of_the_configuration_of_a_run_are_inputs_too(drive: Path, tmp_path: Path) -> None:
    run, model = tmp_path / "run", tmp_path / "model.html"
    model.write_text("a model")
    (run / "config.toml").write_text(f"[classifier]\nmodel = {str(model)!r}\n")
    assert "expected a file that does not overwrite" in complaint("report", run, "--out", model)
    assert drive.is_dir()


def test_the_labels_of_a_sequence_and_the_file_of_a_scene_are_inputs_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sequence, labels = tmp_path / "split" / "images" / "S00001", tmp_path / "split" / "labels"
    for folder in (sequence, labels):
        folder.mkdir(parents=True)
    (labels / "sequences.mcap").touch()
    words = ("run", sequence, "--out", tmp_path / "out", "--record", labels / "sequences.mcap")
    assert "does not overwrite a part of the labels of SOURCE" in complaint(*words)
    for name in ("1.png", "2.png"):
        (sequence / name).touch()
    check = ("calibrate", "check", tmp_path / "camera.toml", sequence / "1.png", "--out", sequence / "2.png")
    assert "does not overwrite a part of the sequence of IMAGE" in complaint(*check)
    monkeypatch.chdir(sequence)
    check = ("calibrate", "check", tmp_path / "camera.toml", Path("1.png"), "--out", Path("2.png"))
    assert "does not overwrite a part of the sequence of IMAGE" in complaint(*check)
    scene = tmp_path / "scene.mcap"
    scene.touch()
    assert "does not overwrite SOURCE" in complaint("live", f"simulate:{scene}", "--record", scene)


def test_a_folder_that_nobody_named_overwrites_no_input(image: Path, tmp_path: Path) -> None:
    """`run` makes it beside the source; an earlier run in it may be where the configuration is from."""
    assert foreglow_command("run", image).exit_code == 0
    config = tmp_path / "image_foreglow" / "config.toml"
    before = config.read_bytes()
    assert "expected a folder whose results do not overwrite --config" in complaint("run", image, "--config", config)
    assert config.read_bytes() == before


@pytest.mark.slow
def test_a_file_of_another_kind_is_not_overwritten(image: Path, drive: Path, tmp_path: Path) -> None:
    """It need not be an input: the image beside labels, or anything else of the user's."""
    before, run = image.read_bytes(), tmp_path / "run"
    for words, ending in (
        (("report", run, "--out"), r".html"),
        (("record", drive, "--out"), ".mcap"),
        (("labels", "export", drive, "--out"), ".xml or .json"),
        (("evaluate", drive, "--json"), ".json"),
    ):
        for path in (image, tmp_path / "-", tmp_path / "new", tmp_path / "new.txt"):
            assert f"{path}: expected a file whose name ends with {ending}" in complaint(*words, path)
    assert image.read_bytes() == before
    assert not list(tmp_path.glob("new*"))
    assert foreglow_command("report", run, "--out", tmp_path / "page.html").exit_code == 0
    assert foreglow_command("report", run, "--out", tmp_path / "page.html").exit_code == 0


def test_a_picture_beside_a_calibration_that_is_not_there(image: Path, drive: Path) -> None:
    before = image.read_bytes()
    words = ("calibrate", "auto", drive, "--fov", 50, "--out", image.with_suffix(".toml"))
    assert f"{image}: expected nothing there but a picture of a calibration" in complaint(*words)
    assert image.read_bytes() == before


def test_every_one_of_several_inputs_counts(tmp_path: Path) -> None:
    scenes = [tmp_path / "out" / "scenes.jsonl", tmp_path / "other.toml"]
    scenes[0].parent.mkdir()
    for path in scenes:
        path.touch()
    given = [word for path in scenes for word in ("--scene", path)]
    assert "--scene" in complaint("simulate", "--out", tmp_path / "out", *given)


def test_a_word_is_no_path_even_if_a_folder_has_its_name(
    tmp_path: Path, image: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "paper").mkdir()
    monkeypatch.chdir(tmp_path)
    assert foreglow_command("run", image, "--preset", "paper", "--out", tmp_path / "paper" / "run").exit_code == 0


def test_a_part_of_a_result_that_is_not_read(tmp_path: Path) -> None:
    """`evaluate --predictions RUN/frames.jsonl --json RUN/summary.json` would cost the run."""
    for mark, part in (("frames.jsonl", "summary.json"), ("recipe.toml", "model.onnx")):
        folder = tmp_path / part
        folder.mkdir()
        for name in (mark, part, "results.json", "report.html"):
            (folder / name).touch()
        with pytest.raises(ValueError, match=f"--json .*{part}: expected a file that does not overwrite a part of"):
            check_outputs({}, {"--json": folder / part}, {})
        check_outputs({}, {"--json": folder / "results.json"}, {})
        check_outputs({"RUN": folder}, {"--out": folder / "report.html"}, {})
