from __future__ import annotations

import numpy as np

from foreglow.lab.evaluation.boxes.matching import smallest_box


def test_the_smallest_box_counts() -> None:
    boxes = np.array([[0, 0, 100, 100], [40, 40, 60, 50], [40, 40, 50, 60], [70, 70, 80, 80]], np.int32)
    assert smallest_box((45.0, 45.0), boxes) == 1
    assert smallest_box((80.0, 75.0), boxes) == 3  # all edges belong to a box
    assert smallest_box((10.0, 10.0), boxes) == 0
    assert smallest_box((101.0, 10.0), boxes) is None
    assert smallest_box((1.0, 1.0), boxes[:0]) is None
