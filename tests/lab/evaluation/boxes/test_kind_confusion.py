"""What boxes are against what they are called, by the stored shares of a simulated data set."""

from __future__ import annotations

import json
import math
from types import SimpleNamespace
from typing import Any

import numpy as np

from foreglow.datasets.simulated.shares import SOURCES, BoxShares
from foreglow.files import json_text
from foreglow.lab.evaluation.boxes.directness import kind_confusion
from foreglow.lab.reports.evaluation_page import kinds_rows, kinds_words
from foreglow.runs.predictions import Predictions
from foreglow.types import KINDS

BOXES = np.array([[10 * k, 5, 10 * k + 8, 12] for k in range(5)], np.int32)


def mostly(*names: str, of: tuple[str, ...] = SOURCES) -> np.ndarray:
    """A row for each name, in which it has most of the light."""
    return np.array([[0.5 if name == source else 0.5 / (len(of) - 1) for source in of] for name in names], np.float32)


def labels(*stored: tuple[int, BoxShares]) -> Any:
    """What is read of a split, as far as it matters here."""
    shares: dict[str, dict[int, BoxShares]] = {}
    for image_id, found in stored:
        shares.setdefault(found.preset, {})[image_id] = found
    return SimpleNamespace(shares=shares, lights={7: (), 8: ()})


def predictions(called: dict[int, list[str]], scores: dict[int, list[float]]) -> Predictions:
    """The first of the boxes in each image."""
    return Predictions(
        {image_id: BOXES[: len(names)].astype(np.float64) for image_id, names in called.items()},
        {image_id: np.array(values) for image_id, values in scores.items()},
        light_kinds={image_id: mostly(*names, of=KINDS[:4]).astype(np.float64) for image_id, names in called.items()},
    )


def test_each_box_is_counted_once_where_its_kinds_meet() -> None:
    """Of two presets that propose the same boxes."""
    true = mostly("front_lamp", "rear_lamp", "front_light", "rear_light", "fixed")
    rows = [(7, BoxShares("foreglow", BOXES, true)), (7, BoxShares("baseline", BOXES[:2], true[:2]))]
    called = ["front_lamp", "front_lamp", "front_light", "rear_light", "rear_lamp"]
    made = predictions({7: called}, {7: [0.9, 0.9, 0.2, 0.9, 0.9]})
    found = kind_confusion(labels(*rows), made, 0.5)
    assert found is not None
    expected = [[1, 0, 0, 0, 0], [1, 0, 0, 0, 0], [0, 0, 0, 0, 1], [0, 0, 0, 1, 0], [0, 1, 0, 0, 0]]
    assert found.counts.tolist() == expected
    assert found.num_unknown == 0
    assert found.right == 0.5
    assert found.recalls == (1.0, 0.0, 0.0, 1.0, 0.0)
    written = json.loads(json_text(found))
    assert written["kinds"] == list(KINDS)
    assert written["counts"] == expected


def test_own_and_fixed_light_together_are_none() -> None:
    shares = np.array([[0.4, 0, 0, 0, 0.3, 0.3], [0.6, 0, 0, 0, 0.2, 0.2]], np.float32)
    split = labels((7, BoxShares("foreglow", BOXES[:2], shares)))
    found = kind_confusion(split, predictions({7: ["front_lamp"] * 2}, {7: [0.9, 0.9]}), 0.5)
    assert found is not None
    assert found.counts[:, 0].tolist() == [1, 0, 0, 0, 1]


def test_boxes_without_shares_or_kinds_are_told() -> None:
    split = labels((7, BoxShares("foreglow", BOXES[:2], mostly("own", "rear_lamp"))))
    called = {7: ["rear_lamp"] * 4, 8: ["rear_lamp"] * 2, 9: ["rear_lamp"] * 3}  # image 9 is not one of the labels
    made = predictions(called, {image_id: [0.9] * len(names) for image_id, names in called.items()})
    made.light_kinds[7][0] = math.nan
    found = kind_confusion(split, made, 0.5)
    assert found is not None
    assert (int(found.counts.sum()), found.counts[1, 1], found.num_unknown) == (1, 1, 5)
    head, *rows = kinds_rows(found)
    assert len(rows) == 5
    assert {len(row) for row in rows} == {len(head)}
    assert rows[1] == ["rear lamp", "0", "1", "0", "0", "0", "1.000"]
    assert "5 boxes without known kinds" in kinds_words(found)


def test_without_shares_or_kinds_there_is_no_table() -> None:
    shares = BoxShares("foreglow", BOXES[:1], mostly("own"))
    silent = Predictions({7: BOXES[:1].astype(np.float64)}, {7: np.ones(1)})
    assert kind_confusion(labels((7, shares)), silent, 0.5) is None
    assert kind_confusion(labels(), predictions({7: ["front_lamp"]}, {7: [0.9]}), 0.5) is None
