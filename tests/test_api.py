"""The package's own names: `foreglow.propose`, and all types of a result."""

from __future__ import annotations

import dataclasses
import typing
from concurrent.futures import ThreadPoolExecutor
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


def test_the_simulator_is_where_it_was() -> None:
    assert foreglow.simulation.simulate is foreglow.simulate
    assert foreglow.simulate(foreglow.simulation.Scene(seed=3)).name.endswith("/3")
