"""The package's own names: `foreglow.propose`, and all types of a result."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import foreglow
from foreglow import proposals
from tests.stand_ins import night_image

GREY = night_image(0, 480, 640)
"""Half the presets' width, so that their sizes hold as they are, without reduction."""


def test_every_kind_of_array_gives_the_same_boxes() -> None:
    expected = foreglow.propose(GREY)
    assert expected.shape == (len(expected), 4)
    assert expected.dtype == np.int32
    assert len(expected) > 0
    kinds: list[Any] = [
        np.dstack([GREY] * 3),
        np.dstack([GREY] * 4),
        GREY.astype(np.uint16) * 257,
        GREY / 255.0,
        (GREY / 255.0).astype(np.float32),
        np.asfortranarray(GREY),
    ]
    for array in kinds:
        assert (foreglow.propose(array) == expected).all()


def test_presets_join_across_different_gaps() -> None:
    image = np.zeros((480, 640), np.uint8)
    image[200:212, 300:312] = image[200:212, 320:332] = 200
    assert len(foreglow.propose(image)) == 2
    assert len(foreglow.propose(image, preset="baseline")) == 1


@pytest.mark.parametrize(
    ("image", "complaint"),
    [
        (np.full((80, 80), np.nan), "NaN"),
        (np.full((80, 80), 1.5), "1.5"),
        (np.zeros((80, 80, 5), np.uint8), "shape"),
        (np.zeros((0, 80), np.uint8), "pixel"),
        (np.zeros((80, 80), np.int64), "int64"),
    ],
)
def test_unfit_arrays_are_refused(image: Any, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        foreglow.propose(image)


def test_unknown_preset_is_refused() -> None:
    with pytest.raises(ValueError, match="expected one of paper, baseline"):
        foreglow.propose(GREY, preset="best")


def test_each_thread_keeps_its_proposer(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Any] = []

    def make(config: Any) -> Any:
        made.append(known(config))
        return made[-1]

    known = proposals.make_proposer
    monkeypatch.setattr(proposals, "make_proposer", make)
    foreglow._proposer.cache_clear()
    for _ in range(3):
        foreglow.propose(GREY)
    assert len(made) == 1
    foreglow.propose(GREY, preset="paper")
    assert len(made) == 2
    with ThreadPoolExecutor(1) as other:
        other.submit(foreglow.propose, GREY).result()
    assert len(made) == 3
    foreglow._proposer.cache_clear()


def test_threads_do_not_disturb_one_another() -> None:
    images = [night_image(seed, 480, 640) for seed in range(24)]
    expected = [foreglow.propose(image).tolist() for image in images]
    with ThreadPoolExecutor(8) as threads:
        found = threads.map(foreglow.propose, images * 4)
        assert [boxes.tolist() for boxes in found] == expected * 4


def types_in(annotation: Any) -> set[type]:
    """Our classes in an annotation."""
    found = {each for part in typing.get_args(annotation) for each in types_in(part)}
    is_ours = isinstance(annotation, type) and annotation.__module__.startswith("foreglow.types")
    return found | ({annotation} if is_ours else set())


def test_all_types_of_a_result_are_public() -> None:
    waiting, known = [foreglow.FrameResult, foreglow.Frame], set()
    while waiting:
        kind = waiting.pop()
        known.add(kind)
        if dataclasses.is_dataclass(kind):
            waiting += {each for hint in typing.get_type_hints(kind).values() for each in types_in(hint)} - known
    assert {foreglow.Ranges, foreglow.Tracks, foreglow.BeamCommand, foreglow.BeamMode, foreglow.RoadAhead} <= known
    assert all(getattr(foreglow, kind.__name__) is kind for kind in known)
    assert foreglow.TrackState(1) is foreglow.TrackState.CONFIRMED


IMAGE = np.zeros((96, 128), np.uint8)
PATHS: dict[str, Callable[[Any], object]] = {
    "path": foreglow.read_image,
    "path ": foreglow.read_config,
    "path  ": foreglow.open_source,
    "folder": foreglow.read_run,
    "root": foreglow.PVDN,
    "split": lambda path: foreglow.evaluate_split(path, "a.json"),
    "predictions": lambda path: foreglow.evaluate_split("a", path),
}


@pytest.mark.parametrize("path", [None, True, 1, b"a", "", [], {}, IMAGE, "a\0b", "x" * 5000])
@pytest.mark.parametrize("field", PATHS)
def test_what_is_no_path_is_named(field: str, path: Any) -> None:
    with pytest.raises(ValueError, match=f"^{field.strip()}: expected the path of a file or folder, ") as refused:
        PATHS[field](path)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 300


@pytest.mark.parametrize("value", [0, 1, "", [], {}, False, IMAGE])
def test_an_argument_of_another_type_is_named(tmp_path: Path, value: Any) -> None:
    path = tmp_path / "a.toml"
    path.write_text("")
    calls: dict[str, Callable[[], object]] = {
        "base": lambda: foreglow.read_config(path, value),
        "select": lambda: foreglow.PVDN(tmp_path, select=value),
        "preset": lambda: foreglow.propose(IMAGE, value),
        "scene": lambda: foreglow.simulate(value),
    }
    for field, call in calls.items():
        with pytest.raises(ValueError, match=f"^{field}: expected "):
            call()


def test_predictions_of_ones_own_can_be_evaluated() -> None:
    own = foreglow.Predictions({1: np.array([[0.0, 0.0, 9.0, 9.0]])}, {1: np.ones(1)})
    assert foreglow.evaluate_boxes({1: np.array([[5, 5]])}, own).f1 == 1.0


@pytest.mark.parametrize(
    ("field", "value", "complaint"),
    [
        ("is_scored", "yes", r"is_scored: expected True or False, got 'yes'"),
        ("is_scored", None, r"is_scored: expected True or False"),
        (
            "direct_probabilities",
            {1: [0.5]},
            r"direct_probabilities: image 1: expected numbers .*, got list",
        ),
        (
            "direct_probabilities",
            {1: np.array([0.5, 0.5])},
            r"direct_probabilities: image 1: expected numbers of",
        ),
        ("direct_probabilities", {1: np.array([1.5])}, r"direct_probabilities: image 1: expected numbers from 0 to 1"),
        (
            "direct_probabilities",
            {2: np.array([0.5])},
            r"direct_probabilities: expected images of boxes_.*, got 2",
        ),
        ("light_kinds", {1: np.ones((1, 5))}, r"light_kinds: image 1: expected numbers of shape \(1, 4\)"),
        ("light_kinds", {1: np.full((1, 4), np.inf)}, r"light_kinds: image 1: expected finite numbers, got inf"),
        (
            "light_kinds",
            {1: np.array([["a"] * 4])},
            r"light_kinds: image 1: expected numbers of .*, got <U1",
        ),
    ],
)
def test_predictions_refuse_unfit_fields(field: str, value: Any, complaint: str) -> None:
    boxes, scores = {1: np.array([[0.0, 0.0, 9.0, 9.0]])}, {1: np.ones(1)}
    with pytest.raises(ValueError, match=rf"^Predictions\.{complaint}"):
        foreglow.Predictions(boxes, scores, **{field: value})
    unknown = {1: np.array([np.nan])}
    assert foreglow.Predictions(boxes, scores, direct_probabilities=unknown).direct_probabilities is unknown


def test_the_simulator_is_where_it_was() -> None:
    assert foreglow.simulation.simulate is foreglow.simulate
    assert foreglow.simulate(foreglow.simulation.Scene(seed=3)).name.endswith("/3")
