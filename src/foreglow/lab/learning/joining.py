"""One model of two: their mean, calibrated anew. Importing this needs the `train` extra.

`python -m foreglow.lab.learning.joining ALONE RELATED --judge DATA... --cache DIR --out FILE` makes the model that
ships, of one that judges each box alone and one that compares the boxes of a frame, which were trained for themselves.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from foreglow.classifier.learnt import PROPOSALS, proposals_text
from foreglow.config import preset
from foreglow.datasets import open_labelled, split_folder
from foreglow.lab.learning.annotation import IGNORED
from foreglow.lab.learning.model_export import calibrated, largest_difference, write_model
from foreglow.lab.learning.model_import import FoldedBothNetwork, FoldedNetwork, FoldedRelatedNetwork, read_model
from foreglow.lab.learning.recipes import RECIPES
from foreglow.lab.learning.samples import Samples, joined
from foreglow.lab.learning.scores import Calibrator, fit_calibrator
from foreglow.lab.learning.training import score_samples
from foreglow.lab.learning.training_run import NUM_COMPARED, labelled_samples
from foreglow.provenance import provenance

_RECIPE = RECIPES["foreglow"]
_CPU = torch.device("cpu")


def join(alone: Path, related: Path, val: Samples, out: Path) -> Calibrator:
    """Writes the mean of two models, as in `networks.BothNetwork`, calibrated by these samples.

    Raises:
        FileNotFoundError: If there is no such model.
        ValueError: If the models are not of the recipes `compact` and `related`, or read or tell something else than
            these, or the one that is written does not compute what it should.
        OSError: If it cannot be written.
    """
    inputs = _RECIPE.inputs
    network = FoldedBothNetwork(inputs.num_channels, inputs.num_features, _RECIPE.num_outputs)
    network.alone, network.related = _member(alone, "compact"), _member(related, "related")
    is_known = val.labels != IGNORED
    logits = score_samples(network, val, _CPU)
    calibrator = fit_calibrator(logits[is_known], val.labels[is_known], _RECIPE.calibration)
    done = calibrated(network, calibrator)
    about = {name: str(value) for name, value in provenance().items() if name != "version"}
    write_model(done, inputs, out, about | {PROPOSALS: proposals_text(preset("foreglow").proposals)})
    few = val.whole_sets(NUM_COMPARED)
    largest_difference(out, few, score_samples(done, few, _CPU))
    return calibrator


def _member(path: Path, recipe: str) -> Any:
    """The network of a model of a recipe whose inputs are as they are there."""
    start, made = read_model(path), FoldedRelatedNetwork if recipe == "related" else FoldedNetwork
    if not (type(start.network) is made and start.inputs == RECIPES[recipe].inputs and start.has_kinds):
        raise ValueError(f"{path}: expected a model of the recipe {recipe}, with its inputs, that tells kinds of light")
    return start.network


def main(arguments: Sequence[str] | None = None) -> None:
    """Makes the model, as the module's docstring says."""
    parser = argparse.ArgumentParser(prog="python -m foreglow.lab.learning.joining", description=__doc__)
    parser.add_argument("alone", type=Path, metavar="ALONE", help="a model of the recipe compact")
    parser.add_argument("related", type=Path, metavar="RELATED", help="a model of the recipe related")
    parser.add_argument(
        "--judge", nargs="+", type=Path, metavar="DATA", required=True, help="data sets whose split val calibrates"
    )
    parser.add_argument("--cache", type=Path, required=True, help="where samples are kept, such as those of a training")
    parser.add_argument("--out", type=Path, required=True, help="the model to write")
    given = parser.parse_args(arguments)
    config = preset("foreglow")
    try:
        splits = [open_labelled(split_folder(path, "val")) for path in given.judge]
        val = joined([labelled_samples(split, _RECIPE, config, "val", given.cache, None) for split in splits])
        calibrator = join(given.alone, given.related, val, given.out)
    except (OSError, ValueError) as error:
        parser.exit(2, f"{parser.prog}: {error}\n")
    print(f"{given.out}: temperature {calibrator.temperature:.2f}, shift {calibrator.shift:.2f}")  # noqa: T201


if __name__ == "__main__":
    main()
