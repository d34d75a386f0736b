"""When each vehicle is lit, found in a box, confirmed by a track, and in sight; and which tracks are false."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.config import validated
from foreglow.datasets import CategoryConfig, LabelledSource
from foreglow.datasets.simulated import has_truth, read_truth
from foreglow.datasets.simulated.production import ProductionConfig, first_reports
from foreglow.files import fields_to_json
from foreglow.lab.evaluation.boxes.breakdown import LightMatches, SplitLabels
from foreglow.lab.evaluation.boxes.matching import lies_in
from foreglow.lab.evaluation.ratios import share
from foreglow.types import Tracks, TrackState


@dataclass(frozen=True, slots=True)
class FirstFound:
    """One vehicle of one sequence, seen by its front lamps' light.

    Times are seconds from the first image of the sequence; NaN where it never happens.

    Attributes:
        light_s: Its first labelled light, direct or not.
        found_s: First accepted box that holds a light of it.
        lamp_s: Its first labelled lamp.
        num_frames: Images of the sequence from its first light to the first such box; NaN where it is never found.
    """

    sequence_id: int
    vehicle_id: int
    light_s: float
    found_s: float
    lamp_s: float
    num_frames: float

    @property
    def delay_s(self) -> float:
        """From its first light to the first box that holds one; NaN where it is never found."""
        return self.found_s - self.light_s

    @property
    def lead_s(self) -> float:
        """From the first box that holds its light to its first lamp: positive if it is found before it is there."""
        return self.lamp_s - self.found_s

    def to_json(self) -> dict[str, Any]:
        """All fields and both times by name."""
        return fields_to_json(self, "delay_s", "lead_s")


def first_found(labels: SplitLabels, matched: LightMatches, threshold: float) -> tuple[FirstFound, ...]:
    """When each vehicle is found if boxes with a score above `threshold` are accepted, by sequence and vehicle.

    Light of rear lamps is left out: those vehicles are not oncoming. With a few frames a second, the times are no
    finer than the frames.
    """
    rows = [
        (light.sequence_id, light.vehicle_id, labels.time_s[light.image_id], light.is_direct, best > threshold, index)
        for light, best, index in zip(
            matched.lights, matched.best_scores.tolist(), matched.matches.image_of_point.tolist(), strict=True
        )
        if not light.is_rear
    ]
    rows.sort(key=lambda row: row[:3])
    found = []
    for (sequence_id, vehicle_id), group in itertools.groupby(rows, key=lambda row: row[:2]):
        lights = list(group)
        light_s, light_index = lights[0][2], lights[0][5]
        found_s, found_index = next(((row[2], float(row[5])) for row in lights if row[4]), (math.nan, math.nan))
        lamp_s = next((row[2] for row in lights if row[3]), math.nan)
        found.append(FirstFound(sequence_id, vehicle_id, light_s, found_s, lamp_s, found_index - light_index))
    return tuple(found)


def share_found_ahead(vehicles: Sequence[FirstFound]) -> float:
    """Of the vehicles whose light comes before their first lamp, the share found before it; NaN without any."""
    return share([vehicle.lead_s > 0 for vehicle in vehicles if vehicle.light_s < vehicle.lamp_s])


HUMAN_DELAY_S = 0.8
"""From the first annotated artifact to a human's report of the vehicle, on average (paper)."""

UNKNOWN_VEHICLE = "vehicle"
"""Kind of a vehicle about which nothing more is known."""


@dataclass(frozen=True, slots=True)
class Encounter:
    """The first vehicle of a sequence. Times are seconds from the sequence's first image; NaN for never.

    Attributes:
        scenario: Name of the simulator's scenario, such as `crest`; empty where unknown.
        vehicle_id: The vehicle (PVDN: oid).
        vehicle: Its kind: car, van, lorry, motorcycle; `vehicle` where unknown.
        light_s: Its first annotated artifact.
        sight_s: Its first annotated lamp.
        production_s: The production system's first report of it; of a drive that is not simulated, of any vehicle.
        duration_s: The sequence's last image.
    """

    sequence_id: int
    sequence: str
    scenario: str
    vehicle_id: int
    vehicle: str
    light_s: float
    sight_s: float
    production_s: float
    duration_s: float

    @property
    def is_occluded(self) -> bool:
        """Whether its light is annotated before its lamps, or its lamps are never annotated."""
        return not self.light_s >= self.sight_s

    @property
    def is_begun(self) -> bool:
        """Whether its light is there in the sequence's first image, so that nobody knows when it came."""
        return self.light_s == 0

    @property
    def human_s(self) -> float:
        """When a human would report it, on average."""
        return self.light_s + HUMAN_DELAY_S


def read_encounters(
    dataset: LabelledSource, labels: SplitLabels, categories: CategoryConfig | None = None
) -> tuple[Encounter, ...]:
    """The first vehicle of every sequence of `dataset` with annotated light, in the order of sequences.

    Args:
        dataset: Images with labels.
        labels: Its labels, as `read_split_labels` gives them.
        categories: Which image category marks the production system's report, where the set is not simulated.

    Raises:
        ValueError: If the simulator's truth beside the labels is broken.
    """
    encounters = []
    for sequence in dataset.sequences:
        lights = sorted(
            (labels.time_s[image_id], light.vehicle_id, light.is_direct)
            for image_id in sequence.image_ids
            for light in labels.lights.get(image_id, ())
            if not light.is_rear
        )
        if not lights:
            continue
        light_s, vehicle_id, _ = lights[0]
        sights = (time_s for time_s, its_id, is_direct in lights if its_id == vehicle_id and is_direct)
        scenario, vehicle, production_s = vehicle_facts(dataset, sequence.id, vehicle_id, categories)
        encounters.append(
            Encounter(
                sequence_id=sequence.id,
                sequence=sequence.directory,
                scenario=scenario,
                vehicle_id=vehicle_id,
                vehicle=vehicle,
                light_s=light_s,
                sight_s=next(sights, math.nan),
                production_s=production_s,
                duration_s=max(map(dataset.time_s, sequence.image_ids)),
            )
        )
    return tuple(encounters)


def vehicle_facts(
    dataset: LabelledSource, sequence_id: int, vehicle_id: int, categories: CategoryConfig | None = None
) -> tuple[str, str, float]:
    """Scenario, kind of the vehicle, and when the production system first reports it; see `Encounter`.

    Of a drive that is not simulated nobody knows which vehicle it reports: the first one counts.
    """
    scenario, kind = "", UNKNOWN_VEHICLE
    if has_truth(dataset.root):
        split = read_truth(dataset.root)
        truth = split.sequence(sequence_id)
        system = validated(ProductionConfig, split.info.production, f"{split.root}: simulation/info.json: production")
        vehicles = (vehicle for frame in truth.frames for vehicle in frame.vehicles)
        kind = next((vehicle.kind for vehicle in vehicles if vehicle.vehicle_id == vehicle_id), UNKNOWN_VEHICLE)
        reported = first_reports(truth.frames, system).get(vehicle_id)
        scenario = truth.scenario
    else:
        sequence = next(sequence for sequence in dataset.sequences if sequence.id == sequence_id)
        reported = dataset.first_with(sequence, (categories or CategoryConfig()).low_beam_trigger)
    return scenario, kind, math.nan if reported is None else dataset.time_s(reported)


@dataclass(frozen=True, slots=True, eq=False)
class SequenceTracks:
    """What the tracks of one sequence are worth.

    A track *has held* a light once one of its detections, so far, had the light in its box, edges included. Tracks are
    *close* if in some image, both plausible, their boxes are no further apart than the larger one's longer side.

    Attributes:
        duration_s: Its images over their rate.
        num_plausible: Tracks that were plausible at some time.
        num_false: Those of them that never held a light, neither labelled nor doubtful, as long as they lived.
        empty_s: Time in images without any vehicle's light, labelled or doubtful.
        num_false_empty: Those false ones that first were plausible in such an image: nobody was there at all.
        num_false_groups: Groups of plausible tracks, those that are close being in one, in which none has held a light.
        num_false_vehicles: Confirmed vehicles of which no track has held a light; None of a tracker that knows none.
        vehicles: Each oncoming vehicle with a labelled light, in the order of their ids; `found_s` is when the box of
            a plausible track first holds a light of it, as in the paper. Of a tracker that confirms vehicles, the
            tracks of a confirmed one are plausible here.
    """

    sequence_id: int
    duration_s: float
    num_plausible: int
    num_false: int
    empty_s: float
    num_false_empty: int
    num_false_groups: int
    num_false_vehicles: int | None
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
    groups = _Groups()
    confirmed: set[int] | None = None  # vehicles
    lit_vehicles: set[int] = set()
    firsts: dict[int, dict[str, float]] = {}  # by vehicle, times and indices of images
    for index, image_id in enumerate(image_ids):
        in_image, now_s = tracks[image_id], labels.time_s[image_id]
        plausible_ids = in_image.ids[in_image.is_plausible]
        plausible = dict.fromkeys(plausible_ids.tolist(), image_id) | plausible
        groups.join(plausible_ids, in_image.boxes_xyxy_px[in_image.is_plausible])
        is_detected = in_image.detections >= 0
        ids = in_image.ids[is_detected].tolist()
        boxes = boxes_xyxy_px[image_id][in_image.detections[is_detected]]
        lights = labels.lights[image_id]
        points_px = np.array([light.position_px for light in lights], np.float64).reshape(-1, 2)
        for light in lights:
            if not light.is_rear:
                first = firsts.setdefault(light.vehicle_id, {"light": now_s, "light_index": index})
                if light.is_direct:
                    first.setdefault("lamp", now_s)
        held = [ids[box] for _, box in (*_held(labels.doubtful_px[image_id], boxes), *_held(points_px, boxes))]
        lit |= set(held)
        is_shown = in_image.is_plausible
        if in_image.vehicles is not None:
            its = in_image.vehicles
            now = its.ids[its.states != TrackState.TENTATIVE]
            is_shown = np.isin(its.of_tracks, now)
            confirmed = (confirmed or set()) | set(now.tolist())
            lit_vehicles |= set(its.of_tracks[np.isin(in_image.ids, held)].tolist())
        for point, _ in _held(points_px, in_image.boxes_xyxy_px[is_shown]):
            if not lights[point].is_rear:
                first = firsts[lights[point].vehicle_id]
                first.setdefault("found", now_s)
                first.setdefault("found_index", index)
    sequence_id = labels.sequence_of[image_ids[0]]
    false = plausible.keys() - lit
    return SequenceTracks(
        sequence_id=sequence_id,
        duration_s=len(image_ids) / labels.rate_hz,
        num_plausible=len(plausible),
        num_false=len(false),
        empty_s=len(labels.empty_images.intersection(image_ids)) / labels.rate_hz,
        num_false_empty=sum(plausible[track_id] in labels.empty_images for track_id in false),
        num_false_groups=sum(lit.isdisjoint(group) for group in groups.found()),
        num_false_vehicles=None if confirmed is None else len(confirmed - lit_vehicles),
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


class _Groups:
    """Tracks that were close to one another, directly or by way of others."""

    def __init__(self) -> None:
        self._above: dict[int, int] = {}  # by track another one of its group, or itself

    def join(self, ids: NDArray[np.int64], boxes_xyxy_px: NDArray[np.floating]) -> None:
        """Joins the tracks of an image with these ids, shape (M,), whose boxes, shape (M, 4), are close."""
        for track_id in ids.tolist():
            self._above.setdefault(track_id, track_id)
        starts, ends = boxes_xyxy_px[:, :2], boxes_xyxy_px[:, 2:]
        gaps = np.maximum(starts[:, None] - ends, starts - ends[:, None]).max(axis=-1, initial=0.0)
        sides = (ends - starts).max(axis=-1, initial=0.0)
        for one, other in np.argwhere(np.triu(gaps <= np.maximum(sides[:, None], sides), 1)):
            self._above[self._first(int(ids[one]))] = self._first(int(ids[other]))

    def found(self) -> list[set[int]]:
        """The groups, each by the ids of its tracks."""
        members: dict[int, set[int]] = {}
        for track_id in self._above:
            members.setdefault(self._first(track_id), set()).add(track_id)
        return [*members.values()]

    def _first(self, track_id: int) -> int:
        while self._above[track_id] != track_id:
            track_id = self._above[track_id]
        return track_id


def _held(points_px: NDArray[np.float64], boxes_xyxy_px: NDArray[np.floating]) -> list[tuple[int, int]]:
    """All pairs of a point and a box that holds it, by their indices."""
    return [(int(point), int(box)) for point, box in np.argwhere(lies_in(points_px[:, None], boxes_xyxy_px))]
