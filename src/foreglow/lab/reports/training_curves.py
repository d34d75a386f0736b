"""The curves of a training as a picture."""

from __future__ import annotations

import csv
import importlib.util
from pathlib import Path

from foreglow.files import MIB, open_atomic, read_text

CURVES, PICTURE = "curves.csv", "curves.png"


def draw_training(folder: Path) -> None:
    """Draws the curves of the training in `folder`, if it has come to any; without the `plots` extra it does nothing.

    Raises:
        OSError: If the picture cannot be written.
    """
    if (folder / CURVES).is_file() and importlib.util.find_spec("matplotlib") is not None:
        draw_curves(folder / CURVES, folder / PICTURE)


def draw_curves(curves: Path, picture: Path) -> None:
    """Draws losses, learning rate, and precision, recall and F over the epochs of `curves`, a training's CSV.

    Raises:
        FileNotFoundError: If there are no curves.
        ModuleNotFoundError: If the `plots` extra is not installed.
    """
    from matplotlib.figure import Figure

    lines = read_text(curves, MIB).splitlines()
    rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(lines)]
    numbers = [row["number"] for row in rows]
    best = max(rows, key=lambda row: row["f1"] if row["f1"] == row["f1"] else -1.0)
    figure = Figure(figsize=(10, 4), layout="constrained")
    losses, scores = figure.subplots(1, 2)
    for name, label in (("train_loss", "training (augmented)"), ("val_loss", "validation")):
        losses.plot(numbers, [row[name] for row in rows], label=label)
    losses.set(xlabel="epoch", ylabel="loss", yscale="log")
    rates = losses.twinx()
    rates.plot(numbers, [row["learning_rate"] for row in rows], color="grey", linewidth=0.8, linestyle=":")
    rates.set_ylabel("learning rate (dotted)")
    losses.legend()
    for name, label in (("f1", "F"), ("precision", "precision"), ("recall", "recall")):
        scores.plot(numbers, [row[name] for row in rows], label=label)
    scores.set(xlabel="epoch", ylim=(0, 1), title=f"validation boxes, score 0.5: F {best['f1']:.3f} at best")
    scores.legend(loc="lower right")
    with open_atomic(picture) as target:
        figure.savefig(target, format="png", dpi=120)
