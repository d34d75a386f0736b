"""`run`: what it prints and where it writes."""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
from pathlib import Path

import av
import pytest

import foreglow
from foreglow.datasets import shipped_drive
from foreglow.inputs import named_by
from foreglow.models import model_path
from foreglow.runs.recorded_run import source_of_run
from foreglow.runs.summary_file import lack_of_run, read_summary
from tests.cli.commands import RESULTS, complaint, foreglow_command, names, num_lines
from tests.datasets.bags.bags import images, make_mcap
from tests.shared_data import shared_file


def test_run_on_a_folder(tmp_path: Path, folder: Path, config: Path) -> None:
    out = tmp_path / "out"
    result = foreglow_command("run", folder, "--out", out, "--preset", "paper", "--config", config)
    assert result.exit_code == 0, result.output
    assert names(out) == RESULTS
    assert num_lines(out) == 3
    assert "3 frames, 3 proposals; " in result.stdout
    assert "the proposals are not classified: no model was given" in result.stdout
    assert f"look in {out}: config.toml, frames.jsonl, summary.json, times.jsonl" in result.stdout
    summary = json.loads((out / "summary.json").read_text())
    assert summary["source"] == str(folder)
    assert summary["is_complete"] is True


@pytest.mark.parametrize("command", ["run", "record"])
def test_images_in_folders_below_are_told(command: str, tmp_path: Path, folder: Path, config: Path) -> None:
    """One image on top was taken for all that there is."""
    options = ("--out", tmp_path / ("out" if command == "run" else "out.mcap"), "--preset", "paper", "--config", config)
    (folder / "notes").mkdir()
    (folder / "notes" / "a.txt").write_text("no image")
    shutil.copytree(folder, folder / ".hidden")
    assert "not read" not in foreglow_command(command, folder, *options).stdout
    for name in ("B", "A", "deep/inside"):
        (folder / name).mkdir(parents=True)
        shutil.copy(folder / "000000.png", folder / name)
    said = foreglow_command(command, folder, *options)
    assert said.exit_code == 0, said.output
    line = f"{folder}: images in folders below it are not read: 'A', 'B', 'deep'; run each by itself"
    assert line in said.stdout.splitlines()
    assert "3 frames" in said.stdout
    for image in folder.glob("*.png"):
        image.unlink()
    said = foreglow_command(command, folder, *options)
    assert said.exit_code == 2
    assert "found none but in folders below it: 'A', 'B', 'deep'; run each by itself" in said.stderr
    assert "not read" not in foreglow_command(command, folder / "A", *options).stdout


def test_our_model_runs_where_nothing_else_is_asked_for(tmp_path: Path, folder: Path) -> None:
    result = foreglow_command("run", folder, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "not classified" not in result.stdout
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["is_classified"] is True
    used = foreglow.read_config(tmp_path / "out" / "config.toml")
    assert used == foreglow.preset("foreglow")


def test_run_on_one_image_with_picture(tmp_path: Path, folder: Path, config: Path) -> None:
    out = tmp_path / "out"
    result = foreglow_command("run", folder / "000000.png", "--out", out, "--config", config, "--video")
    assert result.exit_code == 0, result.output
    assert names(out) == {*RESULTS, "overlay.png"}


def test_run_on_a_folder_with_video_and_on_that_video(tmp_path: Path, folder: Path, config: Path) -> None:
    out = tmp_path / "out"
    assert foreglow_command("run", folder, "--out", out, "--config", config, "--video").exit_code == 0
    assert names(out) == {*RESULTS, "overlay.mp4"}
    with av.open(str(out / "overlay.mp4")) as container:
        assert len(list(container.decode(video=0))) == 3
    again = foreglow_command("run", out / "overlay.mp4", "--out", tmp_path / "again", "--config", config, "--limit", 2)
    assert again.exit_code == 0, again.output
    assert num_lines(tmp_path / "again") == 2


def test_run_again_without_video_removes_the_old_one(tmp_path: Path, folder: Path, config: Path) -> None:
    for options in (["--video"], []):
        assert foreglow_command("run", folder, "--out", tmp_path / "out", "--config", config, *options).exit_code == 0
    assert names(tmp_path / "out") == RESULTS


def test_preset_is_overridden_by_the_file(tmp_path: Path, folder: Path, config: Path) -> None:
    out = tmp_path / "out"
    with config.open("a") as file:
        file.write("gap_px = 7\n")
    assert foreglow_command("run", folder, "--out", out, "--preset", "baseline", "--config", config).exit_code == 0
    used = foreglow.read_config(out / "config.toml").proposals
    assert (used.gap_px, used.kappa, used.backend) == (7, 0.5, "reference")


def test_a_copied_training_runs_with_its_own_model(tmp_path: Path, folder: Path) -> None:
    """Its configuration names the model that it was copied from, which may have been trained anew since."""
    first, copy = tmp_path / "first", tmp_path / "copy"
    first.mkdir()
    shutil.copyfile(model_path(Path("foreglow")), first / "model.onnx")
    (first / "recipe.toml").write_text("")
    (first / "config.toml").write_text(f'[classifier]\nmodel = "{first / "model.onnx"}"\n')
    shutil.copytree(first, copy)
    run = ("run", folder, "--out", tmp_path / "out", "--limit", 1, "--config", copy / "config.toml")
    assert foreglow_command(*run).exit_code == 0
    (first / "model.onnx").write_bytes(b"another")
    line = complaint(*run)
    assert "config.toml: classifier.model: expected the model beside it, as a training's folder has it, got" in line
    assert foreglow_command(*run, "--model", copy / "model.onnx").exit_code == 0


def test_bad_image_among_many(tmp_path: Path, folder: Path, config: Path) -> None:
    (folder / "000001.png").write_text("no image")
    out = tmp_path / "out"
    line = complaint("run", folder, "--out", out, "--config", config)
    assert "000001.png" in line
    assert not out.exists()
    result = foreglow_command("run", folder, "--out", out, "--config", config, "--on-error", "skip", "--video")
    assert result.exit_code == 0, result.output
    assert "1 skipped as unreadable" in result.stdout
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["num_frames"], summary["num_skipped"]) == (2, 1)
    assert "000001.png" in summary["skipped"][0]


def test_a_run_says_that_parts_of_its_recording_are_lost(tmp_path: Path, config: Path) -> None:
    path, out, again = make_mcap(tmp_path / "drive.mcap", images(5)), tmp_path / "out", tmp_path / "again"
    data = path.read_bytes()
    at = data.index(b"zstd", len(data) // 2) + 100
    path.write_bytes(data[:at] + data[at + 50 :])
    result = foreglow_command("run", path, "--out", out, "--config", config, "--on-error", "skip")
    assert result.exit_code == 0, result.output
    assert "any number of frames may be missing: parts of the file could not be read" in result.stdout.splitlines()
    summary = read_summary(out / "summary.json")
    assert summary.num_lost_parts == summary.num_skipped > 0
    apart = tmp_path / "apart"
    result = foreglow_command("run", path, "--out", apart, "--config", config, "--on-error", "skip", "--jobs", 2)
    assert "any number of frames may be missing: parts of the file could not be read" in result.stdout.splitlines()
    assert read_summary(apart / "summary.json").num_lost_parts == summary.num_lost_parts
    lack = lack_of_run(out)
    assert lack is not None
    assert lack.startswith(f"{out}: frames may be missing from the run, its recording is damaged: {path}: byte ")
    make_mcap(path, images(5))
    result = foreglow_command("run", path, "--out", again, "--config", config, "--on-error", "skip")
    assert "may be missing" not in result.stdout
    assert (read_summary(again / "summary.json").num_lost_parts, lack_of_run(again)) == (0, None)


def test_a_source_whose_name_is_no_utf_8_is_found_again(tmp_path: Path, folder: Path, config: Path) -> None:
    moved, out = folder.rename(tmp_path / os.fsdecode(b"night\xff")), tmp_path / "out"
    assert foreglow_command("run", moved, "--out", out, "--config", config).exit_code == 0
    assert json.loads((out / "summary.json").read_text())["source"] == f"file://{tmp_path}/night%FF"
    assert source_of_run(out) == moved
    assert [path for name, path in named_by({"RUN": out}).items() if "source" in name] == [moved]
    assert foreglow_command("run", moved, "--config", config).exit_code == 0
    assert foreglow_command("run", moved, "--config", config).exit_code == 0, "into the same folder beside it"


def test_a_field_that_turns_out_to_be_wrong_is_told_with_its_file(tmp_path: Path, folder: Path) -> None:
    config = tmp_path / "own.toml"
    config.write_text("[proposals]\nregion_xyxy_px = [5000, 0, 5100, 100]\n")
    for command in ("run", "record"):
        line = complaint(command, folder, "--out", tmp_path / "out.mcap", "--config", config)
        assert line.startswith(f"foreglow: {config}: proposals.region_xyxy_px: expected a part of the frame, ")
    config.write_text('[beam]\npolicy = "no:Such"\n')
    for command in ("run", "live"):
        line = complaint(command, folder, "--out", tmp_path / "out", "--config", config)
        assert line.startswith(f"foreglow: {config}: beam.policy: no:Such cannot be imported")


def test_nothing_but_bad_images(tmp_path: Path, folder: Path, config: Path) -> None:
    for path in folder.iterdir():
        path.write_text("no image")
    line = complaint("run", folder, "--out", tmp_path / "out", "--config", config, "--on-error", "skip")
    assert "expected a readable frame" in line
    assert "000000.png" in line
    assert not (tmp_path / "out").exists()


def test_a_bad_source_is_named_once(folder: Path, config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image = folder / "000000.png"
    image.write_text("no image")
    monkeypatch.chdir(folder)
    for name in (image, image.name, f"../{folder.name}/./{image.name}"):
        line = complaint("run", name, "--out", folder / "out", "--config", config, "--on-error", "skip")
        assert "000000.png: expected a readable frame; " in line
        assert line.count("000000.png") == 1


LEAVING = """
import os, tempfile
from foreglow.beam.policy import ForeglowPolicy

class Leaving(ForeglowPolicy):
    def command(self, frame, tracks):
        os.chdir(tempfile.gettempdir())
        return super().command(frame, tracks)

    def reset(self):
        os.chdir(tempfile.gettempdir())
        super().reset()
"""


def test_a_name_that_is_too_long_for_a_folder_beside_it(folder: Path, config: Path, tmp_path: Path) -> None:
    source = folder.rename(tmp_path / ("x" * 250))
    line = complaint("run", source, "--config", config)
    assert "name is too long for that of a folder beside it, _foreglow at the end; name the folder" in line
    assert line.rstrip().endswith("with --out")
    assert foreglow_command("run", source, "--config", config, "--out", tmp_path / "out").exit_code == 0


def test_where_a_plug_in_goes_changes_no_relative_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither those of images, which are read one by one, nor those of results, which appear at the end.

    A live run reads while the plug-in is elsewhere, so that its images may not be relative.
    """
    monkeypatch.chdir(tmp_path)
    importlib.invalidate_caches()
    Path("leaving_policy.py").write_text(LEAVING)
    Path("leaving.toml").write_text('[beam]\npolicy = "leaving_policy:Leaving"\n')
    shutil.copytree(shipped_drive(), "drive")
    options = ("--config", "leaving.toml", "--limit", 3)
    for arguments in (("run", "drive", "--record", "run.mcap"), ("live", shipped_drive(), "--speed", 0)):
        result = foreglow_command(*arguments, *options, "--out", arguments[0])
        assert result.exit_code == 0, result.output
        assert num_lines(tmp_path / str(arguments[0])) == 3
    result = foreglow_command("beam", "run", "--policy", "leaving_policy:Leaving", "--out", "beam")
    assert result.exit_code == 0, result.output
    assert num_lines(tmp_path / "beam") == 3
    assert (tmp_path / "run.mcap").is_file()
    assert Path.cwd() == tmp_path


def test_run_on_the_real_frame_finds_the_published_boxes(tmp_path: Path) -> None:
    frame = shared_file("data/pvdn_frame_047433.png")
    config = tmp_path / "reference.toml"
    config.write_text('[proposals]\nbackend = "reference"\n')
    assert (
        foreglow_command("run", frame, "--out", tmp_path / "out", "--preset", "paper", "--config", config).exit_code
        == 0
    )
    record = json.loads((tmp_path / "out" / "frames.jsonl").read_text())
    assert len(record["proposals_xyxy_px"]) == 7
    assert [706, 482, 738, 508] in record["proposals_xyxy_px"]


def plain_drive(folder: Path) -> tuple[Path, Path]:
    """Some images of the drive that ships, as a user's own without labels, and their calibration."""
    folder.mkdir()
    for image in sorted((shipped_drive() / "images/S00001").iterdir())[60:72]:
        shutil.copy(image, folder)
    return folder, shipped_drive() / "simulation/S00001/camera.toml"


def test_a_calibration_gives_ranges(tmp_path: Path) -> None:
    images, calibration = plain_drive(tmp_path / "images")
    without, out = tmp_path / "without", tmp_path / "out"
    result = foreglow_command("run", images, "--out", without)
    assert "nothing has a range: the camera's calibration is not known (--calibration FILE; " in result.stdout
    result = foreglow_command("run", images, "--out", out, "--calibration", calibration)
    assert result.exit_code == 0, result.output
    assert "nothing has a range" not in result.stdout
    last = [json.loads((folder / "frames.jsonl").read_text().splitlines()[-1]) for folder in (without, out)]
    assert last[0]["ranges_m"] is None
    assert all(track["range_m"] is None for track in last[0]["tracks"])
    assert any(range_m is not None for range_m in last[1]["ranges_m"])
    assert any(track["range_m"] is not None for track in last[1]["tracks"])


def test_bad_vehicle_data(tmp_path: Path) -> None:
    images, calibration = plain_drive(tmp_path / "images")
    run = ("run", images, "--out", tmp_path / "out")
    assert "camera.toml: no such" in complaint(*run, "--calibration", tmp_path / "camera.toml")
    assert "expected poses on it, got none" in complaint(*run, "--map", tmp_path / "road.geojson")
    broken = tmp_path / "broken.toml"
    broken.write_text(calibration.read_text().replace("width_px = 1280", "width_px = 640"))
    line = complaint(*run, "--calibration", broken)
    assert "broken.toml: image: expected the frames' size or its multiple, 1280x960 px, got 640x960 px" in line
    assert not (tmp_path / "out").exists()


def test_a_distortion_that_cannot_be_undone_is_refused_by_every_command(tmp_path: Path) -> None:
    """`run` named no file, and `live` went on in low beam."""
    images, calibration = plain_drive(tmp_path / "images")
    folding, out = tmp_path / "folding.toml", tmp_path / "out"
    folding.write_text(re.sub(r"distortion = \[\s*[^,]+", "distortion = [-3.0", calibration.read_text()))
    image = next(path for path in sorted(images.rglob("*")) if path.is_file())
    for command in (
        ("run", images, "--out", out, "--calibration", folding),
        ("live", images, "--out", out, "--calibration", folding),
        ("calibrate", "check", folding, image, "--out", tmp_path / "check.png"),
    ):
        line = complaint(*command)
        assert "folding.toml: intrinsics.distortion: expected one that can be undone everywhere in the image" in line
    assert names(tmp_path) == {"images", "folding.toml"}


def test_without_a_folder_the_results_are_beside_the_source(folder: Path, config: Path) -> None:
    result = foreglow_command("run", folder, "--config", config)
    assert result.exit_code == 0, result.output
    out = folder.with_name("images_foreglow")
    assert names(out) == RESULTS
    assert f"look in {out}" in result.stdout
    again = foreglow_command("run", f"{folder}/.", "--config", config, "--limit", 2)
    assert again.exit_code == 0, again.output
    assert num_lines(out) == 2, "an earlier run on the same source is replaced"
    line = complaint("run", folder, "--config", config, "--save", out / "frames.jsonl")
    assert f"--save {out / 'frames.jsonl'}: expected a file that does not overwrite a part of {out}" in line
    one_image = foreglow_command("run", folder / "000000.png", "--config", config)
    assert f"look in {folder / '000000_foreglow'}" in one_image.stdout


@pytest.mark.parametrize("there", ["a file", "a folder", "another run"])
def test_what_is_no_earlier_run_is_never_written_over(there: str, folder: Path, config: Path) -> None:
    out = folder.with_name("images_foreglow")
    if there == "a file":
        out.write_text("mine")
    elif there == "a folder":
        out.mkdir()
        (out / "notes.txt").write_text("mine")
    else:
        assert foreglow_command("run", folder / "000000.png", "--config", config, "--out", out).exit_code == 0
    before = sorted((path, path.read_bytes()) for path in folder.parent.rglob("*") if path.is_file())
    line = complaint("run", folder, "--config", config)
    assert f"{out}: expected no folder there" in line
    assert sorted((path, path.read_bytes()) for path in folder.parent.rglob("*") if path.is_file()) == before


def test_nothing_lies_beside_the_root() -> None:
    line = complaint("run", "/")
    assert line == "foreglow: /: nothing lies beside it; name the folder for the results with --out\n"
