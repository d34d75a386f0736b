"""Checkpoints: everything that an interrupted training needs to continue as if it had not been interrupted."""

from __future__ import annotations

import pickle
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from foreglow.files import shortened
from foreglow.whole_files import open_atomic

NAME = "checkpoint.pt"
_FORMAT = 1

State = dict[str, Any]


@dataclass(slots=True)
class Checkpoint:
    """The state of a training at the end of an epoch.

    Random numbers depend on the seed and the number of the epoch alone, and the learning rate on `epochs`, so neither
    generators nor schedules need to be stored.

    Attributes:
        identity: What must be the same to continue, by name: the recipe's fields and the data's digests.
        network: Weights and buffers as they are trained.
        averaged: Their running mean; empty if the recipe wants none.
        epochs: One row of figures for each epoch.
        best_epoch: Number of the best epoch, from 1; 0 before the first.
        best: Weights and buffers of the best epoch.
    """

    identity: dict[str, Any]
    network: State
    averaged: State
    optimiser: State
    epochs: list[dict[str, float]] = field(default_factory=list)
    best_epoch: int = 0
    best: State = field(default_factory=dict)
    num_steps: int = 0


def write_checkpoint(folder: Path, checkpoint: Checkpoint) -> None:
    """Writes `checkpoint` into `folder` atomically, replacing an earlier one.

    Raises:
        OSError: If it cannot be written.
    """
    content = {name: getattr(checkpoint, name) for name in Checkpoint.__slots__}
    with open_atomic(folder / NAME) as file:
        torch.save({"format": _FORMAT, **content}, file)


def read_checkpoint(folder: Path, identity: Mapping[str, Any]) -> Checkpoint | None:
    """The checkpoint in `folder`, on the CPU; None if there is none.

    Raises:
        ValueError: If it is damaged or has another identity; the message names the first difference.
    """
    checkpoint = _whole_checkpoint(folder / NAME)
    if checkpoint is not None:
        began, wanted = _by_field(checkpoint.identity), _by_field(identity)
        _check_same(folder / NAME, began, wanted, began.keys() | wanted.keys())
    return checkpoint


def check_begun(folder: Path, recipe: Mapping[str, Any]) -> None:
    """Checks, before samples are made, that a training begun in `folder` has these fields of its recipe.

    Raises:
        ValueError: If its checkpoint is damaged, or one of them differs; the message names the first.
    """
    checkpoint = _whole_checkpoint(folder / NAME)
    if checkpoint is not None:
        wanted = _by_field(recipe)
        _check_same(folder / NAME, _by_field(checkpoint.identity), wanted, wanted.keys())


def _whole_checkpoint(path: Path) -> Checkpoint | None:
    if not path.is_file():
        return None
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
        if content.pop("format") != _FORMAT:
            raise ValueError("another format")
        return Checkpoint(**content)
    except (
        *(pickle.UnpicklingError, RuntimeError, EOFError, OSError),
        *(ValueError, LookupError, AttributeError, TypeError),
    ) as error:
        raise ValueError(f"{path}: expected a whole checkpoint, found it damaged; remove it to start anew") from error


def _check_same(path: Path, began: Mapping[str, Any], wanted: Mapping[str, Any], names: Iterable[str]) -> None:
    for name in sorted(names):
        before, now = began.get(name), wanted.get(name)
        if before != now:
            raise ValueError(
                f"{path}: {name}: expected that of the training begun here, {shortened(before)}, got {shortened(now)}; "
                "choose another folder, or remove this one"
            )


def _by_field(values: Mapping[str, Any], of: str = "") -> dict[str, Any]:
    """The values that are no tables, by the names of the tables around them and their own.

    >>> _by_field({"seed": 1, "augmentation": {"flip": 0.5}})
    {'seed': 1, 'augmentation.flip': 0.5}
    """
    fields: dict[str, Any] = {}
    for name, value in values.items():
        fields |= _by_field(value, f"{of}{name}.") if isinstance(value, Mapping) else {f"{of}{name}": value}
    return fields
