"""A picture of what a fine-tuned model accepts and the one before did not, and the other way round."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.display.overlay import Colour, Picture
from foreglow.display.pen import Pen
from foreglow.display.tone import Tone
from foreglow.files import write_atomic
from foreglow.lab.learning.annotation import NEGATIVE, POSITIVE
from foreglow.lab.learning.fine_tuning import Judged

PICTURE = "changes.jpg"

MAX_IMAGES = 8
"""The picture has those with the most changes."""

WIDTH_PX = 720
"""Of an image in the picture."""

_LIGHT: Colour = (80, 220, 80)
_FALSE: Colour = (80, 80, 255)
_DOUBTFUL: Colour = (0, 200, 255)
_COLOURS = {POSITIVE: _LIGHT, NEGATIVE: _FALSE}


def draw_changes(judged: Sequence[Judged], folder: Path) -> Path | None:
    """Draws the images with the most changed boxes, before on the left and after on the right; None without any.

    Accepted boxes with labelled light are green, those without are red, and those with doubtful light yellow.

    Raises:
        FileNotFoundError: If an image is missing.
        OSError: If the picture cannot be written.
    """
    counts = []
    for part, each in enumerate(judged):
        if each.images is not None:
            has_changed = (each.before > each.threshold) != (each.after > each.threshold)
            ids, numbers = np.unique(each.samples.image_ids[has_changed], return_counts=True)
            counts += [(-int(number), part, int(image_id)) for image_id, number in zip(ids, numbers, strict=True)]
    if not counts:
        return None
    rows = [_row(judged[part], image_id) for _, part, image_id in sorted(counts)[:MAX_IMAGES]]
    write_atomic(folder / PICTURE, cv2.imencode(".jpg", np.concatenate(rows))[1].tobytes())
    return folder / PICTURE


def _row(judged: Judged, image_id: int) -> Picture:
    """An image with its accepted boxes, before and after, side by side."""
    assert judged.images is not None
    image = judged.images.read(image_id).image
    height_px = round(WIDTH_PX * image.shape[0] / image.shape[1])
    grey = cv2.resize(Tone.of(image).curve[image], (WIDTH_PX, height_px), interpolation=cv2.INTER_AREA)
    is_here = judged.samples.image_ids == image_id
    boxes, labels = judged.samples.boxes_xyxy_px[is_here], judged.samples.labels[is_here]
    pictures = []
    for word, scores in (("before", judged.before), ("after", judged.after)):
        picture: Any = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
        is_accepted = scores[is_here] > judged.threshold
        _draw(picture, boxes[is_accepted] * (WIDTH_PX / image.shape[1]), labels[is_accepted])
        Pen(height_px).write(picture, f"{word}: image {image_id}", (8, height_px - 8), (255, 255, 255), size=28)
        pictures.append(picture)
    return np.concatenate(pictures, axis=1)


def _draw(picture: Picture, boxes_xyxy_px: NDArray[np.float64], labels: NDArray[np.int8]) -> None:
    for box, label in zip(np.rint(boxes_xyxy_px).astype(int).tolist(), labels.tolist(), strict=True):
        cv2.rectangle(picture, box[:2], box[2:], _COLOURS.get(label, _DOUBTFUL), 1, cv2.LINE_AA)
