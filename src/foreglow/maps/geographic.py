"""From latitude and longitude to metres east and north of an origin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from foreglow.geometry import Floats

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
    """

    latitude_deg: float
    longitude_deg: float

    def local(self, latitudes_deg: ArrayLike, longitudes_deg: ArrayLike) -> Floats:
        """Metres east and north, shape (..., 2), of positions on the ellipsoid.

        >>> GeographicOrigin(48.0, 9.0).local(48.0, 9.0).tolist()
        [0.0, 0.0]
        """
        here = _earth_centred_m(self.latitude_deg, self.longitude_deg)
        there = _earth_centred_m(latitudes_deg, longitudes_deg)
        return np.asarray((there - here) @ _axes(self.latitude_deg, self.longitude_deg)[:, :2])

    def yaw_rad(self, latitude_deg: float, longitude_deg: float, heading_deg: float) -> float:
        """Yaw in the map, to the left of x, of a heading at a position, clockwise from its own north."""
        heading = np.radians(heading_deg)
        forward = _axes(latitude_deg, longitude_deg) @ [np.sin(heading), np.cos(heading), 0.0]
        east, north, _ = _axes(self.latitude_deg, self.longitude_deg).T @ forward
        return float(np.arctan2(north, east))


def check_position(latitude_deg: float, longitude_deg: float, origin: str) -> None:
    """Checks a latitude and a longitude in degrees.

    Raises:
        ValueError: If either is NaN or out of range; the message begins with `origin`.
    """
    if not (abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180):
        raise ValueError(
            f"{origin}: expected a latitude of -90 to 90 and a longitude of -180 to 180 degrees, got "
            f"{latitude_deg:g} and {longitude_deg:g}"
        )


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


def _axes(latitude_deg: float, longitude_deg: float) -> Floats:
    """East, north and up as columns, shape (3, 3), in the earth's frame."""
    (sin_lat, sin_lon), (cos_lat, cos_lon) = (f(np.radians([latitude_deg, longitude_deg])) for f in (np.sin, np.cos))
    return np.array(
        [
            [-sin_lon, -sin_lat * cos_lon, cos_lat * cos_lon],
            [cos_lon, -sin_lat * sin_lon, cos_lat * sin_lon],
            [0.0, cos_lat, sin_lat],
        ]
    )
