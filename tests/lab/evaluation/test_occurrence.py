"""Expectations against what happens: made-up moments, and a whole small split."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from foreglow.beam import Occurrence
from foreglow.datasets.simulated import LampTruth, VehicleTruth
from foreglow.geometry import Pose, rotation
from foreglow.lab.evaluation.occurrence import Expectations, Moment, first_sights, is_coming

HERE = Pose(np.zeros(3), np.eye(3))


def lamp(share: float, x: float = 100.0, y: float = 5.0) -> LampTruth:
    return LampTruth("low_left", False, np.array([x, y, 0.7]), (0.0, 0.0), 0.08, 200.0, share)


def vehicle(*lamps: LampTruth, yaw_rad: float = math.pi) -> VehicleTruth:
    fields: dict[str, Any] = {field.name: None for field in dataclasses.fields(VehicleTruth)}
    fields |= {"vehicle_id": 3, "pose": Pose(np.array([102.0, 5.0, 0.0]), rotation(yaw_rad)), "lamps": lamps}
    return VehicleTruth(**fields)


def moments(shares: list[float], **changes: Any) -> list[Moment]:
    return [Moment(number / 18, HERE, (vehicle(lamp(each), **changes),)) for number, each in enumerate(shares)]


def test_first_sight_is_when_a_lamp_is_seen() -> None:
    ((vehicle_id, azimuth_rad, time_s),) = first_sights(moments([0.0, 0.1, 0.5, 1.0]))
    assert vehicle_id == 3
    assert azimuth_rad == pytest.approx(math.atan2(5.0, 100.0))
    assert time_s == pytest.approx(2 / 18)


def test_who_is_in_sight_from_the_beginning_or_drives_ahead_was_not_hidden() -> None:
    assert not list(first_sights(moments([1.0, 1.0])))
    nobody = Moment(-1 / 18, HERE, ())
    assert not list(first_sights([nobody, *moments([1.0, 1.0])]))  # it comes from afar, in plain sight
    assert list(first_sights([nobody, *moments([0.0, 1.0])]))
    assert not list(first_sights(moments([0.0, 1.0], yaw_rad=0.0)))
    assert not is_coming(HERE, vehicle(yaw_rad=0.2))
    assert is_coming(HERE, vehicle(yaw_rad=math.pi / 2))  # it crosses


def test_what_was_expected_before_is_held_against_it() -> None:
    expectations, shares = Expectations(0.8), [0.0] * 18 + [1.0]
    azimuths = np.radians([2.0, 3.0, 4.0])
    for _ in shares:
        expectations.add(Occurrence(azimuths, np.full(3, 100.0), np.array([0.1, 0.8, 0.1]), 1.2, 0.8))
    one_s, half_s = expectations.sightings(moments(shares), 18.0)  # nothing is known of two seconds before
    truth_deg = math.degrees(math.atan2(5.0, 100.0))
    assert (one_s.lead_s, half_s.lead_s) == (1.0, 0.5)
    assert one_s.error_deg == pytest.approx(abs(3.0 - truth_deg))
    assert one_s.error_s == pytest.approx(0.2)
    assert half_s.error_s == pytest.approx(0.7)
    assert one_s.is_covered
    assert 0.5 < one_s.width_deg < 2.0


def test_nothing_expected_is_nan_and_covers_nothing() -> None:
    expectations, shares = Expectations(0.8), [0.0] * 18 + [1.0]
    for _ in shares:
        expectations.add(None)
    for sighting in expectations.sightings(moments(shares), 18.0):
        assert math.isnan(sighting.error_deg)
        assert not sighting.is_covered
