"""How well it is predicted where and when a hidden vehicle comes into sight.

While only a vehicle's light is seen, our beam policy expects the vehicle somewhere (`beam.Occurrence`): as a
distribution over the azimuth, and a time that is left until it is in sight. The simulator knows both.

    t*    time of first sight, s: the first frame in which a headlamp shows at least `MIN_VISIBLE` of its disc
    a*    azimuth at t* of the mean position of the headlamps that do, rad
    q(p)  expected azimuth to the right of which the share p of the probability lies, rad
    T     expected time until sight, s
    c     coverage: the share of the probability that the policy's gap covers

Azimuths are those of our vehicle's frame, positive to the left. An expectation is scored a lead d before first sight,
in the frame nearest to t* - d:

    error of the direction    |q(1/2) - a*|
    error of the time         |T - d|
    the gap's borders         q((1 - c)/2) and q((1 + c)/2); its width is their difference, and it covers a* if a* lies
                              between them

Both are azimuths in our vehicle's frame at t*: an expectation says where the vehicle will be seen when it is, and what
ours turns until then is part of the prediction.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from foreglow.beam import Occurrence
from foreglow.datasets.simulated import VehicleTruth
from foreglow.geometry import Pose
from foreglow.lab.evaluation.ratios import mean, median

LEADS_S = (2.0, 1.0, 0.5)
"""Before first sight, when expectations are scored."""

MIN_VISIBLE = 0.2
"""Share of a lamp's disc that is visible at first sight, as in the labels' rule."""

NEAR_DEG = 1.5
"""An expected direction is right when it is no further off."""

MAX_COSINE_COMING = 0.3
"""Of the angle between our heading and that of a vehicle which counts as coming."""


class Moment(NamedTuple):
    """What is known of one frame.

    Attributes:
        ego_pose: world_from_vehicle.
    """

    time_s: float
    ego_pose: Pose
    vehicles: tuple[VehicleTruth, ...]


@dataclass(frozen=True, slots=True)
class Sighting:
    """What was expected of one hidden vehicle, some time before it came into sight.

    Attributes:
        lead_s: d, the time before its first sight.
        error_deg: Of the direction; NaN where nothing was expected.
        error_s: Of the time; NaN where nothing was expected.
        width_deg: Between the gap's borders; NaN where nothing was expected.
        is_covered: Whether the true direction lay between them.
    """

    vehicle_id: int
    lead_s: float
    error_deg: float
    error_s: float
    width_deg: float
    is_covered: bool

    @classmethod
    def from_json(cls, fields: dict[str, Any]) -> Sighting:
        """What `to_json` made of one, read back."""
        known: dict[str, Any] = {name: math.nan if value is None else value for name, value in fields.items()}
        return cls(**known)


@dataclass(frozen=True, slots=True)
class LeadScore:
    """All sightings with one lead.

    Attributes:
        num: Vehicles that were hidden then.
        median_deg: Their median error of the direction; NaN without any, as all that follow.
        near_share: Share of them within `NEAR_DEG`.
        covered_share: Share of them that lay between the gap's borders.
        width_deg: Median width between these.
        median_s: Median error of the time.
    """

    lead_s: float
    num: int
    num_told: int
    median_deg: float
    near_share: float
    covered_share: float
    width_deg: float
    median_s: float


class Expectations:
    """What was expected in one frame after another of a drive."""

    def __init__(self, coverage: float) -> None:
        """Takes c, the share of the probability that a gap covers."""
        self._shares = (0.5 * (1.0 - coverage), 0.5 * (1.0 + coverage))
        self._rows: list[tuple[float, ...]] = []

    def add(self, expected: Occurrence | None) -> None:
        """Adds the expectation of the next frame."""
        row: tuple[float, ...] = (math.nan,) * 4
        if expected is not None:
            row = (expected.azimuth_rad, expected.time_s, *expected.quantiles_rad(self._shares))
        self._rows.append(row)

    def sightings(self, moments: Sequence[Moment], rate_hz: float) -> tuple[Sighting, ...]:
        """For every vehicle that was hidden and came into sight, what was expected before.

        Args:
            moments: One for each frame that was added.
            rate_hz: Frames a second; a lead without a frame within half of their distance is left out.
        """
        times_s = np.array([moment.time_s for moment in moments])
        found = []
        for vehicle_id, azimuth_rad, sight_s in first_sights(moments):
            for lead_s in LEADS_S:
                frame = int(np.argmin(np.abs(times_s - (sight_s - lead_s))))
                if abs(times_s[frame] - (sight_s - lead_s)) > 0.5 / rate_hz:
                    continue
                expected_rad, expected_s, right_rad, left_rad = self._rows[frame]
                found.append(
                    Sighting(
                        vehicle_id=vehicle_id,
                        lead_s=lead_s,
                        error_deg=abs(math.degrees(expected_rad - azimuth_rad)),
                        error_s=abs(expected_s - lead_s),
                        width_deg=math.degrees(left_rad - right_rad),
                        is_covered=right_rad <= azimuth_rad <= left_rad,
                    )
                )
        return tuple(found)


def first_sights(moments: Sequence[Moment]) -> Iterator[tuple[int, float, float]]:
    """Id, a* and t* of the coming vehicles that were hidden at first: on the road, and not in sight.

    One that comes in sight from where the simulator has no vehicles, far away or beyond the road's end, was not hidden.
    """
    seen: set[int] = set()
    hidden: set[int] = set()
    for moment in moments:
        for vehicle in moment.vehicles:
            lamps = [lamp for lamp in vehicle.lamps if not lamp.is_rear and lamp.visible_share >= MIN_VISIBLE]
            if lamps and vehicle.vehicle_id not in seen:
                seen.add(vehicle.vehicle_id)
                if vehicle.vehicle_id in hidden and is_coming(moment.ego_pose, vehicle):
                    centre_m = np.mean([lamp.position_world_m for lamp in lamps], axis=0)
                    x, y, _ = moment.ego_pose.to_body(centre_m).tolist()
                    yield vehicle.vehicle_id, math.atan2(y, x), moment.time_s
        hidden |= {vehicle.vehicle_id for vehicle in moment.vehicles} - seen


def is_coming(ego_pose: Pose, vehicle: VehicleTruth) -> bool:
    """Whether a vehicle drives more or less against our direction; one that crosses counts as coming, too."""
    return float(ego_pose.rotation[:, 0] @ vehicle.pose.rotation[:, 0]) < MAX_COSINE_COMING


def lead_scores(sightings: Sequence[Sighting]) -> tuple[LeadScore, ...]:
    """One score for each lead, the longest first.

    >>> near, far = Sighting(0, 1.0, 0.5, 0.2, 3.0, True), Sighting(1, 1.0, 2.5, 0.2, 3.0, True)
    >>> lead_scores([near, far])[0].median_deg
    1.5
    """
    scores = []
    for lead_s in sorted({sighting.lead_s for sighting in sightings}, reverse=True):
        hidden = [sighting for sighting in sightings if sighting.lead_s == lead_s]
        expected = [sighting for sighting in hidden if not math.isnan(sighting.error_deg)]
        scores.append(
            LeadScore(
                lead_s=lead_s,
                num=len(hidden),
                num_told=len(expected),
                median_deg=median(sighting.error_deg for sighting in expected),
                near_share=mean(sighting.error_deg <= NEAR_DEG for sighting in expected),
                covered_share=mean(sighting.is_covered for sighting in expected),
                width_deg=median(sighting.width_deg for sighting in expected),
                median_s=median(sighting.error_s for sighting in expected),
            )
        )
    return tuple(scores)
