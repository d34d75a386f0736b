from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch")

import torch
from scipy import ndimage

from foreglow.lab.learning.augmentation import affine_maps, augment, blended, stretched
from foreglow.lab.learning.recipes import RECIPES, Augmentation

pytestmark = pytest.mark.torch

NO_FEATURES = torch.zeros(8, 0)


def crops(num_channels: int = 1, num_crops: int = 8, size_px: int = 32) -> torch.Tensor:
    values = np.random.default_rng(1).random((num_crops, num_channels, size_px, size_px))
    return torch.from_numpy(ndimage.gaussian_filter(values, (0, 0, 2, 2)).astype(np.float32))


def altered(images: torch.Tensor, features: torch.Tensor | None = None, seed: int = 0, **fields: Any) -> torch.Tensor:
    given = torch.zeros(len(images), 0) if features is None else features
    random = torch.Generator().manual_seed(seed)
    found, others = augment(images, given, Augmentation(**fields), torch.ones(given.shape[1]), random)
    assert found.shape == images.shape
    return found if features is None else others


def test_nothing_is_done_by_default() -> None:
    assert torch.equal(altered(crops()), crops())


def test_flip_reflects_about_half_of_the_crops() -> None:
    images = crops(num_crops=200)
    found = altered(images, flip=0.5)
    is_flipped = [torch.equal(one, image.flip(2)) for one, image in zip(found, images, strict=True)]
    is_kept = [torch.equal(one, image) for one, image in zip(found, images, strict=True)]
    assert all(a != b for a, b in zip(is_flipped, is_kept, strict=True))
    assert 70 < sum(is_flipped) < 130
    assert torch.equal(altered(images, flip=1.0), images.flip(3))


def test_flip_in_the_map_is_the_same_reflection() -> None:
    images = crops()
    found = altered(images, flip=1.0, rotation_deg=1e-9)
    torch.testing.assert_close(found, images.flip(3), atol=1e-4, rtol=0)


@pytest.mark.parametrize("angle", [90.0, 180.0, 37.0])
def test_rotation_is_that_of_scipy(angle: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the draw fixed to the end of the range; only where both see no border."""
    monkeypatch.setattr(torch, "rand", lambda num, **_: torch.ones(num))
    images = crops()
    found = altered(images, rotation_deg=angle)[:, 0].numpy()
    turned = [ndimage.rotate(one, angle, reshape=False, order=1) for one in images[:, 0].numpy()]
    other = [ndimage.rotate(one, -angle, reshape=False, order=1) for one in images[:, 0].numpy()]
    rows, columns = np.mgrid[:32, :32] - 15.5
    is_inner = rows**2 + columns**2 < 14**2
    errors = [np.abs(found - np.array(expected))[:, is_inner].max() for expected in (turned, other)]
    assert min(errors) < 1e-3
    assert angle == 180.0 or max(errors) > 0.1


def test_cut_outs_stay_inside_and_have_the_area_and_ratio() -> None:
    augmentation = Augmentation(min_area=0.5, max_ratio=1.5)
    maps = affine_maps(2000, augmentation, torch.Generator().manual_seed(0)).double()
    corners = torch.tensor([[-1, -1, 1], [-1, 1, 1], [1, -1, 1], [1, 1, 1]], dtype=torch.float64)
    assert (maps @ corners.T).abs().max() <= 1 + 1e-6
    width, height = maps[:, 0, 0], maps[:, 1, 1]
    area, ratio = width * height, width / height
    assert area.min() > 0.4  # a side that was cut makes it smaller
    assert area.max() < 1 + 1e-6
    assert 1 / 1.5 - 1e-6 < ratio.min() < 0.75
    assert 1.4 < ratio.max() < 1.5 + 1e-6


def test_a_turned_cut_out_keeps_its_shape() -> None:
    """Rotation and size, but no shear where width and height are the same; reflected ones turn the other way."""
    maps = affine_maps(500, Augmentation(rotation_deg=20.0, flip=0.5), torch.Generator().manual_seed(0))[:, :, :2]
    torch.testing.assert_close(maps @ maps.transpose(1, 2), torch.eye(2).expand(500, 2, 2))
    signs = torch.linalg.det(maps).round()
    assert 200 < (signs == 1).sum() < 300
    assert (torch.abs(maps[:, 1, 0]) <= np.sin(np.radians(20)) + 1e-6).all()


def test_all_channels_move_alike() -> None:
    images = crops()
    pairs = torch.cat([images, 0.5 * images], dim=1)
    found = altered(pairs, rotation_deg=20.0, min_area=0.8, max_ratio=1.5, flip=0.5)
    torch.testing.assert_close(found[:, 1], 0.5 * found[:, 0])
    torch.testing.assert_close(found[:, :1], altered(images, rotation_deg=20.0, min_area=0.8, max_ratio=1.5, flip=0.5))


def test_gamma_keeps_black_white_and_order() -> None:
    images = stretched(crops())
    found = altered(images, gamma=0.2)
    assert (found.amin(dim=(2, 3)) == 0).all()
    assert (found.amax(dim=(2, 3)) == 1).all()
    assert torch.equal(found.flatten(1).argsort(stable=True), images.flatten(1).argsort(stable=True))
    exponents = torch.log(found[images > 0.1]) / torch.log(images[images > 0.1])
    exponents = exponents[torch.isfinite(exponents)]
    assert (exponents > 1 / 1.2 - 1e-3).all()
    assert (exponents < 1 / 0.8 + 1e-3).all()


def test_noise_is_bounded_and_new_for_every_pixel() -> None:
    images = torch.full((50, 1, 16, 16), 0.5)
    found = altered(images, noise=0.05)
    deviations = found.std(dim=(1, 2, 3))
    assert deviations.min() < 0.01
    assert 0.03 < deviations.max() < 0.06
    assert altered(images, noise=1.0).amax() <= 1


def test_samples_are_blended_with_others_by_at_most_a_half() -> None:
    images = torch.arange(64.0)[:, None, None, None].expand(64, 2, 4, 4)
    features = torch.arange(64.0)[:, None].expand(64, 3)
    found, others = blended(images, features, torch.Generator().manual_seed(1))
    torch.testing.assert_close(found.amin(dim=(1, 2, 3)), found.amax(dim=(1, 2, 3)))
    torch.testing.assert_close(found[:, 0, 0, :3], others)  # crop and features with the same one
    changes = others[:, 0] - features[:, 0]
    assert changes.abs().max() <= 63 / 2
    assert len(set(changes.tolist())) > 50
    again, same = blended(images, features, torch.Generator().manual_seed(1), is_compared=True)
    torch.testing.assert_close(again, found)
    torch.testing.assert_close(same, features)  # places of a frame's boxes stay


def test_stretching_is_by_the_first_channel_and_leaves_constant_ones_black() -> None:
    images = crops(num_channels=2)
    low, high = images[:, 0].amin(dim=(1, 2)), images[:, 0].amax(dim=(1, 2))
    found = altered(images, normalise=True)
    assert (found[:, 0].amin(dim=(1, 2)) == 0).all()
    assert (found[:, 0].amax(dim=(1, 2)) == 1).all()
    expected = (images[:, 1] - low[:, None, None]) / (high - low)[:, None, None]
    torch.testing.assert_close(found[:, 1], expected.clamp(0, 1))
    assert (altered(torch.full((8, 1, 4, 4), 0.3), normalise=True) == 0).all()


def test_a_missing_history_stays_black() -> None:
    images = crops(num_channels=2)
    images[::2, 1] = 0
    found = altered(images, noise=0.5, gamma=0.2, normalise=True, rotation_deg=20.0)
    assert (found[::2, 1] == 0).all()
    assert (found[1::2, 1].amax(dim=(1, 2)) > 0).all()


def test_history_is_dropped_from_the_second_channel_alone() -> None:
    images = crops(num_channels=2, num_crops=200)
    found = altered(images, history_dropout=0.15)
    assert torch.equal(found[:, 0], images[:, 0])
    is_black = (found[:, 1] == 0).all(dim=(1, 2))
    assert torch.equal(found[~is_black], images[~is_black])
    assert 15 <= is_black.sum() <= 50
    assert torch.equal(altered(crops(), history_dropout=1.0), crops())


def test_feature_noise_is_in_the_features_units() -> None:
    features = torch.zeros(4000, 2)
    random = torch.Generator().manual_seed(0)
    scale = torch.tensor([1.0, 100.0])
    images = torch.zeros(4000, 1, 2, 2)
    _, found = augment(images, features, Augmentation(feature_noise=0.1), scale, random)
    assert found.std(dim=0).tolist() == pytest.approx([0.1, 10.0], rel=0.1)


def test_the_published_augmentation_draws_by_its_generator_alone() -> None:
    augmentation = RECIPES["paper"].augmentation
    found: list[torch.Tensor] = []
    for own_seed in (1, 1, 2):
        torch.manual_seed(own_seed + len(found))
        random = torch.Generator().manual_seed(own_seed)
        found.append(augment(crops(), NO_FEATURES, augmentation, torch.ones(0), random)[0])
    assert torch.equal(found[0], found[1])
    assert not torch.equal(found[0], found[2])
    for one in found:
        assert one.min() >= 0
        assert one.max() <= 1


def test_the_surroundings_keep_their_own_range_and_are_no_earlier_image() -> None:
    near, wide = torch.full((4, 2, 8, 8), 0.25), torch.full((4, 1, 8, 8), 0.5)
    near[:, 0, 2:6], wide[:, 0, 2:6] = 0.5, 0.6
    fields = Augmentation(normalise=True, history_dropout=1.0)
    random = torch.Generator().manual_seed(0)
    found, _ = augment(torch.cat([near, wide], 1), torch.zeros(4, 0), fields, torch.ones(0), random, has_context=True)
    assert [float(found[:, 0].amin()), float(found[:, 0].amax())] == [0.0, 1.0]
    assert not found[:, 1].any()
    assert [float(found[:, 2].amin()), float(found[:, 2].amax())] == [0.0, 1.0]
