from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from foreglow.lab.studies.glare.drive import DriverEye, GlareDrive, PolicyRun, RoadLight
from tests.lab.studies.glare_drives import approach

EYE: dict[str, Any] = {
    "vehicle_id": 1,
    "kind": "car",
    "is_oncoming": True,
    "ranges_m": [100.0, math.nan],
    "azimuths_rad": [0.1, math.nan],
    "is_in_sight": [True, False],
    "base_lx": [0.5, 0.0],
    "leds_lx": np.array([[[1.0, 2.0], [3.0, 4.0]], np.zeros((2, 2))]),
}


def test_light_at_the_eye_is_linear_in_the_levels() -> None:
    eye = DriverEye(**EYE)
    assert eye.illuminance_lx(0.0).tolist() == [0.5, 0.0]
    assert eye.illuminance_lx(1.0).tolist() == [10.5, 0.0]
    levels = np.array([[[0.5, 0.0], [0.0, 0.25]], np.ones((2, 2))])
    assert eye.illuminance_lx(levels).tolist() == [0.5 + 0.5 + 1.0, 0.0]
    with pytest.raises(ValueError, match="read-only"):
        eye.base_lx[0] = 1.0


def test_light_on_the_road_by_area() -> None:
    road = RoadLight([[4.0, 1.0]], [[[[1.0], [2.0]], [[0.0], [3.0]]]])  # type: ignore[arg-type]
    assert road.illuminance_lx(np.array([[[0.5], [1.0]]])).tolist() == [[6.5, 4.0]]
    assert road.illuminance_lx(1.0).tolist() == [[7.0, 4.0]]


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("ranges_m", [0.0, 1.0], "positive"),
        ("ranges_m", [math.inf, 1.0], "positive"),
        ("azimuths_rad", [math.nan, 0.0], "angle wherever"),
        ("azimuths_rad", [0.1], r"shape \(2\)"),
        ("is_in_sight", [1, 0], "expected bool"),
        ("base_lx", [-0.1, 0.0], "at least 0"),
        ("base_lx", ["a", "b"], "expected float64"),
        ("leds_lx", np.full((2, 2, 2), math.nan), "finite"),
        ("leds_lx", np.zeros((2, 3, 2)), r"shape \(2, 2, any\)"),
    ],
)
def test_a_broken_eye(field: str, value: Any, expected: str) -> None:
    with pytest.raises(ValueError, match=rf"^DriverEye\.{field}: .*{expected}"):
        DriverEye(**EYE | {field: value})


def test_gaps_are_padded() -> None:
    run = PolicyRun.of("ours", np.ones((3, 2, 4)), [[(0.1, 0.2)], [], [(-0.2, -0.1), (0.0, 0.3)]])
    assert run.num_gaps.tolist() == [1, 0, 2]
    assert run.gaps_rad[2].tolist() == [[-0.2, -0.1], [0.0, 0.3]]
    assert np.isnan(run.gaps_rad[0, 1]).all()
    assert PolicyRun.of("low", np.zeros((3, 2, 4))).gaps_rad.shape == (3, 0, 2)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"levels": np.full((1, 2, 3), 1.01)}, r"levels: expected values in \[0, 1\]"),
        ({"levels": np.full((1, 2, 3), math.nan)}, r"levels: expected values in \[0, 1\]"),
        ({"num_gaps": np.array([2])}, "num_gaps: expected 0 to 1"),
        ({"num_gaps": np.array([0])}, "gaps_rad: expected borders for the first num_gaps"),
        ({"gaps_rad": np.array([[[0.2, 0.1]]])}, "right border"),
    ],
)
def test_a_broken_run(changes: dict[str, Any], expected: str) -> None:
    run = PolicyRun.of("ours", np.ones((1, 2, 3)), [[(0.1, 0.2)]])
    with pytest.raises(ValueError, match=rf"^PolicyRun\..*{expected}"):
        dataclasses.replace(run, **changes)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"times_s": np.zeros(252)}, "times_s: expected at least one frame, and times that grow"),
        ({"rate_hz": 0.0}, "rate_hz: expected a positive number"),
        ({"speeds_mps": np.zeros(3)}, "speeds_mps: expected shape"),
        ({"light_s": {1: math.nan}}, "light_s: expected finite"),
        ({"gone_s": {2: math.inf}}, "gone_s: expected finite"),
        ({"gone_s": {1: 0.0}}, "eyes: expected each vehicle once"),
        ({"eyes": approach().eyes * 2}, "eyes: expected each vehicle once"),
        ({"eyes": approach(duration_s=5.0).eyes}, "eyes: vehicle 1: expected frames"),
        ({"runs": {"low": PolicyRun.of("low", np.zeros((252, 2, 3)))}}, "runs: low: expected frames"),
        ({"runs": {"x": approach().runs["low"]}}, "runs: expected 'x' to be called that"),
    ],
)
def test_a_broken_drive(changes: dict[str, Any], expected: str) -> None:
    with pytest.raises(ValueError, match=rf"^GlareDrive\.{expected}"):
        dataclasses.replace(approach(), **changes)


def test_the_eye_of_a_vehicle() -> None:
    drive = approach()
    assert isinstance(drive, GlareDrive)
    assert drive.eye(1) is drive.eyes[0]
    with pytest.raises(ValueError, match="no eye of vehicle 7"):
        drive.eye(7)
