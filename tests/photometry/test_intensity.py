from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foreglow.geometry import Pose, rotation
from foreglow.photometry import IntensityTable, illuminance_lx, low_beam, read_headlamps

AROUND = np.linspace(-180.0, 180.0, 361)
UPWARDS = np.linspace(-90.0, 90.0, 181)
HERE = Pose(np.zeros(3), np.eye(3))


def uniform(intensity_cd: float) -> IntensityTable:
    return IntensityTable(AROUND, UPWARDS, np.full((181, 361), intensity_cd, np.float32))


def lobe() -> IntensityTable:
    azimuths, elevations = np.meshgrid(AROUND, UPWARDS)
    return IntensityTable(
        AROUND, UPWARDS, np.exp(-((azimuths / 20) ** 2) - ((elevations - 5) / 10) ** 2).astype(np.float32)
    )


def test_flux_of_a_uniform_lamp() -> None:
    assert uniform(3.0).luminous_flux_lm == pytest.approx(4 * np.pi * 3.0, rel=1e-4)


@given(
    distance_m=st.floats(0.5, 500), factor=st.floats(1.1, 20), azimuth=st.floats(-3, 3), elevation=st.floats(-1.5, 1.5)
)
def test_inverse_square(distance_m: float, factor: float, azimuth: float, elevation: float) -> None:
    direction = rotation(azimuth, elevation)[:, 0]
    near, far = illuminance_lx(lobe(), HERE, np.stack([distance_m * direction, factor * distance_m * direction]))
    assert far * factor**2 == pytest.approx(near, rel=1e-6, abs=1e-12)


def test_illuminance_faces_the_lamp() -> None:
    """No cosine of a surface: points all around a uniform lamp at the same distance get the same light."""
    directions = rotation(0.3)[:, 0], rotation(2.0, 1.0)[:, 0], rotation(-3.0, -0.7)[:, 0]
    assert illuminance_lx(uniform(100.0), HERE, 5.0 * np.stack(directions)) == pytest.approx([4.0] * 3, rel=1e-6)


@given(yaw=st.floats(-1, 1), pitch=st.floats(-0.5, 0.5), shift=st.floats(-50, 50))
def test_aim_and_place_move_the_light(yaw: float, pitch: float, shift: float) -> None:
    pose = Pose(np.array([shift, 2.0, 0.6]), rotation(yaw, pitch))
    points = np.array([[10.0, 1.0, 0.5], [30.0, -4.0, -0.6]])
    assert illuminance_lx(lobe(), pose, pose.to_outer(points)) == pytest.approx(illuminance_lx(lobe(), HERE, points))


def test_left_is_positive_and_outside_is_dark() -> None:
    table = IntensityTable(np.array([0.0, 10.0]), np.array([0.0, 10.0]), np.array([[1, 2], [3, 4]], np.float32))
    tangent = np.tan(np.radians(10.0))
    upper_left = np.array([np.cos(np.radians(10.0)), np.sin(np.radians(10.0)), tangent])
    assert table.towards(np.array([[1, 0, 0], [1, tangent, 0], [1, 0, tangent]])) == pytest.approx([1, 2, 3], rel=1e-6)
    assert table.towards(upper_left) == pytest.approx(4, rel=1e-6)
    assert table.towards(np.array([[1, -0.01, 0], [1, 0, -0.01], [-1, 0, 0]])) == pytest.approx([0, 0, 0])


@pytest.mark.parametrize(
    ("azimuths", "intensities", "complaint"),
    [
        ([0.0, 1.0, 3.0], np.zeros((2, 3)), "equal steps"),
        ([0.0, 1.0], np.zeros((2, 3)), "expected shape"),
        ([0.0, 1.0], np.array([[0, 0], [0, -1]]), "at least 0"),
    ],
)
def test_bad_tables(azimuths: list[float], intensities: np.ndarray, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        IntensityTable(np.array(azimuths), np.array([0.0, 1.0]), intensities.astype(np.float32))


def test_lamps_that_all_share_cannot_be_changed() -> None:
    """Who moved a built-in table by a degree moved it for every later lamp of the process, and for the guard."""
    lamps, table = read_headlamps(), low_beam()
    assert read_headlamps() is lamps
    matrix, mount = lamps.right.matrix, lamps.right.vehicle_from_lamp
    arrays: list[Any] = [table.azimuths_deg, table.elevations_deg, table.intensities_cd, matrix.base.azimuths_deg]
    arrays += [matrix.leds_cd, matrix.azimuths_deg, matrix.elevations_deg, mount.position_m, mount.rotation]
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array += 1
    angles = AROUND.copy()
    mine = IntensityTable(angles, UPWARDS, np.ones((181, 361), np.float32))
    angles += 1.0
    assert mine.azimuths_deg[0] == -180.0


def test_there_is_no_illuminance_where_the_lamp_is() -> None:
    points = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    with pytest.raises(ValueError, match=r"points: expected points at least 1e-06 m away from the lamp, got one where"):
        illuminance_lx(uniform(3.0), HERE, points)
    headlamps = read_headlamps()
    with pytest.raises(ValueError, match=r"points: expected points at least 1e-06 m away from the lamp"):
        headlamps.illuminance_lx(headlamps.left.vehicle_from_lamp.position_m[None])
