"""Augmentation of a batch of crops in torch. Importing this module needs the `train` extra."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from foreglow.classifier.inputs import FEATURES
from foreglow.lab.learning.recipes import Augmentation

HAS_EARLIER, SIDE = FEATURES.index("has_earlier"), FEATURES.index("side")
COLUMN = FEATURES.index("column")
PLACES = [FEATURES.index(name) for name in ("row", "column", "side")]
SIZES = [FEATURES.index(name) for name in ("width", "height")]

# A crop with a smaller range counts as constant: a hundredth of a grey level, which no camera resolves.
_MIN_RANGE = 1e-4


def augment(
    crops: Tensor,
    features: Tensor,
    augmentation: Augmentation,
    feature_scale: Tensor,
    random: torch.Generator,
    *,
    has_context: bool = False,
    sizes: Sequence[int] | None = None,
) -> tuple[Tensor, Tensor]:
    """Altered copies of `crops` and `features`, drawn from `random` for each sample.

    Reflection, rotation and cropping are one affine map with one bilinear interpolation, the same for all channels of
    a sample. Every channel stays in [0, 1]; a second channel that is black, without an earlier image, stays black.

    Args:
        crops: Shape (N, C, S, S), float32 in [0, 1].
        features: Shape (N, F), float32.
        augmentation: What to do.
        feature_scale: Shape (F,): the unit of `feature_noise` for each feature.
        random: A generator on the CPU, so that the same seed draws the same on every device.
        has_context: Whether the last channel shows the surroundings, and not an earlier image.
        sizes: Numbers of samples of each frame, which sum to N, for networks that compare them: those of a frame are
            reflected together, and their features are moved together, so that their differences stay true.
    """
    frames = None if sizes is None else torch.repeat_interleave(torch.tensor(list(sizes)))  # the frame of each sample
    signs = None if frames is None else _signs(int(frames[-1]) + 1, augmentation, random)[frames]
    num_near = crops.shape[1] - has_context
    has_earlier = crops[:, 1:num_near].amax(dim=(2, 3), keepdim=True) > 0
    crops = _moved(crops, augmentation, random, signs)
    if augmentation.gamma:
        gamma = _uniform(len(crops), 1 - augmentation.gamma, 1 + augmentation.gamma, random)
        crops = crops.clamp_min(0) ** (1 / gamma).to(crops.device)[:, None, None, None]
    if augmentation.noise:
        strength = _uniform(len(crops), 0, augmentation.noise, random).to(crops.device)
        noise = torch.empty(crops.shape).normal_(generator=random).to(crops.device)
        crops = (crops + strength[:, None, None, None] * noise).clamp(0, 1)
    near, context = crops[:, :num_near], crops[:, num_near:]
    if augmentation.normalise:
        near, context = stretched(near), stretched(context) if has_context else context
    if num_near > 1:
        earlier = near[:, 1:] * has_earlier
        if augmentation.history_dropout:
            is_kept = (_uniform(len(crops), 0, 1, random) >= augmentation.history_dropout).to(crops.device)
            earlier = earlier * is_kept[:, None, None, None]
            if features.shape[1]:  # one of the features says whether there is an earlier image
                features = features.clone()
                features[:, HAS_EARLIER] *= is_kept
        near = torch.cat([near[:, :1], earlier], dim=1)
    crops = torch.cat([near, context], dim=1)
    if frames is not None and signs is not None:
        zooms = _uniform(int(frames[-1]) + 1, -augmentation.zoom, augmentation.zoom, random)
        zooms = zooms[frames].to(features.device)
        features = features.clone()
        features[:, SIDE] *= signs.to(features.device)
        features[:, PLACES] *= torch.exp(zooms)[:, None]
        features[:, SIZES] += zooms[:, None] / (10 * math.log(2))
    if augmentation.feature_noise and features.shape[1]:
        num_draws = len(features) if frames is None else int(frames[-1]) + 1
        noise = torch.empty(num_draws, features.shape[1]).normal_(generator=random)
        noise = (noise if frames is None else noise[frames]).to(features.device)
        features = features + augmentation.feature_noise * feature_scale * noise
        if frames is not None:
            features[:, COLUMN] = features[:, SIDE].abs()
    return crops, features


def blended(
    crops: Tensor, features: Tensor, random: torch.Generator, *, is_compared: bool = False
) -> tuple[Tensor, Tensor]:
    """`crops` and `features` with up to half of another sample blended into each: inputs for a teacher to comment on.

    Features stay for networks that compare the boxes of a frame, since they say how these lie to one another.

    Source: the mixup of Beyer et al., arXiv 2106.05237.
    """
    others = torch.randperm(len(crops), generator=random).to(crops.device)
    shares = _uniform(len(crops), 0, 0.5, random).to(crops.device)
    return (
        crops.lerp(crops[others], shares[:, None, None, None]),
        features if is_compared else features.lerp(features[others], shares[:, None]),
    )


def stretched(crops: Tensor) -> Tensor:
    """Every crop stretched to [0, 1] by the minimum and maximum of its first channel; constant crops become zero.

    A second channel is stretched in the same way and clipped to [0, 1], as in `classifier.inputs`.
    """
    low = crops[:, :1].amin(dim=(2, 3), keepdim=True)
    width = crops[:, :1].amax(dim=(2, 3), keepdim=True) - low
    return torch.where(width > _MIN_RANGE, (crops - low) / width.clamp_min(_MIN_RANGE), 0).clamp(0, 1)


def affine_maps(
    num_maps: int, augmentation: Augmentation, random: torch.Generator, signs: Tensor | None = None
) -> Tensor:
    """Affine maps from the altered crop to the original one, shape (N, 2, 3), in the [-1, 1] of `affine_grid`.

    A map takes the result to a window of size (w, h) inside the crop, turns it about the crop's centre, and reflects
    it. Area and ratio of the window are drawn as in torchvision's RandomResizedCrop; a side that would be longer than
    the crop is shortened, where torchvision draws again. With `signs`, shape (N,), those of -1 are reflected.
    """
    angle = torch.deg2rad(_uniform(num_maps, -augmentation.rotation_deg, augmentation.rotation_deg, random))
    area = _uniform(num_maps, augmentation.min_area, 1, random)
    limit = math.log(augmentation.max_ratio)
    ratio = torch.exp(_uniform(num_maps, -limit, limit, random))
    width, height = (area * ratio).sqrt().clamp_max(1), (area / ratio).sqrt().clamp_max(1)
    x = (1 - width) * _uniform(num_maps, -1, 1, random)
    y = (1 - height) * _uniform(num_maps, -1, 1, random)
    sign = _signs(num_maps, augmentation, random) if signs is None else signs
    cos, sin = angle.cos(), angle.sin()
    rows = (sign * cos * width, -sign * sin * height, sign * (cos * x - sin * y), sin * width, cos * height)
    return torch.stack([*rows, sin * x + cos * y], dim=1).view(num_maps, 2, 3)


def _signs(num_signs: int, augmentation: Augmentation, random: torch.Generator) -> Tensor:
    """-1 for what is reflected, 1 for the rest."""
    return torch.where(_uniform(num_signs, 0, 1, random) < augmentation.flip, -1.0, 1.0)


def _moved(crops: Tensor, augmentation: Augmentation, random: torch.Generator, signs: Tensor | None = None) -> Tensor:
    is_turned = augmentation.rotation_deg or augmentation.min_area < 1 or augmentation.max_ratio > 1
    if not is_turned:  # no interpolation where it is not needed
        if not augmentation.flip:
            return crops
        signs = _signs(len(crops), augmentation, random) if signs is None else signs
        is_flipped = (signs < 0).to(crops.device)
        return torch.where(is_flipped[:, None, None, None], crops.flip(3), crops)
    maps = affine_maps(len(crops), augmentation, random, signs).to(crops.device)
    grid = functional.affine_grid(maps, list(crops.shape), align_corners=False)
    return functional.grid_sample(crops, grid, mode="bilinear", padding_mode="zeros", align_corners=False)


def _uniform(num_values: int, low: float, high: float, random: torch.Generator) -> Tensor:
    return torch.rand(num_values, generator=random) * (high - low) + low
