"""The picture of a drive's story: its size, its colours and its places; never pixel by pixel."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest

from foreglow.display.overlay import ACCEPTED_BGR, PROPOSAL_BGR
from foreglow.geometry import Camera, Pose
from foreglow.lab.evaluation import Predictions
from foreglow.lab.studies.demo.figures import (
    BEAM_BGR,
    LIGHT_BGR,
    SIGHT_BGR,
    TILE_PX,
    moments_picture,
    write_moments,
)
from foreglow.lab.studies.demo.metrics import Moment
from foreglow.types import Frame
from tests.lab.evaluation.scored_boxes import light, predictions_of
from tests.lab.studies.demo.test_page import NEVER, story_of
from tests.stand_ins import night_image

STORY = story_of(2.0, 2.5, 3.5, 4.0)
BOXES = predictions_of({5: [(5, 5, 20, 15, 0.9), (60, 40, 70, 50, 0.1)]})


def frames(width_px: int, height_px: int, ids: tuple[int, ...] = (1, 5, 9), dtype: type = np.uint8) -> list[Frame]:
    return [Frame(night_image(k, height_px, width_px, dtype), timestamp_ns=0, frame=k) for k in ids]


def share_of(picture: np.ndarray, colour_bgr: tuple[int, int, int]) -> float:
    near = cv2.inRange(picture, np.array(colour_bgr) - 12, np.array(colour_bgr) + 12)
    return float((near > 0).mean())


@pytest.mark.slow
@pytest.mark.parametrize(("width_px", "height_px"), [(1280, 960), (96, 72), (1600, 64), (200, 700)])
def test_three_moments_side_by_side_whatever_the_size(width_px: int, height_px: int) -> None:
    picture = moments_picture(STORY, frames(width_px, height_px), BOXES, 0.5)
    assert picture.dtype == np.uint8
    assert 3 * TILE_PX[0] / 2 < picture.shape[1] < 1.1 * 3 * TILE_PX[0] / 2
    for colour in (LIGHT_BGR, ACCEPTED_BGR, SIGHT_BGR):
        assert share_of(picture, colour) > 1e-3


def test_light_of_a_kind_that_has_no_words() -> None:
    first = Moment(STORY.light.time_s, light(1, 12, 10, kind="puddle"), STORY.light.score)
    picture = moments_picture(dataclasses.replace(STORY, light=first), frames(640, 480), BOXES, 0.5)
    assert share_of(picture, LIGHT_BGR) > 1e-3


def test_sixteen_bits() -> None:
    assert moments_picture(STORY, frames(640, 480, dtype=np.uint16), BOXES, 0.5).mean() > 10


@pytest.mark.slow
def test_six_moments_are_two_rows_and_show_the_dark_gap() -> None:
    gaps_rad = {3.25: (-0.1, 0.1), 3.5: (-0.1, 0.1)}
    seen = {time_s: Moment(time_s, light(7, 12, 10, kind="rail"), 0.9) for time_s in (2.75, 3.25, 4.0)}
    whole = dataclasses.replace(STORY, confirmed_s=2.75, seen=seen, gaps_rad=gaps_rad)
    assert list(whole.moments) == ["light", "found", "confirmed", "dimmed", "sight", "reported"]
    camera = Camera(640, 480, (656.0, 656.0), (320.0, 240.0), (0.0,) * 5, Pose(np.array([1.9, 0.0, 1.3]), np.eye(3)))
    its_frames = [dataclasses.replace(frame, camera=camera) for frame in frames(640, 480, (1, 5, 6, 7, 9, 10))]
    picture = moments_picture(whole, its_frames, BOXES, 0.5)
    three = moments_picture(STORY, frames(640, 480), BOXES, 0.5)
    assert picture.shape[1] == three.shape[1]
    assert picture.shape[0] - three.shape[0] > TILE_PX[1] / 2
    assert share_of(picture, BEAM_BGR) > share_of(three, BEAM_BGR) == 0.0
    two = moments_picture(whole, its_frames, BOXES, 0.5, ("light", "sight"))
    assert share_of(two, LIGHT_BGR) > 1e-3 < share_of(two, SIGHT_BGR)
    assert two.shape[1] < 2.2 * TILE_PX[0] / 2


def test_a_missed_vehicle_has_two_moments_and_no_green() -> None:
    missed = story_of(2.0, NEVER, 3.5)
    picture = moments_picture(missed, frames(640, 480, (1, 9)), Predictions({}, {}), 0.5)
    assert picture.shape[1] < 2.2 * TILE_PX[0] / 2
    assert share_of(picture, ACCEPTED_BGR) == 0.0


def test_unscored_boxes_are_amber() -> None:
    plain = Predictions(BOXES.boxes_xyxy_px, BOXES.scores, is_scored=False)
    scored, unscored = (moments_picture(STORY, frames(640, 480), each, 0.5) for each in (BOXES, plain))
    middle = slice(scored.shape[1] // 3, 2 * scored.shape[1] // 3)
    assert share_of(unscored[:, middle], PROPOSAL_BGR) > share_of(scored[:, middle], PROPOSAL_BGR)


def test_it_is_written_as_png(tmp_path: Path) -> None:
    write_moments(tmp_path / "moments.png", STORY, frames(640, 480), BOXES, 0.5)
    assert cv2.imread(str(tmp_path / "moments.png")) is not None
