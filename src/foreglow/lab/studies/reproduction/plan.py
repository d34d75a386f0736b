"""What is asked of a reproduction of the paper: the data, our pipeline, and how much of everything."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from foreglow.config import PipelineConfig, preset
from foreglow.datasets import SplitName, split_folder, split_in
from foreglow.datasets.simulated import has_truth

MODELS = ("baseline-small", "baseline", "paper", "published", "yolo-small", "yolo-large")
"""Rows of the table of detectors whose model can be given."""

TRAINED = MODELS[:3]
"""Those whose network is trained here where it is not given."""


@dataclass(frozen=True, slots=True)
class ReproductionPlan:
    """What is asked for.

    Attributes:
        data: A data set with `test`, and perhaps `train` and `val`; the cycle `day` of one with both cycles.
        config: Our pipeline.
        pipeline: The options that gave it, for the commands that are shown.
        models: Given models, by the names of `MODELS`.
        epochs: How many to train the baseline's and the paper's network; None for the paper's 300.
        trials: Of the search for parameters.
        images: On so many images of train.
        scenes: How many simulated scenes are driven in closed loop.
        straight: Simulated drives on a straight level road, for detection by range; those of `data` without any.
        device: To train on.
        production_category: PVDN's image category for the production system's detection.
    """

    data: Path
    config: PipelineConfig = field(default_factory=lambda: preset("foreglow"))
    pipeline: tuple[str, ...] = ()
    models: Mapping[str, Path] = field(default_factory=dict)
    epochs: int | None = None
    trials: int = 200
    images: int = 600
    scenes: int = 8
    straight: tuple[Path, ...] = ()
    device: str = "auto"
    production_category: int = 6

    @property
    def root(self) -> Path:
        """Where the splits are: the paper measures on the cycle `day`."""
        return self.data / "day" if (self.data / "day").is_dir() else self.data

    def has(self, split: SplitName) -> bool:
        """Whether the data set has this split."""
        try:
            self.split(split)
        except FileNotFoundError:
            return False
        return True

    def split(self, name: SplitName) -> Path:
        """The folder of a split.

        Raises:
            FileNotFoundError: If there is none.
        """
        return split_folder(self.root, name)

    @property
    def may_train(self) -> bool:
        """Whether there is something to train networks on."""
        return self.has("train") and self.has("val")

    @property
    def is_simulated(self) -> bool:
        """Whether the test drives are simulated: the simulator's truth is beside them."""
        return has_truth(self.split("test"))

    @property
    def straight_splits(self) -> list[Path]:
        """The test drives for detection by range."""
        return [split_in(path, "test") for path in self.straight] or [self.split("test")]

    def paper_model(self, out: Path) -> Path | None:
        """The paper's network: the given one, or that of the table of detectors; None where there is neither."""
        if "paper" in self.models:
            return self.models["paper"]
        trained = out / "detector" / "models" / "paper" / "model.onnx"
        return trained if trained.is_file() else None
