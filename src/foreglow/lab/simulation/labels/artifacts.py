"""Light artifacts of a vehicle in an image: where an annotator would put keypoints.

The renderer gives each vehicle's light separately, so there is no search in the noisy image: what counts is the grey
level that the light adds, compared with the noise in which an eye would have to find it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.datasets.simulated import KINDS, Artifact, Kind, LampTruth
from foreglow.geometry import Floats
from foreglow.lab.simulation.labels.peaks import area_above_half_px, find_peaks
from foreglow.lab.simulation.scenes.scene import LabelRule
from foreglow.lab.simulation.world.materials import MATERIALS, NO_MATERIAL

Greys: TypeAlias = NDArray[np.float32]
"""Grey levels of 8 bits, shape (height, width), float32."""

SMOOTHING_PX = 2.5
"""Standard deviation of the smoothing by an eye in search of light, at 1280 columns; tuned in the trial renderer."""
COLUMN_GREY = 0.35
"""Standard deviation of the columns' fixed pattern after smoothing; tuned in the trial renderer."""
TEXTURE_SHARE = 0.06
"""Share of the local texture that is mistaken for light; tuned in the trial renderer."""
TEXTURE_WINDOW_PX = 25.0
"""Side of the square of local texture, at 1280 columns."""
HALO_SHARE = 0.2
"""Share of the veil of the vehicle's own lamps that is mistaken for light; tuned in the trial renderer."""
CANDIDATE_FACTOR = 4.0
"""Candidates meet the rule with thresholds divided by this, or by the rule's own factor if that is larger."""
MAX_CANDIDATES = 40
"""So many of the strongest candidates of a vehicle in an image are kept; foliage yields more than a hundred."""
KIND_WINDOW_PX = 7.0
"""Side of the square around a peak that determines its kind, at 1280 columns: about the width of the smoothing."""
LAMP_MERGE_PX = 3.0
"""Lamps closer than this look like a single lamp, at 1280 columns: about the width of the point spread."""
HOUSING_M = 0.4
"""Lamps closer than this share a housing, such as low and high beam of a headlamp."""

_KIND_OF_MATERIAL = np.full(NO_MATERIAL + 1, KINDS.index("haze"), np.intp)
_KIND_OF_MATERIAL[: len(MATERIALS)] = [KINDS.index(material.kind) for material in MATERIALS]


@dataclass(frozen=True, slots=True, eq=False)
class VehicleLight:
    """Noise-free images with and without the light of a vehicle, each of shape (H, W).

    Attributes:
        grey_with: With all light.
        grey_without_indirect: Without the vehicle's reflected and scattered light, but with its lamps' discs and halo.
        grey_without: Without any of the vehicle's light.
        is_rear: Whether it is the light of its rear lamps.
    """

    grey_with: Greys
    grey_without_indirect: Greys
    grey_without: Greys
    is_rear: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """What else is known about each pixel, each of shape (H, W).

    Attributes:
        noise_grey: Standard deviation of the sensor's noise.
        materials: Index in `MATERIALS`, uint8; `NO_MATERIAL` for the sky.
        depth_m: Distance along the ray; without meaning for the sky.
        haze_share: Share of this vehicle's indirect light that comes from the air, 0..1.
    """

    noise_grey: Greys
    materials: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    haze_share: NDArray[np.float32]


def indirect_artifacts(
    light: VehicleLight,
    surroundings: Surroundings,
    rule: LabelRule,
    width_scale: float = 1.0,
    *,
    has_direct: bool = False,
) -> tuple[tuple[Artifact, ...], tuple[Artifact, ...]]:
    """Where a vehicle's reflected and scattered light is perceived, and all peaks under much looser thresholds.

    The smoothed difference D that the light makes and its contrast, D over noise, are both measured in units of the
    rule; the smaller of them is the strength, so that light is perceivable above 1. Peaks of the strength are the
    instances. The peaks do not depend on a common factor on both thresholds, and so `apply_rule(candidates, other)`
    gives the artifacts under a scaled rule without the images.

    Args:
        light: Images with and without the light.
        surroundings: Noise, material and depth.
        rule: When light counts.
        width_scale: Columns of the image over 1280.
        has_direct: Whether a lamp of the vehicle is seen.

    Returns:
        The artifacts and the candidates, both without instance ids, strongest first.
    """
    found = _strength(light, surroundings.noise_grey, rule, width_scale)
    if found is None:
        return (), ()
    peaks = _peak_pixels(found.strength, rule, width_scale)
    radius = max(1, round(KIND_WINDOW_PX * width_scale / 2))
    top, left = found.crop[0].start, found.crop[1].start
    candidates: list[Artifact] = []
    for row, column in peaks:
        pixel = (top + row, left + column)
        kind, depth_m = _lit_surface(found.difference, surroundings, pixel, radius)
        candidates.append(
            Artifact(
                instance_id=-1,
                position_px=(float(pixel[1]), float(pixel[0])),
                kind=kind,
                is_direct=False,
                is_rear=light.is_rear,
                is_doubtful=False,
                depth_m=depth_m,
                grey=float(found.grey[row, column]),
                contrast=float(found.contrast[row, column]),
                area_px=area_above_half_px(found.strength, row, column),
            )
        )
    return apply_rule(candidates, rule, width_scale, has_direct=has_direct), tuple(candidates)


def apply_rule(
    candidates: Iterable[Artifact], rule: LabelRule, width_scale: float = 1.0, *, has_direct: bool = False
) -> tuple[Artifact, ...]:
    """The artifacts among the `candidates` of a vehicle in an image, strongest first, then the doubtful artifacts.

    Those are doubtful that meet only the divided thresholds, and those that are left out because enough others are
    marked: neither answer would be wrong. All haze of a vehicle is a single glow, even where trees divide it: only
    its strongest peak is marked. Thresholds must be at least those of the rule under which the candidates were found,
    divided by `CANDIDATE_FACTOR`.
    """
    min_distance_px = rule.min_distance_px * width_scale
    max_marked = rule.max_instances if has_direct else rule.max_hidden_instances
    large = [candidate for candidate in candidates if candidate.area_px >= rule.min_area_px * width_scale**2]
    ranked = sorted(large, key=lambda candidate: -strength(candidate, rule))
    strongest = strength(ranked[0], rule) if ranked else 0.0
    marked: list[Artifact] = []
    doubtful: list[Artifact] = []
    for candidate in ranked:
        height = strength(candidate, rule)
        if height <= 1 / rule.doubtful_factor or not _is_apart(candidate, marked, min_distance_px):
            continue
        is_haze_again = candidate.kind == "haze" and any(other.kind == "haze" for other in marked)
        is_marked = (
            height > max(1.0, rule.relative_strength * strongest) and len(marked) < max_marked and not is_haze_again
        )
        if is_marked:
            marked.append(replace(candidate, is_doubtful=False))
        elif _is_apart(candidate, doubtful, min_distance_px):
            doubtful.append(replace(candidate, is_doubtful=True))
    return (*marked, *doubtful)


def strength(artifact: Artifact, rule: LabelRule) -> float:
    """The factor by which both thresholds could be raised until the artifact is no longer perceivable."""
    return min(artifact.grey / rule.min_grey, artifact.contrast / rule.min_contrast)


def scaled_rule(rule: LabelRule, factor: float) -> LabelRule:
    """`rule` with both thresholds of perceivability times `factor`."""
    fields = rule.model_dump()
    return LabelRule(**(fields | {name: fields[name] * factor for name in ("min_grey", "min_contrast")}))


def direct_artifacts(
    lamps: Sequence[LampTruth],
    peak_grey: Sequence[float],
    surroundings: Surroundings,
    camera_world_m: Floats,
    rule: LabelRule,
    width_scale: float = 1.0,
) -> tuple[Artifact, ...]:
    """The visible lamps as artifacts without instance ids, in the order of `lamps`.

    Lamps that share a housing or are not separated in the image become a single artifact at their mean position,
    weighted with their grey levels.

    Args:
        lamps: All lamps of a vehicle.
        peak_grey: Grey levels that each lamp adds at its peak.
        surroundings: Its noise is used.
        camera_world_m: Shape (3,), the camera's position.
        rule: When light counts.
        width_scale: Columns of the image over 1280.
    """
    groups: list[list[tuple[LampTruth, float]]] = []
    for lamp, grey in zip(lamps, peak_grey, strict=True):
        if lamp.visible_share < rule.min_visible or not grey > rule.min_grey:
            continue
        joined = next((group for group in groups if _is_joined(group[0][0], lamp, width_scale)), None)
        if joined is None:
            groups.append([(lamp, grey)])
        else:
            joined.append((lamp, grey))
    return tuple(_lamp_artifact(group, surroundings.noise_grey, camera_world_m) for group in groups)


@dataclass(frozen=True, slots=True, eq=False)
class _Strength:
    """The added light of the whole image, and of the part where it may be seen: smoothed, contrast, strength."""

    difference: Greys
    crop: tuple[slice, slice]
    grey: Greys
    contrast: Greys
    strength: Greys


def _strength(light: VehicleLight, noise_grey: Greys, rule: LabelRule, width_scale: float) -> _Strength | None:
    """How perceivable the light is, around the pixels that could pass; None where there are none."""
    sigma = SMOOTHING_PX * width_scale
    reach = math.ceil(3 * sigma)
    window = 2 * round(TEXTURE_WINDOW_PX * width_scale / 2) + 1
    whole = light.grey_with - light.grey_without_indirect
    # A smoothed pixel exceeds the floor only if a pixel within reach does.
    floor = rule.min_grey / max(CANDIDATE_FACTOR, rule.doubtful_factor)
    crop = _box_around(whole > floor, reach + max(reach, window // 2))
    if crop is None:
        return None
    difference = whole[crop]
    background = light.grey_without_indirect[crop]

    grey = _smoothed(difference, sigma, reach)
    # White noise of variance v, smoothed with a Gaussian g, has the variance (g^2 * v), and g^2 is a narrower Gaussian.
    sensor = _smoothed(noise_grey[crop] ** 2, sigma / math.sqrt(2), reach) * min(1.0, 1 / (4 * math.pi * sigma**2))
    mean = cv2.blur(background, (window, window))
    texture = np.maximum(cv2.blur(background * background, (window, window)) - mean * mean, 0.0)
    halo = _smoothed(background - light.grey_without[crop], sigma, reach)
    noise = np.sqrt(sensor + COLUMN_GREY**2 + TEXTURE_SHARE**2 * texture + HALO_SHARE**2 * halo * halo)
    contrast = np.asarray(grey / noise, np.float32)
    strengths = np.minimum(grey / np.float32(rule.min_grey), contrast / np.float32(rule.min_contrast))
    return _Strength(whole, crop, grey, contrast, strengths)


def _peak_pixels(strengths: Greys, rule: LabelRule, width_scale: float) -> list[tuple[int, int]]:
    """Row and column of the highest peaks, highest first; large images are smooth, so every second pixel is enough."""
    stride = 2 if width_scale >= 0.75 else 1
    coarse = np.ascontiguousarray(strengths[::stride, ::stride])
    peaks = find_peaks(coarse, 1 / max(CANDIDATE_FACTOR, rule.doubtful_factor), rule.saddle)
    pixels: list[tuple[int, int]] = []
    for row, column in zip(peaks.rows[:MAX_CANDIDATES].tolist(), peaks.columns[:MAX_CANDIDATES].tolist(), strict=True):
        top, left = max(0, stride * row - stride + 1), max(0, stride * column - stride + 1)
        around = strengths[top : stride * (row + 1), left : stride * (column + 1)]
        down, right = divmod(int(around.argmax()), around.shape[1])
        pixels.append((top + down, left + right))
    return pixels


def _smoothed(image: Greys, sigma_px: float, reach_px: int) -> Greys:
    size = (2 * reach_px + 1, 2 * reach_px + 1)
    return np.asarray(cv2.GaussianBlur(image, size, sigma_px, borderType=cv2.BORDER_REPLICATE), np.float32)


def _box_around(is_inside: NDArray[np.bool_], margin_px: int) -> tuple[slice, slice] | None:
    """The rows and columns of all true pixels and a margin, cut to the image."""
    rows = np.flatnonzero(is_inside.any(axis=1))
    if len(rows) == 0:
        return None
    columns = np.flatnonzero(is_inside[rows[0] : rows[-1] + 1].any(axis=0))
    return (
        slice(max(0, int(rows[0]) - margin_px), min(is_inside.shape[0], int(rows[-1]) + margin_px + 1)),
        slice(max(0, int(columns[0]) - margin_px), min(is_inside.shape[1], int(columns[-1]) + margin_px + 1)),
    )


def _lit_surface(
    difference: Greys, surroundings: Surroundings, pixel: tuple[int, int], radius_px: int
) -> tuple[Kind, float]:
    """The kind of surface with most of the light around `pixel` (row, column), and its brightest pixel's depth."""
    rows, columns = (slice(max(0, at - radius_px), at + radius_px + 1) for at in pixel)
    added = np.maximum(difference[rows, columns], 0.0).ravel()
    numbers = surroundings.materials[rows, columns].ravel()
    in_air = np.where(numbers == NO_MATERIAL, 1.0, surroundings.haze_share[rows, columns].ravel()) * added
    if in_air.sum() >= 0.5 * added.sum():
        return "haze", math.nan
    kinds = _KIND_OF_MATERIAL[numbers]
    on_surface = added - in_air
    kind = int(np.bincount(kinds, weights=on_surface).argmax())
    brightest = int(np.where(kinds == kind, on_surface, -1.0).argmax())
    return KINDS[kind], float(surroundings.depth_m[rows, columns].ravel()[brightest])


def _is_apart(artifact: Artifact, others: Iterable[Artifact], min_distance_px: float) -> bool:
    return all(math.dist(artifact.position_px, other.position_px) >= min_distance_px for other in others)


def _is_joined(lamp: LampTruth, other: LampTruth, width_scale: float) -> bool:
    return lamp.is_rear == other.is_rear and (
        math.dist(lamp.position_px, other.position_px) < LAMP_MERGE_PX * width_scale
        or math.dist(lamp.position_world_m, other.position_world_m) < HOUSING_M
    )


def _lamp_artifact(group: Sequence[tuple[LampTruth, float]], noise_grey: Greys, camera_world_m: Floats) -> Artifact:
    """The common artifact of joined lamps, given with their peaks."""
    weights = np.array([grey for _, grey in group])
    x, y = weights @ np.array([lamp.position_px for lamp, _ in group]) / weights.sum()
    first, peak = group[0][0], float(weights.max())
    row, column = (int(np.clip(round(at), 0, size - 1)) for at, size in zip((y, x), noise_grey.shape, strict=True))
    return Artifact(
        instance_id=-1,
        position_px=(float(x), float(y)),
        kind="lamp",
        is_direct=True,
        is_rear=first.is_rear,
        is_doubtful=False,
        depth_m=math.dist(first.position_world_m, camera_world_m),
        grey=peak,
        contrast=peak / float(noise_grey[row, column]),
        area_px=0,
        lamp=first.name,
    )
