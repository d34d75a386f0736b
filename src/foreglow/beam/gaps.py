"""Dark gaps in the beam: intervals of azimuth in the vehicle's frame, each for something within a span of ranges."""

from __future__ import annotations

from typing import NamedTuple


class Gap(NamedTuple):
    """One dark gap.

    Attributes:
        right_rad: Right border, azimuth to the left in the vehicle's frame.
        left_rad: Left border.
        near_m: Nearest range at which the protected vehicle may be, from the vehicle's origin; infinite where only the
            direction is known.
        far_m: Farthest range at which it may be.
        has_range: Whether the range is known, and `near_m` not just the nearest that is thought of.
    """

    right_rad: float
    left_rad: float
    near_m: float
    far_m: float
    has_range: bool = True


def merged(gaps: list[Gap]) -> list[Gap]:
    """Separate gaps that cover the given ones, from right to left; one has a range where all that it covers do.

    >>> merged([Gap(0.1, 0.3, 50, 60), Gap(0.2, 0.4, 30, 70), Gap(-0.2, -0.1, 90, 90)])[1]
    Gap(right_rad=0.1, left_rad=0.4, near_m=30, far_m=70, has_range=True)
    """
    apart: list[Gap] = []
    for gap in sorted(gaps):
        if apart and gap.right_rad <= apart[-1].left_rad:
            last = apart.pop()
            gap = Gap(
                last.right_rad,
                max(last.left_rad, gap.left_rad),
                min(last.near_m, gap.near_m),
                max(last.far_m, gap.far_m),
                last.has_range and gap.has_range,
            )
        apart.append(gap)
    return apart
