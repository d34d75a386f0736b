"""Laws that hold for every proposal back end."""

from __future__ import annotations

import numpy as np
import pytest

from foreglow.config import ProposalConfig
from foreglow.proposals import BACKENDS, make_proposer
from foreglow.types import Image
from tests.proposals.frames import night_like_frame

pytestmark = pytest.mark.parametrize("backend", BACKENDS)


def config_of(backend: str, **fields: object) -> ProposalConfig:
    return ProposalConfig.model_validate({"reference_width_px": 320, **fields, "backend": backend})


def boxes_of(backend: str, image: Image, **fields: object) -> list[list[int]]:
    boxes: list[list[int]] = make_proposer(config_of(backend, **fields)).propose(image).boxes_xyxy_px.tolist()
    return boxes


def lamps(seed: int = 0, width_px: int = 320, height_px: int = 240) -> Image:
    """Noise under 100 and a handful of hard lamps, away from the border."""
    generator = np.random.default_rng(seed)
    image: Image = generator.integers(10, 14, (height_px, width_px)).astype(np.uint8)
    for _ in range(5):
        x, y = int(generator.integers(50, width_px - 70)), int(generator.integers(50, height_px - 70))
        image[y : y + int(generator.integers(4, 16)), x : x + int(generator.integers(6, 20))] = 100
    return image


def test_boxes_are_sorted_inside_and_of_the_right_type(backend: str) -> None:
    generator = np.random.default_rng(1)
    num_boxes = 0
    for _ in range(20):
        image = night_like_frame(generator, 321, 239)
        proposals = make_proposer(config_of(backend)).propose(image)
        boxes = proposals.boxes_xyxy_px
        assert boxes.dtype == np.int32
        assert not boxes.flags.writeable
        order = [(y1, x1, y2, x2) for x1, y1, x2, y2 in boxes.tolist()]
        assert order == sorted(order)
        assert (boxes >= 0).all()
        assert (boxes[:, 2] <= 321).all()
        assert (boxes[:, 3] <= 239).all()
        num_boxes += len(boxes)
    assert num_boxes > 0


@pytest.mark.parametrize("shape", [(1, 1), (1, 300), (300, 1), (2, 2), (64, 64)])
@pytest.mark.parametrize("level", [0, 77, 255])
def test_flat_frames_of_any_size_have_no_proposals(backend: str, shape: tuple[int, int], level: int) -> None:
    assert boxes_of(backend, np.full(shape, level, np.uint8)) == []


def test_the_same_frame_gives_the_same_boxes_whatever_came_before(backend: str) -> None:
    proposer = make_proposer(config_of(backend))
    image = lamps()
    first = proposer.propose(image).boxes_xyxy_px.tolist()
    proposer.propose(np.full((100, 500), 9, np.uint16))
    proposer.propose(255 - image)
    assert proposer.propose(image).boxes_xyxy_px.tolist() == first != []


def test_strides_do_not_matter(backend: str) -> None:
    image = lamps()
    wanted = boxes_of(backend, image)
    padded = np.zeros((240, 400), np.uint8)
    padded[:, 40:360] = image
    spread = np.zeros((480, 960), np.uint8)
    spread[::2, ::3] = image
    views: list[Image] = [
        padded[:, 40:360],
        spread[::2, ::3],
        image.copy(order="F"),
        image[::-1].copy()[::-1],
        image[:, ::-1].copy()[:, ::-1],
    ]
    for view in views:
        assert boxes_of(backend, view) == wanted != []


def test_offset_and_whole_gain_do_not_matter_when_normalised(backend: str) -> None:
    image = lamps()
    wanted = boxes_of(backend, image)
    assert boxes_of(backend, image + np.uint8(100)) == wanted
    assert boxes_of(backend, image * np.uint8(2)) == wanted
    assert boxes_of(backend, image.astype(np.uint16)) == wanted
    assert boxes_of(backend, image.astype(np.uint16) * np.uint16(257)) == wanted


def test_16_bits_of_full_scale_equal_8_bits_without_normalisation(backend: str) -> None:
    image = lamps()
    wide = image.astype(np.uint16) * np.uint16(257)
    assert boxes_of(backend, wide, normalise=False) == boxes_of(backend, image, normalise=False) != []


def test_moving_the_scene_moves_the_boxes(backend: str) -> None:
    """On a background that is flat at the borders, a shift by whole working pixels shifts every box."""
    image = np.full((240, 320), 10, np.uint8)
    image[100:112, 120:140] = 90
    image[130:136, 180:200] = 60
    wanted = [[x1 + 24, y1 + 12, x2 + 24, y2 + 12] for x1, y1, x2, y2 in boxes_of(backend, image)]
    assert boxes_of(backend, np.roll(image, (12, 24), axis=(0, 1))) == wanted != []


def test_a_region_is_the_frame_cut_to_it(backend: str) -> None:
    image = lamps()
    inside = boxes_of(backend, image, region_xyxy_px=(30, 20, 290, 220))
    # The cut-out as a frame of its own, at the same scale.
    alone = boxes_of(backend, image[20:220, 30:290], reference_width_px=260)
    assert boxes_of(backend, image, region_xyxy_px=(0, 0, 320, 240)) == boxes_of(backend, image)
    assert inside == [[x1 + 30, y1 + 20, x2 + 30, y2 + 20] for x1, y1, x2, y2 in alone] != []


@pytest.mark.parametrize("region", [(320, 0, 400, 240), (0, 240, 9, 999)])
def test_a_region_outside_the_frame_is_an_error(backend: str, region: tuple[int, int, int, int]) -> None:
    with pytest.raises(ValueError, match=r"region_xyxy_px: expected a part of the frame, \[.*320x240 px"):
        boxes_of(backend, lamps(), region_xyxy_px=region)


def test_a_frame_far_too_wide_for_its_reference_is_an_error(backend: str) -> None:
    image = np.zeros((64, 64 * 64), np.uint8)
    assert boxes_of(backend, image, reference_width_px=64, reduction=1) == []  # reduced by 64
    with pytest.raises(ValueError, match="reduced by at most 64, one of 4096 columns is reduced by 128"):
        boxes_of(backend, image, reference_width_px=64, reduction=2)


def test_a_wider_gap_joins_lamps(backend: str) -> None:
    image = np.full((240, 320), 10, np.uint8)
    image[100:110, 100:112] = 90
    image[100:110, 130:142] = 90
    assert len(boxes_of(backend, image, gap_px=2)) == 2
    assert len(boxes_of(backend, image, gap_px=20)) == 1


def test_limits_of_size_are_inclusive(backend: str) -> None:
    image = lamps()
    every = boxes_of(backend, image, min_area_px=0, max_area_px=np.inf, min_width_px=0)
    for x1, y1, x2, y2 in every:
        area_px, width_px = (x2 - x1) * (y2 - y1) / 4, (x2 - x1) / 2  # reduced by two
        box = [x1, y1, x2, y2]
        assert box in boxes_of(backend, image, min_area_px=area_px, max_area_px=area_px, min_width_px=width_px)
        assert box not in boxes_of(backend, image, min_area_px=0, max_area_px=area_px - 0.5, min_width_px=0)
        assert box not in boxes_of(backend, image, min_area_px=area_px + 0.5, max_area_px=np.inf, min_width_px=0)
        assert box not in boxes_of(backend, image, min_area_px=0, max_area_px=np.inf, min_width_px=width_px + 0.5)
    assert len(every) >= 3


def test_a_larger_deviation_limit_keeps_a_subset(backend: str) -> None:
    image = lamps(3)
    loose = boxes_of(backend, image, min_deviation=0.0)
    strict = boxes_of(backend, image, min_deviation=0.15)
    assert set(map(tuple, strict)) < set(map(tuple, loose))
