"""Training and prediction through stand-ins of the libraries, and once through libreyolo where it is installed."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("torch")

import torch

from foreglow.datasets import PVDN
from foreglow.lab.evaluation import read_predictions
from foreglow.lab.learning.yolo import YoloConfig, export_yolo, predict_yolo, read_yolo_run, train_yolo
from foreglow.lab.learning.yolo.backends import BACKENDS, MIN_SCORE, count_multiply_adds
from foreglow.lab.learning.yolo.run import detect_in_frame
from foreglow.runs.predictions import write_predictions
from foreglow.types import Frame
from tests.lab.learning.yolo.fakes import BOXES, SCORES, Calls, fake_libreyolo, fake_ultralytics, small_network
from tests.lab.learning.yolo.night_data import HEIGHT_PX, WIDTH_PX, make_night_data

pytestmark = pytest.mark.torch

FAKES: dict[str, Callable[[Calls], ModuleType]] = {"libreyolo": fake_libreyolo, "ultralytics": fake_ultralytics}


def config(backend: str = "libreyolo", **fields: Any) -> YoloConfig:
    return YoloConfig.model_validate({"backend": backend, "image_size_px": 64, "device": "cpu", **fields})


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return make_night_data(tmp_path / "data", num_images=2)


@pytest.fixture(params=FAKES)
def calls(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Calls:
    calls = Calls(request.param)
    monkeypatch.setitem(sys.modules, request.param, FAKES[request.param](calls))
    return calls


def test_every_back_end_has_a_stand_in() -> None:
    assert FAKES.keys() == BACKENDS.keys()


def test_train_and_predict(calls: Calls, data: Path, tmp_path: Path) -> None:
    name = calls.name
    run = train_yolo(data, tmp_path / "run", config(name))
    assert run == read_yolo_run(tmp_path / "run")
    assert run.settings.boxes == "preset paper"
    assert run.weights.name == "best.pt"
    assert run.results.num_parameters == 8
    assert run.results.num_multiply_adds == 64 * 64 * 6
    (settings,) = calls.trained
    assert Path(settings["data"]) == (tmp_path / "run/dataset/data.yaml").resolve()
    assert settings["epochs"] == 3
    assert settings["imgsz"] == 64
    assert settings["seed"] == 0
    assert settings["pretrained"] is False
    record = json.loads((tmp_path / "run/config.json").read_text())
    assert record["data"] == str(data)
    assert f"{name}_version" in record
    assert "commit" in record
    assert not (tmp_path / "run/dataset/images/test").exists()

    split = PVDN(data / "test")
    found = predict_yolo(run, split, num_threads=1)
    assert found.predictions.boxes_xyxy_px.keys() == set(split.frame_ids)
    assert found.frame_ms.shape == (len(split),)
    assert calls.predicted[-1]["shape"] == (64, 64, 3)
    assert calls.predicted[-1]["conf"] == MIN_SCORE
    scale = np.array([WIDTH_PX, HEIGHT_PX] * 2) / 64
    boxes = found.predictions.boxes_xyxy_px[split.frame_ids[0]]
    assert boxes.tolist() == [[0.0, 0.0, WIDTH_PX, HEIGHT_PX], (np.array(BOXES[0]) * scale).tolist()]
    assert found.predictions.scores[split.frame_ids[0]].tolist() == sorted(SCORES, reverse=True)


def test_a_finished_run_is_not_trained_again(calls: Calls, data: Path, tmp_path: Path) -> None:
    first = train_yolo(data, tmp_path / "run", config(calls.name))
    assert train_yolo(data, tmp_path / "run", config(calls.name)) == first
    assert len(calls.trained) == 1


@pytest.mark.parametrize("is_export", [False, True])
def test_a_run_is_of_its_data(calls: Calls, data: Path, tmp_path: Path, *, is_export: bool) -> None:
    """Of other labels or another export, it was taken for finished."""
    out, given = tmp_path / "run", data
    if is_export:
        given = export_yolo(data, tmp_path / "one", size_px=64).data_file.parent
    train_yolo(given, out, config(calls.name))
    for label in (data / "train/labels/keypoints").glob("*.json"):
        label.write_text(json.dumps(json.loads(label.read_text()) | {"annotations": []}))
    if is_export:
        given = export_yolo(data, tmp_path / "two", size_px=64).data_file.parent
    with pytest.raises(ValueError, match=r"config\.json: data_sha256: expected .* choose another folder"):
        train_yolo(given, out, config(calls.name))
    record = json.loads((out / "config.json").read_text())
    del record["data_sha256"]  # as before there was one
    (out / "config.json").write_text(json.dumps(record))
    train_yolo(given, out, config(calls.name))
    assert len(calls.trained) == 1


def test_an_interrupted_run_goes_on(calls: Calls, data: Path, tmp_path: Path) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    calls.interrupt = interrupt
    with pytest.raises(KeyboardInterrupt):
        train_yolo(data, tmp_path / "run", config(calls.name))
    with pytest.raises(FileNotFoundError, match=r"results\.json: no such file, expected a finished run"):
        read_yolo_run(tmp_path / "run")
    calls.interrupt = lambda: None
    train_yolo(data, tmp_path / "run", config(calls.name))
    checkpoint = tmp_path / "run/training/run/weights/last.pt"
    if calls.name == "libreyolo":
        assert calls.trained[1]["resume"] == str(checkpoint)
    else:
        assert (calls.made[1], calls.trained[1]) == ((str(checkpoint),), {"resume": True})
    (tmp_path / "run/results.json").unlink()  # killed after the last epoch
    train_yolo(data, tmp_path / "run", config(calls.name))
    assert len(calls.trained) == 2


def test_other_settings_need_another_folder(calls: Calls, data: Path, tmp_path: Path) -> None:
    train_yolo(data, tmp_path / "run", config(calls.name))
    with pytest.raises(ValueError, match=r"config\.json: epochs: expected 4 to go on with this run, it has 3"):
        train_yolo(data, tmp_path / "run", config(calls.name, epochs=4))


def test_train_on_an_export(calls: Calls, data: Path, tmp_path: Path) -> None:
    export_yolo(data, tmp_path / "export", preset_name="baseline", size_px=96)
    run = train_yolo(tmp_path / "export", tmp_path / "run", config(calls.name))
    assert (run.settings.boxes, run.settings.export_size_px) == ("preset baseline", 96)
    with pytest.raises(ValueError, match=r"export: expected no preset with an export, .* preset baseline, got 'paper'"):
        train_yolo(tmp_path / "export", tmp_path / "other", config(calls.name), preset_name="paper")
    assert calls.trained[0]["imgsz"] == 64
    predict_yolo(run, PVDN(data / "val"))
    assert calls.predicted[-1]["shape"] == (96, 96, 3)


def test_an_export_without_train_cannot_be_trained_on(calls: Calls, tmp_path: Path) -> None:
    data = make_night_data(tmp_path / "data", ("val",), num_images=1)
    export_yolo(data, tmp_path / "export", size_px=64)
    with pytest.raises(ValueError, match="splits: expected train and val to train on, got val"):
        train_yolo(tmp_path / "export", tmp_path / "run", config(calls.name))


def test_a_network_that_found_nothing_is_as_it_was_last(
    monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "libreyolo", fake_libreyolo(Calls(""), best=0.0))
    assert train_yolo(data, tmp_path / "run", config()).weights.name == "last.pt"


def test_a_broken_checkpoint(monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "libreyolo", fake_libreyolo(Calls("")))
    weights = train_yolo(data, tmp_path / "run", config()).weights.parent
    (tmp_path / "run" / "results.json").unlink()
    for content in (b"", b"half", b"PK\x03\x04"):
        (weights / "last.pt").write_bytes(content)
        with pytest.raises(ValueError, match=r"last\.pt: expected a checkpoint"):
            train_yolo(data, tmp_path / "run", config())


def test_one_wrong_bit_in_the_weights_is_noticed(calls: Calls, data: Path, tmp_path: Path) -> None:
    run = train_yolo(data, tmp_path / "run", config(calls.name))
    torch.save({"weight": torch.zeros(1000)}, run.weights)
    content = bytearray(run.weights.read_bytes())
    content[len(content) // 2] ^= 1
    run.weights.write_bytes(content)
    with pytest.raises(ValueError, match=r"best\.pt: expected a whole checkpoint, found it damaged"):
        predict_yolo(run, PVDN(data / "val"))


def test_a_run_of_a_gpu_that_is_not_here_predicts_nevertheless(
    calls: Calls, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("torch.cuda.device_count", lambda: 1)
        run = train_yolo(data, tmp_path / "run", config(calls.name, device="0"))
        predict_yolo(run, PVDN(data / "val"))
        assert predicted_on(calls) == "0"
    monkeypatch.setattr("torch.cuda.device_count", lambda: 0)
    predict_yolo(run, PVDN(data / "val"))
    assert predicted_on(calls) in ("auto", None)  # as either library says it
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    predict_yolo(run, PVDN(data / "val"), device="cpu")
    assert predicted_on(calls) == "cpu"
    assert "CUDA_VISIBLE_DEVICES" not in os.environ  # what is trained next may use GPUs


def predicted_on(calls: Calls) -> Any:
    """The device of the latest prediction."""
    return calls.made[-1][1]["device"] if calls.name == "libreyolo" else calls.predicted[-1]["device"]


def test_ultralytics_reads_labels_anew(monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path) -> None:
    """It knows labels that it has read by their paths and sizes, which are the same after a box was moved."""
    export = export_yolo(data, tmp_path / "export", size_px=64).data_file.parent
    labels = [export / "labels" / f"{split}.cache" for split in ("train", "val")]
    for path in labels:
        path.write_bytes(b"of another training")
    calls = Calls("", interrupt=lambda: seen.extend(filter(Path.exists, labels)))
    seen: list[Path] = []
    monkeypatch.setitem(sys.modules, "ultralytics", fake_ultralytics(calls))
    train_yolo(export, tmp_path / "run", config("ultralytics"))
    assert not seen


def test_missing_weights(calls: Calls, data: Path, tmp_path: Path) -> None:
    run = train_yolo(data, tmp_path / "run", config(calls.name))
    run.weights.unlink()
    with pytest.raises(FileNotFoundError, match=r"best\.pt: no such file, expected the weights"):
        predict_yolo(run, PVDN(data / "val"))


@pytest.mark.parametrize("name", FAKES)
def test_a_library_that_is_not_installed_is_missed_at_once(
    name: str, monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ModuleNotFoundError):
        train_yolo(data, tmp_path / "run", config(name))
    assert not (tmp_path / "run").exists()


def test_given_weights_are_started_from(monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path) -> None:
    calls = Calls("")
    monkeypatch.setitem(sys.modules, "ultralytics", fake_ultralytics(calls))
    weights = tmp_path / "yolov5su.pt"
    with pytest.raises(FileNotFoundError, match=r"yolov5su\.pt: no such file, expected weights to start from"):
        train_yolo(data, tmp_path / "run", config("ultralytics", weights=str(weights)))
    weights.write_bytes(b"")
    train_yolo(data, tmp_path / "run", config("ultralytics", weights=str(weights)))
    assert calls.made[0] == (str(weights),)
    assert calls.trained[0]["pretrained"] is True
    with pytest.raises(ValueError, match="weights: expected none with libreyolo"):
        config("libreyolo", weights=str(weights))


def test_a_run_is_of_the_weights_that_it_started_from(
    monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path
) -> None:
    """By what is in their file, wherever it is: another file of this name gave the results of the former one."""
    monkeypatch.setitem(sys.modules, "ultralytics", fake_ultralytics(Calls("")))
    weights, moved = tmp_path / "coco.pt", tmp_path / "moved.pt"
    weights.write_bytes(b"one")
    train_yolo(data, tmp_path / "run", config("ultralytics", weights=str(weights)))
    weights.rename(moved)
    train_yolo(data, tmp_path / "run", config("ultralytics", weights=str(moved)))
    moved.write_bytes(b"two")
    with pytest.raises(ValueError, match=r"config\.json: weights_sha256: expected .* to go on with this run"):
        train_yolo(data, tmp_path / "run", config("ultralytics", weights=str(moved)))
    with pytest.raises(ValueError, match=r"config\.json: weights: expected '' to go on with this run"):
        train_yolo(data, tmp_path / "run", config("ultralytics"))


def test_unknown_size(monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "ultralytics", fake_ultralytics(Calls("")))
    with pytest.raises(ValueError, match="size: expected one of n, s, m, l, x for ultralytics, got 't'"):
        train_yolo(data, tmp_path / "run", config("ultralytics", size="t"))
    assert not (tmp_path / "run").exists()  # what it left would keep the corrected command out


@pytest.mark.parametrize("name", FAKES)
def test_a_gpu_that_is_not_there(name: str, monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, name, FAKES[name](Calls("")))
    monkeypatch.setattr("torch.cuda.device_count", lambda: 1)
    with pytest.raises(ValueError, match="device: expected auto or cpu, torch has no GPU with the number 1"):
        train_yolo(data, tmp_path / "run", config(name, device="1"))
    assert not (tmp_path / "run").exists()


def test_damaged_weights_to_start_from(monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "ultralytics", fake_ultralytics(Calls("")))
    weights = tmp_path / "yolov5su.pt"
    torch.save({"a": torch.zeros(1000)}, weights)
    content = bytearray(weights.read_bytes())
    content[len(content) // 2] ^= 1
    weights.write_bytes(content)
    with pytest.raises(ValueError, match=r"yolov5su\.pt: "):
        train_yolo(data, tmp_path / "run", config("ultralytics", weights=str(weights)))
    assert not (tmp_path / "run").exists()


def test_lost_weights_are_made_anew(calls: Calls, data: Path, tmp_path: Path) -> None:
    run = train_yolo(data, tmp_path / "run", config(calls.name))
    shutil.rmtree(run.folder / "training")
    assert train_yolo(data, tmp_path / "run", config(calls.name)).weights.is_file()
    assert len(calls.trained) == 2


@pytest.mark.parametrize("name", ["config.json", "results.json"])
@pytest.mark.parametrize("content", [b"", b"junk", b"[]", b"{}", b"[" * 100_000, b"\xff\xfe"])
def test_damaged_records_are_told_by_name(calls: Calls, data: Path, tmp_path: Path, name: str, content: bytes) -> None:
    run = train_yolo(data, tmp_path / "run", config(calls.name))
    (run.folder / name).write_bytes(content)
    with pytest.raises(ValueError, match=rf"{name}: "):
        train_yolo(data, tmp_path / "run", config(calls.name))


def test_junk_among_the_epochs_of_ultralytics(monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "ultralytics", fake_ultralytics(Calls("")))
    run = train_yolo(data, tmp_path / "run", config("ultralytics"))
    (run.folder / "results.json").unlink()
    for content in (b"\xff\xfe\0" * 9, b""):
        (run.folder / "training" / "run" / "results.csv").write_bytes(content)
        assert train_yolo(data, tmp_path / "run", config("ultralytics")).weights == run.weights
        (run.folder / "results.json").unlink()


class OneBox:
    """Finds the whole image."""

    num_parameters = num_multiply_adds = 0

    def detect(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return np.array([[0.0, 0.0, *image.shape[::-1]]]), np.array([0.5])


def test_the_whole_square_is_the_whole_frame() -> None:
    boxes, scores = detect_in_frame(OneBox(), Frame(np.zeros((96, 200), np.uint8), 0), 64)
    assert boxes.tolist() == [[0.0, 0.0, 200.0, 96.0]]
    assert scores.tolist() == [0.5]


def test_threads_are_given_back(calls: Calls, data: Path, tmp_path: Path) -> None:
    run = train_yolo(data, tmp_path / "run", config(calls.name))
    before = torch.get_num_threads()
    seen = []
    predict_yolo(run, PVDN(data / "val"), num_threads=3, progress=lambda *_: seen.append(torch.get_num_threads()))
    assert set(seen) == {3}
    assert torch.get_num_threads() == before


def test_predictions_go_to_a_file_and_back(calls: Calls, data: Path, tmp_path: Path) -> None:
    run = train_yolo(data, tmp_path / "run", config(calls.name))
    found = predict_yolo(run, PVDN(data / "val")).predictions
    write_predictions(tmp_path / "found.json", found)
    again = read_predictions(tmp_path / "found.json")
    assert again.is_scored
    for image_id, boxes in found.boxes_xyxy_px.items():
        assert np.array_equal(again.boxes_xyxy_px[image_id], boxes)
        assert np.array_equal(again.scores[image_id], found.scores[image_id])


def test_counting_leaves_the_network_as_it_was() -> None:
    network = small_network().train()
    assert count_multiply_adds(network, 32) == 32 * 32 * 6
    assert network.training


@pytest.mark.filterwarnings("ignore")
def test_libreyolo_itself(data: Path, tmp_path: Path) -> None:
    pytest.importorskip("libreyolo")
    from tests.torchvision_cpu import install

    install()
    run = train_yolo(data, tmp_path / "run", config(size="n", epochs=1, batch=2))
    assert run.results.num_parameters == pytest.approx(0.9e6, rel=0.05)  # YOLOX-Nano: 0.91 million with 80 classes
    found = predict_yolo(run, PVDN(data / "val"), num_threads=1).predictions
    for boxes in found.boxes_xyxy_px.values():
        assert (boxes >= 0).all()
        assert (boxes <= np.array([WIDTH_PX, HEIGHT_PX] * 2)).all()


@pytest.mark.parametrize("split", ["train", "val"])
def test_nothing_is_trained_on_data_that_nobody_has_labelled(
    calls: Calls, data: Path, tmp_path: Path, split: str
) -> None:
    for label in (data / split / "labels/keypoints").iterdir():
        label.write_text(json.dumps(json.loads(label.read_text()) | {"annotations": []}))
    with pytest.raises(ValueError, match=rf"labels/{split}: expected a box with light in some image"):
        train_yolo(data, tmp_path / "run", config(calls.name))
