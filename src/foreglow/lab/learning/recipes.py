"""Recipes: everything that determines a training, except the data."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import tomli_w
from pydantic import Field, model_validator

from foreglow.classifier.inputs import FEATURES, InputSpec
from foreglow.config import FrozenModel, read_toml, validated
from foreglow.lab.learning.samples import Inputs, Jitter
from foreglow.types import KINDS
from foreglow.types.arrays import check_kind
from foreglow.wording import check_one_of

Share: TypeAlias = Annotated[float, Field(ge=0, le=1)]


MAX_EPOCHS = 100_000
"""Far beyond any training; published ones have 300."""


class Augmentation(FrozenModel):
    """Random changes of training crops; the defaults change nothing.

    Attributes:
        flip: Probability of a reflection left to right.
        rotation_deg: Largest rotation to either side; areas from outside the crop are black.
        min_area: Smallest area, as a share of the crop's, of the window that is stretched to the crop's size.
        max_ratio: Largest ratio of the window's sides, either way; uniform in the logarithm.
        gamma: The exponent is 1 / g with g in 1 - gamma .. 1 + gamma.
        noise: Largest standard deviation of the noise on every pixel, drawn for each crop from 0; white is 1.
        normalise: Stretch every crop to [0, 1] afterwards by its own range, a second channel by that of the first.
        history_dropout: Probability that the second channel, the earlier image, is black, as at a sequence's start.
        feature_noise: Standard deviation of the noise on the features, in units of their standard deviations over the
            training samples.
        zoom: Where the boxes of a frame are read together, the frame is enlarged by up to exp(zoom), or made smaller.
    """

    flip: Share = 0.0
    rotation_deg: Annotated[float, Field(ge=0, le=180)] = 0.0
    min_area: Annotated[float, Field(gt=0, le=1)] = 1.0
    max_ratio: Annotated[float, Field(ge=1, le=10)] = 1.0
    gamma: Annotated[float, Field(ge=0, lt=1)] = 0.0
    noise: Share = 0.0
    normalise: bool = False
    history_dropout: Share = 0.0
    feature_noise: Annotated[float, Field(ge=0, le=10)] = 0.0
    zoom: Share = 0.0


class Recipe(FrozenModel):
    """How a network is trained.

    Attributes:
        network: Name of the network, a key of `networks.NETWORKS`.
        jitter: Moved and resized copies of the training boxes.
        epochs: Largest number of passes over the training samples.
        patience: Training ends after this many epochs without a better one; None trains all epochs, as `best_by` with
            `last` does.
        optimiser: `adam` adds the weight decay to the gradient (L2, as published), `adamw` subtracts it from the
            weights.
        learning_rate: At the start, or after the warm-up.
        weight_decay: Strength of the decay; `adamw` does not decay biases and normalisation.
        schedule: `plateau` multiplies the rate by `plateau_factor` once the validation loss has not fallen for more
            than `plateau_patience` epochs; `cosine` falls at every step, to zero at the last epoch; `constant`.
        plateau_factor: See `schedule`.
        plateau_patience: See `schedule`.
        warmup_epochs: Number of epochs, also fractional, over which the rate rises from zero; not with `plateau`.
        max_gradient: The gradient's norm is clipped to this; None does not clip.
        ema_decay: Decay of an exponential moving average of the weights, which is then validated and kept; 0 keeps the
            weights themselves.
        positive_weight: Weight of a positive sample against a negative one in the loss: `balanced` is negatives over
            positives (as published), `equal` is 1.
        group_balance: How evenly the groups of light artifacts (what the light is seen on, vehicle hidden or in sight)
            count among the positives: with 0 each sample counts the same, with 1 each group. Weights are proportional
            to 1 / size of the group to this power, and 1 on average.
        label_smoothing: Labels are moved by this share towards 1/2.
        kinds: Whether the network tells the five kinds of light in `KINDS`; otherwise it only tells whether there is
            light of a vehicle.
        by_light: Whether boxes are labelled by whose light is in them, where the data set stores that for the boxes of
            the preset, instead of by key points.
        unmarked_light: With `by_light`, how much of vehicles' light counts in a box without any key point; the rest
            counts as none, so that what a person would mark comes first.
        max_negatives_per_positive: Largest number of negatives for each positive in an epoch, drawn again each time;
            None for all.
        taught: Where a training has teachers, how much of the targets is what these say; the rest is whose light it is.
        without_lamps: Where the boxes of a frame are read together, share of the frames whose lamps in sight are left
            out, drawn again in each epoch: what else a vehicle lights is then seen as if the vehicle were hidden.
        augmentation: Random changes of training crops; validation samples are never changed.
        best_by: The kept epoch has the least validation loss, or the greatest validation F at a score of 0.5, or is the
            last one.
        calibration: `temperature` divides the logits so that the scores of the validation samples are probabilities,
            `platt` also shifts them (which moves the threshold); `none` leaves them.
        precision: `bf16` computes with bfloat16 where that is safe: faster on processors and GPUs that support it.

    Source: Ewecker et al., arXiv 2107.11302, and the published code, for what `RECIPES["paper"]` sets.
    """

    network: str
    inputs: Inputs = InputSpec()
    jitter: Jitter = Jitter()
    epochs: Annotated[int, Field(ge=1, le=MAX_EPOCHS)]
    patience: Annotated[int, Field(ge=1, le=MAX_EPOCHS)] | None = None
    batch_size: Annotated[int, Field(ge=2, le=65536)]
    optimiser: Literal["adam", "adamw"]
    learning_rate: Annotated[float, Field(gt=0, le=10)]
    weight_decay: Annotated[float, Field(ge=0, le=10)]
    schedule: Literal["plateau", "cosine", "constant"]
    plateau_factor: Annotated[float, Field(gt=0, lt=1)] = 0.9
    plateau_patience: Annotated[int, Field(ge=0, le=MAX_EPOCHS)] = 5
    warmup_epochs: Annotated[float, Field(ge=0)] = 0.0
    max_gradient: Annotated[float, Field(gt=0)] | None = None
    ema_decay: Annotated[float, Field(ge=0, lt=1)] = 0.0
    positive_weight: Literal["balanced", "equal"] = "balanced"
    group_balance: Share = 0.0
    label_smoothing: Share = 0.0
    kinds: bool = False
    by_light: bool = False
    unmarked_light: Share = 1.0
    max_negatives_per_positive: Annotated[float, Field(gt=0)] | None = None
    without_lamps: Share = 0.0
    taught: Share = 0.8
    augmentation: Augmentation = Augmentation()
    best_by: Literal["loss", "f1", "last"] = "loss"
    calibration: Literal["none", "temperature", "platt"] = "temperature"
    precision: Literal["fp32", "bf16"] = "fp32"
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 1

    @model_validator(mode="after")
    def _check(self) -> Recipe:
        if self.schedule == "plateau" and self.warmup_epochs:
            raise ValueError("warmup_epochs: expected 0 with the schedule plateau")
        if self.inputs.together != (self.network in ("related", "both")):
            wanted = "false" if self.inputs.together else "true"
            raise ValueError(f"inputs.together: expected {wanted} with the network {self.network}")
        if self.inputs.together and self.max_negatives_per_positive is not None:
            raise ValueError(
                "max_negatives_per_positive: expected none where inputs.together, since all boxes are read"
            )
        if self.without_lamps and not self.inputs.together:
            raise ValueError(f"without_lamps: expected 0 without inputs.together, got {self.without_lamps:g}")
        if self.best_by == "last" and self.patience is not None:
            raise ValueError(f"patience: expected none where best_by is last, as each epoch is, got {self.patience}")
        if self.warmup_epochs > self.epochs:
            raise ValueError(f"warmup_epochs: expected at most epochs, {self.epochs}, got {self.warmup_epochs:g}")
        return self

    @property
    def num_outputs(self) -> int:
        """Number of logits for each sample: one of being light, or one for each kind."""
        return len(KINDS) if self.kinds else 1


_COMPACT = Recipe(
    network="compact",
    inputs=InputSpec(size_px=32, lag_s=0.25, num_features=9, context=6),
    jitter=Jitter(num_copies=1),
    epochs=30,
    batch_size=256,
    optimiser="adamw",
    learning_rate=2e-3,
    weight_decay=0.01,
    schedule="cosine",
    warmup_epochs=1.0,
    max_gradient=5.0,
    ema_decay=0.998,
    max_negatives_per_positive=4.0,
    positive_weight="equal",
    group_balance=0.25,
    kinds=True,
    by_light=True,
    unmarked_light=0.5,
    augmentation=Augmentation(
        flip=0.5,
        rotation_deg=8.0,
        min_area=0.8,
        max_ratio=1.2,
        gamma=0.5,
        noise=0.04,
        normalise=True,
        history_dropout=0.3,
        feature_noise=0.4,
    ),
    best_by="f1",
    calibration="platt",
)

# Judges the boxes of a frame together; the samples are half as many without copies, and 12 epochs are enough.
_RELATED = _COMPACT.model_copy(
    update={
        "network": "related",
        "inputs": dataclasses.replace(_COMPACT.inputs, num_features=len(FEATURES), together=True),
        "jitter": Jitter(),
        "epochs": 12,
        "without_lamps": 0.2,
        "max_negatives_per_positive": None,
        "augmentation": _COMPACT.augmentation.model_copy(update={"zoom": 0.5}),
    }
)

RECIPES: dict[str, Recipe] = {
    # Paper: 300 epochs, Adam 1e-3, batch 64, weight decay 0.01, BCE. Published code: the rest.
    "paper": Recipe(
        network="paper",
        epochs=300,
        batch_size=64,
        optimiser="adam",
        learning_rate=1e-3,
        weight_decay=0.01,
        schedule="plateau",
        augmentation=Augmentation(flip=0.5, rotation_deg=20.0, min_area=0.8, max_ratio=1.5, gamma=0.2, normalise=True),
        calibration="none",
    ),
    "compact": _COMPACT,
    "related": _RELATED,
    "foreglow": _RELATED.model_copy(update={"network": "both"}),
}
"""Recipes by name."""


_NONE = "none"
_OPTIONAL = ("patience", "max_gradient", "max_negatives_per_positive")


def recipe(name: str) -> Recipe:
    """The recipe called `name`.

    Raises:
        ValueError: If there is no such recipe; the message lists those that exist.

    >>> recipe("paper").epochs
    300
    """
    check_one_of(name, RECIPES, "recipe")
    return RECIPES[name]


def changed(base: Recipe, fields: dict[str, Any], origin: str = "recipe") -> Recipe:
    """`base` with some fields changed; a table, such as `augmentation`, changes only the fields that it names.

    Raises:
        ValueError: If an argument is of another kind, or a field is unknown or out of range; the message names `origin`
            and the field.
    """
    check_kind("base", base, Recipe)
    check_kind("fields", fields, dict)
    known = list(dict.fromkeys(each.network for each in RECIPES.values()))
    check_one_of(fields.get("network", known[0]), known, f"{origin}: network")  # before what else it would have to be
    merged: dict[str, Any] = base.model_dump()
    for name, value in fields.items():
        before = merged.get(name)
        merged[name] = before | value if isinstance(before, dict) and isinstance(value, dict) else value
    return validated(Recipe, merged, origin)


def read_recipe(path: Path, base: Recipe) -> Recipe:
    """The recipe in the TOML file `path`; what it does not mention comes from `base`.

    TOML has no None: "none" stands for it in `patience`, `max_gradient`, `max_negatives_per_positive`,
    `inputs.lag_s` and `inputs.context`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not TOML, or a field is unknown or out of range; the message names path and field.
    """
    fields = _mapped(read_toml(path), lambda value: None if value == _NONE else value)
    return changed(base, fields, str(path))


def recipe_to_toml(recipe: Recipe) -> str:
    """`recipe` as TOML text that `read_recipe` reads back equal, over any base."""
    return tomli_w.dumps(_mapped(recipe.model_dump(mode="json"), lambda value: _NONE if value is None else value))


def _mapped(fields: dict[str, Any], change: Callable[[Any], Any]) -> dict[str, Any]:
    """`fields` with the values that may be None changed."""
    inputs = fields.get("inputs")
    optional = {name: change(value) for name, value in fields.items() if name in _OPTIONAL}
    if isinstance(inputs, dict):
        optional["inputs"] = inputs | {name: change(inputs[name]) for name in ("lag_s", "context") if name in inputs}
    return fields | optional
