"""A drive as a story: when a vehicle's light was first visible, when it was found, when the vehicle was in sight."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from foreglow.datasets import LabelledSource
from foreglow.geometry import Floats
from foreglow.lab.evaluation.boxes.breakdown import match_lights, read_split_labels
from foreglow.lab.evaluation.boxes.lights import Light
from foreglow.lab.evaluation.vehicles import FirstFound, first_found, match_tracks, vehicle_facts
from foreglow.runs.predictions import Predictions
from foreglow.types import Tracks

_Lit: TypeAlias = tuple[Light, float]
"""A light and the highest score of the boxes around it: -inf without a box, infinite if boxes have no scores."""


@dataclass(frozen=True, slots=True)
class Moment:
    """One light at one instant.

    Attributes:
        time_s: From the first image of the sequence.
        score: Highest score of the boxes around it; NaN where there is none, or boxes have no scores.
    """

    time_s: float
    light: Light
    score: float


@dataclass(frozen=True, slots=True)
class Story:
    """What happens in one sequence with the vehicle whose light is visible first.

    Attributes:
        vehicle: What it is: car, van, lorry, motorcycle; `vehicle` where unknown.
        times: When its light is visible, when it is found, and when its first lamp is.
        light: Its first light; the strongest one where there are several.
        found: Its light in the first accepted box, that with the highest score; None if there is never one.
        sight: Its first lamp; None if it never comes into sight.
        confirmed_s: When the box of a plausible track, or of one of a confirmed vehicle, first holds its light; NaN if
            none ever does, or nothing was tracked.
        production_s: When the production system first reports it (`vehicle_facts`); NaN if it never does.
        duration_s: From the first image of the sequence to the last.
        num_images_before: Images of the sequence before the first light.
        num_boxes_before: Accepted boxes in them that hold no light at all, not even doubtful light.
        seen: By time, the one of its lights with the highest score, in every image that shows any.
        gaps_rad: By time, from its opening until the vehicle is in sight, right and left border of the dark gap in
            which it comes into sight; empty without such a gap, None where there is no beam.
    """

    sequence: str
    vehicle: str
    times: FirstFound
    light: Moment
    found: Moment | None
    sight: Moment | None
    confirmed_s: float
    production_s: float
    duration_s: float
    num_images_before: int
    num_boxes_before: int
    seen: Mapping[float, Moment] = field(default_factory=dict)
    gaps_rad: Mapping[float, tuple[float, float]] | None = None

    @property
    def is_hidden_first(self) -> bool:
        """Whether its light is visible before its lamps are."""
        return not self.times.light_s >= self.times.lamp_s

    @property
    def gap_s(self) -> float:
        """When the dark gap opened in which it comes into sight, be it for something else; NaN without one."""
        return min(self.gaps_rad or (math.nan,))

    @property
    def moments(self) -> dict[str, Moment]:
        """`light`, `found`, `confirmed`, `dimmed`, `sight` and `reported`, as far as it is seen then, by time."""
        moments = {
            "light": self.light,
            "found": self.found,
            "confirmed": self.seen.get(self.confirmed_s),
            "dimmed": self.seen.get(self.gap_s),
            "sight": self.sight,
            "reported": self.seen.get(self.production_s),
        }
        known = {name: moment for name, moment in moments.items() if moment is not None}
        return dict(sorted(known.items(), key=lambda named: named[1].time_s))


def tell_stories(
    dataset: LabelledSource,
    predictions: Predictions,
    threshold: float,
    tracks: Mapping[int, Tracks] | None = None,
    gaps_rad: Mapping[int, Floats] | None = None,
) -> tuple[Story, ...]:
    """The story of every sequence of `dataset` in which an oncoming vehicle's light is visible.

    Args:
        dataset: Images with labels.
        predictions: What a run made of them; without scores every box counts as accepted.
        threshold: Boxes with a score above this are accepted.
        tracks: By image id, what the same run followed; None for nothing.
        gaps_rad: By image id, shape (G, 2), right and left borders of its gaps, as in `BeamCommand`; None for no beam.

    Raises:
        FileNotFoundError: If a label file is missing.
        ValueError: If one is broken.
    """
    labels = read_split_labels(dataset)
    confirmed_s: dict[tuple[int, int], float] = {}
    for quality in () if tracks is None else match_tracks(labels, tracks, predictions.boxes_xyxy_px):
        confirmed_s |= {(quality.sequence_id, vehicle.vehicle_id): vehicle.found_s for vehicle in quality.vehicles}
    matched = match_lights(labels, predictions)
    image_ids = matched.matches.image_ids
    is_false = (matched.matches.scores > threshold) & ~matched.matches.has_point & ~matched.has_doubtful
    first: dict[int, FirstFound] = {}
    for vehicle in first_found(labels, matched, threshold):
        known = first.setdefault(vehicle.sequence_id, vehicle)
        if vehicle.light_s < known.light_s:
            first[vehicle.sequence_id] = vehicle
    stories = []
    for sequence in dataset.sequences:
        times = first.get(sequence.id)
        if times is None:
            continue
        lit_at = [
            (labels.time_s[light.image_id], (light, score))
            for light, score in zip(matched.lights, matched.best_scores.tolist(), strict=True)
            if (light.sequence_id, light.vehicle_id) == (sequence.id, times.vehicle_id) and not light.is_rear
        ]
        visible = [lit for time_s, lit in lit_at if time_s == times.light_s]
        boxed = [lit for time_s, lit in lit_at if time_s == times.found_s and lit[1] > threshold]
        lamps = [lit for time_s, lit in lit_at if time_s == times.lamp_s and lit[0].is_direct]
        before = [
            labels.sequence_of[image_id] == sequence.id and labels.time_s[image_id] < times.light_s
            for image_id in image_ids
        ]
        sight = _moment(times.lamp_s, lamps[0]) if lamps else None
        _, vehicle_kind, production_s = vehicle_facts(dataset, sequence.id, times.vehicle_id)
        stories.append(
            Story(
                sequence=sequence.directory,
                vehicle=vehicle_kind,
                times=times,
                light=_moment(times.light_s, min(visible, key=lambda lit: lit[0].rank)),
                found=_moment(times.found_s, max(boxed, key=lambda lit: lit[1])) if boxed else None,
                sight=sight,
                confirmed_s=confirmed_s.get((sequence.id, times.vehicle_id), math.nan),
                production_s=production_s,
                duration_s=dataset.time_s(max(sequence.image_ids)),
                num_images_before=sum(before),
                num_boxes_before=int((is_false & np.array(before)[matched.matches.image_of_box]).sum()),
                seen={time_s: _moment(time_s, lit) for time_s, lit in sorted(lit_at, key=lambda seen: seen[1][1])},
                gaps_rad=None if gaps_rad is None or sight is None else gap_at_sight(dataset, sight, gaps_rad),
            )
        )
    return tuple(stories)


def gap_at_sight(
    dataset: LabelledSource, sight: Moment, gaps_rad: Mapping[int, Floats]
) -> dict[float, tuple[float, float]] | None:
    """The dark gap in which a vehicle comes into sight, back to where it opened: `Story.gaps_rad`; None without camera.

    A gap may move: one that overlaps a gap of the image before is the same one. So it may also have opened for
    something else, and before the vehicle's first light.

    Args:
        dataset: Images with calibration.
        sight: When the vehicle comes into sight, in one of its sequences.
        gaps_rad: As for `tell_stories`.
    """
    sight_id = sight.light.image_id
    camera = dataset.read(sight_id).camera
    if camera is None:
        return None
    ray = camera.vehicle_from_camera.rotation @ camera.rays(np.array([sight.light.position_px]))[0]
    range_m, camera_m = sight.light.range_m, camera.vehicle_from_camera.position_m[:2]
    place_m = ray[:2] if math.isnan(range_m) else camera_m + range_m * ray[:2]
    right = left = math.atan2(place_m[1], place_m[0])  # from the vehicle's origin, as gaps count
    found: dict[float, tuple[float, float]] = {}
    image_ids = [image_id for image_id in dataset.sequence(sight_id).image_ids if image_id <= sight_id]
    for image_id in sorted(image_ids, reverse=True):
        gaps = [gap for gap in gaps_rad.get(image_id, np.zeros((0, 2))).tolist() if gap[0] <= left and right <= gap[1]]
        if not gaps:
            break
        right, left = min(gap[0] for gap in gaps), max(gap[1] for gap in gaps)
        found[dataset.time_s(image_id)] = right, left
    return found


def best_story(stories: Iterable[Story]) -> Story | None:
    """The story with the longest lead, or else the first one; None without stories."""
    return max(stories, key=lambda story: max(0.0, np.nan_to_num(story.times.lead_s)), default=None)


def has_labels(dataset: LabelledSource) -> bool:
    """Whether `dataset` has key points, without which there are no stories."""
    return (dataset.root / "labels" / "keypoints").is_dir()


def _moment(time_s: float, lit: _Lit) -> Moment:
    light, score = lit
    return Moment(time_s, light, score if math.isfinite(score) else math.nan)
