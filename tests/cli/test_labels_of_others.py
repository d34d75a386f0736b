"""Labels and runs, or guesses, that belong to something else: told apart by digests, or refused."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from foreglow.datasets import open_labelled, open_source, shipped_drive
from foreglow.lab.evaluation import evaluate_split
from foreglow.runs.labels_of_run import labels_of_run
from tests.cli.commands import complaint, foreglow_command
from tests.datasets.tiny_pvdn import make_pvdn
from tests.datasets.video.test_video_file import make_video


def test_labels_of_another_video(tmp_path: Path) -> None:
    """Their frames have the same numbers."""
    for name, num_frames in (("a", 10), ("b", 12)):
        make_video(tmp_path / f"{name}.mp4", num_frames=num_frames)
        result = foreglow_command("run", tmp_path / f"{name}.mp4", "--out", tmp_path / name)
        assert result.exit_code == 0, result.output
    guess = tmp_path / "guess.json"
    video = tmp_path / "a.mp4"
    export = ("labels", "export", video, "--run", tmp_path / "a", "--format", "coco", "--out", guess)
    for words in (export, ("labels", "import", guess, "--images", video, "--out", tmp_path / "own")):
        result = foreglow_command(*words)
        assert result.exit_code == 0, result.output
    evaluate = ("evaluate", tmp_path / "own", "--predictions")
    assert foreglow_command(*evaluate, tmp_path / "a" / "frames.jsonl").exit_code == 0
    said = complaint(*evaluate, tmp_path / "b" / "frames.jsonl")
    assert f"{tmp_path / 'own'}: expected the labels of what {tmp_path / 'b'} was made from" in said
    video.rename(tmp_path / "moved.mp4")
    assert foreglow_command(*evaluate, tmp_path / "a" / "frames.jsonl").exit_code == 0


def test_results_of_coco_name_images_by_the_ids_of_its_labels(tmp_path: Path) -> None:
    """Here from 1 on, while the images' names count from 0: all boxes are right, and each is in an image of its own."""
    folder = tmp_path / "images"
    folder.mkdir()
    pictures, lights, boxes = [], [], []
    for number in range(4):
        cv2.imwrite(str(folder / f"{number:06d}.png"), np.zeros((72, 96), np.uint8))
        name = {"file_name": f"{number:06d}.png", "width": 96, "height": 72}
        about = {"image_id": number + 1, "category_id": 1}
        pictures.append({"id": number + 1, **name})
        lights.append({**about, "id": number, "keypoints": [10 * number + 5.5, 20.5, 2]})
        boxes.append({**about, "bbox": [10 * number, 15, 9, 9], "score": 0.9})
    labels, results = folder / "labels.json", tmp_path / "results.json"
    file = {"images": pictures, "categories": [{"id": 1, "name": "light"}], "annotations": lights}
    labels.write_text(json.dumps(file))
    results.write_text(json.dumps(boxes))
    result = foreglow_command("evaluate", labels, "--predictions", results, "--json", tmp_path / "figures.json")
    assert result.exit_code == 0, result.output
    assert f"{results}: its image ids are taken for those in {labels}, not for numbers of frames" in result.stdout
    figures = json.loads((tmp_path / "figures.json").read_text())
    assert (figures["tp"], figures["fp"], figures["num_missing"]) == (4, 0, 0)
    with pytest.warns(UserWarning, match="its image ids are taken for those in"):
        assert evaluate_split(labels, results).f1 == 1.0
    result = foreglow_command("labels", "import", labels, "--out", tmp_path / "own")
    assert f"COCO's results by its ids are compared with {labels} itself" in result.stdout
    doubt = f"{results}: its image ids are taken for numbers of frames, not for those in {labels}, of which"
    result = foreglow_command("evaluate", tmp_path / "own", "--predictions", results)
    assert f"{doubt} {tmp_path / 'own'} is" in result.stdout
    with pytest.warns(UserWarning, match=re.escape(doubt)):
        evaluate_split(tmp_path / "own", results)
    again = tmp_path / "again.json"
    result = foreglow_command("labels", "export", tmp_path / "own", "--format", "coco", "--out", again)
    assert [each["id"] for each in json.loads(again.read_text())["images"]] == [0, 1, 2, 3]  # as a run counts them


def test_labels_of_another_folder(tmp_path: Path) -> None:
    """Labels beside their images, and a set that was imported from them; runs on those, on others, and on a video."""
    runs = {}
    for name, contrast in (("a", 200), ("b", 40)):
        folder = tmp_path / name / "images"
        folder.mkdir(parents=True)
        for number in range(3):
            noise = np.random.default_rng(number).integers(0, contrast, (72, 96), np.uint8)
            cv2.imwrite(str(folder / f"{number:03d}.png"), noise)
        runs[folder] = tmp_path / f"run_{name}"
    runs[make_video(tmp_path / "c.mp4", num_frames=3)] = tmp_path / "run_c"
    for source, out in runs.items():
        result = foreglow_command("run", source, "--out", out)
        assert result.exit_code == 0, result.output
    images, labels = tmp_path / "a" / "images", tmp_path / "a" / "labels.xml"
    result = foreglow_command("labels", "export", images, "--run", runs[images], "--out", labels)
    assert result.exit_code == 0, result.output
    result = foreglow_command("labels", "import", labels, "--out", tmp_path / "own")
    assert result.exit_code == 0, result.output
    own, video, other = tmp_path / "own", tmp_path / "run_c", tmp_path / "run_b"
    for labelled in (labels, own):
        evaluate = ("evaluate", labelled, "--predictions")
        said = foreglow_command(*evaluate, runs[images] / "frames.jsonl")
        assert said.exit_code == 0, said.output
        assert "nothing tells" not in said.stdout
        assert f"expected the labels of what {other} was made from" in complaint(*evaluate, other / "frames.jsonl")
    beside = foreglow_command("evaluate", labels, "--predictions", video / "frames.jsonl")
    doubt = f"{labels}: nothing tells whether these are labels of what {video} was made from, {tmp_path / 'c.mp4'}"
    assert f"{doubt}\n" in beside.stdout
    assert "expected the labels of" in complaint("evaluate", own, "--predictions", video / "frames.jsonl")


def test_labels_that_know_no_origin(tmp_path: Path) -> None:
    """Those of PVDN beside runs on plain folders: a copy of a sequence, other images, and images of another size."""
    split = make_pvdn(tmp_path / "data")
    sequence = next((split / "images").iterdir())
    shutil.copytree(sequence, tmp_path / "copy")
    for name, scale in (("other", 1), ("large", 2)):
        (tmp_path / name).mkdir()
        for image in sequence.glob("*.png"):
            frame = next(iter(open_source(image)))
            size_px = scale * frame.height_px, scale * frame.width_px
            noise = np.random.default_rng(0).integers(0, 99, size_px, np.uint8)
            cv2.imwrite(str(tmp_path / name / image.name), noise)
    for name in ("copy", "other", "large"):
        result = foreglow_command("run", tmp_path / name, "--out", tmp_path / f"run_{name}")
        assert result.exit_code == 0, result.output
    dataset = open_labelled(split)
    assert labels_of_run(tmp_path / "run_copy", split, dataset).doubt is None
    assert labels_of_run(tmp_path / "run_copy", sequence, open_labelled(sequence)).lines == ()
    doubt = labels_of_run(tmp_path / "run_other", split, dataset).doubt
    assert doubt == (
        f"{split}: nothing tells whether these are labels of what {tmp_path / 'run_other'} was made from, "
        f"{tmp_path / 'other'}"
    )
    with pytest.raises(ValueError, match=r"expected the labels of what .*run_large was made from"):
        labels_of_run(tmp_path / "run_large", split, dataset)
    export = ("export-mot", tmp_path / "run_other", split, "--out", tmp_path / "mot")
    assert complaint(*export) == f"foreglow: {doubt}; expected a run on {split}\n"
    assert not (tmp_path / "mot").exists()


def test_labels_that_state_another_size_than_their_images(tmp_path: Path) -> None:
    split = make_pvdn(tmp_path / "day")
    run, sizes = tmp_path / "run", split / "labels" / "image_annotations.json"
    assert foreglow_command("run", split, "--out", run).exit_code == 0
    file = json.loads(sizes.read_text())
    for image in file["images"]:
        image["width"], image["height"] = 2 * image["width"], 2 * image["height"]
    sizes.write_text(json.dumps(file))
    said = complaint("evaluate", split, "--predictions", run / "frames.jsonl")
    assert said == f"foreglow: {split}: image size: expected 96x72 px as {run} has, got 192x144 px\n"


def test_labels_whose_times_were_changed_since_the_run(tmp_path: Path) -> None:
    split, run = make_pvdn(tmp_path / "day"), tmp_path / "run"
    path = split / "labels" / "image_annotations.json"
    file = json.loads(path.read_text())
    assert foreglow_command("run", split, "--out", run).exit_code == 0
    evaluate = ("evaluate", split, "--predictions", run / "frames.jsonl")
    assert foreglow_command(*evaluate).exit_code == 0
    file["info"]["rate_hz"] = 5
    for image in file["images"]:
        image["timestamp"] = None
    path.write_text(json.dumps(file))
    said = complaint(*evaluate)
    assert re.search(
        rf"^foreglow: {split}: image \d+: expected 0\.056 s after image \d+, as in {run}, got 0\.200 s", said
    )
    assert complaint("export-mot", run, split, "--out", tmp_path / "mot") == said


def test_suggestions_of_another_run(tmp_path: Path) -> None:
    """Those of a second run on the same video are of the same frames."""
    videos = {name: make_video(tmp_path / f"{name}.mp4", num_frames=num) for name, num in (("a", 10), ("b", 12))}
    for name, out in (("a", "a"), ("a", "again"), ("b", "b")):
        for words in (("run", videos[name], "--out", tmp_path / out), ("suggest", tmp_path / out, "--frames", 3)):
            result = foreglow_command(*words)
            assert result.exit_code == 0, result.output
    export = ("labels", "export", videos["a"], "--run", tmp_path / "a", "--out", tmp_path / "guess.xml", "--frames")
    for out in ("a", "again"):
        result = foreglow_command(*export, tmp_path / out / "suggestions.csv")
        assert result.exit_code == 0, result.output
    others = tmp_path / "b" / "suggestions.csv"
    expected = f"{others}: expected frames of {tmp_path / 'a'}, got those of another run, on {videos['b']}"
    assert expected in complaint(*export, others)


def test_frames_that_a_run_left_out_do_not_shift_those_of_a_video(tmp_path: Path) -> None:
    """`cvat-video` counts frames: behind one that was skipped, each would have the light of the next."""
    images = tmp_path / "images"
    images.mkdir()
    for path in sorted((shipped_drive() / "images").glob("*/*"))[:4]:
        shutil.copy(path, images)
    bad = sorted(images.iterdir())[1]
    bad.write_bytes(bad.read_bytes()[:200])
    run, guess = tmp_path / "run", tmp_path / "guess.xml"
    for limit, number in ((1, 1), (3, 3)):
        options = ("--out", run, "--on-error", "skip", "--limit", limit)
        assert foreglow_command("run", images, *options).exit_code == 0
        export = ("labels", "export", images, "--run", run, "--out", guess, "--format")
        if limit > 1:
            said = complaint(*export, "cvat-video")
            assert (
                f"{images}: expected every frame of a drive for cvat-video, the run has 1 of the 2 before frame" in said
            )
        result = foreglow_command(*export, "cvat" if limit > 1 else "cvat-video")
        assert result.exit_code == 0, result.output
        assert f"{number} image" in result.stdout
        guess.unlink()


def test_evaluate_says_which_labels_of_a_tool_it_does_not_take(tmp_path: Path) -> None:
    """Half of the lights have another label, which nobody finds in the figures."""
    split = make_pvdn(tmp_path)
    labels, predictions = split / "images" / "labels.xml", tmp_path / "boxes.json"
    assert foreglow_command("labels", "export", split, "--out", tmp_path / "a.xml").exit_code == 0
    labels.write_text((tmp_path / "a.xml").read_text().replace('label="light"', 'label="headlight"', 1))
    predictions.write_text(json.dumps({"5": {"boxes": [[0, 0, 9, 9]], "scores": [0.9]}}))
    lost = "not taken: 1 x shape labelled 'headlight'"
    result = foreglow_command("evaluate", labels, "--predictions", predictions, "--out", tmp_path / "report")
    assert result.exit_code == 0, result.output
    assert lost in result.stdout
    assert lost in (tmp_path / "report" / "report.md").read_text()
    with pytest.warns(UserWarning, match="not taken: 1 x shape labelled 'headlight'"):
        evaluate_split(labels, predictions)


def test_lights_of_unknown_vehicles_are_counted(tmp_path: Path) -> None:
    split, labels = make_pvdn(tmp_path), tmp_path / "labels.xml"
    assert foreglow_command("labels", "export", split, "--out", labels).exit_code == 0
    text = re.sub(r' *<attribute name="[io]id">\d+</attribute>\n', "", labels.read_text(), count=4)
    labels.write_text(text)
    result = foreglow_command("labels", "import", labels, "--images", split / "images", "--out", tmp_path / "own")
    assert result.exit_code == 0, result.output
    assert "1 of 3 lights have neither oid nor iid: each is of a vehicle of its own" in result.stdout
    assert "no light is marked as direct" not in result.stdout
    labels.write_text(text.replace(">true<", ">false<"))
    result = foreglow_command("labels", "import", labels, "--images", split / "images", "--out", tmp_path / "other")
    assert result.exit_code == 0, result.output
    assert "no light is marked as direct: all of it is learnt as light that lamps throw" in result.stdout
