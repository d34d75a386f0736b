"""PVDN's category of each image, from its truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from foreglow.datasets.pvdn.schema import ImageCategory
from foreglow.datasets.simulated import VehicleTruth
from foreglow.lab.simulation.scenes.scene import LabelRule, VehicleSpec

IN_SIGHT_SHARE = 0.5
"""Visible share of a vehicle's body from which the vehicle itself counts as in sight."""


@dataclass(frozen=True, slots=True)
class Signs:
    """What an image shows of oncoming vehicles.

    Attributes:
        has_indirect: Whether reflected or scattered light is perceivable.
        has_direct: Whether a lamp is perceivable.
        is_in_sight: Whether a vehicle itself is in sight: all its headlamps, or half of its body.
    """

    has_indirect: bool = False
    has_direct: bool = False
    is_in_sight: bool = False


def is_oncoming(vehicle: VehicleSpec) -> bool:
    """Whether a vehicle's artifacts count for the category: it comes towards us, or stands facing us with lamps on."""
    if vehicle.lane == "own" or vehicle.beam == "off":
        return False
    return vehicle.lane == "oncoming" or vehicle.is_towards


def signs_of(vehicle: VehicleTruth, rule: LabelRule) -> Signs:
    """What an image shows of an oncoming vehicle; doubtful artifacts and those of rear lamps do not count."""
    counted = [artifact for artifact in vehicle.artifacts if not artifact.is_doubtful and not artifact.is_rear]
    headlamps = [lamp for lamp in vehicle.lamps if lamp.is_headlamp]
    has_direct = any(artifact.is_direct for artifact in counted)
    are_all_seen = all(lamp.visible_share >= rule.min_visible for lamp in headlamps)
    return Signs(
        has_indirect=any(not artifact.is_direct for artifact in counted),
        has_direct=has_direct,
        is_in_sight=has_direct and (are_all_seen or vehicle.visible_share >= IN_SIGHT_SHARE),
    )


class ImageCategories:
    """The categories of a drive, image by image.

    The first image with indirect light, with a lamp, or with the vehicle itself has the category 1, 3 or 5; the
    highest if they coincide. All other images have the state so far: 2 with indirect light only, 4 after a lamp was
    seen, 6 after the production system reported a vehicle. 7 is never used, as in PVDN.

    Images without any label are 0. After more than `hold_frames` of them the vehicle is gone, and the states of the
    next vehicle begin with 1; a shorter gap changes nothing.
    """

    def __init__(self, vehicles: Sequence[VehicleSpec], rule: LabelRule) -> None:
        """Starts a drive among `vehicles`, whose indices are the ids in the truth."""
        self._oncoming = {index for index, vehicle in enumerate(vehicles) if is_oncoming(vehicle)}
        self._rule = rule
        self._reached = Signs()
        self._is_triggered = False
        self._num_empty = 0

    def update(self, vehicles: Sequence[VehicleTruth], is_production_detected: bool) -> ImageCategory:
        """The category of the next image."""
        signs = [signs_of(vehicle, self._rule) for vehicle in vehicles if vehicle.vehicle_id in self._oncoming]
        return self.step(
            Signs(
                has_indirect=any(sign.has_indirect for sign in signs),
                has_direct=any(sign.has_direct for sign in signs),
                is_in_sight=any(sign.is_in_sight for sign in signs),
            ),
            is_production_detected,
        )

    def step(self, signs: Signs, is_production_detected: bool) -> ImageCategory:
        """The category of the next image, which shows `signs`."""
        if not (signs.has_indirect or signs.has_direct):
            self._num_empty += 1
            if self._num_empty > self._rule.hold_frames:
                self._reached, self._is_triggered = Signs(), False
            return ImageCategory.NONE
        before, self._num_empty = self._reached, 0
        self._is_triggered |= is_production_detected
        self._reached = Signs(
            has_indirect=True,
            has_direct=before.has_direct or signs.has_direct,
            is_in_sight=before.is_in_sight or signs.is_in_sight,
        )
        if self._reached.is_in_sight and not before.is_in_sight:
            return ImageCategory.FIRST_DIRECT_SIGHT
        if self._reached.has_direct and not before.has_direct:
            return ImageCategory.FIRST_DIRECT_ARTIFACTS
        if not before.has_indirect:
            return ImageCategory.FIRST_VISIBLE_SIGNS
        if self._is_triggered:
            return ImageCategory.FIRST_TRIGGER_LOW_BEAM
        return ImageCategory.DIRECT_ARTIFACTS if self._reached.has_direct else ImageCategory.INDIRECT
