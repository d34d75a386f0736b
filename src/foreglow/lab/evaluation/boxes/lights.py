"""The labelled lights of a data set, with the properties by which a detector's recall is broken down."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from foreglow.datasets import LabelledSource, Vehicle
from foreglow.datasets.simulated import (
    KINDS,
    BoxShares,
    FrameTruth,
    SequenceTruth,
    has_truth,
    read_shares,
    read_truth,
    shares_path,
)

LAMP, INDIRECT = "lamp", "indirect"
"""The kinds in the labels themselves; the truth of simulated sets says what indirect light is seen on."""

SEEN_ON: tuple[str, ...] = (*KINDS, INDIRECT)
"""All kinds, in the order of tables."""

NUM_STRONGEST = 3
"""Indirect lights of an image that count as its strongest."""

DIRECT_RANK = -1

SplitShares: TypeAlias = Mapping[str, Mapping[int, BoxShares]]
"""Whose light is in the proposals of a split: by preset, by image id. Images without proposals have no entry."""


@dataclass(frozen=True, slots=True)
class Light:
    """A light artifact in an image: a keypoint of the labels, with what else is known about it.

    Attributes:
        vehicle_id: The vehicle whose light it is (PVDN: oid).
        position_px: Full-frame pixels x, y.
        kind: A name in `SEEN_ON`: `lamp` for the lamp itself; of other light what it is seen on, or `indirect` if
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


def read_lights(dataset: LabelledSource) -> dict[int, tuple[Light, ...]]:
    """The lights of every selected image of `dataset`, by image id, without doubtful lights.

    Kinds, ranges and strengths come from the simulator's truth if the split has it.

    Raises:
        FileNotFoundError: If a file of the labels or of the truth is missing.
        ValueError: If such a file is broken, or the truth does not have an image or an instance of the labels.
    """
    selected = set(dataset.frame_ids)
    lights: dict[int, tuple[Light, ...]] = {}
    for sequence in dataset.sequences:
        truth = _truth(dataset, sequence.id)
        seen: set[int] = set()  # vehicles with a direct instance so far
        for image_id in sorted(sequence.image_ids):
            vehicles = dataset.annotations(image_id)
            seen |= {vehicle.oid for vehicle in vehicles if any(light.is_direct for light in vehicle.instances)}
            if image_id in selected:
                lights[image_id] = tuple(_ranked(_lights(image_id, sequence.id, vehicles, seen, truth)))
    return {image_id: lights[image_id] for image_id in dataset.frame_ids}


def read_split_shares(dataset: LabelledSource) -> SplitShares:
    """The shares of light that are stored for the selected images of `dataset`; empty without any.

    Raises:
        ModuleNotFoundError: If there are some, and the extra `parquet` is not installed.
        ValueError: If a file is broken; the message names it.
    """
    selected = set(dataset.frame_ids)
    shares: dict[str, dict[int, BoxShares]] = {}
    for sequence in dataset.sequences:
        path = shares_path(dataset.root, sequence.id)
        for image_id, found in read_shares(path) if path.is_file() else ():
            if image_id in selected:
                shares.setdefault(found.preset, {})[image_id] = found
    return shares


def empty_images(dataset: LabelledSource) -> tuple[int, ...]:
    """Ids of the selected images without a labelled vehicle, also one without a light, and without doubtful light."""
    return tuple(
        image_id
        for image_id in dataset.frame_ids
        if not dataset.annotations(image_id) and not dataset.doubtful(image_id)
    )


def unsaid(lights: Mapping[int, tuple[Light, ...]]) -> tuple[str, ...]:
    """What labels do not say, a line each: without it, figures on hidden vehicles and on times mean little."""
    found = [light for its in lights.values() for light in its]
    images = Counter(sequence_id for sequence_id, _ in {(light.sequence_id, light.image_id) for light in found})
    seen = {(light.sequence_id, light.vehicle_id, light.image_id) for light in found}
    num_images = Counter((sequence_id, vehicle_id) for sequence_id, vehicle_id, _ in seen)
    lines = []
    if found and not any(light.is_direct for light in found):
        lines.append("no light is marked as direct: all of it counts as light of hidden vehicles")
    if max(num_images.values(), default=0) == 1 < max(images.values()):
        lines.append(
            "no vehicle has light in two images of its sequence, as where oid is missing: which ones are hidden, and "
            "when they are found, is not known"
        )
    return tuple(lines)


def _truth(dataset: LabelledSource, sequence_id: int) -> SequenceTruth | None:
    """What the simulator knows about a sequence; None if it is not simulated."""
    return read_truth(dataset.root).sequence(sequence_id) if has_truth(dataset.root) else None


def _lights(
    image_id: int, sequence_id: int, vehicles: Sequence[Vehicle], seen: set[int], truth: SequenceTruth | None
) -> Iterator[Light]:
    known = {} if truth is None else _known(truth.frame(image_id))
    for vehicle in vehicles:
        for instance in vehicle.instances:
            x, y = instance.position_px
            key = (vehicle.oid, instance.iid)
            if truth is not None and key not in known:
                what = f"instance {instance.iid} of vehicle {vehicle.oid}"
                raise ValueError(f"{truth.path}: image {image_id}: expected {what}, as the labels have it, got none")
            unknown = (math.nan, LAMP if instance.is_direct else INDIRECT, math.nan)
            range_m, kind, grey = known.get(key, unknown)
            yield Light(
                image_id=image_id,
                sequence_id=sequence_id,
                vehicle_id=vehicle.oid,
                position_px=(float(x), float(y)),
                kind=kind,
                is_direct=instance.is_direct,
                is_rear=instance.is_rear,
                is_hidden=vehicle.oid not in seen,
                range_m=range_m,
                grey=grey,
            )


def _known(frame: FrameTruth) -> Mapping[tuple[int, int], tuple[float, str, float]]:
    """By vehicle and instance, the range, the kind and the grey of each artifact of an image."""
    return {
        (vehicle.vehicle_id, artifact.instance_id): (vehicle.range_m, artifact.kind, artifact.grey)
        for vehicle in frame.vehicles
        for artifact in vehicle.artifacts
    }


def _ranked(lights: Iterable[Light]) -> Iterator[Light]:
    lights = list(lights)
    indirect = [light for light in lights if not light.is_direct]
    indirect.sort(key=lambda light: 0.0 if math.isnan(light.grey) else -light.grey)
    rank_of = {id(light): rank for rank, light in enumerate(indirect)}
    for light in lights:
        yield dataclasses.replace(light, rank=rank_of.get(id(light), DIRECT_RANK))
