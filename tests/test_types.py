"""The values that flow: checked once when made, and never written to afterwards."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from foreglow.types import Detections, Frame, FrameResult, Image, Proposals

BOXES = np.array([[0, 0, 4, 4], [2, 3, 9, 8]], np.int32)


@pytest.mark.parametrize(
    ("image", "complaint"),
    [
        (np.zeros((4, 4, 3), np.uint8), r"expected a grey array .*\(4, 4, 3\)"),
        (np.zeros((4, 4), np.float32), "expected uint8 or uint16, got float32"),
        (np.zeros((0, 4), np.uint8), r"expected at least one pixel, got shape \(0, 4\)"),
        ([[1, 2]], "expected a grey array .*list"),
    ],
)
def test_frame_refuses_unfit_images(image: Any, complaint: str) -> None:
    with pytest.raises(ValueError, match=f"a.png: Frame.image: {complaint}"):
        Frame(image, timestamp_ns=0, path="a.png")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_frame_is_read_only_but_its_owner_is_not(dtype: type) -> None:
    image: Image = np.zeros((3, 5), dtype)
    frame = Frame(image, timestamp_ns=0)
    assert (frame.width_px, frame.height_px) == (5, 3)
    with pytest.raises(ValueError, match="read-only"):
        frame.image[0, 0] = 1
    image[0, 0] = 1
    assert frame.image[0, 0] == 1


@pytest.mark.parametrize(
    ("boxes", "complaint"),
    [
        (np.zeros((3,), np.int32), r"expected shape \(N, 4\), got \(3,\)"),
        (np.zeros((1, 4)), "expected int32, got float64"),
        (np.array([[0, 0, 1, 1], [4, 0, 4, 9]], np.int32), r"box 1 is \[4, 0, 4, 9\], expected x1 < x2"),
    ],
)
def test_proposals_refuse_unfit_boxes(boxes: Any, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        Proposals(boxes)


@pytest.mark.parametrize(
    ("scores", "complaint"),
    [
        (np.zeros(1, np.float32), r"scores: expected float32 of shape \(2,\)"),
        (np.zeros(2), "scores: expected float32 .*got float64"),
        (np.array([0.5, np.nan], np.float32), r"expected values in \[0, 1\]"),
        (np.array([0.5, 1.5], np.float32), r"expected values in \[0, 1\]"),
        (np.array([-0.1, 0.5], np.float32), r"expected values in \[0, 1\]"),
    ],
)
def test_detections_refuse_unfit_scores(scores: Any, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        Detections(Proposals(BOXES), scores, 0.5)


def test_accepted_boxes() -> None:
    detections = Detections(Proposals(BOXES), np.array([0.2, 0.9], np.float32), 0.2)
    assert detections.is_accepted.tolist() == [True, True]  # the float32 nearest to 0.2 is above 0.2
    detections = Detections(Proposals(BOXES), np.array([0.5, 0.9], np.float32), 0.5)  # not above 0.5
    assert detections.accepted_boxes_xyxy_px.tolist() == [[2, 3, 9, 8]]
    assert len(detections) == 2


def test_result_cannot_be_changed() -> None:
    stage_ms = {"proposals": 1.0}
    result = FrameResult(0, 0, Proposals(BOXES), None, stage_ms)
    stage_ms["proposals"] = 2.0
    assert result.stage_ms == {"proposals": 1.0}
    with pytest.raises(TypeError):
        result.stage_ms["proposals"] = 3.0  # type: ignore[index]
    with pytest.raises(ValueError, match="read-only"):
        result.proposals.boxes_xyxy_px[0, 0] = 1
