"""Lamps beside each other at a vehicle's spacing are one vehicle; nothing else is."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from math import inf, nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foreglow.geometry import Camera
from foreglow.lab.evaluation.lamp_pairs import group_vehicles
from foreglow.types import Tracks, TrackState
from foreglow.types.kinds import kinds_of_direct
from tests.stand_ins import tracks_of
from tests.tracking.made_up import camera

CAMERA = camera()
LAMP_M = 0.2


def tracks_at(*lamps_m: tuple[float, float, float], sigma: float = 0.1, **fields: Any) -> Tracks:
    """Tracks of lamps at these places in the vehicle's frame, with their ranges, known to the share `sigma`."""
    points = np.array(lamps_m, np.float64).reshape(-1, 3)
    mount = CAMERA.vehicle_from_camera
    ranges_m = np.linalg.norm(points - mount.position_m, axis=1)
    centres = CAMERA.project(mount.to_body(points))
    halves = LAMP_M * CAMERA.focal_px[0] / ranges_m[:, None]
    tracks = tracks_of(
        np.concatenate([centres - halves, centres + halves], axis=1).tolist(), ranges_m=ranges_m.tolist()
    )
    return dataclasses.replace(tracks, sigmas_m=sigma * ranges_m, **fields)


def grouped(tracks: Tracks, calibration: Camera = CAMERA) -> list[list[int]]:
    return [group.tolist() for group in group_vehicles(tracks, calibration)]


def car(x_m: float, y_m: float, spacing_m: float = 1.35, z_m: float = 0.65) -> Sequence[tuple[float, float, float]]:
    return [(x_m, y_m + spacing_m / 2, z_m), (x_m, y_m - spacing_m / 2, z_m)]


@pytest.mark.parametrize("x_m", [10.0, 30.0, 80.0, 150.0])
@pytest.mark.parametrize("spacing_m", [1.2, 1.5, 1.9])
def test_two_lamps_of_a_vehicle(x_m: float, spacing_m: float) -> None:
    assert grouped(tracks_at(*car(x_m, 3.0, spacing_m))) == [[0, 1]]


@pytest.mark.parametrize(
    ("lamps_m", "why"),
    [
        ([(40.0, 3.0, 0.65), (40.0, 8.0, 0.65)], "too far apart"),
        ([(40.0, 3.0, 0.65), (40.0, 3.3, 0.65)], "too near each other"),
        ([(40.0, 3.0, 0.65), (40.0, 3.3, 2.0)], "one above the other"),
        ([(30.0, 3.0, 0.65), (60.0, 4.35, 0.65)], "one behind the other"),
    ],
)
def test_lamps_of_different_vehicles(lamps_m: list[tuple[float, float, float]], why: str) -> None:
    assert grouped(tracks_at(*lamps_m)) == [[0], [1]], why


def test_two_vehicles_side_by_side() -> None:
    """Of the three lamps in a row that a vehicle might have, the likelier two."""
    lamps_m = [*car(40.0, 5.0), *car(40.0, 2.5, z_m=0.7)]
    assert grouped(tracks_at(*lamps_m)) == [[0, 1], [2, 3]]


def test_light_on_something_belongs_to_none() -> None:
    tracks = tracks_at(*car(40.0, 3.0), light_kinds=kinds_of_direct(np.array([0.9, 0.2])))
    assert grouped(tracks) == [[0]]
    assert grouped(dataclasses.replace(tracks, light_kinds=kinds_of_direct(np.array([nan, 0.6])))) == [[0, 1]]
    assert grouped(dataclasses.replace(tracks, light_kinds=kinds_of_direct(np.zeros(2)))) == []


def test_tentative_tracks_belong_to_none() -> None:
    states = np.array([TrackState.TENTATIVE, TrackState.COASTING])
    assert grouped(tracks_at(*car(40.0, 3.0), states=states)) == [[1]]


def test_without_a_range_a_lamp_stays_alone() -> None:
    tracks = tracks_at(*car(40.0, 3.0))
    tracks = dataclasses.replace(tracks, ranges_m=np.array([40.0, nan]), sigmas_m=np.array([4.0, inf]))
    assert grouped(tracks) == [[0], [1]]
    assert grouped(tracks_of([])) == []


def test_a_range_without_a_sigma_is_a_rough_one() -> None:
    tracks = tracks_at(*car(40.0, 3.0))
    assert grouped(dataclasses.replace(tracks, sigmas_m=np.full(2, inf))) == [[0, 1]]


@given(st.lists(st.tuples(st.floats(5, 200), st.floats(-8, 8), st.floats(0.4, 2)), max_size=8), st.integers(0, 9))
def test_every_lamp_is_in_one_vehicle(lamps_m: list[tuple[float, float, float]], seed: int) -> None:
    """Whatever the order of the tracks, each is in one group, and the groups are the same."""
    tracks = tracks_at(*lamps_m)
    groups = grouped(tracks)
    assert sorted(index for group in groups for index in group) == list(range(len(tracks)))
    assert all(len(group) in (1, 2) for group in groups)
    assert groups == sorted(groups)
    order = np.random.default_rng(seed).permutation(len(lamps_m))
    shuffled = [
        sorted(int(order[index]) for index in group) for group in grouped(tracks_at(*[lamps_m[k] for k in order]))
    ]
    pairs = {tuple(group) for group in groups if len(group) == 2}
    if len({round(lamp[0], 3) for lamp in lamps_m}) == len(lamps_m):  # equal deviations may go either way
        assert {tuple(group) for group in shuffled if len(group) == 2} == pairs
