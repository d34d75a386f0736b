"""The point at which a ray comes closest to a line of road points, in the plane or in space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats

MAX_SPACING_M = 2.0
"""A coarser line gets a point each metre: the closest point is only searched for beside the nearest point of the line,
and in a coarse line it may lie elsewhere."""

MIN_SQUARED_SINE = 1e-12
"""A ray at less than a millionth of a radian to the road runs along it: no point of it is the closest."""

_BESIDE = np.array([-1, 0])
"""The pieces that end and begin at a point, relative to its index."""


def dense(points_m: Floats) -> Floats:
    """The line through `points_m`, shape (N, D), with a further point each metre if it is coarse."""
    steps_m = points_m[1:] - points_m[:-1]
    squared = np.einsum("ij,ij->i", steps_m, steps_m)
    if squared.max() <= MAX_SPACING_M**2:
        return points_m
    arc_lengths_m = np.concatenate([[0.0], np.cumsum(np.sqrt(squared))])
    wanted_m = np.union1d(arc_lengths_m, np.arange(0.0, arc_lengths_m[-1]))
    return np.stack([np.interp(wanted_m, arc_lengths_m, column) for column in points_m.T], -1)


def nearest_points(along_m: Floats, offsets_m: Floats) -> NDArray[np.intp]:
    """Index i of the road point that is nearest to each ray, shape (M,): the least of D(x(t), P_i) over i and t >= 0.

    Args:
        along_m: Shape (M, N), d . (P_i - o) of each ray and point.
        offsets_m: Shape (N, D), P_i - o.

    Source: Ewecker et al., arXiv 2107.11302, distance estimation, method PSD-3D.
    """
    # The best t >= 0 for point i is max(0, d . (P_i - o)); there D^2 = |P_i - o|^2 - t^2.
    reach_m = np.maximum(along_m, 0.0)
    np.multiply(reach_m, reach_m, out=reach_m)
    np.subtract(np.einsum("ij,ij->i", offsets_m, offsets_m), reach_m, out=reach_m)
    return np.asarray(reach_m.argmin(axis=1))


def closest_approach(directions: Floats, offsets_m: Floats, nearest: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Distance along each ray at which it is closest to the line near point `nearest`, and the sine of their angle.

    The line is straight between its points, so that the result does not depend on where they lie.

    Args:
        directions: Shape (M, D), unit vectors d.
        offsets_m: Shape (N, D), the line's points relative to the rays' origin.
        nearest: Shape (M,), index of the point whose two adjoining pieces are searched.

    Returns:
        Distances t, shape (M,), metres, and sines, shape (M,). NaN where the closest point is the ray's origin or an
        end of the line (the line may go on beyond it), and where ray and line are parallel.
    """
    last = len(offsets_m) - 2
    pieces = np.minimum(np.maximum(nearest[:, None] + _BESIDE, 0), last)  # (M, 2)
    starts = offsets_m[pieces]
    spans = offsets_m[pieces + 1] - starts
    # |start + s span - t d|^2 is least where both derivatives are 0; s is then clipped to the piece.
    along_starts = np.einsum("ij,ikj->ik", directions, starts)
    along_spans = np.einsum("ij,ikj->ik", directions, spans)
    lengths_squared = np.einsum("ikj,ikj->ik", spans, spans)
    across_squared = lengths_squared - along_spans * along_spans
    is_across = across_squared > MIN_SQUARED_SINE * lengths_squared
    across_squared[~is_across] = np.inf
    shares = (along_spans * along_starts - np.einsum("ikj,ikj->ik", spans, starts)) / across_squared
    shares = np.minimum(np.maximum(shares, 0.0), 1.0)
    feet = starts + shares[..., None] * spans
    reaches_m = np.maximum(along_starts + shares * along_spans, 0.0)
    better = (np.einsum("ikj,ikj->ik", feet, feet) - reaches_m * reaches_m).argmin(axis=1)
    chosen = np.arange(len(better)), better
    piece, share, reach_m = pieces[chosen], shares[chosen], reaches_m[chosen]
    is_inside = ((piece > 0) | (share > 0.0)) & ((piece < last) | (share < 1.0))
    is_found = is_inside & (reach_m > 0.0) & is_across[chosen]
    sines = np.sqrt(np.where(is_found, across_squared[chosen] / lengths_squared[chosen], 1.0))
    return np.where(is_found, reach_m, np.nan), np.where(is_found, sines, np.nan)
