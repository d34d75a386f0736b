"""Proposals at a size that no whole factor gives."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from foreglow.config import ProposalConfig, preset
from foreglow.lab.studies.detector.rows import ROWS
from foreglow.proposals import make_proposer
from tests.stand_ins import night_image

SMALL = preset("baseline").changed("proposals", working_size_px=(345, 240)).proposals


def lamp(x: int, y: int) -> np.ndarray:
    image = np.full((960, 1280), 8, np.uint8)
    image[y : y + 24, x : x + 40] = 240
    return image


@pytest.mark.parametrize("backend", ["native", "reference"])
def test_a_lamp_is_in_its_box_in_pixels_of_the_frame(backend: Literal["native", "reference"]) -> None:
    proposer = make_proposer(SMALL.model_copy(update={"backend": backend}))
    (box,) = proposer.propose(lamp(600, 400)).boxes_xyxy_px.tolist()
    assert box[0] <= 600 < 640 <= box[2]
    assert box[1] <= 400 < 424 <= box[3]
    assert box[2] - box[0] < 80
    assert box[3] - box[1] < 60


@pytest.mark.parametrize("side_px", [147, 281, 294, 525])
def test_a_box_at_the_border_ends_there(side_px: int) -> None:
    """The frame's width over these, times these, is more than the width, in double precision."""
    assert side_px * (1280 / side_px) > 1280
    proposer = make_proposer(SMALL.model_copy(update={"working_size_px": (side_px, 240), "max_area_px": 1e6}))
    (box,) = proposer.propose(lamp(1240, 400)).boxes_xyxy_px.tolist()
    assert box[0] <= 1240
    assert box[2] == 1280


def test_both_back_ends_agree_at_every_depth() -> None:
    slow = SMALL.model_copy(update={"backend": "reference"})
    for dtype in (np.uint8, np.uint16):
        image = night_image(3, 960, 1280, dtype)
        boxes = make_proposer(SMALL).propose(image).boxes_xyxy_px
        np.testing.assert_array_equal(boxes, make_proposer(slow).propose(image).boxes_xyxy_px)
        assert len(boxes)


def test_it_is_the_papers_row() -> None:
    assert ROWS["baseline-small"].configuration.proposals == SMALL
    assert ROWS["baseline"].configuration == preset("baseline")


def test_the_whole_frame_is_resized() -> None:
    with pytest.raises(ValueError, match="expected none with working_size_px"):
        ProposalConfig(working_size_px=(345, 240), region_xyxy_px=(0, 0, 640, 480))
