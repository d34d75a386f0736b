"""What may be lit in a box: kinds of light along the road, and how likely each of them is at each place.

A kind of light is a line along the road, at some offset and height: lamps over either lane, the road itself, rails,
what stands beside it. A hypothesis is a kind at a place, thus with a range. For each, the direction in which its light
should be seen is Gaussian about the line's, and so are the features of its box: together with how often each kind is
seen at which range, Bayes' rule gives every hypothesis a weight.

All functions work on NumPy arrays and, with `xp=torch`, on tensors: the model is fitted by what it is used with.
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
"""Of a box: log of its width in radians, log of height over width, log of its contrast in grey levels."""

FEATURE_MEANS = np.array([-3.3, -0.5, 4.7])
FEATURE_SCALES = np.array([1.1, 0.8, 0.4])
"""Features are taken relative to these, so that the model's numbers are of the order of 1."""

REFERENCE_LOG_RANGE = 4.0
"""Features of a kind are given at this log of metres, 55 m."""

ANYWHERE_SIGMA_RAD = 0.35
"""Kinds that are tied to no line may be seen in any direction of the view."""

PLANE_SIGMA_RAD = 0.01
"""Slope of the ground against the plane that we stand on, for those kinds."""

ROLL_SIGMA_RAD = float(np.radians(0.13))
"""Of a body on its springs."""

PAIR_SHARE = 0.8
"""Of the lamps with a partner, those whose partner is the same vehicle's other lamp."""

PAIR_LOG_SIGMA = 0.9
PAIR_LOG_MEAN = 4.5
"""Of the range that a pair seems to have where it is none."""

IMPOSSIBLE = -1e6
"""Log weight of a place that the map does not reach; finite, so that gradients are."""

CELL_SIGMAS_M = CELLS_M / math.sqrt(12.0)
"""Of a place within its cell."""

LOG_CELLS = np.log(CELLS_M / (PLACES_M - 2.0))
"""Log of how much of the log range each place stands for."""

_PLACES, _CELL_SIGMAS, _LOG_CELLS = PLACES_M[:, None], CELL_SIGMAS_M[:, None], LOG_CELLS[:, None]

_Three: TypeAlias = Annotated[tuple[float, float, float], Field(strict=False)]
_Two: TypeAlias = Annotated[tuple[float, float], Field(strict=False)]


class Kind(FrozenModel):
    """One kind of light.

    Attributes:
        name: Unique.
        side: Where its line runs: 1 the left edge of the carriageway, -1 the right one, 0 the centre line.
        offset_m: And further to the left of that.
        height_m: Above the carriageway.
        offset_sigma_m: Standard deviation of the offset (fitted).
        height_sigma_m: Of the height (fitted).
        is_lamp: Whether it may be one of a pair.
        is_anywhere: Whether it is tied to no line: at its height above the plane that we stand on.
        log_share: Log of how often it is seen, to a constant (fitted).
        log_range: Mean log of its range in metres (fitted).
        features: Of its boxes at 55 m, relative (fitted).
        size_slope: Of the size over the log of the range (fitted).
        pair_logit: Log odds of having a partner (fitted).
    """

    name: str
    side: Annotated[float, Field(ge=-1, le=1)] = 0.0
    offset_m: float = 0.0
    height_m: float = 0.0
    offset_sigma_m: Annotated[float, Field(gt=0)]
    height_sigma_m: Annotated[float, Field(gt=0)]
    is_lamp: bool = False
    is_anywhere: bool = False
    log_share: float = 0.0
    log_range: float = 4.0
    features: _Three = (0.0, 0.0, 0.0)
    size_slope: float = 0.0
    pair_logit: float = 0.0


class Hypotheses(FrozenModel):
    """All kinds of light, and what they share.

    Attributes:
        origin: What it was fitted on.
        kinds: Lamps first.
        range_log_sigma: Spread of the log of each kind's range (fitted).
        feature_slopes: Of shape and contrast over the log of the range (fitted).
        feature_sigmas: Of the features about their means (fitted).
        pixel_sigma_rad: Of the direction of a small box's light (fitted).
        slope_sigma: Of the map's slopes, and what else errs upwards beside the pitch (fitted).
        box_shares: Of the direction, in widths and heights of the box (fitted).
        sigma_scale: Of the stated standard deviations (chosen on other drives).
    """

    origin: str = ""
    range_log_sigma: Annotated[float, Field(gt=0)] = 0.9
    feature_slopes: _Two = (0.0, 0.0)
    feature_sigmas: _Three = (1.0, 1.0, 1.0)
    pixel_sigma_rad: Annotated[float, Field(gt=0)] = 0.0015
    slope_sigma: Annotated[float, Field(gt=0)] = 0.0012
    box_shares: _Two = (0.14, 0.14)
    sigma_scale: Annotated[float, Field(gt=0)] = 1.0
    kinds: Annotated[tuple[Kind, ...], Field(strict=False, min_length=1)]


def read_hypotheses(path: Path | None = None) -> Hypotheses:
    """The model in the TOML file `path`; the one that ships without.

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
    """All hypotheses of a frame: what is expected of each; shape (C,), C = places times kinds, kinds fastest.

    Attributes:
        azimuths_rad: Direction of its light, to the left.
        elevations_rad: Upwards.
        variances_across: Of the azimuth.
        covariances: Of both.
        variances_up: Of the elevation.
        log_ranges: Of the distance from the camera, metres.
        log_priors: How likely it is before its box is looked at.
    """

    azimuths_rad: Array
    elevations_rad: Array
    variances_across: Array
    covariances: Array
    variances_up: Array
    log_ranges: Array
    log_priors: Array


class _Lines(NamedTuple):
    """The kinds' lines seen from the camera, and how their directions err; shape (S, K), or what broadcasts to it."""

    forward_m: Array
    left_m: Array
    up_m: Array
    variances_across: Array
    covariances: Array
    variances_up: Array
    is_known: Array


class BoxEvidence(NamedTuple):
    """What is seen of each box, N of them.

    Attributes:
        directions_rad: Shape (N, 2), azimuth to the left and elevation of its light.
        sizes_rad: Shape (N, 2), width and height.
        features: Shape (N, F), relative, as `FEATURES`.
        pair_log_ranges: Shape (N,), log of the range at which a partner would be the other headlamp; NaN without one.
    """

    directions_rad: Array
    sizes_rad: Array
    features: Array
    pair_log_ranges: Array


def cells_along(
    parameters: Parameters, road: Ribbon | None, camera_m: Floats, pitch_sigma_rad: float, xp: Any = np
) -> Cells:
    """The hypotheses along `road`; without one, no kind is tied to a line.

    Args:
        parameters: Of the model.
        road: As it lies before us.
        camera_m: Shape (3,), where the camera is.
        pitch_sigma_rad: Standard deviation of the camera's pitch against the road.
        xp: Of the parameters' arrays, NumPy or PyTorch.
    """
    x_m, y_m, z_m = (float(one) for one in camera_m)
    lines = _on_plane(parameters, x_m, z_m, xp)
    if road is not None:
        pairs = zip(lines, _on_road(parameters, road, (x_m, y_m, z_m), xp), strict=True)
        lines = _Lines(*(xp.where(parameters.is_anywhere, one, other) for one, other in pairs))
    forward, left, up = lines[:3]
    level = xp.sqrt(forward * forward + left * left)
    log_ranges = 0.5 * xp.log(level * level + up * up)
    pixel, height = parameters.pixel_sigma_rad**2, (parameters.height_sigma_m / level) ** 2
    tilt = ((pitch_sigma_rad * forward) ** 2 + (ROLL_SIGMA_RAD * left) ** 2) / (level * level)
    offs = (log_ranges - parameters.log_range) / parameters.range_log_sigma
    log_priors = parameters.log_share - 0.5 * offs * offs + xp.where(lines.is_known, xp.asarray(_LOG_CELLS), IMPOSSIBLE)
    cells = (
        xp.arctan2(left, forward),
        xp.arctan2(up, level),
        lines.variances_across + pixel,
        lines.covariances,
        lines.variances_up + pixel + height + tilt + parameters.slope_sigma**2,
        log_ranges,
        log_priors,
    )
    return Cells(*(one.reshape(-1) for one in cells))


def log_weights(parameters: Parameters, cells: Cells, boxes: BoxEvidence, xp: Any = np) -> Array:
    """Log weight of every hypothesis for every box, to a constant for each box; shape (N, C)."""
    shares = (boxes.sizes_rad * parameters.box_shares) ** 2
    across = cells.variances_across + shares[:, :1]
    up = cells.variances_up + shares[:, 1:]
    right = boxes.directions_rad[:, :1] - cells.azimuths_rad
    above = boxes.directions_rad[:, 1:] - cells.elevations_rad
    determinants = across * up - cells.covariances**2
    squares = up * right * right - 2.0 * cells.covariances * right * above + across * above * above
    weights = cells.log_priors - 0.5 * (squares / determinants + xp.log(determinants))
    # Gaussian features with the same variance for all kinds: what is left is linear in them.
    num_kinds = len(parameters.log_share)
    log_ranges = cells.log_ranges.reshape(-1, num_kinds, 1) - REFERENCE_LOG_RANGE
    means = (parameters.features + parameters.feature_slopes * log_ranges) / parameters.feature_sigmas
    means = means.reshape(-1, len(FEATURES))
    weights = weights + (boxes.features / parameters.feature_sigmas) @ means.T - 0.5 * (means * means).sum(-1)
    return weights + _pair_terms(parameters, cells, boxes, xp)


def _pair_terms(parameters: Parameters, cells: Cells, boxes: BoxEvidence, xp: Any) -> Array:
    """Log likelihood of having a partner at the seen distance, or none, to a constant for each box; shape (N, C)."""
    num_places, num_kinds = len(PLACES_M), len(parameters.log_share)
    # log(1 + exp(x)) for having one, with the sign turned for having none.
    no_partner = -xp.log1p(xp.exp(parameters.pair_logit))
    has_partner = ~xp.isnan(boxes.pair_log_ranges)
    alone = xp.broadcast_to(no_partner, (num_places, num_kinds)).reshape(-1)
    if not bool(has_partner.any()):
        return alone
    seen = xp.where(has_partner, boxes.pair_log_ranges, PAIR_LOG_MEAN)[:, None]
    is_lamp = xp.broadcast_to(parameters.is_lamp, (num_places, num_kinds)).reshape(-1)
    of_one = ((seen - cells.log_ranges) / SPACING_LOG_SIGMA) ** 2
    of_two = ((seen - PAIR_LOG_MEAN) / PAIR_LOG_SIGMA) ** 2
    ratio = xp.exp(0.5 * (of_two - of_one)) * (PAIR_LOG_SIGMA / SPACING_LOG_SIGMA * PAIR_SHARE) + (1.0 - PAIR_SHARE)
    paired = xp.where(is_lamp, xp.log(ratio), 0.0) + xp.broadcast_to(
        parameters.pair_logit, (num_places, num_kinds)
    ).reshape(-1)
    return alone + xp.where(has_partner[:, None], paired, 0.0)


def _on_plane(parameters: Parameters, camera_x_m: float, camera_z_m: float, xp: Any) -> _Lines:
    """Lines that may be seen in any direction, at their height above the plane that we stand on."""
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
    """The kinds' lines along the road, with the errors of the map, of our place on it, and of the lines themselves."""
    offset = parameters.side * road.half_width_m + parameters.offset_m
    inside = xp.clip(offset, -road.half_width_m, road.half_width_m)
    x, y = road.x_m - road.sin * offset, road.y_m + road.cos * offset
    across = -road.banking * inside - road.crown * abs(inside)
    up = road.z_m + across - road.rise_m - road.lean * y + parameters.height_m - camera_m[2]
    forward, left = x - camera_m[0], y - camera_m[1]
    squared = forward * forward + left * left
    level = xp.sqrt(squared)
    # Displacements become angles: across by the perpendicular over the distance, ...
    to_cos, to_sin, fall = forward / squared, left / squared, up / squared

    def angles(x_m: Array, y_m: Array, z_m: Array) -> tuple[Array, Array]:
        return to_cos * y_m - to_sin * x_m, z_m / level - fall * (to_cos * x_m + to_sin * y_m) * level

    # ... of the place within its cell, along the road; ...
    cells_m = xp.asarray(_CELL_SIGMAS)
    cell = angles(cells_m * road.cos, cells_m * road.sin, cells_m * road.slope)
    # ... of the whole road, when we are further along it than we believe: P' = T(s) - T(0) - kappa z x P; ...
    shift_m, turn = road.shift_sigma_m, road.curvature_per_m
    shift = angles(
        shift_m * (road.cos - road.start_cos + turn * y),
        shift_m * (road.sin - road.start_sin - turn * x),
        shift_m * (road.slope - road.start_slope),
    )
    # ... and of the line across the road, over which it also rises.
    sigma = parameters.offset_sigma_m
    steep = xp.where(abs(offset) <= road.half_width_m, -road.banking - road.crown * xp.sign(offset), 0.0)
    line = angles(-road.sin * sigma, road.cos * sigma, steep * sigma)
    stand = road.yaw_sigma_rad**2 + (road.left_sigma_m * to_cos) ** 2
    return _Lines(
        forward_m=forward,
        left_m=left,
        up_m=up,
        variances_across=cell[0] ** 2 + shift[0] ** 2 + line[0] ** 2 + stand,
        covariances=cell[0] * cell[1] + shift[0] * shift[1] + line[0] * line[1],
        variances_up=cell[1] ** 2 + shift[1] ** 2 + line[1] ** 2,
        is_known=road.is_known,
    )
