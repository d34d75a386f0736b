"""From latitude and longitude to metres east and north of an origin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from foreglow.geometry import Floats
from foreglow.numbers import checked_floats, checked_number
from foreglow.wording import shortened

SEMI_MAJOR_M = 6_378_137.0
FLATTENING = 1 / 298.257223563
"""WGS 84."""


@dataclass(frozen=True, slots=True)
class GeographicOrigin:
    """The position of x = 0, y = 0 of a map; x points east and y north there. Heights are not changed.

    Positions are projected along the origin's plumb line onto the plane that touches the ellipsoid there. That is exact
    at the origin, and d metres away distances are too short by a share of (d / 6370 km)^2 / 2: 1.2e-6 at 10 km,
    1.2e-4 at 100 km.

    Attributes:
        latitude_deg: WGS 84, -90 to 90.
        longitude_deg: WGS 84, -180 to 180.

    Raises:
        ValueError: If one is no number, or out of range.
    """

    latitude_deg: float
    longitude_deg: float

    def __post_init__(self) -> None:
        for name in ("latitude_deg", "longitude_deg"):
            object.__setattr__(self, name, checked_number(f"GeographicOrigin.{name}", getattr(self, name)))
        check_position(self.latitude_deg, self.longitude_deg, "GeographicOrigin")

    def local(self, latitudes_deg: ArrayLike, longitudes_deg: ArrayLike) -> Floats:
        """Metres east and north, shape (..., 2), of positions on the ellipsoid.

        Raises:
            ValueError: If they are no numbers, or out of range.

        >>> GeographicOrigin(48.0, 9.0).local(48.0, 9.0).tolist()
        [0.0, 0.0]
        """
        latitudes_deg, longitudes_deg = _checked_degrees(latitudes_deg, longitudes_deg)
        here = _earth_centred_m(self.latitude_deg, self.longitude_deg)
        there = _earth_centred_m(latitudes_deg, longitudes_deg)
        return np.asarray((there - here) @ _axes(self.latitude_deg, self.longitude_deg)[:, :2])

    def yaw_rad(self, latitudes_deg: ArrayLike, longitudes_deg: ArrayLike, headings_deg: ArrayLike) -> Floats:
        """Yaws in the map, to the left of x, of headings at positions, clockwise from their own north.

        Raises:
            ValueError: If they are no numbers, or positions out of range.
        """
        latitudes_deg, longitudes_deg = _checked_degrees(latitudes_deg, longitudes_deg)
        headings = np.radians(checked_floats("headings_deg", headings_deg))[..., None]
        axes = _axes(latitudes_deg, longitudes_deg)
        forward = np.sin(headings) * axes[..., 0] + np.cos(headings) * axes[..., 1]
        east, north, _ = np.moveaxis(forward @ _axes(self.latitude_deg, self.longitude_deg), -1, 0)
        return np.asarray(np.arctan2(north, east))


def check_position(latitude_deg: float, longitude_deg: float, origin: str) -> None:
    """Checks a latitude and a longitude in degrees.

    Raises:
        ValueError: If either is NaN or out of range; the message begins with `origin`.
    """
    if not (abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180):
        raise ValueError(
            f"{origin}: expected a latitude of -90 to 90 and a longitude of -180 to 180 degrees, got "
            f"{latitude_deg:.10g} and {longitude_deg:.10g}"
        )


def _checked_degrees(latitudes_deg: ArrayLike, longitudes_deg: ArrayLike) -> tuple[Floats, Floats]:
    """Both as numbers; ValueError if they are none, or out of range."""
    latitudes = checked_floats("latitudes_deg", latitudes_deg)
    longitudes = checked_floats("longitudes_deg", longitudes_deg)
    for name, values, most in (("latitudes_deg", latitudes, 90), ("longitudes_deg", longitudes, 180)):
        is_right = np.abs(values) <= most
        if not is_right.all():
            raise ValueError(f"{name}: expected -{most} to {most} degrees, got {shortened(values[~is_right][0])}")
    return latitudes, longitudes


def _earth_centred_m(latitudes_deg: ArrayLike, longitudes_deg: ArrayLike) -> Floats:
    """Positions on the ellipsoid, shape (..., 3), metres from the centre of the earth."""
    latitude, longitude = np.radians(latitudes_deg), np.radians(longitudes_deg)
    eccentricity2 = FLATTENING * (2 - FLATTENING)
    radius_m = SEMI_MAJOR_M / np.sqrt(1 - eccentricity2 * np.sin(latitude) ** 2)
    level_m = radius_m * np.cos(latitude)
    return np.stack(
        [level_m * np.cos(longitude), level_m * np.sin(longitude), (1 - eccentricity2) * radius_m * np.sin(latitude)],
        -1,
    )


def _axes(latitudes_deg: ArrayLike, longitudes_deg: ArrayLike) -> Floats:
    """East, north and up as columns, shape (..., 3, 3), in the earth's frame."""
    latitude, longitude = np.radians(latitudes_deg), np.radians(longitudes_deg)
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    east = np.stack([-sin_lon, cos_lon, np.zeros_like(longitude)], -1)
    north = np.stack([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat], -1)
    up = np.stack([cos_lat * cos_lon, cos_lat * sin_lon, sin_lat], -1)
    return np.stack([east, north, up], -1)
