"""The rows of the detector's table, and what the user decides about them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeAlias

from foreglow.datasets import SplitName

RowKind: TypeAlias = Literal["classifier", "yolo"]

THRESHOLD = 0.5
"""A box counts if its score is above. Source: published evaluation."""


@dataclass(frozen=True, slots=True)
class RowSpec:
    """One row of the table.

    Attributes:
        title: What the reader sees.
        kind: Proposals with a classifier, or a YOLO.
        preset: The proposals that are classified, or on whose labelled boxes the YOLO is trained.
        recipe: How the classifier is trained here, a name of `learning.recipes`; empty where it is only ever given.
        size: The YOLO's.
        option: The option of the command that gives a trained model.
    """

    title: str
    kind: RowKind
    preset: str
    option: str
    recipe: str = ""
    size: Literal["", "s", "x"] = ""


ROWS: dict[str, RowSpec] = {
    "baseline": RowSpec("Baseline's preset, paper's network", "classifier", "baseline", "--baseline-model", "paper"),
    "paper": RowSpec("Paper's preset and network", "classifier", "paper", "--paper-model", "paper"),
    "published": RowSpec("Paper's preset, published weights", "classifier", "paper", "--published"),
    "compact": RowSpec("Paper's preset, compact network", "classifier", "paper", "--compact-model", "foreglow"),
    "ours": RowSpec("Ours: preset foreglow, compact network", "classifier", "foreglow", "--our-model", "foreglow"),
    "yolo-small": RowSpec("YOLO, small", "yolo", "paper", "--yolo-small", size="s"),
    "yolo-large": RowSpec("YOLO, large", "yolo", "paper", "--yolo-large", size="x"),
}
"""The table's rows by name, in its order."""

COMPARISONS = (("compact", "paper"), ("ours", "paper"), ("ours", "baseline"), ("ours", "yolo-small"))
"""Rows whose F is compared scene by scene: the first less the second."""


@dataclass(frozen=True, slots=True)
class DetectorPlan:
    """What is asked for.

    Attributes:
        rows: Names of rows, of `ROWS`.
        given: Trained models by row: an ONNX file or a folder of `train`, or for a YOLO a folder of `yolo train`.
        split: The split that everything is measured on.
        may_train: Whether rows without a given model are trained.
        with_yolo: Whether the YOLO rows are made.
        epochs: By recipe, how many to train; a recipe that is not named has its own number.
        patience: Training ends this many epochs after the best one; None for the recipe's.
        seed: Of all training, and of the bootstrap.
        yolo_epochs: Passes over the training split for a YOLO that is trained here.
        yolo_image_size_px: Side of its images.
        device: `auto`, `cpu` or `cuda`.
    """

    rows: tuple[str, ...] = tuple(ROWS)
    given: Mapping[str, Path] = field(default_factory=dict)
    split: SplitName = "test"
    may_train: bool = True
    with_yolo: bool = True
    epochs: Mapping[str, int] = field(default_factory=dict)
    patience: int | None = None
    seed: int = 1
    yolo_epochs: int = 3
    yolo_image_size_px: int = 320
    device: str = "auto"

    def __post_init__(self) -> None:
        for name in (*self.rows, *self.given):
            if name not in ROWS:
                raise ValueError(f"rows: expected some of {', '.join(ROWS)}, got {name!r}")
        if len(set(self.rows)) < len(self.rows):
            raise ValueError(f"rows: expected each once, got {', '.join(self.rows)}")
        for name, path in self.given.items():
            if not path.exists():
                raise FileNotFoundError(f"{path}: no such model, given with {ROWS[name].option}")
