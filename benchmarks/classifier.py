"""Run-time of the classifier by number of crops: `python -m benchmarks.classifier [--out FILE.json] [--quick]`.

All channels against folded, one thread. Uses the published weights where they are at hand, else random ones.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from rich.table import Table

from benchmarks.material import imported_models
from benchmarks.timing import CONSOLE, Contender, Row, in_ms, interleaved, options, table, write_results
from foreglow import _native
from foreglow.classifier import OnnxClassifier
from foreglow.config import ClassifierConfig
from foreglow.types import Frame, Proposals

NUM_CROPS = (1, 7, 32)


def measure(rounds: int) -> tuple[str, list[Row]]:
    """What the weights are; median and p99 of `classify`, crops and Python call included, and of the crops alone."""
    random = np.random.default_rng(0)
    image = random.integers(0, 256, (960, 1280)).astype(np.uint8)
    frame = Frame(image, 0)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        weights, models = imported_models(Path(folder))
        classifiers = {name: OnnxClassifier(ClassifierConfig(model=path)) for name, (path, _) in models.items()}
    for count in NUM_CROPS:
        corners = random.integers(50, 850, (count, 2))
        boxes = np.concatenate([corners, corners + random.integers(10, 60, (count, 2))], axis=1)
        proposals = Proposals(boxes.astype(np.int32))
        contenders = {
            name: Contender(partial(classifier.classify, frame, proposals), calls=5)
            for name, classifier in classifiers.items()
        }
        crops = Contender(partial(_native.extract_crops, image, proposals.boxes_xyxy_px, 2, 64), calls=5)
        times = interleaved({"crops": crops, **contenders}, rounds)
        for name in classifiers:
            row: Row = {"variant": name, "multiply_adds": models[name][1].num_multiply_adds, "num_crops": count}
            rows.append(row | times[name].figures() | {"crops_median_ms": times["crops"].median_ms})
    return weights, rows


def classifier_table(rows: Sequence[Row], weights: str) -> Table:
    figures = ("M multiply-adds a crop", "crops", "median ms", "p99 ms", "of it crops ms")
    shown = table(f"Classifier, one thread, {weights}", ("classifier",), figures)
    for row in rows:
        times = in_ms(row, "median_ms", "p99_ms", "crops_median_ms")
        shown.add_row(row["variant"], f"{row['multiply_adds'] / 1e6:.2f}", str(row["num_crops"]), *times)
    return shown


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, "classifier", arguments)
    weights, rows = measure(1 if given.quick else 40)
    CONSOLE.print(classifier_table(rows, weights))
    write_results(given.out, {"weights": weights, "classifier": rows})
    CONSOLE.print(f"look in {given.out}")


if __name__ == "__main__":
    main()
