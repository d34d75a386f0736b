"""The reference against the paper's equations in closed form, and against plain loops."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foreglow.config import ProposalConfig
from foreglow.proposals import reference
from foreglow.proposals.reference import ReferenceProposer


def test_block_sums_leave_out_what_fills_no_block() -> None:
    image = np.arange(35, dtype=np.uint8).reshape(5, 7)
    assert reference.block_sums(image, 3).tolist() == [[int(image[:3, :3].sum()), int(image[:3, 3:6].sum())]]


@pytest.mark.parametrize(
    ("width_px", "reduction", "half_window_px"), [(1280, 2, 9), (640, 1, 9), (3840, 6, 9), (2872, 4, 10), (64, 1, 1)]
)
def test_sizes_scale_with_the_width(width_px: int, reduction: int, half_window_px: int) -> None:
    sizes = reference.working_sizes(ProposalConfig(), width_px)
    assert (sizes.reduction, sizes.half_window_px) == (reduction, half_window_px)
    ratio = (width_px // reduction) / 640
    assert sizes.max_area_px == pytest.approx(1999 * ratio**2)


def test_gap_and_limits_scale_with_the_width() -> None:
    """2872 columns are reduced by 4 to 718, which is 1.121875 times the 640 that the sizes are meant for."""
    sizes = reference.working_sizes(ProposalConfig(gap_px=13, min_area_px=100, min_width_px=10), 2872)
    assert sizes.gap_px == 15  # 14.58
    assert sizes.min_area_px == pytest.approx(125.86, abs=0.01)
    assert sizes.min_width_px == pytest.approx(11.22, abs=0.01)
    assert reference.working_sizes(ProposalConfig(gap_px=13), 64).gap_px == 1


def test_normalisation() -> None:
    sums = np.array([[100, 204], [612, 1020]])
    own = reference.normalised(sums, 1020, ProposalConfig())
    np.testing.assert_allclose(own, [[0, 104 / 920], [512 / 920, 1]], rtol=1e-15)
    full = reference.normalised(sums, 1020, ProposalConfig(normalise=False))
    np.testing.assert_allclose(full, sums / 1020, rtol=1e-15)
    stages = ReferenceProposer(ProposalConfig(normalise=False)).stages(np.full((64, 1280), 51, np.uint8))
    assert stages is not None
    np.testing.assert_allclose(stages.blurred, 0.2, atol=1e-12)


def test_blur_spreads_a_point_as_the_product_of_its_kernels() -> None:
    image = np.zeros((9, 11))
    image[4, 5] = 1.0
    blurred = reference.blur(image, ProposalConfig(blur_sigma_px=0.7))
    across = np.exp(-0.5 * (np.arange(-2, 3) / 0.7) ** 2)
    down = np.exp(-0.5 * (np.arange(-1, 2) / 0.7) ** 2)
    wanted = np.outer(down / down.sum(), across / across.sum())
    np.testing.assert_allclose(blurred[3:6, 3:8], wanted, atol=1e-15)
    assert blurred.sum() == pytest.approx(1.0)


def test_blur_mirrors_about_the_border_pixel() -> None:
    image = np.zeros((6, 6))
    image[0, 1] = 1.0
    blurred = reference.blur(image, ProposalConfig(blur_width_px=3, blur_height_px=1))
    side = np.exp(-0.125)
    assert blurred[0, 0] == pytest.approx(2 * side / (1 + 2 * side))  # column 1 is seen on both sides


@pytest.mark.parametrize("window", ["published", "centred"])
@pytest.mark.parametrize("half_window_px", [1, 4, 9])
def test_local_mean_equals_plain_loops(window: str, half_window_px: int) -> None:
    image = np.random.default_rng(0).random((13, 17))
    mean = reference.local_mean(image, half_window_px, window)
    back, first = (half_window_px - 1, 1) if window == "published" else (half_window_px, 0)
    for y in range(13):
        for x in range(17):
            inside = image[max(first, y - back) : y + half_window_px + 1, max(first, x - back) : x + half_window_px + 1]
            assert mean[y, x] == pytest.approx(inside.mean(), abs=1e-12)


def test_published_window_is_off_centre() -> None:
    image = np.zeros((41, 41))
    image[20, 20] = 1.0
    mean = reference.local_mean(image, 3, "published")
    rows, columns = np.nonzero(mean > 1e-12)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (17, 22, 17, 22)
    assert mean.max() == pytest.approx(1 / 36)


def is_set(image: np.ndarray, mean: np.ndarray, kappa: float, eps: float) -> np.ndarray:
    return reference.exceeds_threshold(image, reference.dynamic_threshold(image, mean, kappa, eps))


def test_threshold_in_closed_form() -> None:
    """Without eps, D = 1/2 makes the contrast term 1 - 1 = 0, so that T is the mean itself."""
    mean = np.array([0.25])
    above = is_set(mean + 0.5 + 1e-9, mean, kappa=10.0, eps=1e-12)
    assert above.all()
    # For D -> 0 the threshold is mean (1 + kappa), which a pixel at the mean stays below for any kappa > 0.
    assert not is_set(mean, mean, kappa=1e-6, eps=1e-3).any()
    assert not is_set(np.zeros(1), np.zeros(1), kappa=0.0, eps=1e-3).any()


def test_threshold_by_hand() -> None:
    """I = 0.5, mu = 0.2, eps = 0.1: D = 0.3, D / (1 - D + eps) = 0.375, so that kappa = 1.5 / 0.625 = 2.4 ties."""
    value, mean = np.array([0.5]), np.array([0.2])
    assert is_set(value, mean, kappa=2.4 - 1e-6, eps=0.1).all()
    assert not is_set(value, mean, kappa=2.4 + 1e-6, eps=0.1).any()


def test_a_tie_is_not_above_the_threshold() -> None:
    mean = np.array([0.5])
    for excess, is_above in [(0.0, False), (1e-11, False), (1e-9, True)]:
        assert is_set(mean + excess, mean, kappa=0.0, eps=1e-3).all() == is_above


@given(st.floats(0, 1), st.floats(0, 1), st.floats(0, 10), st.floats(0, 10))
@settings(derandomize=True)
def test_a_larger_kappa_never_sets_a_pixel_of_low_contrast(
    value: float, mean: float, kappa: float, more: float
) -> None:
    if value - mean >= 0.5:
        return  # above D = 1/2 the contrast term turns round
    image, means = np.array([value]), np.array([mean])
    low = is_set(image, means, kappa, 1e-3)
    high = is_set(image, means, kappa + more, 1e-3)
    assert not (high & ~low).any()


@given(st.integers(0, 2**32 - 1), st.integers(1, 9))
@settings(derandomize=True, max_examples=40)
def test_blobs_join_what_is_near_in_l_infinity(seed: int, gap_px: int) -> None:
    generator = np.random.default_rng(seed)
    binary = generator.random((24, 31)) < generator.choice([0.01, 0.03, 0.1])
    labels = reference.label_blobs(binary, gap_px)
    points = np.argwhere(binary)
    near = np.abs(points[:, None] - points[None, :]).max(axis=2) <= gap_px
    reach = near.copy()
    for _ in range(6):  # transitive closure: squaring six times links chains of up to 64
        reach = (reach.astype(np.int32) @ reach.astype(np.int32)) > 0
    same = labels[tuple(points.T)][:, None] == labels[tuple(points.T)][None, :]
    assert (same == reach).all()
    assert (labels[~binary] == 0).all()


def test_flat_frame_has_no_proposals() -> None:
    for level in (0, 128, 255):
        assert len(ReferenceProposer(ProposalConfig()).propose(np.full((96, 128), level, np.uint8))) == 0


def test_a_lamp_is_boxed_where_it_is() -> None:
    image = np.full((480, 640), 8, np.uint8)
    image[200:212, 300:330] = 250
    boxes = ReferenceProposer(ProposalConfig(reference_width_px=640)).propose(image).boxes_xyxy_px
    assert len(boxes) == 1
    x1, y1, x2, y2 = boxes[0].tolist()
    assert x1 <= 300 <= 330 <= x2
    assert y1 <= 200 <= 212 <= y2
    assert (x2 - x1, y2 - y1) <= (42, 24)


def test_the_area_cap_drops_a_near_lamp_and_infinity_keeps_it() -> None:
    image = np.full((960, 1280), 8, np.uint8)
    image[400:520, 500:700] = 250
    assert len(ReferenceProposer(ProposalConfig(window_px=200)).propose(image)) == 0
    assert len(ReferenceProposer(ProposalConfig(window_px=200, max_area_px=np.inf)).propose(image)) == 1
