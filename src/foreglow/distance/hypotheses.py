"""The road-surface model: which kind of light a box may show, where along the road, and how likely that is.

A kind of light k is a line along the road with an offset and a height: lamps over either lane, the road itself, a
guard rail, whatever stands beside the road. A hypothesis is a kind k at one of the arc lengths s in `PLACES_M`, so it
has a position, a direction and a range. Bayes' rule weighs all hypotheses of a frame against each box; the weights
over the ranges are the distribution of the box's range. `docs/road_surface.md` explains the model and its fit.

Units and axes: metres and radians in the vehicle's frame, x forward, y left, z up; azimuths to the left, elevations
upwards. `log` is the natural logarithm.

Hidden state: (k, s). Observed for each box: the direction (a, e) of its light, the features f, and, where another box
looks like the second headlamp of the same vehicle, the range p that their spacing implies.

Position of hypothesis (k, s), for a centre line X, Y, Z with the heading psi, at the offset t and the height h; c is
the height of the road's cross section above its centre line, and the vehicle stands on a road that is z0 high and
leans by l:

    x = X - t sin(psi),   y = Y + t cos(psi),   z = Z + c(t) + h - z0 - l y                                     (1)

Direction and range from the camera, with (u, v, w) = (x, y, z) - camera and q^2 = u^2 + v^2:

    azimuth = atan2(v, u),   elevation = atan2(w, q),   r^2 = q^2 + w^2                                         (2)

A small displacement of the light turns its direction by

    d azimuth = (u dy - v dx) / q^2,   d elevation = dz / q - w (u dx + v dy) / q^3                             (3)

The covariance C of the direction adds up independent errors. Three displacements, turned into angles by (3):

    along the road within the cell          sigma_cell (cos psi, sin psi, slope)                                (4)
    the whole road, if we are further on    sigma_shift (T(s) - T(0) - kappa e_z x P)                           (5)
    across the road, over which it rises    sigma_offset (-sin psi, cos psi, dc/dt)                             (6)

with the tangent T, the position P = (x, y, 0) and the curvature kappa under the vehicle; and errors of a single angle:

    azimuth      sigma_yaw^2 + (sigma_left u / q^2)^2 + sigma_pixel^2 + (share of the box's width)^2            (7)
    elevation    ((sigma_pitch u)^2 + (sigma_roll v)^2 + sigma_height^2) / q^2
                 + sigma_slope^2 + sigma_pixel^2 + (share of the box's height)^2                                (8)

Log weight of a hypothesis for a box, up to a constant of the box:

    log w = log share_k - ((log r - m_k) / tau)^2 / 2 + log(length of the cell / range)       how common        (9)
          - d' C^-1 d / 2 - log|C| / 2,   d = (a - azimuth, e - elevation)                    direction        (10)
          - sum over i of ((f_i - mu_ki - beta_ki (log r - 4)) / sigma_i)^2 / 2               features         (11)
          + log P(pair | k, r)                                                                lamp pairs       (12)

A box of kind k has a partner with the probability 1 / (1 + exp(-g_k)). For lamps, the partner is the other headlamp of
the same vehicle with the probability rho, and then log p is Gaussian about log r; otherwise log p is Gaussian about a
fixed mean, whatever r is.

All functions work on NumPy arrays and, with `xp=torch`, on tensors, so the model is fitted with the code that uses it.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeAlias

import numpy as np
from pydantic import Field

from foreglow.config import FrozenModel, read_toml, validated
from foreglow.distance.lamp_pairs import SPACING_LOG_SIGMA
from foreglow.distance.ribbon import CELLS_M, PLACES_M, Array, Ribbon
from foreglow.geometry import Floats

SHIPPED = Path(__file__).with_name("road_surface.toml")

FEATURES = ("size", "shape", "contrast")
"""Features of a box: log of its width in radians, log of height over width, log of its contrast in grey levels."""

FEATURE_MEANS = np.array([-3.3, -0.5, 4.7])
FEATURE_SCALES = np.array([1.1, 0.8, 0.4])
"""Features are shifted and scaled by these, so that the model's numbers are of the order of 1."""

REFERENCE_LOG_RANGE = 4.0
"""Features of a kind are given at this log range: 55 m."""

ANYWHERE_SIGMA_RAD = 0.35
"""Standard deviation of the azimuth of kinds that are tied to no line: anywhere in the field of view."""

LEAST_HORIZONTAL_M = 0.1
"""From the camera to a place: a camera may be mounted right above one, from where it is in no direction."""

PLANE_SIGMA_RAD = 0.01
"""Slope of the ground against the plane under the vehicle, for those kinds."""

ROLL_SIGMA_RAD = float(np.radians(0.13))
"""Standard deviation of the roll of a body on its springs."""

PAIR_SHARE = 0.8
"""rho: share of the lamps with a partner whose partner is the other lamp of the same vehicle."""

PAIR_LOG_SIGMA = 0.9
PAIR_LOG_MEAN = 4.5
"""Spread and mean of the log range that two unrelated lights imply when they are taken for a pair."""

IMPOSSIBLE = -1e6
"""Log weight of a position beyond the map's end; finite, so that gradients stay finite."""

CELL_SIGMAS_M = CELLS_M / math.sqrt(12.0)
"""Standard deviation of a position that is equally likely anywhere in its cell."""

LOG_CELLS = np.log(CELLS_M / (PLACES_M - 2.0))
"""Log of the cell's length over its range: how much of the log range each position stands for."""

_PLACES, _CELL_SIGMAS, _LOG_CELLS = PLACES_M[:, None], CELL_SIGMAS_M[:, None], LOG_CELLS[:, None]

_Shifted: TypeAlias = Annotated[float, Field(ge=-20, le=20)]
"""A log, log odds, a slope or a scaled feature: far beyond what is ever fitted, and not yet what overflows."""

_Metres: TypeAlias = Annotated[float, Field(ge=-100, le=100)]
_SigmaMetres: TypeAlias = Annotated[float, Field(ge=1e-3, le=100)]
_Share: TypeAlias = Annotated[float, Field(ge=1e-6, le=100)]
_Three: TypeAlias = Annotated[tuple[_Shifted, _Shifted, _Shifted], Field(strict=False)]
_Shares: TypeAlias = Annotated[tuple[_Share, _Share, _Share], Field(strict=False)]
_TwoShares: TypeAlias = Annotated[tuple[_Share, _Share], Field(strict=False)]
_Two: TypeAlias = Annotated[tuple[_Shifted, _Shifted], Field(strict=False)]


class Kind(FrozenModel):
    """One kind of light, k in the equations.

    Attributes:
        name: Unique.
        side: Where its line runs: 1 along the left edge of the carriageway, -1 the right edge, 0 the centre line.
        offset_m: Distance of the line to the left of that edge or centre line.
        height_m: Height of the line above the carriageway.
        offset_sigma_m: Standard deviation of the offset (fitted).
        height_sigma_m: Standard deviation of the height (fitted).
        is_lamp: Whether it may be one of a pair of headlamps.
        is_anywhere: Whether it is tied to no line, but to its height above the plane under the vehicle.
        log_share: Log of how often it is seen, up to a constant (fitted).
        log_range: Mean log of its range in metres, m in (9) (fitted).
        features: Mean features of its boxes at 55 m, scaled, mu in (11) (fitted).
        size_slope: Slope of the feature `size` over the log range, beta in (11) (fitted).
        pair_logit: Log odds of having a partner, g in (12) (fitted).
    """

    name: str
    side: Annotated[float, Field(ge=-1, le=1)] = 0.0
    offset_m: _Metres = 0.0
    height_m: _Metres = 0.0
    offset_sigma_m: _SigmaMetres
    height_sigma_m: _SigmaMetres
    is_lamp: bool = False
    is_anywhere: bool = False
    log_share: _Shifted = 0.0
    log_range: _Shifted = 4.0
    features: _Three = (0.0, 0.0, 0.0)
    size_slope: _Shifted = 0.0
    pair_logit: _Shifted = 0.0


class Hypotheses(FrozenModel):
    """The whole model: all kinds of light, and the parameters that they share.

    Attributes:
        origin: What the model was fitted on.
        kinds: The kinds, lamps first.
        range_log_sigma: Spread of the log range of each kind, tau in (9) (fitted).
        feature_slopes: Slopes of shape and contrast over the log range, beta in (11) (fitted).
        feature_sigmas: Standard deviations of the features about their means, sigma in (11) (fitted).
        pixel_sigma_rad: Standard deviation of the direction of a small box's light (fitted).
        slope_sigma: Error of the map's slopes, and of everything else upwards but the pitch (fitted).
        box_shares: Standard deviation of the direction, as a share of the box's width and height (fitted).
        sigma_scale: Factor on the standard deviations that are reported (chosen on other drives).
    """

    origin: str = ""
    range_log_sigma: _Share = 0.9
    feature_slopes: _Two = (0.0, 0.0)
    feature_sigmas: _Shares = (1.0, 1.0, 1.0)
    pixel_sigma_rad: _Share = 0.0015
    slope_sigma: _Share = 0.0012
    box_shares: _TwoShares = (0.14, 0.14)
    sigma_scale: _Share = 1.0
    kinds: Annotated[tuple[Kind, ...], Field(strict=False, min_length=1)]


def read_hypotheses(path: Path | None = None) -> Hypotheses:
    """The model in the TOML file `path`; without a path, the model that ships.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not TOML, or a field is missing, unknown or out of range; the message names path and field.
    """
    path = path or SHIPPED
    return validated(Hypotheses, read_toml(path), str(path))


class Parameters(NamedTuple):
    """The numbers of a model as arrays, K kinds and F features; names as in `Kind` and `Hypotheses`."""

    side: Array
    offset_m: Array
    height_m: Array
    offset_sigma_m: Array
    height_sigma_m: Array
    is_anywhere: Array
    is_lamp: Array
    log_share: Array
    log_range: Array
    features: Array
    feature_slopes: Array
    pair_logit: Array
    range_log_sigma: Array
    feature_sigmas: Array
    pixel_sigma_rad: Array
    slope_sigma: Array
    box_shares: Array


def parameters_of(model: Hypotheses) -> Parameters:
    """The numbers of `model`: shapes (K,), (K, F), (F,) or scalars."""
    columns = {
        name: np.array([getattr(kind, name) for kind in model.kinds])
        for name in Kind.model_fields
        if name not in ("name", "size_slope")
    }
    slopes = np.array([[kind.size_slope, *model.feature_slopes] for kind in model.kinds])
    shared = {
        name: np.array(getattr(model, name))
        for name in Parameters._fields
        if name not in columns | {"feature_slopes": 0}
    }
    return Parameters(**columns, feature_slopes=slopes, **shared)


class Cells(NamedTuple):
    """What each hypothesis of a frame predicts; shape (C,), C = arc lengths times kinds, kinds varying fastest.

    Attributes:
        azimuths_rad: Direction of its light, to the left.
        elevations_rad: The same, upwards.
        variances_across: Variance of the azimuth, without the box's own share.
        covariances: Covariance of azimuth and elevation.
        variances_up: Variance of the elevation, without the box's own share.
        log_ranges: Log of the distance from the camera in metres.
        log_priors: Log of how common it is, (9).
    """

    azimuths_rad: Array
    elevations_rad: Array
    variances_across: Array
    covariances: Array
    variances_up: Array
    log_ranges: Array
    log_priors: Array


class _Lines(NamedTuple):
    """The kinds' lines as the camera sees them, and the errors of their directions; arrays that broadcast to (S, K)."""

    forward_m: Array
    left_m: Array
    up_m: Array
    variances_across: Array
    covariances: Array
    variances_up: Array
    is_known: Array


class BoxEvidence(NamedTuple):
    """What is observed of each of N boxes.

    Attributes:
        directions_rad: Shape (N, 2), azimuth and elevation of the light.
        sizes_rad: Shape (N, 2), width and height.
        features: Shape (N, F), the `FEATURES`, scaled.
        pair_log_ranges: Shape (N,), log of the range p at which the partner would be the other headlamp of the same
            vehicle; NaN without a partner.
    """

    directions_rad: Array
    sizes_rad: Array
    features: Array
    pair_log_ranges: Array


def cells_along(
    parameters: Parameters, road: Ribbon | None, camera_m: Floats, pitch_sigma_rad: float, xp: Any = np
) -> Cells:
    """The hypotheses along `road`; without a road, no kind is tied to a line.

    Args:
        parameters: The model's.
        road: The road in the vehicle's frame.
        camera_m: Shape (3,), position of the camera.
        pitch_sigma_rad: Standard deviation of the camera's pitch against the road.
        xp: The module of the parameters' arrays, NumPy or PyTorch.
    """
    x_m, y_m, z_m = (float(coordinate) for coordinate in camera_m)
    lines = _on_plane(parameters, x_m, z_m, xp)
    if road is not None:
        pairs = zip(lines, _on_road(parameters, road, (x_m, y_m, z_m), xp), strict=True)
        lines = _Lines(*(xp.where(parameters.is_anywhere, on_plane, on_road) for on_plane, on_road in pairs))
    forward, left, up = lines[:3]
    horizontal = xp.sqrt(xp.clip(forward * forward + left * left, LEAST_HORIZONTAL_M**2, None))  # q
    log_ranges = 0.5 * xp.log(horizontal * horizontal + up * up)  # (2)
    pixel, height = parameters.pixel_sigma_rad**2, (parameters.height_sigma_m / horizontal) ** 2
    tilt = ((pitch_sigma_rad * forward) ** 2 + (ROLL_SIGMA_RAD * left) ** 2) / (horizontal * horizontal)
    deviations = (log_ranges - parameters.log_range) / parameters.range_log_sigma
    log_cells = xp.where(lines.is_known, xp.asarray(_LOG_CELLS), IMPOSSIBLE)
    cells = (
        xp.arctan2(left, forward),  # (2)
        xp.arctan2(up, horizontal),
        lines.variances_across + pixel,  # (7)
        lines.covariances,
        lines.variances_up + pixel + height + tilt + parameters.slope_sigma**2,  # (8)
        log_ranges,
        parameters.log_share - 0.5 * deviations * deviations + log_cells,  # (9)
    )
    return Cells(*(column.reshape(-1) for column in cells))


def log_weights(parameters: Parameters, cells: Cells, boxes: BoxEvidence, xp: Any = np) -> Array:
    """Log weight of every hypothesis for every box, up to a constant for each box; shape (N, C)."""
    shares = (boxes.sizes_rad * parameters.box_shares) ** 2
    across = cells.variances_across + shares[:, :1]  # (7), the box's own share
    up = cells.variances_up + shares[:, 1:]  # (8)
    to_left = boxes.directions_rad[:, :1] - cells.azimuths_rad
    above = boxes.directions_rad[:, 1:] - cells.elevations_rad
    determinants = across * up - cells.covariances**2
    squares = up * to_left * to_left - 2.0 * cells.covariances * to_left * above + across * above * above
    weights = cells.log_priors - 0.5 * (squares / determinants + xp.log(determinants))  # (10)
    # (11), expanded: the squares of the features are the same for all hypotheses of a box and fall away.
    num_kinds = len(parameters.log_share)
    log_ranges = cells.log_ranges.reshape(-1, num_kinds, 1) - REFERENCE_LOG_RANGE
    means = (parameters.features + parameters.feature_slopes * log_ranges) / parameters.feature_sigmas
    means = means.reshape(-1, len(FEATURES))
    weights = weights + (boxes.features / parameters.feature_sigmas) @ means.T - 0.5 * (means * means).sum(-1)
    return weights + _pair_terms(parameters, cells, boxes, xp)


def _pair_terms(parameters: Parameters, cells: Cells, boxes: BoxEvidence, xp: Any) -> Array:
    """Equation (12) for every hypothesis and box, up to a constant for each box; shape (N, C).

    The density of log p is given relative to that of unrelated lights, so that lights other than lamps have 1.
    """
    num_places, num_kinds = len(PLACES_M), len(parameters.log_share)
    # log P(no partner) = -log(1 + exp(g)), and log P(partner) is that plus g.
    no_partner = -xp.log1p(xp.exp(parameters.pair_logit))
    has_partner = ~xp.isnan(boxes.pair_log_ranges)
    alone = xp.broadcast_to(no_partner, (num_places, num_kinds)).reshape(-1)
    if not bool(has_partner.any()):
        return alone
    seen = xp.where(has_partner, boxes.pair_log_ranges, PAIR_LOG_MEAN)[:, None]
    is_lamp = xp.broadcast_to(parameters.is_lamp, (num_places, num_kinds)).reshape(-1)
    same_vehicle = ((seen - cells.log_ranges) / SPACING_LOG_SIGMA) ** 2
    unrelated = ((seen - PAIR_LOG_MEAN) / PAIR_LOG_SIGMA) ** 2
    density = xp.exp(0.5 * (unrelated - same_vehicle)) * (PAIR_LOG_SIGMA / SPACING_LOG_SIGMA * PAIR_SHARE)
    paired = xp.where(is_lamp, xp.log(density + (1.0 - PAIR_SHARE)), 0.0) + xp.broadcast_to(
        parameters.pair_logit, (num_places, num_kinds)
    ).reshape(-1)
    return alone + xp.where(has_partner[:, None], paired, 0.0)


def _on_plane(parameters: Parameters, camera_x_m: float, camera_z_m: float, xp: Any) -> _Lines:
    """Lines that may be seen in any direction, at their height above the plane under the vehicle."""
    zeros = xp.zeros_like(xp.asarray(_PLACES) + parameters.height_m)
    return _Lines(
        forward_m=zeros + xp.asarray(_PLACES - camera_x_m),
        left_m=zeros,
        up_m=zeros + (parameters.height_m - camera_z_m),
        variances_across=zeros + ANYWHERE_SIGMA_RAD**2,
        covariances=zeros,
        variances_up=zeros + PLANE_SIGMA_RAD**2,
        is_known=zeros == 0.0,
    )


def _on_road(parameters: Parameters, road: Ribbon, camera_m: tuple[float, float, float], xp: Any) -> _Lines:
    """The kinds' lines along the road, with the errors of the map, of our position on it, and of the lines."""
    offset = parameters.side * road.half_width_m + parameters.offset_m
    inside = xp.clip(offset, -road.half_width_m, road.half_width_m)
    x, y = road.x_m - road.sin * offset, road.y_m + road.cos * offset  # (1)
    across = -road.banking * inside - road.crown * abs(inside)
    up = road.z_m + across - road.rise_m - road.lean * y + parameters.height_m - camera_m[2]
    forward, left = x - camera_m[0], y - camera_m[1]
    squared = xp.clip(forward * forward + left * left, LEAST_HORIZONTAL_M**2, None)
    horizontal = xp.sqrt(squared)
    to_cos, to_sin, fall = forward / squared, left / squared, up / squared

    def angles(x_m: Array, y_m: Array, z_m: Array) -> tuple[Array, Array]:  # (3)
        return to_cos * y_m - to_sin * x_m, z_m / horizontal - fall * (to_cos * x_m + to_sin * y_m) * horizontal

    cells_m = xp.asarray(_CELL_SIGMAS)
    cell = angles(cells_m * road.cos, cells_m * road.sin, cells_m * road.slope)  # (4)
    shift_m, turn = road.shift_sigma_m, road.curvature_per_m
    shift = angles(  # (5)
        shift_m * (road.cos - road.start_cos + turn * y),
        shift_m * (road.sin - road.start_sin - turn * x),
        shift_m * (road.slope - road.start_slope),
    )
    sigma = parameters.offset_sigma_m
    steep = xp.where(abs(offset) <= road.half_width_m, -road.banking - road.crown * xp.sign(offset), 0.0)
    line = angles(-road.sin * sigma, road.cos * sigma, steep * sigma)  # (6)
    pose = road.yaw_sigma_rad**2 + (road.left_sigma_m * to_cos) ** 2  # (7)
    return _Lines(
        forward_m=forward,
        left_m=left,
        up_m=up,
        variances_across=cell[0] ** 2 + shift[0] ** 2 + line[0] ** 2 + pose,
        covariances=cell[0] * cell[1] + shift[0] * shift[1] + line[0] * line[1],
        variances_up=cell[1] ** 2 + shift[1] ** 2 + line[1] ** 2,
        is_known=road.is_known,
    )
