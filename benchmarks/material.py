"""What the benchmarks work on: the published frame and weights where they lie beside the checkout, else our own."""

from __future__ import annotations

from pathlib import Path

import torch

from benchmarks.synthetic_frames import night_frame
from foreglow.datasets import open_source
from foreglow.lab.learning import import_weights
from foreglow.lab.learning.export import Layers
from foreglow.lab.learning.networks import ArtifactNetwork
from foreglow.types import Image

PUBLISHED = Path(__file__).resolve().parents[2] / "shared" / "data"
VARIANTS: dict[str, float | None] = {"all channels": None, "folded at 1e-3": 1e-3}
"""The classifiers by name, and the tolerance of their folding."""


def benchmark_frame() -> tuple[str, Image]:
    """What the frame is, and the frame: 1280x960, uint8."""
    path = PUBLISHED / "pvdn_frame_047433.png"
    if path.exists():
        return "PVDN frame 047433", next(iter(open_source(path))).image
    return "generated frame (the real one is not part of the project)", night_frame()


def imported_models(folder: Path) -> tuple[str, dict[str, tuple[Path, Layers]]]:
    """What the weights are, and the models of `VARIANTS`, written to `folder`."""
    weights, name = PUBLISHED / "pvdn_weights_pretrained.pt", "published weights"
    if not weights.exists():
        weights, name = folder / "random.pt", "random weights, of which folding can remove little"
        torch.manual_seed(0)
        torch.save(ArtifactNetwork().state_dict(), weights)
    paths = {variant: folder / f"{index}.onnx" for index, variant in enumerate(VARIANTS)}
    return name, {variant: (path, import_weights(weights, path, VARIANTS[variant])) for variant, path in paths.items()}
