"""Search spaces: parameters with their ranges, and how they become a configuration."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

from foreglow.config import PRESETS, ProposalConfig

if TYPE_CHECKING:
    from optuna.trial import Trial

Parameters: TypeAlias = Mapping[str, bool | int | float]
"""Values by the names of a space's ranges."""

PAPER = PRESETS["paper"].proposals
"""The parameters that every search begins with and is compared with."""


@dataclass(frozen=True, slots=True)
class Whole:
    """Whole numbers from `low` to `high` in steps."""

    low: int
    high: int
    step: int = 1

    def suggest(self, trial: Trial, name: str) -> int:
        """One of these numbers."""
        return trial.suggest_int(name, self.low, self.high, step=self.step)


@dataclass(frozen=True, slots=True)
class Real:
    """Numbers from `low` to `high` in steps."""

    low: float
    high: float
    step: float

    def suggest(self, trial: Trial, name: str) -> float:
        """One of these numbers, without the rounding errors of adding steps."""
        return round(trial.suggest_float(name, self.low, self.high, step=self.step), 9)


@dataclass(frozen=True, slots=True)
class Switch:
    """On or off."""

    def suggest(self, trial: Trial, name: str) -> bool:
        """One of the two."""
        return bool(trial.suggest_categorical(name, (True, False)))


def _same(parameters: Parameters) -> dict[str, Any]:
    return dict(parameters)


@dataclass(frozen=True, slots=True)
class Space:
    """A search space.

    Attributes:
        ranges: The range of each parameter.
        first: The paper's parameters in this space: the first trial.
        fields: Turns parameters into fields of `ProposalConfig`; all other fields are the paper's.
    """

    ranges: Mapping[str, Whole | Real | Switch]
    first: Parameters
    fields: Callable[[Parameters], dict[str, Any]] = _same

    def suggest(self, trial: Trial) -> dict[str, bool | int | float]:
        """A value for each parameter."""
        return {name: values.suggest(trial, name) for name, values in self.ranges.items()}

    def config(self, parameters: Parameters) -> ProposalConfig:
        """The configuration of `parameters`."""
        return ProposalConfig(**(PAPER.model_dump() | self.fields(parameters)))


def _wide_fields(parameters: Parameters) -> dict[str, Any]:
    """`is_capped` and `is_blurred` as areas and kernels."""
    fields = {name: value for name, value in parameters.items() if name not in ("is_capped", "is_blurred")}
    if not parameters["is_capped"]:
        fields["max_area_px"] = math.inf
    if not parameters["is_blurred"]:
        fields |= {"blur_width_px": 1, "blur_height_px": 1}
    return fields


_PAPER_FIRST = {name: getattr(PAPER, name) for name in ("kappa", "window_px", "min_deviation", "gap_px")}

SPACES: dict[str, Space] = {
    # The ranges of the paper's parameter search.
    "paper": Space(
        {
            "kappa": Real(0.25, 0.75, 0.05),
            "window_px": Whole(5, 25),
            "min_deviation": Real(0.0, 0.1, 0.01),
            "gap_px": Whole(1, 9),
        },
        _PAPER_FIRST,
    ),
    # Our own: windows up to the size of a near lamp with its glare (only window // 2 counts), finer steps, smaller
    # boxes, splitting, and the two switches that the paper does not mention.
    "wide": Space(
        {
            "kappa": Real(0.25, 0.75, 0.025),
            "window_px": Whole(5, 79, 2),
            "min_deviation": Real(0.0, 0.05, 0.0025),
            "gap_px": Whole(1, 9),
            "min_area_px": Whole(6, 26, 5),
            "min_width_px": Whole(3, 6),
            "split_saddle": Real(0.0, 0.9, 0.025),
            "is_capped": Switch(),
            "is_blurred": Switch(),
        },
        {
            **_PAPER_FIRST,
            "min_area_px": 11,
            "min_width_px": 6,
            "split_saddle": 0.0,
            "is_capped": True,
            "is_blurred": True,
        },
        _wide_fields,
    ),
}


def space(name: str) -> Space:
    """The space called `name`.

    Raises:
        ValueError: If there is none; the message lists those that exist.
    """
    if name not in SPACES:
        raise ValueError(f"space: expected one of {', '.join(SPACES)}, got {name!r}")
    return SPACES[name]
