"""`OnnxClassifier`: scores in the proposals' order, and one clear line for every unusable model."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest

from foreglow.classifier import ClassifierInputs, OnnxClassifier
from foreglow.config import ClassifierConfig
from foreglow.types import KINDS, Frame, Proposals

pytest.importorskip("onnx")

from onnx import TensorProto, helper, numpy_helper

IMAGE = np.random.default_rng(0).integers(0, 256, (120, 160)).astype(np.uint8)
SIZE_PX = 16


def test_weights_of_pytorch_are_told_from_other_files(tmp_path: Path) -> None:
    path = tmp_path / "weights.pt"
    path.write_bytes(b"PK\3\4weights")
    with pytest.raises(ValueError, match=r"weights\.pt: expected an ONNX model .*; `foreglow import-weights` converts"):
        OnnxClassifier(ClassifierConfig(model=path))


def test_a_model_whose_names_are_no_text(tmp_path: Path) -> None:
    path = write_model(tmp_path / "model.onnx")
    data = path.read_bytes()
    assert data.count(b"crops") > 1
    path.write_bytes(data.replace(b"crops", b"\x8arops"))
    with pytest.raises(ValueError, match=r"model\.onnx: expected an ONNX model that can be run: .*decode"):
        OnnxClassifier(ClassifierConfig(model=path))


def proposals(count: int) -> Proposals:
    random = np.random.default_rng(count)
    corners = random.integers(0, 100, (count, 2))
    return Proposals(np.concatenate([corners, corners + random.integers(1, 20, (count, 2))], axis=1).astype(np.int32))


def write_model(
    path: Path,
    shape: tuple[Any, ...] = ("N", 1, SIZE_PX, SIZE_PX),
    output_shape: tuple[Any, ...] = ("N",),
    kind: int = TensorProto.FLOAT,
    gain: float = 8.0,
    axes: tuple[int, ...] = (1, 2, 3),
    copies: int = 1,
    biases: tuple[float, ...] = (0.0,),
    metadata: dict[str, str] | None = None,
) -> Path:
    """A model whose logits are gain x (mean of the crop - 1/2) + the biases; NaN for a gain of NaN."""
    constants = [
        numpy_helper.from_array(np.array(value, helper.tensor_dtype_to_np_dtype(kind)), name)
        for name, value in (("half", 0.5), ("gain", gain), ("biases", biases))
    ]
    nodes = [
        helper.make_node("ReduceMean", ["crops"], ["mean"], axes=axes, keepdims=0),
        helper.make_node("Sub", ["mean", "half"], ["centred"]),
        helper.make_node("Mul", ["centred", "gain"], ["once"]),
        helper.make_node("Concat", ["once"] * copies, ["same"], axis=0),
        helper.make_node("Add", ["same", "biases"], ["logits"]),
    ]
    graph = helper.make_graph(
        nodes,
        "test",
        [helper.make_tensor_value_info("crops", kind, shape)],
        [helper.make_tensor_value_info("logits", kind, output_shape)],
        constants,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, metadata or {})
    path.write_bytes(model.SerializeToString())
    return path


@pytest.mark.parametrize("count", [1, 7, 8, 9, 40])
def test_scores_are_the_sigmoid_of_the_logits(tmp_path: Path, count: int) -> None:
    classifier = OnnxClassifier(ClassifierConfig(model=write_model(tmp_path / "model.onnx")))
    assert classifier.spec.size_px == SIZE_PX
    boxes = proposals(count)
    detections = classifier.classify(Frame(IMAGE, 0), boxes)
    np.testing.assert_array_equal(detections.boxes_xyxy_px, boxes.boxes_xyxy_px)
    from foreglow import _native

    crops, _ = _native.extract_crops(IMAGE, boxes.boxes_xyxy_px, 2, SIZE_PX)
    expected = 1 / (1 + np.exp(-8 * (crops.astype(np.float64).mean(axis=(1, 2, 3)) - 0.5)))
    np.testing.assert_allclose(detections.scores, expected, atol=1e-6)
    np.testing.assert_array_equal(detections.is_accepted, detections.scores > 0.5)


def test_large_crops_of_many_boxes_are_made_in_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A thousand boxes of a frame took gigabytes."""
    model = write_model(tmp_path / "model.onnx", shape=("N", 1, 1024, 1024))
    sizes: list[tuple[int, int]] = []
    unspied = OnnxClassifier._logits

    def spied(classifier: OnnxClassifier, inputs: ClassifierInputs) -> Any:
        sizes.append((len(inputs.crops), inputs.crops.nbytes))
        return unspied(classifier, inputs)

    monkeypatch.setattr(OnnxClassifier, "_logits", spied)
    classifier, boxes = OnnxClassifier(ClassifierConfig(model=model)), proposals(70)
    scores = classifier.classify(Frame(IMAGE, 0), boxes).scores
    assert [num for num, _ in sizes] == [64, 6]
    assert max(num_bytes for _, num_bytes in sizes) <= 256 << 20
    few = Proposals(boxes.boxes_xyxy_px[60:])
    np.testing.assert_array_equal(classifier.classify(Frame(IMAGE, 0), few).scores, scores[60:])


def test_threshold_support_and_strides(tmp_path: Path) -> None:
    model = write_model(tmp_path / "model.onnx")
    strict = OnnxClassifier(ClassifierConfig(model=model, score_threshold=1.0))
    assert not strict.classify(Frame(IMAGE, 0), proposals(9)).is_accepted.any()
    usual = OnnxClassifier(ClassifierConfig(model=model)).classify(Frame(IMAGE, 0), proposals(9)).scores
    wide = OnnxClassifier(ClassifierConfig(model=model, support=4)).classify(Frame(IMAGE, 0), proposals(9)).scores
    assert not np.array_equal(usual, wide)
    strided = np.repeat(IMAGE, 2, axis=1)[:, ::2]
    classifier = OnnxClassifier(ClassifierConfig(model=model, num_threads=2))
    np.testing.assert_array_equal(classifier.classify(Frame(strided, 0), proposals(9)).scores, usual)


def test_no_proposals_do_not_run_the_model(tmp_path: Path) -> None:
    classifier = OnnxClassifier(ClassifierConfig(model=write_model(tmp_path / "model.onnx", gain=float("nan"))))
    detections = classifier.classify(Frame(IMAGE, 0), Proposals(np.zeros((0, 4), np.int32)))
    assert len(detections) == 0
    assert detections.scores.dtype == np.float32


def test_extreme_logits_do_not_overflow(tmp_path: Path) -> None:
    classifier = OnnxClassifier(ClassifierConfig(model=write_model(tmp_path / "model.onnx", gain=1e6)))
    assert set(classifier.classify(Frame(IMAGE, 0), proposals(20)).scores) <= {0.0, 1.0}


def test_scores_are_float32_with_column_of_logits(tmp_path: Path) -> None:
    """The mean over rows and columns leaves shape (N, 1)."""
    plain = OnnxClassifier(ClassifierConfig(model=write_model(tmp_path / "plain.onnx")))
    column = write_model(tmp_path / "column.onnx", output_shape=("N", 1), axes=(2, 3))
    detections = OnnxClassifier(ClassifierConfig(model=column)).classify(Frame(IMAGE, 0), proposals(5))
    np.testing.assert_allclose(detections.scores, plain.classify(Frame(IMAGE, 0), proposals(5)).scores, atol=1e-6)


def test_five_logits_are_the_softmax_of_the_kinds(tmp_path: Path) -> None:
    """However far apart they are: neither a score near 0 nor its kinds lose their digits."""
    for biases in ([1.0, -2.0, 0.5, 3.0, 1.5], [80.0, 81.0, 79.0, 0.0, 120.0], [-300.0, -301.0, -302.0, -303.0, 300.0]):
        model = write_model(tmp_path / "model.onnx", output_shape=("N", 5), axes=(2, 3), gain=0.0, biases=tuple(biases))
        found = OnnxClassifier(ClassifierConfig(model=model)).classify(Frame(IMAGE, 0), proposals(9))
        weights = np.exp(np.array(biases) - max(biases))
        lights = np.exp(np.array(biases[:4]) - max(biases[:4]))
        np.testing.assert_allclose(found.kinds, np.tile(weights / weights.sum(), (9, 1)), atol=1e-6)
        np.testing.assert_allclose(found.kinds.sum(axis=1), 1.0, atol=1e-6)
        np.testing.assert_allclose(found.light_kinds, np.tile(lights / lights.sum(), (9, 1)), atol=1e-6)
        np.testing.assert_allclose(found.scores, 1 - found.kinds[:, 4], atol=1e-7)
        assert set(found.kind_names) == {KINDS[int(np.argmax(biases[:4]))]}
        np.testing.assert_allclose(found.direct_probabilities, (lights[0] + lights[1]) / lights.sum(), atol=1e-6)


def test_two_logits_tell_front_lamps_from_their_light(tmp_path: Path) -> None:
    model = write_model(tmp_path / "model.onnx", output_shape=("N", 2), axes=(2, 3), gain=0.0, biases=(0.5, -1.0))
    found = OnnxClassifier(ClassifierConfig(model=model)).classify(Frame(IMAGE, 0), proposals(9))
    score, direct = 1 / (1 + np.exp(-0.5)), 1 / (1 + np.exp(1.0))
    expected = [score * direct, 0.0, score * (1 - direct), 0.0, 1 - score]
    np.testing.assert_allclose(found.kinds, np.tile(expected, (9, 1)), atol=1e-6)
    np.testing.assert_allclose(found.direct_probabilities, direct, atol=1e-6)


def test_one_logit_tells_no_kinds(tmp_path: Path) -> None:
    found = OnnxClassifier(ClassifierConfig(model=write_model(tmp_path / "model.onnx"))).classify(
        Frame(IMAGE, 0), proposals(9)
    )
    assert np.isnan(found.kinds).all()
    assert np.isnan(found.direct_probabilities).all()


@pytest.mark.parametrize(
    ("num_outputs", "names"),
    [
        (5, {"0": "rear_lamp", "1": "front_lamp", "2": "front_light", "3": "rear_light", "4": "none"}),
        (5, ["none", "front_lamp", "rear_lamp", "front_light", "rear_light"]),
        (5, {"0": "front_lamp", "1": "rear_lamp", "2": "front_light", "3": "rear_light"}),
        (2, {"0": "none", "1": "front_lamp"}),
        (1, {"0": "none"}),
    ],
)
def test_names_that_contradict_the_order_of_the_kinds(tmp_path: Path, num_outputs: int, names: Any) -> None:
    metadata = {"names": json.dumps(names)}
    biases = (0.0,) * num_outputs
    model = write_model(
        tmp_path / "model.onnx", output_shape=("N", num_outputs), axes=(2, 3), biases=biases, metadata=metadata
    )
    with pytest.raises(ValueError, match=r"model\.onnx: metadata: names: expected .*'front_lamp'.*, got \["):
        OnnxClassifier(ClassifierConfig(model=model))


@pytest.mark.parametrize(
    "names", [json.dumps(dict(enumerate(KINDS))), json.dumps(KINDS), '{"0": "lamp"}', "{0: 'none'}", "[" * 9999, "3"]
)
def test_names_that_contradict_nothing(tmp_path: Path, names: str) -> None:
    path, biases = tmp_path / "model.onnx", (0.0,) * len(KINDS)
    write_model(path, output_shape=("N", len(KINDS)), axes=(2, 3), biases=biases, metadata={"names": names})
    OnnxClassifier(ClassifierConfig(model=path))


@pytest.mark.parametrize("text", ["", "0", "no", "true"])
def test_metadata_that_are_no_mark(tmp_path: Path, text: str) -> None:
    model = write_model(tmp_path / "model.onnx", metadata={"together": text})
    with pytest.raises(ValueError, match=rf"model\.onnx: metadata: together: expected 1, or none, got '{text}'"):
        OnnxClassifier(ClassifierConfig(model=model))


@pytest.mark.parametrize("name", ["support", "context"])
@pytest.mark.parametrize("text", ["2.7", "nan", "inf", "1e400", "0", "1e9", "two"])
def test_metadata_that_are_no_number_of_box_sizes(tmp_path: Path, name: str, text: str) -> None:
    shape = ("N", 2 if name == "context" else 1, SIZE_PX, SIZE_PX)
    model = write_model(tmp_path / "model.onnx", shape, metadata={name: text})
    with pytest.raises(ValueError, match=rf"model\.onnx: metadata: {name}: expected a .*number.*, got '{text}'"):
        OnnxClassifier(ClassifierConfig(model=model))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"shape": ("N", 4, 16, 16)}, "got 4 channels"),
        ({"shape": ("N", 3, 16, 16)}, "expected one channel, one more for lag_s and one for context"),
        ({"shape": ("N", 1, 16, 24)}, r"expected shape \(N, C, S, S\)"),
        ({"shape": ("N", 1, "H", "W")}, r"expected shape \(N, C, S, S\)"),
        ({"shape": (1, 1, 16, 16), "output_shape": (1,)}, "fixed batch of 1"),
        ({"shape": ("N", 16, 16), "axes": (1, 2)}, "got 3 dimensions"),
        ({"kind": TensorProto.DOUBLE}, r"expected float32, got tensor\(double\)"),
        ({"output_shape": ("N", 16), "axes": (1, 2)}, r"output logits: expected shape \(N,\), \(N, 1\), \(N, 2\) or"),
        ({"output_shape": ("N", 1, 16), "axes": (2,)}, r"output logits: expected shape \(N,\), \(N, 1\), \(N, 2\) or"),
    ],
)
def test_wrong_model(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    model = write_model(tmp_path / "model.onnx", **changes)
    with pytest.raises(ValueError, match=message) as caught:
        OnnxClassifier(ClassifierConfig(model=model))
    assert str(model) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_wrong_output_found_when_run(tmp_path: Path) -> None:
    model = write_model(tmp_path / "model.onnx", output_shape=("K",), copies=2)
    with pytest.raises(ValueError, match="expected 1, 2 or 5 logits for each of 3 crops"):
        OnnxClassifier(ClassifierConfig(model=model)).classify(Frame(IMAGE, 0), proposals(3))


def test_not_finite_output(tmp_path: Path) -> None:
    classifier = OnnxClassifier(ClassifierConfig(model=write_model(tmp_path / "model.onnx", gain=float("nan"))))
    with pytest.raises(ValueError, match="expected finite logits"):
        classifier.classify(Frame(IMAGE, 0), proposals(3))


def test_a_gpu_where_onnx_runtime_has_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a stand-in for onnxruntime-gpu, which computes on the CPU; it may leave out a device that it cannot load."""
    config = ClassifierConfig(model=write_model(tmp_path / "model.onnx"), device="cuda")
    on_cpu, cuda = ["CPUExecutionProvider"], "CUDAExecutionProvider"
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: on_cpu)
    with pytest.raises(ValueError, match=r"classifier\.device: expected cpu, this ONNX Runtime is not onnxruntime-gpu"):
        OnnxClassifier(config)

    asked: list[Any] = []
    make = onnxruntime.InferenceSession

    def make_session(path: str, options: Any, providers: list[Any]) -> Any:
        asked.append([provider if isinstance(provider, str) else provider[0] for provider in providers])
        session = make(path, options, providers=on_cpu)
        session.get_providers = lambda: loaded
        return session

    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: [cuda, *on_cpu])
    monkeypatch.setattr(onnxruntime, "InferenceSession", make_session)
    loaded = on_cpu
    with pytest.raises(ValueError, match=r"classifier\.device: expected cpu, ONNX Runtime cannot use a GPU here"):
        OnnxClassifier(config)
    loaded = [cuda, *on_cpu]
    OnnxClassifier(config)
    OnnxClassifier(config.model_copy(update={"device": "cpu"}))
    assert asked == [[cuda, *on_cpu], [cuda, *on_cpu], on_cpu]


def test_missing_and_unset_model(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no such model file"):
        OnnxClassifier(ClassifierConfig(model=tmp_path / "none.onnx"))
    with pytest.raises(ValueError, match=r"classifier\.model: expected the path"):
        OnnxClassifier(ClassifierConfig())


def test_a_folder_in_place_of_a_model(tmp_path: Path) -> None:
    expected = f"^{re.escape(str(tmp_path))}: expected an ONNX file such as "
    with pytest.raises(IsADirectoryError, match=expected + "model.onnx of a training, got a folder"):
        OnnxClassifier(ClassifierConfig(model=tmp_path))
    model = tmp_path / "model.onnx"
    model.touch()
    with pytest.raises(IsADirectoryError, match=f"{expected}{re.escape(str(model))}, got a folder"):
        OnnxClassifier(ClassifierConfig(model=tmp_path))


@pytest.mark.parametrize("content", [b"", b"this is not a model", bytes(100)])
def test_not_a_model(tmp_path: Path, content: bytes) -> None:
    model = tmp_path / "model.onnx"
    model.write_bytes(content)
    with pytest.raises(ValueError, match=r"model\.onnx: expected an ONNX model") as caught:
        OnnxClassifier(ClassifierConfig(model=model))
    assert "\n" not in str(caught.value)


def test_truncated_model(tmp_path: Path) -> None:
    model = write_model(tmp_path / "model.onnx")
    content = model.read_bytes()
    for length in range(1, len(content), 40):
        model.write_bytes(content[:length])
        with pytest.raises(ValueError, match=r"model\.onnx: "):
            OnnxClassifier(ClassifierConfig(model=model))


@pytest.mark.slow
def test_a_model_with_bytes_that_are_no_text(tmp_path: Path) -> None:
    model = write_model(tmp_path / "model.onnx")
    content, num_refused = model.read_bytes(), 0
    for place in range(0, len(content), 3):
        model.write_bytes(content[:place] + b"\x8a" + content[place + 1 :])
        try:
            OnnxClassifier(ClassifierConfig(model=model))
        except ValueError as error:
            num_refused += "model.onnx: " in str(error) or pytest.fail(f"byte {place}: {error!r}")
    assert num_refused


@pytest.mark.slow
def test_classifier_reports_to_nobody(tmp_path: Path) -> None:
    model, home = write_model(tmp_path / "model.onnx"), tmp_path / "home"
    home.mkdir()
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("ORT_", "XDG_"))}
    code = (
        "import pathlib, sys, foreglow.classifier as c, foreglow.config as f\n"
        "c.OnnxClassifier(f.ClassifierConfig(model=pathlib.Path(sys.argv[1])))"
    )
    command = [sys.executable, "-c", code, str(model)]
    done = subprocess.run(command, env=environment | {"HOME": str(home)}, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")
    assert list(home.rglob("*")) == []
