"""Pictures of a training: its curves, and what a fine-tuned model accepts and the one before did not, or vice versa."""

from __future__ import annotations

import csv
import dataclasses
import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.display.overlay import Colour, Picture
from foreglow.display.pen import REFERENCE_HEIGHT_PX, Pen
from foreglow.display.tone import Tone
from foreglow.files import MIB, number_in, read_text
from foreglow.lab.learning.annotation import NEGATIVE, POSITIVE
from foreglow.lab.learning.fine_tuning import Judged
from foreglow.lab.learning.training_progress import Epoch
from foreglow.whole_files import open_atomic, write_atomic
from foreglow.wording import shortened

CURVES, PICTURE = "curves.csv", "curves.png"


def draw_training(folder: Path, judged: Sequence[Judged] = ()) -> None:
    """Draws the curves of the training in `folder`, if it has come to any, and of a fine-tuning, what has changed.

    Without the `plots` extra there are no curves.

    Raises:
        FileNotFoundError: If an image is missing.
        ValueError: If the curves are damaged.
        OSError: If a picture cannot be written.
    """
    draw_changes(judged, folder)
    if (folder / CURVES).is_file() and importlib.util.find_spec("matplotlib") is not None:
        draw_curves(folder / CURVES, folder / PICTURE)


def draw_curves(curves: Path, picture: Path) -> None:
    """Draws losses, learning rate, and precision, recall and F over the epochs of `curves`, a training's CSV.

    Raises:
        FileNotFoundError: If there are no curves.
        ValueError: If they are damaged; the message names the line and the column.
        ModuleNotFoundError: If the `plots` extra is not installed.
    """
    from matplotlib.figure import Figure

    rows = _rows(curves)
    numbers = [row["number"] for row in rows]
    marker = "." if len(rows) == 1 else None  # of a single epoch there is no line
    figure = Figure(figsize=(10, 4), layout="constrained")
    losses, scores = figure.subplots(1, 2)
    for name, label in (("train_loss", "training (augmented)"), ("val_loss", "validation")):
        losses.plot(numbers, [row[name] for row in rows], marker=marker, label=label)
    losses.set(xlabel="epoch", ylabel="loss", yscale="log")
    rates = losses.twinx()
    rates.plot(numbers, [row["learning_rate"] for row in rows], color="grey", linewidth=0.8, linestyle=":")
    rates.set_ylabel("learning rate (dotted)")
    losses.legend()
    for name, label in (("f1", "F"), ("precision", "precision"), ("recall", "recall")):
        scores.plot(numbers, [row[name] for row in rows], marker=marker, label=label)
    scores.set(xlabel="epoch", ylim=(0, 1), title=f"validation boxes, score > {rows[-1]['threshold']:g}")
    scores.legend(loc="lower right")
    with open_atomic(picture) as target:
        figure.savefig(target, format="png", dpi=120)


def _rows(curves: Path) -> list[dict[str, float]]:
    """The figures of each epoch.

    Raises:
        ValueError: If one is missing or is no number, or there is no epoch.
    """
    names = [field.name for field in dataclasses.fields(Epoch)]
    rows = []
    try:
        for number, row in enumerate(csv.DictReader(read_text(curves, MIB).splitlines()), start=2):
            for name in names:
                if not _is_number(row.get(name)):
                    value = shortened(row.get(name)) if row.get(name) is not None else "nothing"
                    raise ValueError(f"{curves}: line {number}: {name}: expected a number, got {value}")
            rows.append({name: float(row[name]) for name in names})
    except csv.Error as error:
        raise ValueError(f"{curves}: expected the curves of a training: {error}") from None
    if not rows:
        raise ValueError(f"{curves}: expected a line for each epoch of a training, got none")
    return rows


def _is_number(text: str | None) -> bool:
    try:
        number_in(text or "")
    except ValueError:
        return False
    return True


CHANGES = "changes.jpg"

MAX_IMAGES = 8
"""The picture has those with the most changes."""

WIDTH_PX = 720
"""Of an image in the picture."""

_LIGHT: Colour = (80, 220, 80)
_FALSE: Colour = (80, 80, 255)
_DOUBTFUL: Colour = (0, 200, 255)
_COLOURS = {POSITIVE: _LIGHT, NEGATIVE: _FALSE}
LEGEND = {"light of a vehicle": _LIGHT, "no light of a vehicle": _FALSE, "doubtful": _DOUBTFUL}
LEGEND_HEIGHT_PX = 28


def draw_changes(judged: Sequence[Judged], folder: Path) -> None:
    """Draws the images with the most changed boxes, if there are any: before on the left and after on the right.

    Accepted boxes with labelled light are green, those without are red, and those with doubtful light yellow, as the
    legend on top says.

    Raises:
        FileNotFoundError: If an image is missing.
        OSError: If the picture cannot be written.
    """
    counts = []
    for part, each in enumerate(judged):
        if each.images is not None:
            ids, numbers = np.unique(each.samples.image_ids[each.is_changed], return_counts=True)
            counts += [(-int(number), part, int(image_id)) for image_id, number in zip(ids, numbers, strict=True)]
    if not counts:
        return
    rows = [_legend(), *(_row(judged[part], image_id) for _, part, image_id in sorted(counts)[:MAX_IMAGES])]
    write_atomic(folder / CHANGES, cv2.imencode(".jpg", np.concatenate(rows))[1].tobytes())


def _legend() -> Picture:
    """What the colours of boxes mean, as wide as a row."""
    picture: Picture = np.zeros((LEGEND_HEIGHT_PX, 2 * WIDTH_PX, 3), np.uint8)
    pen, x_px, middle_px = Pen(REFERENCE_HEIGHT_PX), 8, LEGEND_HEIGHT_PX // 2
    words = "accepted boxes, labelled as:"
    pen.write(picture, words, (x_px, middle_px + 5), (255, 255, 255), size=10)
    x_px += pen.width_px(words, size=10) + 16
    for words, colour in LEGEND.items():
        cv2.rectangle(picture, (x_px, middle_px - 7), (x_px + 14, middle_px + 7), colour, cv2.FILLED)
        pen.write(picture, words, (x_px + 22, middle_px + 5), (255, 255, 255), size=10)
        x_px += pen.width_px(words, size=10) + 46
    return picture


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
