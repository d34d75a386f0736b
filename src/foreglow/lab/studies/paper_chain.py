"""The paper's whole chain, to be measured beside ours."""

from __future__ import annotations

from pathlib import Path

from foreglow.config import PipelineConfig, preset
from foreglow.lab.studies.detector.rows import check_given


def paper_chain(model: Path) -> PipelineConfig:
    """The paper's proposals, network, ground plane, tracker and policy.

    Args:
        model: The network, trained on the proposals of the preset `paper`: ONNX or a folder of `train`.

    Raises:
        FileNotFoundError: If there is no such model.
        ValueError: If it is broken, or says that it is another network, or of other proposals.
    """
    path = model / "model.onnx" if model.is_dir() else model
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such model, given with --paper-model")
    check_given({"paper": model})
    return preset("paper").changed("classifier", model=path).changed("beam", policy="paper")
