"""Variants of a drive: its moments with our light stronger or weaker, another veil, and vehicles off or unseen."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from foreglow.lab.simulation.scenes.scene import Scene
from foreglow.lab.simulation.scenes.surroundings import FactorOrNone, SpecModel
from foreglow.numbers import checked_whole

VARIANT_STREAM = 903
"""Random stream of a variant, `np.random.default_rng([scene.seed, VARIANT_STREAM, number])`."""

LOW_FACTORS, HIGH_FACTORS = (0.6, 1.5), (0.2, 1.5)
"""Strengths of our low beam and of the rest of our light, drawn evenly in the logarithm: worn, dirty or other lamps."""

VEIL_FACTORS = (0.25, 4.0)
"""Strengths of the veil, drawn likewise: a cleaned and a neglected windscreen."""

OFF_SHARE = 0.35
"""Probability of a vehicle to be off."""

UNSEEN_SHARE = 0.5
"""Probability that no vehicle's lamps are in sight, as before they come round a bend or over a crest."""


class Variant(SpecModel):
    """How a variant differs from the scene.

    Attributes:
        low: Factor on our low beam.
        high: Factor on the rest of our own light: LEDs or high beam.
        veil: Factor on the veils of lens and windscreen.
        off: Numbers of the scene's vehicles whose lamps are off.
        unseen: Numbers of those whose lamps are hidden from the camera, while all that they light is as it was.
    """

    low: FactorOrNone = 1.0
    high: FactorOrNone = 1.0
    veil: FactorOrNone = 1.0
    off: Annotated[tuple[int, ...], Field(max_length=1000)] = ()
    unseen: Annotated[tuple[int, ...], Field(max_length=1000)] = ()

    @property
    def changes_own(self) -> bool:
        """Whether our own light differs from the scene's."""
        return (self.low, self.high) != (1.0, 1.0)


MAX_VARIANTS = 10_000
"""Variants of a drive, each of which is exposed at every moment."""

AS_IT_IS = Variant()
"""The scene itself."""


def draw_variants(scene: Scene, num: int) -> tuple[Variant, ...]:
    """The first `num` variants of a scene; the first one is the scene itself. Each depends on its own number only.

    Raises:
        ValueError: If the number is none from 1 to `MAX_VARIANTS`.
    """
    checked_whole("variants", num, 1, MAX_VARIANTS)
    return (AS_IT_IS, *(_drawn(scene, number) for number in range(1, num)))


def _drawn(scene: Scene, number: int) -> Variant:
    rng = np.random.default_rng([scene.seed, VARIANT_STREAM, number])
    low, high, veil = (
        float(np.exp(rng.uniform(*np.log(factors)))) for factors in (LOW_FACTORS, HIGH_FACTORS, VEIL_FACTORS)
    )
    lit = [index for index, vehicle in enumerate(scene.vehicles) if vehicle.beam != "off"]
    off = tuple(index for index in lit if rng.random() < OFF_SHARE)
    unseen = tuple(index for index in lit if index not in off) if rng.random() < UNSEEN_SHARE else ()
    return Variant(low=round(low, 4), high=round(high, 4), veil=round(veil, 4), off=off, unseen=unseen)
