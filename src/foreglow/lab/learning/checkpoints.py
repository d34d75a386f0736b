"""Checkpoints: everything that an interrupted training needs to continue as if it had not been interrupted."""

from __future__ import annotations

import contextlib
import dataclasses
import io
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from foreglow.lab.learning.kept_files import read_torch_file
from foreglow.lab.learning.training_progress import Epoch
from foreglow.whole_files import write_atomic
from foreglow.wording import shortened

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
    file = io.BytesIO()  # torch.save does not say of a disk that it is full
    torch.save({"format": _FORMAT, **content}, file)
    write_atomic(folder / NAME, file.getvalue())


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
    if not path.exists():
        return None
    with whole(path.parent):
        content = read_torch_file(path)
        if content.pop("format") != _FORMAT:
            raise ValueError("another format")
        checkpoint = Checkpoint(**content)
        _check_kinds(checkpoint)
    return checkpoint


@contextlib.contextmanager
def whole(folder: Path) -> Iterator[None]:
    """What cannot be done in the block with what the checkpoint in `folder` holds is the fault of that file.

    Raises:
        ValueError: If so.
    """
    try:
        yield
    except (RuntimeError, EOFError, OSError, ValueError, LookupError, AttributeError, TypeError) as error:
        raise ValueError(
            f"{folder / NAME}: expected a whole checkpoint, found it damaged; remove it to start anew"
        ) from error


def _check_kinds(checkpoint: Checkpoint) -> None:
    """Checks what a training takes for granted of its own checkpoint.

    Raises:
        ValueError: If a value is of another kind, or a weight is not finite.
        TypeError: Likewise.
    """
    states = (checkpoint.network, checkpoint.averaged, checkpoint.best)
    are_tables = all(isinstance(table, dict) for table in (checkpoint.identity, checkpoint.optimiser, *states))
    if not are_tables or not all(bool(torch.isfinite(value).all()) for state in states for value in state.values()):
        raise ValueError("expected tables, and finite weights")
    names = {each.name for each in dataclasses.fields(Epoch)}
    for row in checkpoint.epochs:
        if row.keys() != names or not all(type(value) in (int, float) for value in row.values()):
            raise ValueError("expected the figures of an epoch")
    counts = (checkpoint.best_epoch, checkpoint.num_steps)
    is_counted = all(type(count) is int and count >= 0 for count in counts)
    if not is_counted or not min(1, len(checkpoint.epochs)) <= checkpoint.best_epoch <= len(checkpoint.epochs):
        raise ValueError("expected the number of the best epoch, and that of all steps")


def shapes(state: State) -> dict[str, torch.Size]:
    """The shape of each tensor, by name."""
    return {name: value.shape for name, value in state.items()}


def _check_same(path: Path, began: Mapping[str, Any], wanted: Mapping[str, Any], names: Iterable[str]) -> None:
    for name in sorted(names):
        before, now = began.get(name), wanted.get(name)
        if before != now:
            about_data = "data that were moved, copied or touched count as others, as does other code; "
            why = about_data if name.endswith(" data") else ""
            raise ValueError(
                f"{path}: {name}: expected that of the training begun here, {shortened(before)}, got {shortened(now)}; "
                f"{why}choose another folder, or remove this one"
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
