"""The table of detectors: which rows there are, what they hold, and that a repeated call changes nothing."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foreglow.config import PRESETS, config_to_toml, preset, read_config
from foreglow.datasets import PVDN
from foreglow.lab.evaluation import Predictions, read_predictions, read_split_labels
from foreglow.lab.learning.annotation import label_boxes
from foreglow.lab.learning.yolo import YoloConfig, train_yolo
from foreglow.lab.studies.detector.page import choose, pictures, write_report
from foreglow.lab.studies.detector.rows import (
    ROWS,
    DetectorPlan,
    Workspace,
    classifier_model,
    missing_reason,
    split_digest,
)
from foreglow.lab.studies.detector.run import DetectorResults, run_experiment
from foreglow.lab.studies.paper_chain import paper_chain
from foreglow.models import model_path
from foreglow.proposals import make_proposer
from foreglow.proposals.reference import ReferenceProposer
from foreglow.whole_files import RemadeWarning
from tests.lab.learning.yolo.fakes import Calls, fake_libreyolo
from tests.lab.studies.detector_data import Trainings, boxes_around, make_data, make_model
from tests.lab.studies.ranged_drives import make_split

pytestmark = pytest.mark.torch

pytest.importorskip("onnx")


@pytest.fixture(autouse=True)
def presets(monkeypatch: pytest.MonkeyPatch) -> None:
    if "foreglow" not in PRESETS:
        monkeypatch.setitem(PRESETS, "foreglow", preset("paper"))


@pytest.fixture
def trainings(monkeypatch: pytest.MonkeyPatch) -> Trainings:
    from foreglow.lab.learning import training_run

    trainings = Trainings()
    monkeypatch.setattr(training_run, "train_model", trainings.train_model)
    return trainings


def given(folder: Path, *names: str) -> dict[str, Path]:
    return {name: make_model(folder / f"{name}.onnx") for name in names}


def without_times(results: DetectorResults) -> dict[str, Any]:
    document = results.to_json()
    for row in document["rows"]:
        if row["reason"] is not None:
            assert row.keys() == {"name", "title", "reason"}, "zeros would be taken for its figures"
            continue
        row["run_time_ms"] = row["load"] = row["examination"]["run_time_ms"] = None
    return document


def test_the_published_weights_run_on_the_boxes_of_the_baseline(tmp_path: Path) -> None:
    plan = DetectorPlan(rows=("published",), given=given(tmp_path, "published"), may_train=False)
    config, _ = classifier_model("published", Workspace(tmp_path, tmp_path / "out", plan))
    assert config.proposals == preset("baseline").proposals != preset("paper").proposals


def test_a_row_of_a_given_model(tmp_path: Path) -> None:
    data = make_data(tmp_path / "data")
    plan = DetectorPlan(rows=("paper", "published"), given=given(tmp_path, "paper"), may_train=False)
    results = run_experiment(data, tmp_path / "out", plan)
    paper, published = results.rows
    assert paper.reason is None
    assert published.reason == "not given (--published FILE.onnx, made by import-weights)"

    # The model accepts every proposal, so everything can be counted by hand.
    dataset = PVDN(data / "test")
    proposer = make_proposer(preset("paper").proposals)
    proposed = {frame.frame: proposer.propose(frame.image).boxes_xyxy_px for frame in dataset}
    num_proposals = sum(map(len, proposed.values()))
    assert num_proposals > 0
    assert paper.num_proposals == paper.num_boxes == num_proposals / 6
    positive = {each: label_boxes(boxes, dataset.keypoints_px(each)) == 1 for each, boxes in proposed.items()}
    quality = paper.examination["quality"]
    assert quality["fp"] == num_proposals - sum(int(each.sum()) for each in positive.values())
    assert paper.ceiling["precision"] == 1.0
    assert paper.ceiling["recall"] == quality["recall"]
    assert paper.num_multiply_adds_frame == paper.num_multiply_adds * num_proposals / 6
    assert 0 < paper.run_time_ms["median"] <= paper.run_time_ms["p99"]
    kept = read_predictions(tmp_path / "out/predictions/paper.json")
    assert {each: boxes.tolist() for each, boxes in kept.boxes_xyxy_px.items()} == {
        each: boxes.tolist() for each, boxes in proposed.items()
    }
    assert paper.note.startswith("given: paper.onnx, SHA-256 ")


def test_rows_are_trained_where_none_is_given(trainings: Trainings, tmp_path: Path) -> None:
    data = make_data(tmp_path / "data")
    plan = DetectorPlan(with_yolo=False, epochs={"paper": 7}, patience=3, seed=5)
    results = run_experiment(data, tmp_path / "out", plan)
    by_name = {row.name: row for row in results.rows}
    assert list(by_name) == list(ROWS)
    trained = [asked["folder"].name for asked in trainings.asked]
    assert trained == ["baseline-small", "baseline", "paper", "compact", "ours"]
    for asked in trainings.asked:
        spec = ROWS[asked["folder"].name]
        assert asked["config"] == spec.configuration
        assert asked["recipe"].network == {"foreglow": "both"}.get(spec.recipe, spec.recipe)
        assert (asked["recipe"].seed, asked["recipe"].patience) == (5, 3)
    assert trainings.asked[0]["recipe"].epochs == 7
    small, baseline = (trainings.asked[index]["config"].proposals for index in (0, 1))
    assert (small.working_size_px, baseline.working_size_px) == ((345, 240), None)
    assert small.model_copy(update={"working_size_px": None}) == baseline
    assert by_name["paper"].note == "network paper, 2 of 7 epochs, best 1, seed 5"
    assert by_name["yolo-small"].reason == by_name["yolo-large"].reason == "left out (--no-yolo)"
    assert {(comparison["row"], comparison["other"]) for comparison in results.comparisons} == {
        ("paper", "baseline"),
        ("compact", "paper"),
        ("ours", "paper"),
        ("ours", "baseline"),
    }


def test_a_repeated_call_measures_nothing_twice(trainings: Trainings, tmp_path: Path) -> None:
    data = make_data(tmp_path / "data")
    plan = DetectorPlan(rows=("paper", "compact"))
    calls: list[tuple[str, int, int]] = []
    first = run_experiment(data, tmp_path / "out", plan, progress=lambda *told: calls.append(told))
    assert calls[-1] == ("compact: images", 6, 6)
    calls.clear()
    again = run_experiment(data, tmp_path / "out", plan, progress=lambda *told: calls.append(told))
    assert calls == []
    assert len(trainings.asked) == 2
    assert again.to_json() == first.to_json()


@pytest.mark.parametrize("name", ["predictions/paper.json", "rows/paper.json"])
@pytest.mark.parametrize("is_cut", [False, True])
def test_a_row_that_is_not_what_was_written_is_made_again(tmp_path: Path, name: str, is_cut: bool) -> None:
    """Its figures and those of its curves would contradict each other."""
    data, out = make_data(tmp_path / "data"), tmp_path / "out"
    plan = DetectorPlan(rows=("paper",), given=given(tmp_path, "paper"), may_train=False)
    first = run_experiment(data, out, plan)
    whole = (out / "predictions/paper.json").read_bytes()
    text = (out / name).read_text()
    place = next(each for each, letter in enumerate(text) if letter in "123" and text[each - 1] in "[ ")
    (out / name).write_text(text[:-30] if is_cut else f"{text[:place]}4{text[place + 1 :]}")
    with pytest.warns(RemadeWarning, match=r"rows/paper\.json: the row kept here is damaged, and is made again"):
        again = run_experiment(data, out, plan)
    assert (out / "predictions/paper.json").read_bytes() == whole
    assert without_times(again) == without_times(first)
    assert run_experiment(data, out, plan).to_json() == again.to_json()


def test_the_same_seed_gives_the_same_table(trainings: Trainings, tmp_path: Path) -> None:
    data = make_data(tmp_path / "data")
    plan = DetectorPlan(rows=("paper", "compact"))
    results = [run_experiment(data, tmp_path / name, plan) for name in ("one", "two")]
    assert len(trainings.asked) == 4
    assert without_times(results[0]) == without_times(results[1])
    json.dumps(results[0].to_json(), allow_nan=False)


def test_another_model_or_other_data_make_a_row_anew(tmp_path: Path) -> None:
    data = make_data(tmp_path / "data")
    plan = DetectorPlan(rows=("paper",), given=given(tmp_path, "paper"))
    (accepting,) = run_experiment(data, tmp_path / "out", plan).rows
    assert accepting.num_boxes > 0
    make_model(tmp_path / "paper.onnx", bias=-1.0)
    (rejecting,) = run_experiment(data, tmp_path / "out", plan).rows
    assert rejecting.num_boxes == 0
    before = split_digest(data / "test")
    label = next((data / "test/labels/keypoints").glob("*.json"))
    label.write_text(label.read_text() + "\n")
    assert split_digest(data / "test") != before
    shutil.copytree(data / "test", tmp_path / "elsewhere")
    image = next((tmp_path / "elsewhere/images").rglob("*.png"))
    assert split_digest(tmp_path / "elsewhere") == split_digest(data / "test")
    content = bytearray(image.read_bytes())
    content[len(content) // 2] ^= 1
    image.write_bytes(content)
    assert split_digest(tmp_path / "elsewhere") != split_digest(data / "test")
    (again,) = run_experiment(data, tmp_path / "out", plan).rows
    assert again.key != rejecting.key


def made_training(tmp_path: Path) -> tuple[Path, Path]:
    """Data, and the folder of a training on them by the row of the paper."""
    data = make_data(tmp_path / "data")
    run_experiment(data, tmp_path / "first", DetectorPlan(rows=("paper",)))
    return data, tmp_path / "first/models/paper"


def test_a_folder_of_a_training_brings_its_own_configuration(trainings: Trainings, tmp_path: Path) -> None:
    data, folder = made_training(tmp_path)
    plan = DetectorPlan(rows=("paper",), given={"paper": folder}, may_train=False)
    (row,) = run_experiment(data, tmp_path / "second", plan).rows
    assert row.note.startswith("network paper, 2 of 300 epochs")
    assert len(trainings.asked) == 1
    with pytest.raises(ValueError, match=r"config\.toml: proposals: expected those of Baseline's preset"):
        DetectorPlan(rows=("baseline",), given={"baseline": folder})
    (folder / "summary.json").write_text("{}")
    with pytest.raises(ValueError, match=r"summary\.json: expected the summary of a training: KeyError"):
        run_experiment(data, tmp_path / "fourth", plan)


@pytest.mark.usefixtures("trainings")
@pytest.mark.parametrize("section", ["classifier", "standing"])
def test_another_configuration_of_a_given_training_makes_its_row_anew(section: str, tmp_path: Path) -> None:
    """The row of the former one was read again."""
    data, folder = made_training(tmp_path)
    plan = DetectorPlan(rows=("paper",), given={"paper": folder}, may_train=False)
    (before,) = run_experiment(data, tmp_path / "out", plan).rows
    used = read_config(folder / "config.toml")
    changes: dict[str, dict[str, Any]] = {"classifier": {"support": 3}, "standing": {"enabled": True}}
    (folder / "config.toml").write_text(config_to_toml(used.changed(section, **changes[section])))
    (after,) = run_experiment(data, tmp_path / "out", plan).rows
    assert after.key != before.key
    moved = folder.rename(tmp_path / "moved")
    plan = DetectorPlan(rows=("paper",), given={"paper": moved}, may_train=False)
    assert run_experiment(data, tmp_path / "out", plan).rows == (after,)


@pytest.mark.usefixtures("trainings")
def test_a_models_file_in_its_trainings_folder_tells_its_boxes(tmp_path: Path) -> None:
    """Only the folder was asked, so that the file was measured on boxes that it does not know."""
    model = made_training(tmp_path)[1] / "model.onnx"
    DetectorPlan(rows=("paper",), given={"paper": model})
    with pytest.raises(ValueError, match=r"config\.toml: proposals: expected those of Baseline's preset"):
        DetectorPlan(rows=("baseline",), given={"baseline": model})
    config = model.with_name("config.toml")
    config.write_text(config_to_toml(read_config(config).changed("proposals", kappa=0.5)))
    with pytest.raises(ValueError, match=r"config\.toml: proposals: expected those of Paper's preset"):
        paper_chain(model)


@pytest.mark.parametrize(
    "name",
    ["scenes.jsonl", "simulation/S00001/frames.jsonl", "simulation/S00001/camera.toml", "labels/sequences.json"],
)
def test_the_digest_of_a_split_is_of_all_that_figures_depend_on(name: str, tmp_path: Path) -> None:
    root = make_split(tmp_path / "data")
    before = split_digest(root)
    content = (root / name).read_bytes()
    (root / name).write_bytes(content + b"\n")
    assert split_digest(root) != before
    (root / name).write_bytes(content)
    (root / "labels" / ".lock").touch()
    assert split_digest(root) == before


def of_network(path: Path, recipe: str) -> Path:
    """A model that says that it is of a recipe's network, whatever it is."""
    import onnx

    model = onnx.load(make_model(path))
    onnx.helper.set_model_props(model, {"recipe": recipe})
    onnx.save(model, path)
    return path


@pytest.mark.parametrize("row", [name for name, spec in ROWS.items() if spec.kind == "classifier"])
def test_a_model_that_says_that_it_is_another_network(row: str, tmp_path: Path) -> None:
    paper = of_network(tmp_path / "paper.onnx", '{"network": "paper"}')
    both = of_network(tmp_path / "both.onnx", '{"network": "both"}')
    compact = of_network(tmp_path / "compact.onnx", '{"network": "compact"}')
    fitting = {"compact": [compact], "ours": [compact, both], "published": []}.get(row, [paper])
    for model in (paper, both, compact):
        if model in fitting:
            DetectorPlan(rows=(row,), given={row: model})
        else:
            words = rf"{model.name}: metadata: recipe: expected .* with {ROWS[row].option}, got '{model.stem}'"
            with pytest.raises(ValueError, match=words):
                DetectorPlan(rows=(row,), given={row: model})
    broken = of_network(tmp_path / "broken.onnx", "[" * 9999)
    with pytest.raises(ValueError, match="metadata: recipe: expected that of a training"):
        DetectorPlan(rows=(row,), given={row: broken})


def test_the_papers_chain_has_the_papers_network(tmp_path: Path) -> None:
    paper_chain(of_network(tmp_path / "paper.onnx", '{"network": "paper"}'))
    with pytest.raises(ValueError, match="expected a network paper with --paper-model, got 'both'"):
        paper_chain(of_network(tmp_path / "both.onnx", '{"network": "both"}'))


def test_a_small_yolo(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    calls = Calls("libreyolo")
    monkeypatch.setitem(sys.modules, "libreyolo", fake_libreyolo(calls))
    data = make_data(tmp_path / "data")
    plan = DetectorPlan(
        rows=("paper", "yolo-small"), given=given(tmp_path, "paper"), yolo_image_size_px=64, device="cpu"
    )
    results = run_experiment(data, tmp_path / "out", plan)
    paper, yolo = results.rows
    assert yolo.note == (
        "libreyolo, size s, 64 px, 3 epochs (paper: 960 px; its repository: 200 epochs from COCO weights), "
        "boxes: preset paper, seed 1"
    )
    assert yolo.ceiling == paper.ceiling
    assert {arguments["device"] for _, arguments in calls.made[1:]} == {"cpu"}  # as its run-time says
    first = next(iter(PVDN(data / "test"))).image
    stages = ReferenceProposer(preset("paper").proposals).stages(first)
    assert stages is not None
    assert paper.image_size_px == stages.blurred.shape[::-1]
    assert yolo.image_size_px == (64, 64)
    assert (yolo.num_parameters, yolo.num_multiply_adds) == (8, 64 * 64 * 6)
    assert (yolo.num_boxes, yolo.num_proposals) == (1, 2)  # scores 0.75 and 0.25 in every image
    (trained,) = calls.trained
    assert trained["seed"] == 1
    plan = DetectorPlan(rows=("yolo-small",), given={"yolo-small": tmp_path / "out/models/yolo-small"}, may_train=False)
    (same,) = run_experiment(data, tmp_path / "other", plan).rows
    assert same.examination == yolo.examination


@pytest.mark.parametrize("is_in_split", [False, True])
def test_a_yolo_of_other_boxes_is_beside_these(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, *, is_in_split: bool
) -> None:
    """Those of the row's preset stood there, whatever it had learnt from."""
    calls = Calls("libreyolo")
    monkeypatch.setitem(sys.modules, "libreyolo", fake_libreyolo(calls))
    data = make_data(tmp_path / "data")
    for split in ("train", "val", "test"):
        dataset = PVDN(data / split)
        for image_id in dataset.frame_ids if is_in_split or split != "test" else ():
            path = dataset.root / "labels/bounding_boxes" / f"{image_id:06d}.json"
            path.parent.mkdir(exist_ok=True)
            path.write_text('{"bounding_boxes": [[0, 0, 319, 239]], "labels": [1]}')
    config = YoloConfig(image_size_px=64, device="cpu")
    train_yolo(data, tmp_path / "run", config)
    plan = DetectorPlan(rows=("yolo-small",), given={"yolo-small": tmp_path / "run"})
    results = run_experiment(data, tmp_path / "out", plan)
    (row,) = results.rows
    if is_in_split:
        assert (row.ceiling["recall"], row.ceiling["fp"]) == (1.0, 2)  # two images without a light
    else:
        assert row.ceiling == {}
    write_report(results, (), tmp_path / "out")


def test_a_yolo_that_cannot_be_used_is_named_before_other_rows_are_made(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "libreyolo", fake_libreyolo(Calls("libreyolo")))
    run = train_yolo(make_data(tmp_path / "data"), tmp_path / "run", YoloConfig(image_size_px=64, device="cpu"))
    given = {"yolo-small": run.folder}
    DetectorPlan(rows=("yolo-small",), given=given)
    whole = run.weights.read_bytes()
    for change, message in ((whole[:-30], "expected a whole checkpoint"), (None, "no such file, expected the weights")):
        run.weights.unlink()
        if change is not None:
            run.weights.write_bytes(change)
        with pytest.raises((ValueError, FileNotFoundError), match=rf"best\.pt: {message}"):
            DetectorPlan(rows=("yolo-small",), given=given)
    run.weights.write_bytes(whole)
    monkeypatch.setitem(sys.modules, "libreyolo", None)
    with pytest.raises(ModuleNotFoundError, match="libreyolo"):
        DetectorPlan(rows=("yolo-small",), given=given)


def test_rows_without_an_f_are_not_compared(tmp_path: Path) -> None:
    """Drives without a light, in which nothing is found; the table was lost with an error."""
    data = make_data(tmp_path / "data")
    for label in (data / "test/labels/keypoints").glob("*.json"):
        label.write_text(json.dumps(json.loads(label.read_text()) | {"annotations": []}))
    models = {name: make_model(tmp_path / f"{name}.onnx", bias=-1.0) for name in ("paper", "compact")}
    results = run_experiment(data, tmp_path / "out", DetectorPlan(rows=("paper", "compact"), given=models))
    assert [row.examination["quality"]["f1"] for row in results.rows] == [None, None]
    assert results.comparisons == ()
    assert "so that only false boxes are judged" in write_report(results, (), tmp_path / "out").read_text()


def test_reasons(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = DetectorPlan(device="cpu")
    monkeypatch.setattr("foreglow.lab.studies.detector.rows.has_library", lambda: False)
    assert missing_reason("yolo-small", plan) == "needs pip install 'foreglow[yolo]'"
    monkeypatch.setattr("foreglow.lab.studies.detector.rows.has_library", lambda: True)
    assert missing_reason("yolo-small", plan) is None
    reason = missing_reason("yolo-large", plan)
    assert reason is not None
    assert reason.startswith("needs a GPU: run there foreglow yolo train DATA --size x")
    assert missing_reason("paper", plan) is None
    off = missing_reason("paper", DetectorPlan(may_train=False))
    assert off == "not given (--paper-model), and nothing is trained (--no-training)"


def test_bad_plans(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="rows: expected some of baseline-small, baseline, paper, published"):
        DetectorPlan(rows=("papers",))
    with pytest.raises(ValueError, match="rows: expected each once"):
        DetectorPlan(rows=("paper", "paper"))
    with pytest.raises(FileNotFoundError, match=r"absent\.onnx: no such model, given with --paper-model"):
        DetectorPlan(given={"paper": tmp_path / "absent.onnx"})
    (tmp_path / "broken.onnx").write_text("nothing of the kind")
    with pytest.raises(ValueError, match=r"broken\.onnx: expected an ONNX model"):
        DetectorPlan(given={"paper": tmp_path / "broken.onnx"})


@pytest.mark.parametrize(
    ("option", "name", "asked"),
    [
        ("--published", "published", {"rows": ("paper", "yolo-small")}),
        ("--our-model", "ours", {"rows": ("paper",)}),
        ("--yolo-small", "yolo-small", {"with_yolo": False}),
        ("--yolo-large", "yolo-large", {"rows": ("paper", "yolo-large"), "with_yolo": False}),
    ],
)
def test_a_model_whose_row_is_not_made_is_no_plan(option: str, name: str, asked: dict[str, Any]) -> None:
    """It was ignored without a word."""
    with pytest.raises(ValueError, match=rf"^{option}: expected its row {name} among those that are made, which are "):
        DetectorPlan(given={name: model_path(Path("foreglow"))}, **asked)


def test_a_missing_split(tmp_path: Path) -> None:
    data = make_data(tmp_path / "data", ("train", "val"))
    with pytest.raises(FileNotFoundError, match="expected the split test"):
        run_experiment(data, tmp_path / "out", DetectorPlan(rows=("paper",)))
    (tmp_path / "folder").mkdir()
    with pytest.raises(FileNotFoundError, match=r"model\.onnx: no such file, expected an ONNX model"):
        DetectorPlan(rows=("paper",), given={"paper": tmp_path / "folder"}, split="val")


def test_best_and_worst_images(tmp_path: Path) -> None:
    dataset = PVDN(make_data(tmp_path / "data") / "test")
    labels = read_split_labels(dataset)
    first, second, empty, *others = dataset.frame_ids
    points = {image_id: dataset.keypoints_px(image_id) for image_id in dataset.frame_ids}
    boxes = {image_id: np.empty((0, 4)) for image_id in dataset.frame_ids}
    boxes[first] = boxes_around(points[first].tolist())  # found
    boxes[second] = boxes_around([[20.0, 20.0], [60.0, 20.0]])  # missed, and two false ones
    boxes[empty] = boxes_around([[20.0, 20.0]])
    predictions = Predictions(boxes, {image_id: np.full(len(found), 0.9) for image_id, found in boxes.items()})
    chosen = choose(labels, predictions)
    assert chosen == ((first, True, 0), (second, False, 2), (others[0], False, 0))

    plan = DetectorPlan(rows=("paper",))
    results = DetectorResults("data", labels, plan, (), {"paper": predictions}, ())
    shown = list(pictures(results, dataset))
    assert [picture.is_found.tolist() for picture in shown] == [[True], [False], [False]]
    assert len(shown[1].result.proposals) == 2
