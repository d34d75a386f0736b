"""Labels of images in several folders, beside runs on one of these: the same images are compared, by their paths."""

from __future__ import annotations

import json
import shutil
import warnings
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import foreglow
from foreglow.datasets import open_labelled
from foreglow.runs.frames_file import read_tracks
from foreglow.runs.labels_of_run import labels_of_run
from tests.cli.commands import complaint, foreglow_command
from tests.datasets.tiny_pvdn import make_pvdn

NUMBERS, OTHERS = "{:06d}.png", "a{}.png"
"""How images are called: by numbers, which another folder has, too, or not, so that they are counted."""


def image_at(path: Path, x: int) -> Path:
    """A bright square on dark ground, with its left edge at column `x`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = np.full((72, 160), 8, np.uint8)
    image[30:36, x : x + 6] = 250
    cv2.imwrite(str(path), image)
    return path


def drives(root: Path, pattern: str = NUMBERS, folders: tuple[str, ...] = ("A", "B")) -> tuple[Path, Path]:
    """Folders of four images each in `root`/d, of which no two are alike, and labels of all their lights."""
    images = root / "d"
    lines: list[str] = []
    for number, folder in enumerate(folders):
        for k in range(4):
            name, x = f"{folder}/{pattern.format(k + 1)}".removeprefix("./"), 10 + 13 * number + 35 * k
            image_at(images / name, x)
            point = f'<points label="light" points="{x + 3.5},33.5"/>'
            lines.append(f'<image id="{len(lines)}" name="{name}" width="160" height="72">{point}</image>')
    labels = images / "t.xml"
    labels.write_text(f"<annotations>{''.join(lines)}</annotations>")
    return images, labels


def done(*words: object) -> str:
    result = foreglow_command(*words)
    assert result.exit_code == 0, result.output
    return result.stdout


def run_on(source: Path, out: Path) -> Path:
    done("run", source, "--out", out)
    return out


def compared(labels: Path, run: Path) -> dict[str, Any]:
    """What `evaluate` and `evaluate_split` say alike."""
    figures = run / "figures.json"
    done("evaluate", labels, "--predictions", run / "frames.jsonl", "--threshold", 0, "--json", figures)
    found: dict[str, Any] = json.loads(figures.read_text())
    with warnings.catch_warnings(record=True):
        warnings.simplefilter("always")
        quality = foreglow.evaluate_split(labels, run / "frames.jsonl", 0.0)
    assert (quality.tp, quality.fp, quality.fn) == (found["tp"], found["fp"], found["fn"])
    return found


def all_found(num_images: int = 4) -> dict[str, int]:
    return {"tp": num_images, "fp": 0, "fn": 0, "num_images": num_images, "num_missing": 0, "num_unknown": 0}


@pytest.mark.parametrize("pattern", [NUMBERS, OTHERS])
@pytest.mark.parametrize("folders", [("A", "B"), ("A", "."), ("deep/A", "B", "deep/C")])
def test_a_run_on_one_of_several_folders(folders: tuple[str, ...], pattern: str, tmp_path: Path) -> None:
    """The images of all folders were counted on, and those of the run were taken for others."""
    images, labels = drives(tmp_path, pattern, folders)
    own = tmp_path / "own"
    said = done("labels", "import", labels, "--images", images, "--out", own)
    assert "the images are renumbered" in said
    for number, folder in enumerate(folders):
        run = run_on(images / folder, tmp_path / f"run_{number}")
        for labelled in (own, labels):
            found = compared(labelled, run)
            assert {name: found[name] for name in all_found()} == all_found()
        mot = tmp_path / f"mot_{number}"
        part = (
            f"{own}: 4 of its {4 * len(folders)} images count, those of what the run was made from, {images / folder}"
        )
        assert part in done("export-mot", run, own, "--out", mot).splitlines()
        (truth,) = mot.rglob("gt.txt")
        assert len(truth.read_text().splitlines()) == 4
        with pytest.warns(UserWarning, match=r"4 of its \d+ images count"):
            foreglow.evaluate_split(own, run / "frames.jsonl")


def test_a_folder_alone_wherever_it_lies(tmp_path: Path) -> None:
    """Labels of d/A, named with their folder or not; a run on d/A, and on a copy of another name."""
    images, labels = drives(tmp_path, OTHERS, ("A",))
    flat = tmp_path / "flat.xml"
    flat.write_text(labels.read_text().replace('name="A/', 'name="'))
    done("labels", "import", labels, "--images", images, "--out", tmp_path / "deep")
    said = done("labels", "import", flat, "--images", images / "A", "--out", tmp_path / "flat")
    assert "renumbered" not in said
    shutil.copytree(images / "A", tmp_path / "elsewhere")
    for name, source in (("here", images / "A"), ("there", tmp_path / "elsewhere")):
        run = run_on(source, tmp_path / name)
        for labelled in (tmp_path / "deep", tmp_path / "flat", labels):
            assert compared(labelled, run).items() >= all_found().items()


def test_labels_of_some_images_of_a_folder(tmp_path: Path) -> None:
    """They were counted without those between them."""
    images, labels = drives(tmp_path, OTHERS, ("A",))
    for k in (2, 3):
        image_at(images / f"A/a{k}0.png", 5)
    text = labels.read_text()
    labels.write_text(text.replace(text[text.index("<image") : text.index("</image>") + len("</image>")], ""))
    done("labels", "import", labels, "--images", images, "--out", tmp_path / "own")
    run = run_on(images / "A", tmp_path / "run")
    for labelled in (tmp_path / "own", labels):
        assert compared(labelled, run).items() >= (all_found(3) | {"num_unknown": 3}).items()


def test_a_folder_of_which_there_are_no_labels(tmp_path: Path) -> None:
    images, labels = drives(tmp_path, OTHERS, ("A", "B"))
    for k in range(4):
        image_at(images / f"C/a{k + 1}.png", 17 + 35 * k)
    image_at(images / "a1.png", 3)
    done("labels", "import", labels, "--images", images, "--out", tmp_path / "own")
    for number, source in enumerate((images, images / "C")):
        run = run_on(source, tmp_path / f"run_{number}")
        for labelled in (tmp_path / "own", labels):
            words = f"{labelled}: expected the labels of what {run} was made from, {source}, got others"
            assert words in complaint("evaluate", labelled, "--predictions", run / "frames.jsonl")
            assert words in complaint("export-mot", run, labelled, "--out", tmp_path / "mot")


def test_bitmaps_are_told_apart_by_what_they_show(tmp_path: Path) -> None:
    """They have the same sizes whatever is in them."""
    images, labels = drives(tmp_path, "a{}.bmp", ("A", "B"))
    own = tmp_path / "own"
    done("labels", "import", labels, "--images", images, "--out", own)
    shutil.copytree(images / "B", tmp_path / "elsewhere")
    runs = [run_on(images / "B", tmp_path / "run"), run_on(tmp_path / "elsewhere", tmp_path / "run_elsewhere")]
    for labelled, run in ((own, runs[0]), (labels, runs[0]), (own, runs[1])):
        assert compared(labelled, run).items() >= all_found().items()


def test_folders_whose_images_nothing_tells_apart(tmp_path: Path) -> None:
    """The path tells, or nothing does."""
    images, labels = drives(tmp_path, "a{}.bmp", ("A", "B"))
    for image in (images / "A").iterdir():
        shutil.copy(image, images / "B")
    own = tmp_path / "own"
    done("labels", "import", labels, "--images", images, "--out", own)
    shutil.copytree(images / "B", tmp_path / "elsewhere")
    run = run_on(tmp_path / "elsewhere", tmp_path / "run_elsewhere")
    said = complaint("evaluate", own, "--predictions", run / "frames.jsonl")
    assert f"{own}: expected labels of the folder that {run} was made from, {tmp_path / 'elsewhere'}, got those" in said
    assert "those of A and B, whose images have the same names and sizes; `foreglow labels import` makes" in said


def test_a_sequence_whose_files_are_called_by_other_numbers_than_its_images(tmp_path: Path) -> None:
    """A run on the sequence has the numbers of the labels, and one on a copy those of the files."""
    split = make_pvdn(tmp_path / "data")
    sequence = split / "images" / "S00003"
    path = split / "labels" / "image_annotations.json"
    content = json.loads(path.read_text())
    for record in content["images"]:
        if record["id"] in (11, 12, 13):
            name = f"{24 - record['id']:06d}.png"
            (sequence / record["file_name"]).rename(sequence / f"{name}.new")
            record["file_name"] = name
    for image in sequence.glob("*.new"):
        image.rename(image.with_suffix(""))
    path.write_text(json.dumps(content))
    shutil.copytree(sequence, tmp_path / "copy")
    dataset = open_labelled(split)
    of_sequence = labels_of_run(run_on(sequence, tmp_path / "run"), split, dataset)
    of_copy = labels_of_run(run_on(tmp_path / "copy", tmp_path / "run_copy"), split, dataset)
    assert (of_sequence.ids, set(of_sequence.dataset.frame_ids)) == (None, {11, 12, 13})
    assert of_copy.ids == {11: 13, 12: 12, 13: 11}
    tracks = of_copy.by_image(read_tracks(tmp_path / "run_copy" / "frames.jsonl"))
    assert set(tracks) == {11, 12, 13}


def test_a_split_by_a_relative_path_is_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The names in the digest of a sequence began with that of its folder, or not."""
    split = make_pvdn(tmp_path / "data")
    shutil.copytree(split / "images" / "S00003", tmp_path / "copy")
    run = run_on(tmp_path / "copy", tmp_path / "run")
    monkeypatch.chdir(split.parent)
    assert labels_of_run(run, Path(split.name), open_labelled(split.name)).doubt is None


def test_an_origin_that_is_none_is_refused(tmp_path: Path) -> None:
    images, labels = drives(tmp_path)
    own = tmp_path / "own"
    done("labels", "import", labels, "--images", images, "--out", own)
    run, path = run_on(images / "A", tmp_path / "run"), own / "labels" / "image_annotations.json"
    content = json.loads(path.read_text())
    content["info"]["origin"] = [each["digest"] for each in content["info"]["origin"]]
    path.write_text(json.dumps(content))
    said = complaint("evaluate", own, "--predictions", run / "frames.jsonl")
    assert said.startswith(f"foreglow: {path}: info.origin: 0: ")
    assert "; import the labels again\n" in said


def test_frames_of_a_video_that_are_there_twice(tmp_path: Path) -> None:
    """The second was left out without a word."""
    images, labels = drives(tmp_path)
    video = tmp_path / "a.mp4"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"mp4v"), 18.0, (160, 72))
    for _ in range(6):
        writer.write(np.zeros((72, 160, 3), np.uint8))
    writer.release()
    said = complaint("labels", "import", labels, "--images", video, "--out", tmp_path / "own")
    assert f"{labels}: expected each frame of {video} once, 1 is there twice" in said
    assert images.is_dir()


def test_a_run_on_other_labels(tmp_path: Path) -> None:
    """A file of labels has no digest of its own: labels of other images with the same numbers were taken in silence."""
    _, labels = drives(tmp_path / "a", folders=(".",))
    _, others = drives(tmp_path / "b", folders=(".",))
    run = run_on(labels, tmp_path / "run")
    evaluate = ("--predictions", run / "frames.jsonl", "--threshold", 0)
    doubt = f"nothing tells whether these are labels of what {run} was made from, {labels}"
    assert doubt not in done("evaluate", labels, *evaluate)
    assert f"{others}: {doubt}" in done("evaluate", others, *evaluate)
    assert doubt in complaint("export-mot", run, others, "--out", tmp_path / "mot")
