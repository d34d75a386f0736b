"""What a search minimises, and where it searches: losses and spaces of parameters by name."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

from foreglow.config import PRESETS, ProposalConfig
from foreglow.lab.learning.tuning.measurement import Measurement

if TYPE_CHECKING:
    from optuna.trial import Trial

Loss: TypeAlias = Callable[[Measurement, Measurement], float]
"""The loss of the first measurement; the second is that of the paper's parameters on the same frames."""

TARGETS = {"recall_lamps": 0.97, "recall_strongest": 0.70, "recall_hidden": 0.85}
"""Recalls that `light_loss` requires. Our own requirements: what a first trial reached with a large window."""

MARGIN = 0.01
MARGINS = {"recall_lamps": 0.01, "recall_strongest": 0.03, "recall_hidden": 0.05}
"""`light_loss` requires this much more, since parameters must also hold on other frames. Hidden light is rare: over a
hundred lights a recall of 0.85 has a standard deviation of 0.04, over 400 of the strongest of 0.02."""

SHORTFALL_WEIGHT = 10.0
"""Large enough that no gain beyond the targets outweighs a shortfall of 0.1."""


def q_only_loss(found: Measurement, paper: Measurement) -> float:  # noqa: ARG001
    """1 - q, the paper's loss; 1 if no box contains a key point.

    Missed lights do not count: a proposer that finds only a few single lamps, in tight boxes, has a q of 1.
    """
    return 1.0 if math.isnan(found.quality.q) else 1.0 - found.quality.q


def q_loss(found: Measurement, paper: Measurement) -> float:
    """1 - q + max(0, R_paper - R) + max(0, f / f_paper - 1): the paper's, without losing recall or adding false boxes.

    R is the recall, f the number of boxes without a key point; splitting the box of two lights costs nothing. Without
    the two penalties, the search ends at parameters that find nothing.
    """
    missed = paper.quality.recall - found.quality.recall
    excess = found.quality.fp / max(paper.quality.fp, 1) - 1.0
    return q_only_loss(found, paper) + (0.0 if math.isnan(missed) else max(0.0, missed)) + max(0.0, excess)


def light_loss(found: Measurement, paper: Measurement) -> float:
    """Recall by kind of light, no more boxes than the paper's parameters make, and no lower q; see `shortfalls`.

    10 * (sum of the shortfalls) + (1 - mean(R_lamps, R_strongest, R_hidden, q)): the requirements come first, and among
    parameters that meet them all, the best mean. A figure that is undefined on the frames counts as met and is left out
    of the mean; without any box, all figures count as 0.
    """
    gained = [getattr(found, name) for name in TARGETS] + [0.0 if found.num_boxes == 0 else found.quality.q]
    defined = [value for value in gained if not math.isnan(value)]
    mean = sum(defined) / len(defined) if defined else 0.0
    return SHORTFALL_WEIGHT * sum(shortfalls(found, paper).values()) + 1.0 - mean


def shortfalls(found: Measurement, paper: Measurement) -> dict[str, float]:
    """How far each requirement of `light_loss` is missed; 0 if it is met.

    max(0, T + m_R - R) for each recall R with its target T and margin m_R; with m = 0.01, max(0, q_paper + m - q) and,
    for the mean number of boxes an image, max(0, n / n_paper - (1 - m)).
    """
    missed = {name: target + MARGINS[name] - getattr(found, name) for name, target in TARGETS.items()}
    missed["q"] = paper.quality.q + MARGIN - (0.0 if found.num_boxes == 0 else found.quality.q)
    missed["boxes_per_image"] = found.num_boxes / max(paper.num_boxes, 1) - (1.0 - MARGIN)
    return {name: 0.0 if math.isnan(value) else max(0.0, value) for name, value in missed.items()}


OBJECTIVES: dict[str, tuple[Loss, str]] = {
    "q": (q_loss, "paper"),
    "q-only": (q_only_loss, "paper"),
    "light": (light_loss, "wide"),
}
"""The loss to minimise, and the name of the space that is searched by default."""

Parameters: TypeAlias = Mapping[str, bool | int | float]
"""Values by the names of a space's ranges."""

PAPER = PRESETS["paper"].proposals
"""The parameters that every search begins with and is compared with."""


@dataclass(frozen=True, slots=True)
class Range:
    """Numbers from `low` to `high` in steps: whole ones, if these are; switches, if they are truth values."""

    low: float
    high: float
    step: float = 1

    def suggest(self, trial: Trial, name: str) -> bool | int | float:
        """One of these, without the rounding errors of adding steps."""
        if isinstance(self.low, bool):
            return bool(trial.suggest_categorical(name, (True, False)))
        if isinstance(self.low, int):
            return trial.suggest_int(name, self.low, int(self.high), step=int(self.step))
        return round(trial.suggest_float(name, self.low, self.high, step=self.step), 9)


@dataclass(frozen=True, slots=True)
class Space:
    """A search space.

    Attributes:
        first: The paper's parameters in this space: the first trial.
        fields: Turns parameters into fields of `ProposalConfig`; all other fields are the paper's.
    """

    ranges: Mapping[str, Range]
    first: Parameters
    fields: Callable[[Parameters], dict[str, Any]] = dict

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
            "kappa": Range(0.25, 0.75, 0.05),
            "window_px": Range(5, 25),
            "min_deviation": Range(0.0, 0.1, 0.01),
            "gap_px": Range(1, 9),
        },
        _PAPER_FIRST,
    ),
    # Our own: windows up to the size of a near lamp with its glare (only window // 2 counts), finer steps, smaller
    # boxes, splitting, and the two switches that the paper does not mention.
    "wide": Space(
        {
            "kappa": Range(0.25, 0.75, 0.025),
            "window_px": Range(5, 79, 2),
            "min_deviation": Range(0.0, 0.05, 0.0025),
            "gap_px": Range(1, 9),
            "min_area_px": Range(6, 26, 5),
            "min_width_px": Range(3, 6),
            "split_saddle": Range(0.0, 0.9, 0.025),
            "is_capped": Range(False, True),
            "is_blurred": Range(False, True),
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
