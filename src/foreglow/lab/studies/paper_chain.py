"""The paper's whole chain, to be measured beside ours."""

from __future__ import annotations

from pathlib import Path

from foreglow.config import PipelineConfig, preset
from foreglow.lab.studies.detector.rows import check_given


def paper_chain(model: Path, white_level: int | None = None) -> PipelineConfig:
    """The paper's proposals, network, ground plane, tracker and policy.

    Args:
        model: The network, trained on the proposals of the preset `paper`: ONNX or a folder of `train`.
        white_level: That of the camera, as of the guard of the pipeline beside it.

    Raises:
        FileNotFoundError: If there is no such model.
        ValueError: If it is broken, or says that it is another network, of other proposals, or for another white level.
    """
    path = model / "model.onnx" if model.is_dir() else model
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such model, given with --paper-model")
    check_given({"paper": model}, white_level)
    seen = preset("paper").changed("guard", white_level=white_level)
    return seen.changed("classifier", model=path).changed("beam", policy="paper")
