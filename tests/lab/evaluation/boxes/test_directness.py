"""How well lamps are told from their light, on cases counted by hand."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from foreglow.files import to_json
from foreglow.lab.evaluation.boxes.directness import Directness, directness, directness_of_boxes
from foreglow.runs.predictions import Predictions
from foreglow.types import Tracks, TrackState
from foreglow.types.kinds import kinds_of_direct
from tests.lab.evaluation.scored_boxes import light, split_labels
from tests.stand_ins import tracks_of
from tests.tracking.made_up import camera

LEFT, RIGHT, ROAD, NOTHING = (0, 0, 10, 10), (47, 0, 57, 10), (0, 50, 10, 60), (90, 90, 99, 99)
BOXES = np.array([LEFT, RIGHT, ROAD, NOTHING], np.float64)
LABELS = split_labels(
    {
        0: [light(0, 5, 5), light(0, 52, 5), light(0, 6, 6, kind="road"), light(0, 5, 55, kind="road")],
        1: [light(1, 5, 55, kind="verge")],
    }
)


def predictions(*direct: float, scores: float = 0.9) -> Predictions:
    """The same boxes in both images, with these probabilities."""
    every = dict.fromkeys(LABELS.lights, np.array(direct))
    return Predictions(
        dict.fromkeys(LABELS.lights, BOXES), dict.fromkeys(LABELS.lights, np.full(4, scores)), True, every
    )


def followed(direct: list[float], states: list[TrackState] | None = None) -> dict[int, Tracks]:
    """Tracks in the boxes, 40 m away: at 1400 px a radian, 47 px are 1.34 m."""
    tracks = tracks_of(BOXES.tolist(), states, ranges_m=[40.0] * 4)
    return dict.fromkeys(LABELS.lights, dataclasses.replace(tracks, light_kinds=kinds_of_direct(np.array(direct))))


def test_boxes_by_what_they_hold() -> None:
    """Two boxes hold a lamp, one of them light on the road, too; one holds light on something, in either image."""
    found = directness_of_boxes(LABELS, predictions(0.9, 0.4, 0.3, 0.9), 0.5)
    assert found is not None
    assert (found.num_direct, found.num_indirect) == (2, 2)
    assert (found.recall_direct, found.recall_indirect, found.balanced_accuracy) == (0.5, 1.0, 0.75)


def test_only_accepted_boxes_that_say_it_count() -> None:
    assert directness_of_boxes(LABELS, predictions(0.9, 0.9, 0.9, 0.9), 0.95) is None
    assert directness_of_boxes(LABELS, predictions(*[math.nan] * 4), 0.5) is None
    found = directness_of_boxes(LABELS, predictions(0.9, math.nan, 0.9, 0.1), 0.5)
    assert found is not None
    assert (found.num_direct, found.recall_indirect) == (1, 0.0)
    unsaid = Predictions(dict.fromkeys(LABELS.lights, BOXES), dict.fromkeys(LABELS.lights, np.ones(4)))
    assert directness(LABELS, unsaid, 0.5) == Directness()


def test_tracks_and_vehicles() -> None:
    """The first image has one vehicle with both lamps in tracks of their own; the second has none, but a pair."""
    found = directness(LABELS, predictions(0.9, 0.9, 0.1, 0.1), 0.5, followed([0.8, 0.7, 0.2, 0.1]), {0: camera()})
    assert found.tracks is not None
    assert (found.tracks.num_direct, found.tracks.num_indirect, found.tracks.balanced_accuracy) == (2, 2, 1.0)
    assert found.vehicles is not None
    assert (found.vehicles.num_pairs, found.vehicles.precision) == (2, 0.5)
    assert (found.vehicles.num_vehicles, found.vehicles.recall) == (1, 1.0)


@pytest.mark.parametrize("state", list(TrackState))
def test_tentative_tracks_do_not_count(state: TrackState) -> None:
    tracks = followed([0.8, 0.7, 0.2, 0.1], [state] * 4)
    found = directness(LABELS, predictions(0.9, 0.9, 0.1, 0.1), 0.5, tracks, {0: camera()})
    assert (found.tracks is None) == (state == TrackState.TENTATIVE)
    assert found.vehicles is not None
    assert found.vehicles.num_vehicles == int(state != TrackState.TENTATIVE)


def test_no_figures_of_vehicles_without_a_calibration() -> None:
    found = directness(LABELS, predictions(0.9, 0.9, 0.1, 0.1), 0.5, followed([0.8, 0.7, 0.2, 0.1]))
    assert found.vehicles is None
    assert found.tracks is not None
    assert to_json(found)["vehicles"] is None
