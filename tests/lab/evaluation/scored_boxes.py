"""Random and hand-made keypoints, boxes and lights for the tests of the figures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.lab.evaluation import Predictions, SplitLabels
from foreglow.lab.evaluation.boxes.lights import Light


def predictions_of(images: Mapping[int, Sequence[tuple[float, ...]]]) -> Predictions:
    """Rows of x1, y1, x2, y2, score by image id."""
    rows = {image_id: np.array(boxes, np.float64).reshape(-1, 5) for image_id, boxes in images.items()}
    return Predictions({key: row[:, :4] for key, row in rows.items()}, {key: row[:, 4] for key, row in rows.items()})


def random_case(seed: int, num_images: int = 12) -> tuple[dict[int, NDArray[np.float64]], Predictions]:
    """Crowded images, with boxes that share keypoints and scores that tie."""
    rng = np.random.default_rng(seed)
    points, boxes, scores = {}, {}, {}
    for image_id in range(num_images):
        points[image_id] = rng.integers(0, 60, (rng.integers(0, 6), 2)).astype(np.float64)
        corners = rng.integers(0, 50, (rng.integers(0, 9), 2))
        boxes[image_id] = np.hstack([corners, corners + rng.integers(1, 25, corners.shape)]).astype(np.float64)
        scores[image_id] = rng.integers(0, 11, len(corners)) / 10.0
    return points, Predictions(boxes, scores)


def light(image_id: int, x: float, y: float, **fields: Any) -> Light:
    """A lamp in sight, but for `fields`."""
    ordinary: dict[str, Any] = {"vehicle_id": 0, "kind": "lamp", "is_rear": False, "is_hidden": False}
    given = ordinary | {"sequence_id": image_id // 100} | fields
    return Light(image_id=image_id, position_px=(x, y), is_direct=given["kind"] == "lamp", **given)


def split_labels(
    lights: Mapping[int, Sequence[Light]],
    *,
    doubtful_px: Mapping[int, Sequence[tuple[float, float]]] | None = None,
    empty: Sequence[int] = (),
    rate_hz: float = 2.0,
) -> SplitLabels:
    """Labels of images whose ids are a sequence's number times 100 plus their place in it."""
    doubtful = doubtful_px or {}
    return SplitLabels(
        name="made up",
        rate_hz=rate_hz,
        lights={image_id: tuple(its) for image_id, its in lights.items()},
        doubtful_px={each: np.array(doubtful.get(each, []), np.float64).reshape(-1, 2) for each in lights},
        empty_images=frozenset(empty),
        weather_of={each: "rain" if each // 100 else "dry" for each in lights},
        sequence_of={each: each // 100 for each in lights},
        time_s={each: each % 100 / rate_hz for each in lights},
        scenario_of={each: "village" if each // 100 else "motorway" for each in lights},
    )


def is_same(value: float, other: float) -> bool:
    """Equal up to rounding, or both NaN."""
    return math.isclose(value, other, abs_tol=1e-12) or (math.isnan(value) and math.isnan(other))
