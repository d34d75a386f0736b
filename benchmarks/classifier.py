"""Run-time of the classifier, all channels against folded: `python -m benchmarks.classifier [--out FILE.json]`.

Uses the published weights where they are at hand, else random ones (of which folding can remove little).
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from foreglow import _native
from foreglow.classifier import OnnxClassifier
from foreglow.config import ClassifierConfig
from foreglow.learning import import_weights
from foreglow.learning.networks import ArtifactNetwork
from foreglow.types import Proposals

PUBLISHED_WEIGHTS = Path(__file__).resolve().parents[2] / "shared" / "data" / "pvdn_weights_pretrained.pt"
NUM_CROPS = (1, 7, 32)
VARIANTS: dict[str, float | None] = {"all channels": None, "folded at 1e-3": 1e-3}


def measure(seconds: float = 2.0) -> list[dict[str, Any]]:
    """Median and 99th percentile of `classify`, crops and Python call included, and of the crops alone."""
    random = np.random.default_rng(0)
    image = random.integers(0, 256, (960, 1280)).astype(np.uint8)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        weights = PUBLISHED_WEIGHTS
        if not weights.exists():
            weights = Path(folder) / "random.pt"
            torch.save(ArtifactNetwork().state_dict(), weights)
        for variant, fold in VARIANTS.items():
            imported = import_weights(weights, Path(folder) / "model.onnx", fold)
            classifier = OnnxClassifier(ClassifierConfig(model=imported.path))
            for count in NUM_CROPS:
                corners = random.integers(50, 850, (count, 2))
                boxes = np.concatenate([corners, corners + random.integers(10, 60, (count, 2))], axis=1)
                proposals = Proposals(boxes.astype(np.int32))
                whole_ms = _times_ms(lambda p=proposals, c=classifier: c.classify(image, p), seconds)
                crops_ms = _times_ms(lambda p=proposals: _native.extract_crops(image, p.boxes_xyxy_px, 2, 64), 0.2)
                row = {"weights": weights.name, "variant": variant, "multiply_adds": imported.num_multiply_adds}
                row |= {"num_crops": count, "crops_median_ms": float(np.median(crops_ms))}
                row |= {"median_ms": float(np.median(whole_ms)), "p99_ms": float(np.percentile(whole_ms, 99))}
                rows.append(row)
    return rows


def _times_ms(call: Any, seconds: float) -> list[float]:
    times: list[float] = []
    end = time.perf_counter() + seconds
    while len(times) < 20 or time.perf_counter() < end:
        started = time.perf_counter_ns()
        call()
        times.append((time.perf_counter_ns() - started) / 1e6)
    return times[len(times) // 10 :]  # without the warm-up


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="also write the figures as JSON")
    out, rows = parser.parse_args().out, measure()
    columns = ("variant", "M multiply-adds", "crops", "median ms", "p99 ms", "of it crops ms")
    table = Table(*columns, title=f"Classifier, one thread, {rows[0]['weights']}")
    for row in rows:
        figures = (f"{row[key]:.3f}" for key in ("median_ms", "p99_ms", "crops_median_ms"))
        table.add_row(row["variant"], f"{row['multiply_adds'] / 1e6:.2f}", str(row["num_crops"]), *figures)
    Console().print(table)
    if out:
        out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
