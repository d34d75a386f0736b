"""The labelled lights of a data set, with the properties by which a detector's recall is broken down."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from foreglow.datasets import Instance, LabelledSource, Vehicle
from foreglow.datasets.simulated import KINDS, Artifact, has_truth, read_truth

LAMP, INDIRECT = "lamp", "indirect"
"""The kinds in the labels themselves; the truth of simulated sets says what indirect light is seen on."""

LIGHT_KINDS: tuple[str, ...] = (*KINDS, INDIRECT)
"""All kinds, in the order of tables."""

NUM_STRONGEST = 3
"""Indirect lights of an image that count as its strongest."""

DIRECT_RANK = -1


@dataclass(frozen=True, slots=True)
class Light:
    """A light artifact in an image: a keypoint of the labels, with what else is known about it.

    Attributes:
        vehicle_id: The vehicle whose light it is (PVDN: oid).
        position_px: Full-frame pixels x, y.
        kind: A name in `LIGHT_KINDS`: `lamp` for the lamp itself; of other light what it is seen on, or `indirect` if
            the set is not simulated.
        is_hidden: Whether no lamp of its vehicle is labelled in this or an earlier image of the sequence.
        range_m: From the camera to the vehicle; NaN where unknown.
        grey: Grey levels that the light adds at its peak; NaN where unknown.
        rank: Rank among the indirect lights of its image, 0 for the strongest; in the file's order where strengths
            are unknown; -1 for direct light.
    """

    image_id: int
    sequence_id: int
    vehicle_id: int
    position_px: tuple[float, float]
    kind: str
    is_direct: bool
    is_rear: bool
    is_hidden: bool
    range_m: float = math.nan
    grey: float = math.nan
    rank: int = DIRECT_RANK


@dataclass(frozen=True, slots=True)
class _Known:
    """What the simulator knows about a vehicle in an image, beside its labels."""

    range_m: float
    artifacts: dict[int, Artifact]


def read_lights(dataset: LabelledSource) -> dict[int, tuple[Light, ...]]:
    """The lights of every selected image of `dataset`, by image id, without doubtful lights.

    Kinds, ranges and strengths come from the simulator's truth if the split has it.

    Raises:
        FileNotFoundError: If a file of the labels or of the truth is missing.
        ValueError: If such a file is broken, or the truth does not have an instance of the labels.
    """
    selected = set(dataset.frame_ids)
    lights: dict[int, tuple[Light, ...]] = {}
    for sequence in dataset.sequences:
        known = _known(dataset, sequence.id)
        seen: set[int] = set()  # vehicles with a direct instance so far
        for image_id in sorted(sequence.image_ids):
            vehicles = dataset.annotations(image_id)
            seen |= {vehicle.oid for vehicle in vehicles if any(light.is_direct for light in vehicle.instances)}
            if image_id in selected:
                found = [
                    _light(image_id, sequence.id, vehicle, instance, vehicle.oid not in seen, known)
                    for vehicle in vehicles
                    for instance in vehicle.instances
                ]
                lights[image_id] = tuple(_ranked(found))
    return {image_id: lights[image_id] for image_id in dataset.frame_ids}


def empty_images(dataset: LabelledSource) -> tuple[int, ...]:
    """Ids of the selected images without any light of vehicles, not even doubtful light."""
    return tuple(
        image_id
        for image_id in dataset.frame_ids
        if not dataset.annotations(image_id) and not dataset.doubtful(image_id)
    )


def _known(dataset: LabelledSource, sequence_id: int) -> dict[tuple[int, int], _Known]:
    """The simulator's truth by image and vehicle; empty if the set is not simulated."""
    if not has_truth(dataset.root):
        return {}
    return {
        (frame.image_id, vehicle.vehicle_id): _Known(
            vehicle.range_m, {artifact.instance_id: artifact for artifact in vehicle.artifacts}
        )
        for frame in read_truth(dataset.root).sequence(sequence_id).frames
        for vehicle in frame.vehicles
    }


def _light(
    image_id: int,
    sequence_id: int,
    vehicle: Vehicle,
    instance: Instance,
    is_hidden: bool,
    known: dict[tuple[int, int], _Known],
) -> Light:
    x, y = instance.position_px
    light = Light(
        image_id=image_id,
        sequence_id=sequence_id,
        vehicle_id=vehicle.oid,
        position_px=(float(x), float(y)),
        kind=LAMP if instance.is_direct else INDIRECT,
        is_direct=instance.is_direct,
        is_rear=instance.is_rear,
        is_hidden=is_hidden,
    )
    if not known:
        return light
    vehicle_known = known.get((image_id, vehicle.oid))
    artifact = None if vehicle_known is None else vehicle_known.artifacts.get(instance.iid)
    if vehicle_known is None or artifact is None:
        raise ValueError(
            f"image {image_id}: expected instance {instance.iid} of vehicle {vehicle.oid} in the simulator's truth"
        )
    return dataclasses.replace(light, kind=artifact.kind, range_m=vehicle_known.range_m, grey=artifact.grey)


def _ranked(lights: Sequence[Light]) -> Iterator[Light]:
    indirect = sorted((light for light in lights if not light.is_direct), key=lambda light: -_strength(light))
    rank_of = {id(light): rank for rank, light in enumerate(indirect)}
    for light in lights:
        yield dataclasses.replace(light, rank=rank_of.get(id(light), DIRECT_RANK))


def _strength(light: Light) -> float:
    return 0.0 if math.isnan(light.grey) else light.grey
