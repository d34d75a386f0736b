"""What tracks are worth: false confirmed ones, how soon a vehicle is confirmed, and how many tracks share a light."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.lab.evaluation.boxes.breakdown import SplitLabels
from foreglow.lab.evaluation.boxes.first_found import FirstFound
from foreglow.lab.evaluation.boxes.matching import lies_in
from foreglow.types import Tracks


@dataclass(frozen=True, slots=True, eq=False)
class SequenceTracks:
    """What the tracks of one sequence are worth.

    A track *has held* a light once one of its detections, so far, had the light in its box, edges included.

    Attributes:
        sequence_id: The sequence.
        duration_s: Its images over their rate.
        num_plausible: Tracks that were plausible at some time.
        num_false: Those of them that never held a light, neither labelled nor doubtful, as long as they lived.
        empty_s: Time in images without any vehicle's light, labelled or doubtful.
        num_false_empty: Those false ones that first were plausible in such an image: nobody was there at all.
        vehicles: Each oncoming vehicle with a labelled light, in the order of their ids; `found_s` is when the first
            track that has held a light of it is plausible.
    """

    sequence_id: int
    duration_s: float
    num_plausible: int
    num_false: int
    empty_s: float
    num_false_empty: int
    vehicles: tuple[FirstFound, ...]


def match_tracks(
    labels: SplitLabels, tracks: Mapping[int, Tracks], boxes_xyxy_px: Mapping[int, NDArray[np.floating]]
) -> tuple[SequenceTracks, ...]:
    """What the tracks are worth, sequence by sequence.

    Args:
        labels: Of the split.
        tracks: By image id, for every image of the labels; ids are unique within a sequence.
        boxes_xyxy_px: By image id, shape (N, 4), the boxes that `Tracks.detections` counts.
    """
    image_ids = sorted(labels.sequence_of, key=lambda image_id: (labels.sequence_of[image_id], labels.time_s[image_id]))
    groups = itertools.groupby(image_ids, key=labels.sequence_of.__getitem__)
    return tuple(_match_sequence(labels, list(group), tracks, boxes_xyxy_px) for _, group in groups)


def _match_sequence(
    labels: SplitLabels,
    image_ids: Sequence[int],
    tracks: Mapping[int, Tracks],
    boxes_xyxy_px: Mapping[int, NDArray[np.floating]],
) -> SequenceTracks:
    """What the tracks of one sequence, with its images in the order of time, are worth."""
    plausible: dict[int, int] = {}  # by track, the image in which it first was
    lit: set[int] = set()  # tracks that have held any light
    vehicles_of: dict[int, set[int]] = {}  # by track
    firsts: dict[int, dict[str, float]] = {}  # by vehicle, times and indices of images
    for index, image_id in enumerate(image_ids):
        in_image, now_s = tracks[image_id], labels.time_s[image_id]
        plausible_now = set(in_image.ids[in_image.is_plausible].tolist())
        plausible = dict.fromkeys(plausible_now, image_id) | plausible
        is_detected = in_image.detections >= 0
        ids = in_image.ids[is_detected].tolist()
        boxes = boxes_xyxy_px[image_id][in_image.detections[is_detected]]
        lit |= {ids[box] for _, box in _held(labels.doubtful_px[image_id], boxes)}
        lights = labels.lights[image_id]
        points_px = np.array([light.position_px for light in lights], np.float64).reshape(-1, 2)
        for light in lights:
            if not light.is_rear:
                first = firsts.setdefault(light.vehicle_id, {"light": now_s, "light_index": index})
                if light.is_direct:
                    first.setdefault("lamp", now_s)
        for point, box in _held(points_px, boxes):
            light, track_id = lights[point], ids[box]
            lit.add(track_id)
            if not light.is_rear:
                vehicles_of.setdefault(track_id, set()).add(light.vehicle_id)
        for vehicle_id in set().union(*(vehicles_of.get(track_id, ()) for track_id in plausible_now)):
            firsts[vehicle_id].setdefault("found", now_s)
            firsts[vehicle_id].setdefault("found_index", index)
    sequence_id = labels.sequence_of[image_ids[0]]
    false = plausible.keys() - lit
    return SequenceTracks(
        sequence_id=sequence_id,
        duration_s=len(image_ids) / labels.rate_hz,
        num_plausible=len(plausible),
        num_false=len(false),
        empty_s=len(labels.empty_images.intersection(image_ids)) / labels.rate_hz,
        num_false_empty=sum(plausible[track_id] in labels.empty_images for track_id in false),
        vehicles=tuple(
            FirstFound(
                sequence_id,
                vehicle_id,
                first["light"],
                first.get("found", math.nan),
                first.get("lamp", math.nan),
                first.get("found_index", math.nan) - first["light_index"],
            )
            for vehicle_id, first in sorted(firsts.items())
        ),
    )


def _held(points_px: NDArray[np.float64], boxes_xyxy_px: NDArray[np.floating]) -> list[tuple[int, int]]:
    """All pairs of a point and a box that holds it, by their indices."""
    return [(int(point), int(box)) for point, box in np.argwhere(lies_in(points_px[:, None], boxes_xyxy_px))]
