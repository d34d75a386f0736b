"""Messages stay short, whatever is given."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

import foreglow
from foreglow.geometry import Pose
from foreglow.numbers import checked_number
from foreglow.pipeline import Pipeline
from foreglow.types import BeamCommand, BeamMode, Frame, Tracks, Vehicles
from tests.beam.made_up import CAMERA
from tests.stand_ins import tracks_of

MANY = 3000

GAPS = np.linspace(-1.0, 1.0, 2 * MANY).reshape(-1, 2)
IDS = np.arange(MANY)[::-1].copy()
BOXES = [[0.0, 0.0, 1.0, 1.0]] * MANY


def vehicles(ids: object, **changed: object) -> Vehicles:
    columns = {
        "states": np.zeros(MANY, np.int64),
        "confidences": np.ones(MANY),
        "is_in_sight": np.ones(MANY, np.bool_),
        "of_tracks": np.arange(MANY),
        "leading": np.arange(MANY),
    }
    return Vehicles(ids=ids, **columns | changed)  # type: ignore[arg-type]


def tracks(**changed: object) -> Tracks:
    made = tracks_of(BOXES)
    return type(made)(**{name: getattr(made, name) for name in made.__dataclass_fields__} | changed)


CASES: dict[str, Callable[[], object]] = {
    "gaps": lambda: BeamCommand(0, BeamMode.GLARE_FREE, np.ones((2, 3)), GAPS[::-1], np.ones(MANY)),
    "ranges of gaps": lambda: BeamCommand(0, BeamMode.GLARE_FREE, np.ones((2, 3)), GAPS, -np.ones(MANY)),
    "faults": lambda: BeamCommand(0, BeamMode.LOW, np.zeros((2, 3)), faults=[str(number) for number in IDS]),  # type: ignore[arg-type]
    "mode": lambda: BeamCommand(0, "x" * MANY, np.zeros((2, 3))),  # type: ignore[arg-type]
    "ids of tracks": lambda: tracks(ids=IDS),
    "states of tracks": lambda: tracks(states=IDS),
    "confidences of tracks": lambda: tracks(confidences=IDS.astype(float)),
    "ids of vehicles": lambda: vehicles(IDS),
    "confidences of vehicles": lambda: vehicles(IDS[::-1].copy(), confidences=IDS.astype(float)),
    "of tracks": lambda: vehicles(IDS[::-1].copy(), of_tracks=IDS - 1),
    "leading": lambda: vehicles(IDS[::-1].copy(), leading=IDS),
    "position": lambda: Pose(np.ones(MANY), np.eye(3)),
    "rotation": lambda: Pose(np.ones(3), np.ones((MANY, 3))),
    "number": lambda: checked_number("number", "x" * MANY),
    "long number": lambda: checked_number("number", 10 ** (2 * MANY)),
    "time": lambda: Frame(np.zeros((64, 64), np.uint8), 10 ** (2 * MANY), 0),
    "a value with arrays": lambda: Pipeline(tracks()),  # type: ignore[arg-type]
    "an image for a configuration": lambda: Pipeline(np.zeros((96, 128))),  # type: ignore[arg-type]
    "a path that is an image": lambda: foreglow.open_source(np.zeros((96, 128))),  # type: ignore[arg-type]
    "a path that is long": lambda: foreglow.read_image("x" * MANY),
    "focal length": lambda: dataclasses.replace(CAMERA, focal_px=np.ones(MANY)),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("name", CASES)
def test_what_is_long_is_not_printed_as_a_whole(name: str) -> None:
    with pytest.raises(ValueError, match="expected") as refused:
        CASES[name]()
    assert len(str(refused.value)) < 300
    assert "\n" not in str(refused.value)
