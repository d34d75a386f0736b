"""Where headlamps may be and shine: a guard dims nothing for a vehicle that it believes beyond their light."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import numpy as np
from pydantic import Field

from foreglow.geometry import Floats, Pose
from foreglow.photometry.intensity import IntensityTable
from foreglow.photometry.matrix import MAX_AZIMUTH_DEG, MatrixLamp

MIN_FORWARD_M = 0.5
MAX_FORWARD_M = 12.0
"""Lamps before the rear axle; those of a long coach are some 9 m before it."""

MIN_ASIDE_M = 0.1
MAX_ASIDE_M = 2.0
"""The left lamp to the left of the middle, the right one to the right; half of the widest tractor is 1.5 m."""

MIN_HEIGHT_M = 0.2
MAX_HEIGHT_M = 3.0
"""Above the road; UN R48 has 0.5 to 1.2 m for cars, and snow ploughs have theirs at 2.5 m."""

MAX_YAW_DEG = 5.0
MAX_PITCH_DEG = 2.0
MAX_TURN_DEG = 5.0
"""Of a lamp's axis, and of its grid of LEDs, either way; headlamps are adjusted by about 2.5 degrees."""

MIN_LIT_DEG = -10.0
MAX_LIT_DEG = 15.0
"""Elevations between which LEDs may shine, in the vehicle's frame; to the sides it is `MAX_AZIMUTH_DEG`."""

DARK_CD = 1.0
"""Beyond these directions, an LED has at most this intensity."""

AHEAD_DEG = 5.0
MIN_AHEAD = 0.25
"""So near to straight ahead, and level, all LEDs of a lamp have at least this share of their peak somewhere. High beams
have at least 0.8 of it right there (UN R149)."""

BASE_ASIDE_DEG = 15.0
MIN_BASE_DEG = -10.0
MAX_BASE_DEG = 1.0
"""Where a low beam is brightest: just below the horizon, and a little to the side of the road's edge."""

Forward: TypeAlias = Annotated[float, Field(strict=True, ge=MIN_FORWARD_M, le=MAX_FORWARD_M)]
Aside: TypeAlias = Annotated[float, Field(strict=True, ge=-MAX_ASIDE_M, le=MAX_ASIDE_M)]
Height: TypeAlias = Annotated[float, Field(strict=True, ge=MIN_HEIGHT_M, le=MAX_HEIGHT_M)]
Yaw: TypeAlias = Annotated[float, Field(strict=True, ge=-MAX_YAW_DEG, le=MAX_YAW_DEG)]
Pitch: TypeAlias = Annotated[float, Field(strict=True, ge=-MAX_PITCH_DEG, le=MAX_PITCH_DEG)]
Turn: TypeAlias = Annotated[float, Field(strict=True, ge=-MAX_TURN_DEG, le=MAX_TURN_DEG)]


def check_base_aim(base: IntensityTable, vehicle_from_lamp: Pose) -> None:
    """Passes a low beam that is brightest where low beams are.

    Raises:
        ValueError: If it is brightest elsewhere.
    """
    azimuth, elevation = _brightest_deg(base, vehicle_from_lamp)
    if not (abs(azimuth) <= BASE_ASIDE_DEG and MIN_BASE_DEG <= elevation <= MAX_BASE_DEG):
        raise ValueError(
            f"expected a low beam that is brightest within {BASE_ASIDE_DEG:g} degrees of straight ahead, "
            f"{MIN_BASE_DEG:g} to {MAX_BASE_DEG:g} degrees high, got {_direction(azimuth, elevation)}"
        )


def check_led_order(lamp: MatrixLamp) -> None:
    """Passes LEDs that are listed from right to left, and from the lowest row up.

    Raises:
        ValueError: If the first column is left of the last, or the first row above the last.
    """
    azimuths, elevations = (each.reshape(-1, lamp.num_columns) for each in (lamp.azimuths_deg, lamp.elevations_deg))
    left_deg = float((azimuths[:, 0] - azimuths[:, -1]).mean())
    if left_deg > 0:
        raise ValueError(f"expected rows from right to left, the first LED is {left_deg:.1f} degrees left of the last")
    above_deg = float((elevations[0] - elevations[-1]).mean())
    if above_deg > 0:
        raise ValueError(f"expected the lowest row first, the first row is {above_deg:.1f} degrees above the last")


def check_led_aim(lamp: MatrixLamp, vehicle_from_lamp: Pose) -> None:
    """Passes LEDs that shine nowhere but where the guard looks, and together straight ahead.

    Raises:
        ValueError: If an LED shines beyond, or they are too dark straight ahead.
    """
    columns_deg, rows_deg = lamp.base.azimuths_deg[lamp.columns], lamp.base.elevations_deg[lamp.rows]
    lit = np.argwhere(lamp.leds_cd.max(axis=0) > DARK_CD)
    azimuths, elevations = _in_vehicle_deg(columns_deg[lit[:, 1]], rows_deg[lit[:, 0]], vehicle_from_lamp)
    step = _step_deg(lamp.base)  # so far beyond a lit cell, there may be light
    beyond = np.maximum.reduce(
        [np.abs(azimuths) + step - MAX_AZIMUTH_DEG, elevations + step - MAX_LIT_DEG, MIN_LIT_DEG + step - elevations]
    )
    furthest = int(beyond.argmax())
    if beyond[furthest] > 0:
        number = int(lamp.leds_cd[:, lit[furthest, 0], lit[furthest, 1]].argmax())
        raise ValueError(
            f"LED {number}: expected light within {MAX_AZIMUTH_DEG:g} degrees to the sides and {MIN_LIT_DEG:g} to "
            f"{MAX_LIT_DEG:g} degrees high, got some at {_direction(azimuths[furthest], elevations[furthest])}"
        )
    together = np.zeros(lamp.base.intensities_cd.shape, np.float32)
    together[lamp.rows, lamp.columns] = lamp.leds_cd.sum(axis=0)
    table = IntensityTable(lamp.base.azimuths_deg, lamp.base.elevations_deg, together)
    ahead = np.radians(np.linspace(-AHEAD_DEG, AHEAD_DEG, 101))
    level = np.stack([np.cos(ahead), np.sin(ahead), np.zeros_like(ahead)], axis=-1)
    ahead_cd, peak_cd = float(table.towards(level @ vehicle_from_lamp.rotation).max()), float(together.max())
    if ahead_cd < MIN_AHEAD * peak_cd:
        raise ValueError(
            f"all LEDs together: expected at least {MIN_AHEAD:g} of their peak, {peak_cd:.0f} cd, within {AHEAD_DEG:g} "
            f"degrees of straight ahead at elevation 0, got {ahead_cd:.0f} cd: the peak is at "
            f"{_direction(*_brightest_deg(table, vehicle_from_lamp))}"
        )


def _brightest_deg(table: IntensityTable, vehicle_from_lamp: Pose) -> tuple[float, float]:
    row, column = np.unravel_index(int(table.intensities_cd.argmax()), table.intensities_cd.shape)
    azimuths, elevations = _in_vehicle_deg(table.azimuths_deg[[column]], table.elevations_deg[[row]], vehicle_from_lamp)
    return float(azimuths[0]), float(elevations[0])


def _in_vehicle_deg(azimuths_deg: Floats, elevations_deg: Floats, vehicle_from_lamp: Pose) -> tuple[Floats, Floats]:
    """Azimuths and elevations in the vehicle's frame, of shape (N,), of those in the lamp's."""
    azimuths, elevations = np.radians(azimuths_deg), np.radians(elevations_deg)
    across = np.cos(elevations)
    directions = np.stack([across * np.cos(azimuths), across * np.sin(azimuths), np.sin(elevations)], axis=-1)
    x, y, z = (directions @ vehicle_from_lamp.rotation.T).T
    return np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))


def _step_deg(table: IntensityTable) -> float:
    return float(max(grid[1] - grid[0] for grid in (table.azimuths_deg, table.elevations_deg)))


def _direction(azimuth_deg: float, elevation_deg: float) -> str:
    return f"azimuth {azimuth_deg:.1f}, elevation {elevation_deg:.1f}"
