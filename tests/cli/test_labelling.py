"""`labels` and `suggest`: from a run to a tool, back, and measured."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from foreglow.datasets import open_labelled, shipped_drive
from foreglow.runs.recorded_run import read_run
from tests.cli.commands import complaint, foreglow_command, names, without_digest
from tests.datasets.tiny_pvdn import make_pvdn


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("labelling") / "run"
    result = foreglow_command("run", shipped_drive(), "--out", out, "--limit", 30)
    assert result.exit_code == 0, result.output
    return out


@pytest.mark.slow
@pytest.mark.parametrize(("name", "suffix"), [("cvat", "xml"), ("coco", "json"), ("label-studio", "json")])
def test_a_first_guess_of_suggested_frames(name: str, suffix: str, run: Path, tmp_path: Path) -> None:
    said = foreglow_command("suggest", run, "--frames", 7)
    assert said.exit_code == 0, said.output
    assert f"7 frames: look at {run / 'suggestions.csv'}" in said.stdout
    guess = tmp_path / f"guess.{suffix}"
    assert "expected each run once" in complaint("suggest", run, run / ".")
    options = ("--run", run, "--frames", run / "suggestions.csv", "--format", name)
    result = foreglow_command("labels", "export", shipped_drive(), *options, "--out", guess)
    assert result.exit_code == 0, result.output
    assert "7 images, " in result.stdout
    if name == "label-studio":  # as a person who accepts everything
        tasks = [task | {"annotations": task.pop("predictions")} for task in json.loads(guess.read_text())]
        guess.write_text(json.dumps(tasks))
    own = tmp_path / "own"
    result = foreglow_command("labels", "import", guess, "--images", shipped_drive() / "images", "--out", own)
    assert result.exit_code == 0, result.output
    found = {each.frame: each for results in read_run(run).sequences.values() for each in results}
    labelled = open_labelled(own)
    assert len(labelled) == 7
    for image_id in labelled.frame_ids:
        detections = found[image_id].detections
        assert detections is not None
        boxes = detections.accepted_boxes_xyxy_px
        assert sorted(map(tuple, labelled.keypoints_px(image_id).tolist())) == sorted(
            ((x1 + x2) // 2, (y1 + y2) // 2) for x1, y1, x2, y2 in boxes.tolist()
        )


def test_evaluate_takes_the_files_of_tools(run: Path, tmp_path: Path) -> None:
    split = shipped_drive()
    (tmp_path / "images").symlink_to(split / "images")
    results = []
    for number, suffix in enumerate(("xml", "json")):
        labels = tmp_path / f"labels.{suffix}"
        name = "cvat" if suffix == "xml" else "coco"
        result = foreglow_command("labels", "export", split, "--format", name, "--out", labels)
        assert result.exit_code == 0, result.output
        assert "not taken: 1 x sequence with attributes" in result.stdout
        measured = tmp_path / f"{number}.json"
        done = foreglow_command("evaluate", labels, "--predictions", run / "frames.jsonl", "--json", measured)
        assert done.exit_code == 0, done.output
        results.append(json.loads(measured.read_text()))
    assert (
        foreglow_command(
            "evaluate", split, "--predictions", run / "frames.jsonl", "--json", tmp_path / "own.json"
        ).exit_code
        == 0
    )
    assert results == [json.loads((tmp_path / "own.json").read_text())] * 2


def test_bad_arguments_are_one_line(run: Path, tmp_path: Path) -> None:
    split = make_pvdn(tmp_path)
    out = tmp_path / "a.xml"
    export = ("labels", "export", split, "--out")
    assert "expected one of cvat, cvat-video, coco, label-studio, got 'yolo'" in complaint(
        *export, out, "--format", "yolo"
    )
    assert "expected a name ending in .json for coco" in complaint(*export, out, "--format", "coco")
    listed = tmp_path / "frames.csv"
    listed.write_text("frame\n99\n")
    assert "line 2: frame: expected one of the" in complaint(*export, out, "--frames", listed)
    listed.write_text("sequence,frame\nS00002,5\n")
    assert "line 2: sequence: expected 'S00001' as of frame 5, got 'S00002'" in complaint(
        *export, out, "--frames", listed
    )
    number = next(result.frame for results in read_run(run).sequences.values() for result in results)
    listed.write_text(f"sequence,frame\nelsewhere,{number}\n")
    own = ("labels", "export", shipped_drive(), "--run", run, "--out", out, "--frames", listed)
    assert f"as of frame {number}, got 'elsewhere'" in complaint(*own)
    listed.write_text("frame\n99\n")
    assert "cvat-video has every frame" in complaint(*export, out, "--frames", listed, "--format", "cvat-video")
    assert "was made from, " in complaint(*export, out, "--run", run)
    earlier = shutil.copytree(run, tmp_path / "earlier")
    without_digest(earlier)
    assert "expected the frames of the run, has no frame" in complaint(*export, out, "--run", earlier)
    assert "line 2: frame: expected one of the" in complaint(*export, out, "--run", earlier, "--frames", listed)
    assert not out.exists()
    assert foreglow_command(*export, out).exit_code == 0
    imported = ("labels", "import", out, "--out", tmp_path / "own")
    assert "--images" in complaint(*imported), "they are not beside the file"
    assert "no such folder" in complaint(*imported, "--images", tmp_path / "nothing")
    assert "no such image" in complaint(*imported, "--images", tmp_path)
    assert not (tmp_path / "own/labels/sequences.json").exists()


def test_points_outside_of_their_image(tmp_path: Path) -> None:
    """A light that the edge cuts off may be marked beyond it; one that is nowhere near it is a mistake."""
    split, labels = make_pvdn(tmp_path), tmp_path / "labels.json"
    assert foreglow_command("labels", "export", split, "--format", "coco", "--out", labels).exit_code == 0
    content = json.loads(labels.read_text())
    width_px = content["images"][0]["width"]
    imported = ("labels", "import", labels, "--images", split / "images", "--out")
    for x, name in ((width_px + 3.5, "near"), (50.0 * width_px, "far")):
        content["annotations"][0]["keypoints"][0] = x
        labels.write_text(json.dumps(content))
        if name == "near":
            result = foreglow_command(*imported, tmp_path / name)
            assert result.exit_code == 0, result.output
            assert "; 1 point outside the image\n" in result.stdout
    error = complaint(*imported, tmp_path / "far")
    assert error.startswith(f"foreglow: {labels}: S0000")
    assert f"expected points in or near an image of {width_px}x" in error
    assert not (tmp_path / "far").exists()


def test_a_run_without_a_model_suggests_nothing(folder: Path, config: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert foreglow_command("run", folder, "--config", config, "--preset", "paper", "--out", out).exit_code == 0
    assert "expected those of a model" in complaint("suggest", out)


def test_guesses_are_for_the_frames_of_the_run(tmp_path: Path) -> None:
    """Guesses go by number: where an image is gone, they would all be for the next one."""
    images, out = tmp_path / "images", tmp_path / "guess.xml"
    images.mkdir()
    for number, path in enumerate(sorted((shipped_drive() / "images").rglob("*.jpg"))[40:44]):
        cv2.imwrite(str(images / f"{number}.png"), np.asarray(cv2.imread(str(path)))[::4, ::4])
    (images / "2.png").write_bytes(b"damaged")
    run = tmp_path / "run"
    assert foreglow_command("run", images, "--out", run, "--on-error", "skip").exit_code == 0
    export = ("labels", "export", images, "--run", run, "--out", out)
    assert foreglow_command(*export).exit_code == 0, "what the run skipped is skipped here, too"
    out.unlink()
    first = (images / "0.png").read_bytes()
    (images / "0.png").unlink()
    assert "was made from, " in complaint(*export)
    without_digest(run)
    assert "images: expected the frames of the run, frame 1 is at" in complaint(*export)
    (images / "0.png").write_bytes(first)
    (images / "3.png").unlink()
    assert "images: expected the frames of the run, has no frame 3" in complaint(*export)
    assert not out.exists()


@pytest.mark.parametrize("names", ["frame_{:04d}.png", "DSC{}.png"])
def test_labels_have_the_frames_of_a_run_on_their_folder(tmp_path: Path, names: str) -> None:
    """Whatever the images are called, wherever the count begins, and if only some of them are labelled."""
    images, run, guess, own = (tmp_path / name for name in ("images", "run", "guess.xml", "own"))
    images.mkdir()
    for number, path in enumerate(sorted((shipped_drive() / "images").rglob("*.jpg"))[60:64], start=1):
        cv2.imwrite(str(images / names.format(number)), np.asarray(cv2.imread(str(path)))[::2, ::2])
    listed = tmp_path / "frames.csv"
    result = foreglow_command("run", images, "--out", run)
    assert result.exit_code == 0, result.output
    frames = [result.frame for results in read_run(run).sequences.values() for result in results]
    listed.write_text(f"frame\n{frames[1]}\n{frames[3]}\n")
    export = ("labels", "export", images, "--run", run, "--frames", listed, "--out", guess)
    for words in (export, ("labels", "import", guess, "--images", images, "--out", own)):
        assert foreglow_command(*words).exit_code == 0
    assert open_labelled(own).frame_ids == (frames[1], frames[3])
    quality = tmp_path / "quality.json"
    judged = foreglow_command("evaluate", own, "--predictions", run / "frames.jsonl", "--json", quality)
    assert judged.exit_code == 0
    found = json.loads(quality.read_text())
    assert found["tp"] > 0
    assert (found["fn"], found["fp"], found["num_missing"]) == (0, 0, 0), "what was guessed is what was found"


@pytest.mark.usefixtures("undrawn")
def test_every_reader_of_an_interrupted_run_says_so(run: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut"
    shutil.copytree(run, cut, ignore=shutil.ignore_patterns("suggestions.csv"))
    summary = json.loads((cut / "summary.json").read_text())
    (cut / "summary.json").write_text(json.dumps(summary | {"is_complete": False}))
    lack = f"{cut}: the run was interrupted after 30 frames, what is made from it is incomplete"
    for command in (
        ("report", cut),
        ("suggest", cut, "--frames", 3),
        ("labels", "export", shipped_drive(), "--run", cut, "--out", tmp_path / "guess.xml"),
        ("evaluate", shipped_drive(), "--predictions", cut / "frames.jsonl", "--json", tmp_path / "figures.json"),
    ):
        said = foreglow_command(*command)
        assert said.exit_code == 0, said.output
        assert f"{lack}\n" in said.stdout
    assert "Incomplete: the run was interrupted" in (cut / "report.html").read_text()
    assert json.loads((tmp_path / "figures.json").read_text())["is_complete"] is False
    with pytest.warns(UserWarning, match="interrupted after 30 frames") as caught:
        assert not read_run(cut).summary.is_complete
    assert caught[0].filename == __file__


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("frame", [10050, 99])
def test_every_reader_refuses_a_line_that_the_run_did_not_write(run: Path, frame: int, tmp_path: Path) -> None:
    """Of a later frame of the drive, or of one that it does not have."""
    longer, drive = tmp_path / "longer", shipped_drive()
    shutil.copytree(run, longer, ignore=shutil.ignore_patterns("suggestions.csv", "report.html"))
    frames = longer / "frames.jsonl"
    lines = frames.read_text().splitlines(keepends=True)
    line = json.loads(lines[-1])
    assert frame not in {json.loads(each)["frame"] for each in lines}
    frames.write_text("".join([*lines, f"{json.dumps(line | {'frame': frame})}\n"]))
    before = names(longer)
    for command in (
        ("report", longer),
        ("suggest", longer),
        ("beam", longer, "--out", tmp_path / "beam"),
        ("export-mot", longer, drive, "--out", tmp_path / "mot"),
        ("labels", "export", drive, "--run", longer, "--out", tmp_path / "guess.xml"),
        ("evaluate", drive, "--predictions", frames),
    ):
        assert f"{frames}: expected the frames that the run wrote, by frames_sha256" in complaint(*command)
    assert names(longer) == before
    assert names(tmp_path) == {"longer"}


@pytest.mark.usefixtures("undrawn")
def test_an_evaluated_run_without_a_summary_or_all_of_its_frames(run: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut"
    shutil.copytree(run, cut)
    evaluate = ("evaluate", shipped_drive(), "--predictions", cut / "frames.jsonl", "--out", tmp_path / "report")
    lines = (cut / "frames.jsonl").read_text().splitlines(keepends=True)
    (cut / "frames.jsonl").write_text("".join(lines[:20]))
    assert "frames.jsonl: expected the frames that the run wrote, by frames_sha256" in complaint(*evaluate)
    without_digest(cut)
    assert f"{cut}: 20 of 30 frames are left of the run, what is made" in foreglow_command(*evaluate).stdout
    (cut / "summary.json").unlink()
    assert f"{cut}: no summary.json: the run was not finished, what is made" in foreglow_command(*evaluate).stdout
    assert json.loads((tmp_path / "report/results.json").read_text())["is_complete"] is False
    assert "Incomplete: the predictions are of a run" in (tmp_path / "report/report.md").read_text()
    (tmp_path / "alone.jsonl").write_text("".join(lines))
    said = foreglow_command("evaluate", shipped_drive(), "--predictions", tmp_path / "alone.jsonl")
    assert "incomplete" not in said.stdout


def test_names_that_are_not_utf_8(tmp_path: Path) -> None:
    """One line, or it works; the file of a text cannot hold such a name."""
    images = tmp_path / os.fsdecode(b"night\xff")
    images.mkdir()
    for number, path in enumerate(sorted((shipped_drive() / "images").glob("*/*"))[:2]):
        shutil.copy(path, images / f"{number}{os.fsdecode(bytes([255]))}{path.suffix}")
    run = tmp_path / "run"
    result = foreglow_command("run", images, "--out", run)
    assert result.exit_code == 0, result.output
    for name in ("cvat", "coco", "label-studio"):
        out = tmp_path / f"guess.{'xml' if name == 'cvat' else 'json'}"
        said = complaint("labels", "export", images, "--run", run, "--format", name, "--out", out)
        assert "night?: name of an image: expected a path" in said
        assert "0\\udcff.jpg" in said
        assert not out.exists()
    video = tmp_path / "video.xml"  # names no images
    result = foreglow_command("labels", "export", images, "--run", run, "--format", "cvat-video", "--out", video)
    assert result.exit_code == 0, result.output
    own = tmp_path / "own"
    result = foreglow_command("labels", "import", video, "--images", images, "--out", own)
    assert result.exit_code == 0, result.output
    assert len(open_labelled(own)) == 2
    assert foreglow_command("suggest", run, "--frames", 1).exit_code == 0
    said = complaint("beam", run, "--out", tmp_path / "beam")
    assert "the beam needs the camera's calibration" in said  # so the images were found


def test_suggestions_that_somebody_has_edited_stay(run: Path, tmp_path: Path) -> None:
    runs = [tmp_path / name for name in "ab"]
    for path in runs:
        shutil.copytree(run, path, ignore=shutil.ignore_patterns("suggestions.csv"))
    for _ in range(2):  # the same again is no loss
        assert foreglow_command("suggest", *runs, "--frames", 6).exit_code == 0
    first, second = (path / "suggestions.csv" for path in runs)
    first.unlink()
    lines = second.read_text().splitlines(keepends=True)
    second.write_text("".join(lines[:-1]))
    said = foreglow_command("suggest", *runs, "--frames", 6)
    assert said.exit_code == 2
    assert f"foreglow: {second}: expected nothing there, or the same suggestions" in said.stderr
    assert second.read_text() == "".join(lines[:-1])
    assert not first.exists()


def test_images_without_points_and_doubtful_light_are_counted(tmp_path: Path) -> None:
    images = tmp_path / "images"
    images.mkdir()
    for name in "abc":
        cv2.imwrite(str(images / f"{name}.png"), np.zeros((72, 96), np.uint8))
    point = '<points label="{}" points="5,5"/>'
    for empty, doubtful in ((1, 1), (2, 0), (0, 2)):
        marked = ["", *[point.format("light")] * 2] if empty == 1 else ["", "", point.format("light")]
        marked = [point.format("light")] * 3 if empty == 0 else marked
        marked[-1] += doubtful * point.format("doubtful")
        parts = (
            f'<image id="0" name="{name}.png">{inside}</image>' for name, inside in zip("abc", marked, strict=True)
        )
        (tmp_path / "labels.xml").write_text(f"<annotations>{''.join(parts)}</annotations>")
        result = foreglow_command("labels", "import", tmp_path / "labels.xml", "--out", tmp_path / f"own{empty}")
        assert result.exit_code == 0, result.output
        words = {1: "1 of the images has no point: it teaches", 2: "2 of the images have no point: they teach"}
        assert [word in result.stdout for word in words.values()] == [empty == 1, empty == 2]
        lights = f"{3 - empty} light{'s' if empty < 2 else ''}"
        assert f", {lights}{f', {doubtful} doubtful' if doubtful else ''}\n" in result.stdout


@pytest.mark.slow
def test_a_guess_for_images_of_another_source(run: Path, tmp_path: Path) -> None:
    """Frames of the same number, size and times: nothing but the images themselves tells them apart."""
    moved, other = (Path(shutil.copytree(shipped_drive(), tmp_path / name)) for name in ("moved", "other"))
    frames = tmp_path / "frames.csv"
    frames.write_text(
        "frame\n" + "\n".join(str(result.frame) for result in next(iter(read_run(run).sequences.values())))
    )
    options = ("--run", run, "--frames", frames, "--format", "cvat", "--out", tmp_path / "guess.xml")
    assert foreglow_command("labels", "export", moved, *options).exit_code == 0
    image = next(path for path in (other / "images").rglob("*") if path.is_file())
    cv2.imwrite(str(image), np.asarray(cv2.imread(str(image), cv2.IMREAD_GRAYSCALE)) // 2)
    assert "other: expected what " in complaint("labels", "export", other, *options)
    summary = run / "summary.json"
    before = summary.read_text()
    summary.write_text(json.dumps(json.loads(before) | {"source_digest": None}))  # as of an earlier version
    try:
        said = foreglow_command("labels", "export", other, *options)
    finally:
        summary.write_text(before)
    assert said.exit_code == 0, said.output
    assert said.stdout.startswith(f"{other}: taken for what {run} was made from, which was {shipped_drive()}\n")
