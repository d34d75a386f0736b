"""Limits on a headlamp's light towards other drivers by regulations, as data for comparisons and plots.

Everything here was transcribed from public third-party notes of the regulations, not from the official texts, and the
regulations' test procedures are not followed: staying below these numbers does not prove compliance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foreglow.geometry import Floats
from foreglow.numbers import checked_floats, checked_whole

DOUBT = "transcribed from public third-party notes of the regulations, not the official texts; never call it compliant"

Towards: TypeAlias = Literal["oncoming", "preceding"]


@dataclass(frozen=True, slots=True)
class IlluminanceLimits:
    """Largest illuminance at another driver, by the range of that driver.

    Attributes:
        towards: Whose eyes: an oncoming driver's, or a preceding driver's in the mirrors.
        edges_m: Edges of the range bins, growing. A bin includes its beginning; the last bin includes its end as well.
        limits_lx: One limit for each bin.
        source: Origin of the numbers.
        doubt: Reservations about them.
    """

    towards: Towards
    edges_m: tuple[float, ...]
    limits_lx: tuple[float, ...]
    source: str
    doubt: str = DOUBT

    @property
    def bin_names(self) -> tuple[str, ...]:
        """Name of each bin, such as `15-30 m`."""
        return tuple(f"{a:g}-{b:g} m" for a, b in zip(self.edges_m[:-1], self.edges_m[1:], strict=True))

    def bins(self, range_m: ArrayLike) -> NDArray[np.int64]:
        """The bin of each range, any shape; -1 outside of all, and for NaN.

        >>> FMVSS_ONCOMING.bins([14.9, 15.0, 220.0, 221.0]).tolist()
        [-1, 0, 3, -1]
        """
        edges = np.array(self.edges_m)
        edges[-1] = np.nextafter(edges[-1], np.inf)
        bins = np.searchsorted(edges, checked_floats("range_m", range_m), side="right") - 1
        return np.where(bins < len(self.limits_lx), bins, -1)

    def at(self, range_m: ArrayLike) -> Floats:
        """The limit at each range, any shape, lx; infinity outside of all bins, and for NaN."""
        return np.array([*self.limits_lx, np.inf])[self.bins(range_m)]


@dataclass(frozen=True, slots=True)
class IntensityLimit:
    """Largest luminous intensity of one lamp towards a zone of directions, for traffic on the right.

    Attributes:
        towards: Whose eyes.
        distance_m: Distance of the driver that the zone stands for.
        limit_cd: Candela of one lamp.
        zone_deg: First and last azimuth to the left, and the elevation above the horizon; None where the notes leave
            them out.
        source: Origin of the numbers.
        doubt: Reservations about them.
    """

    towards: Towards
    distance_m: float
    limit_cd: float
    zone_deg: tuple[float, float, float] | None
    source: str
    doubt: str = DOUBT

    def illuminance_lx(self, num_lamps: int = 2) -> float:
        """Illuminance at the distance, on a plane that faces the lamps, when all of them shine as much as they may.

        >>> UN_R123[0].illuminance_lx()
        0.5
        """
        return checked_whole("num_lamps", num_lamps, 1) * self.limit_cd / self.distance_m**2


_FMVSS = "49 CFR 571.108 (FMVSS 108), track test of adaptive driving beams"

FMVSS_ONCOMING = IlluminanceLimits("oncoming", (15.0, 30.0, 60.0, 120.0, 220.0), (3.1, 1.8, 0.6, 0.3), _FMVSS)
"""Limits at an oncoming driver. The test scores the largest value of each bin rounded to 0.1 lx, and leaves out a
transition zone of 1 degree at the edges of the dark gap."""

FMVSS_PRECEDING = IlluminanceLimits("preceding", (15.0, 60.0, 100.0), (18.9, 4.0), _FMVSS)
"""Limits at the mirrors of a vehicle that drives in the same direction."""

_R123 = "UN R123, table 7: adaptation of the driving beam, traffic on the right"

UN_R123 = (
    IntensityLimit("oncoming", 50.0, 625.0, (2.0, 4.8, 0.57), _R123),
    IntensityLimit("oncoming", 100.0, 1_750.0, (1.0, 2.4, 0.3), _R123),
    IntensityLimit("oncoming", 200.0, 5_450.0, (0.5, 1.2, 0.15), _R123),
    IntensityLimit("preceding", 50.0, 1_850.0, None, _R123),
    IntensityLimit("preceding", 50.0, 2_500.0, None, _R123),
    IntensityLimit("preceding", 100.0, 5_300.0, None, _R123),
    IntensityLimit("preceding", 100.0, 7_000.0, None, _R123),
    IntensityLimit("preceding", 200.0, 16_000.0, None, _R123),
)
"""Limits for one lamp. Towards preceding vehicles there are two limits at 50 m and at 100 m, each for a part of the
zone; the notes do not say which."""
