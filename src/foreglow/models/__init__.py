"""The model that ships with Foreglow; the card beside it says what it was trained on and what it can do."""

from __future__ import annotations

from pathlib import Path

BUNDLED = "foreglow"
"""Name of the model."""

SHA256 = "e39a928671841e7149ea9a1e621bc8d4ce1ffe9d8a0ce8105dac67cd516b3459"
"""Of the model's file: a wrong bit in its weights would go unnoticed otherwise."""

OLD_SAMPLES = Path(__file__).parent / "foreglow_samples.npz"
"""A little of what the model learnt from, for training it further; `foreglow.lab.learning.old_samples` makes it."""


def model_path(model: Path) -> Path:
    """Where the model lies: that of the package for the name `BUNDLED`, else `model` itself.

    >>> model_path(Path("foreglow")).name
    'foreglow.onnx'
    >>> model_path(Path("runs/mine/model.onnx")).as_posix()
    'runs/mine/model.onnx'
    """
    if str(model) == BUNDLED:
        return Path(__file__).parent / f"{model}.onnx"
    return model
