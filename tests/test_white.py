"""Cameras that fill a part of their images' type are seen as those that fill it."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from foreglow.classifier.colour import redness
from foreglow.config import GuardConfig, preset
from foreglow.datasets import PVDN, shipped_drive
from foreglow.datasets.images import red_chroma, to_grey
from foreglow.pipeline import Pipeline
from foreglow.types import Frame
from foreglow.types.white import full_scale


@pytest.mark.parametrize("white", [1020, 4080])
def test_few_bits_with_their_white_level_are_seen_as_all_bits(white: int) -> None:
    config = preset("foreglow")
    whole, few = Pipeline(config), Pipeline(config.model_copy(update={"guard": GuardConfig(white_level=white)}))
    num_plausible = 0
    for frame in islice(PVDN(shipped_drive()), 45):
        wide = frame.image.astype(np.uint16)
        expected = whole.step(replace(frame, image=wide * np.uint16(65535 // 255)))
        found = few.step(replace(frame, image=wide * np.uint16(white // 255)))
        assert expected.tracks is not None
        assert expected.detections is not None
        assert found.tracks is not None
        assert found.detections is not None
        np.testing.assert_array_equal(found.detections.scores, expected.detections.scores)
        np.testing.assert_array_equal(found.tracks.boxes_xyxy_px, expected.tracks.boxes_xyxy_px)
        num_plausible += int(found.tracks.is_plausible.sum())
    assert num_plausible > 5


def test_brighter_than_white_is_white_and_the_earlier_image_follows() -> None:
    image = np.array([[0, 1023, 5000]], np.uint16)
    frame = Frame(image[:, ::-1], 10**9, earlier=Frame(image, 0))
    seen = full_scale(frame, 1023)
    assert seen.image.tolist() == [[65535, 65535, 0]]
    assert seen.earlier is not None
    assert seen.earlier.image.tolist() == [[0, 65535, 65535]]
    assert seen.image.dtype == np.uint16


@pytest.mark.parametrize("white_level", [None, 255, 1023])
def test_images_that_fill_their_type_stay_as_they_are(white_level: int | None) -> None:
    frame = Frame(np.zeros((2, 3), np.uint8), 0)
    assert full_scale(frame, white_level) is frame


def test_red_light_is_as_red() -> None:
    """Its grey grew and its chroma did not, so that every rear lamp was called a front one."""
    colours = np.zeros((40, 60, 3), np.uint16)
    colours[:] = (160, 160, 160)
    colours[10:20, 10:20] = (3000, 400, 300)
    boxes = np.array([[10, 10, 20, 20], [30, 10, 40, 20]], np.int32)
    few = Frame(to_grey(colours), 0, red_chroma=red_chroma(colours))
    wide = (colours.astype(np.float64) * (65535 / 4095)).astype(np.uint16)
    whole = Frame(to_grey(wide), 0, red_chroma=red_chroma(wide))
    assert redness(whole, boxes)[0] > 0.5
    np.testing.assert_allclose(redness(full_scale(few, 4095), boxes), redness(whole, boxes), atol=0.15)
