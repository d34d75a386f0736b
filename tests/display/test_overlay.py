"""The annotated picture: sizes, colours and places; never a picture compared pixel by pixel."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from foreglow.display.overlay import (
    ACCEPTED_BGR,
    CAPTION_GROUND_BGR,
    KIND_BGR,
    PROPOSAL_BGR,
    REJECTED_BGR,
    TRACK_BGR,
    Measures,
    annotate,
    track_text,
)
from foreglow.display.tone import Tone
from foreglow.types import LIGHT_KINDS, Frame, TrackState
from foreglow.types.kinds import kinds_of_direct
from tests.stand_ins import night_image, result_of, tracks_of

SIZES = [(64, 64), (640, 360), (1280, 960), (2872, 1622), (65, 4001), (1001, 67), (1, 1)]


def frame_of(width_px: int, height_px: int, dtype: type = np.uint8) -> Frame:
    return Frame(night_image(1, max(9, height_px), max(9, width_px), dtype)[:height_px, :width_px], timestamp_ns=0)


def has_colour(picture: np.ndarray, colour_bgr: tuple[int, int, int]) -> bool:
    return bool((picture == colour_bgr).all(axis=2).any())


@pytest.mark.slow
@pytest.mark.parametrize(("width_px", "height_px"), SIZES)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_any_size_gives_an_even_picture_with_the_frame_at_its_top(width_px: int, height_px: int, dtype: type) -> None:
    frame = frame_of(width_px, height_px, dtype)
    picture = annotate(frame, result_of(frame, []))
    factor = Measures.of(width_px, height_px).enlargement
    assert picture.dtype == np.uint8
    assert picture.shape[0] % 2 == picture.shape[1] % 2 == 0
    assert picture.shape[0] > height_px * factor
    assert picture.shape[1] in (width_px * factor, width_px * factor + 1)
    assert picture.shape[0] <= max(2160, height_px) + 100
    if factor == 1:
        assert (picture[:height_px, :width_px, 1] == Tone.of(frame.image).apply(frame.image)).all()


def test_proposals_without_scores_are_amber() -> None:
    frame = frame_of(1280, 960)
    picture = annotate(frame, result_of(frame, [[400, 300, 440, 330]]))[:960]
    assert has_colour(picture, PROPOSAL_BGR)
    assert not has_colour(picture, ACCEPTED_BGR)


def test_accepted_and_rejected_boxes_differ_and_cover_nothing_inside() -> None:
    frame = frame_of(1280, 960)
    boxes = [[400, 300, 440, 330], [700, 500, 800, 600]]
    picture = annotate(frame, result_of(frame, boxes, [0.9, 0.2]))
    assert has_colour(picture[280:350, 380:460], ACCEPTED_BGR)
    assert has_colour(picture[480:620, 680:820], REJECTED_BGR)
    assert not has_colour(picture[:960], PROPOSAL_BGR)
    plain = annotate(frame, result_of(frame, []))
    for x1, y1, x2, y2 in boxes:
        assert (picture[y1:y2, x1:x2] == plain[y1:y2, x1:x2]).all()


def test_accepted_boxes_have_the_colour_of_their_kind_and_the_caption_names_it() -> None:
    frame = frame_of(1280, 960)
    boxes = [[400, 300, 440, 330], [700, 500, 800, 600], [900, 200, 940, 240]]
    result = result_of(frame, boxes, [0.9, 0.8, 0.2])
    assert result.detections is not None
    kinds = np.array([[0.1, 0.7, 0.1, 0.1], [0.1, 0.1, 0.7, 0.1], [0.7, 0.1, 0.1, 0.1]], np.float32)
    told = dataclasses.replace(result, detections=dataclasses.replace(result.detections, light_kinds=kinds))
    picture = annotate(frame, told)
    assert has_colour(picture[280:350, 380:460], KIND_BGR["rear_lamp"])
    assert has_colour(picture[480:620, 680:820], KIND_BGR["front_light"])
    assert has_colour(picture[960:], KIND_BGR["rear_lamp"])
    assert has_colour(picture[960:], KIND_BGR["front_light"])
    assert not has_colour(picture, KIND_BGR["front_lamp"])  # rejected
    assert len(set(KIND_BGR.values())) == len(LIGHT_KINDS)


def test_a_model_that_does_not_tell_front_from_rear_shows_no_kinds() -> None:
    frame = frame_of(1280, 960)
    result = result_of(frame, [[400, 300, 440, 330]], [0.9])
    assert result.detections is not None
    kinds = kinds_of_direct(np.ones(1, np.float32))
    told = dataclasses.replace(result, detections=dataclasses.replace(result.detections, light_kinds=kinds))
    assert (annotate(frame, told) == annotate(frame, result)).all()


@pytest.mark.parametrize("width_px", [64, 640, 1280, 2872])
def test_a_long_caption_fits(width_px: int) -> None:
    frame = dataclasses.replace(frame_of(width_px, 400), sequence="S00001", frame=123456)
    boxes = [[4 + 9 * k, 30, 10 + 9 * k, 40] for k in range(4)]
    result = result_of(frame, boxes, [0.9] * 4)
    assert result.detections is not None
    kinds = (0.1 + 0.6 * np.eye(4)).astype(np.float32)
    detections = dataclasses.replace(result.detections, light_kinds=kinds)
    picture = annotate(frame, dataclasses.replace(result, detections=detections, tracks=tracks_of(boxes)))
    caption = picture[400 * Measures.of(width_px, 400).enlargement :]
    assert (caption[:, -Measures.of(width_px, 400).thin_px - 1 :] == CAPTION_GROUND_BGR).all()
    assert all(has_colour(caption, KIND_BGR[kind]) for kind in LIGHT_KINDS) or width_px < 640


def test_boxes_at_the_edges_and_crowded_boxes_are_drawn() -> None:
    frame = frame_of(640, 360)
    boxes = [[0, 0, 640, 360], [0, 0, 3, 3], [637, 357, 640, 360]] + [[300 + k, 200, 312 + k, 212] for k in range(20)]
    scores = [0.9, 0.1] * 11 + [1.0]
    picture = annotate(frame, result_of(frame, boxes, scores))
    assert has_colour(picture, ACCEPTED_BGR)
    assert has_colour(picture, REJECTED_BGR)


def test_caption_does_not_touch_the_frame() -> None:
    frame = frame_of(1280, 960)
    pictures = [annotate(frame, result_of(frame, [])), annotate(frame, result_of(frame, [], []))]
    assert (pictures[0][:960] == pictures[1][:960]).all()
    assert (pictures[0][960:] != pictures[1][960:]).any()


def test_tone_brightens_without_changing_the_order() -> None:
    image = night_image(2)
    tone = Tone.of(image)
    assert (np.diff(tone.curve.astype(int)) >= 0).all()
    assert np.median(tone.apply(image)) > 2 * np.median(image)
    assert (tone.curve[0], tone.curve[-1]) == (0, 255)


def test_tone_of_twelve_bits_in_sixteen_uses_the_whole_display() -> None:
    image = (night_image(2).astype(np.uint16) * 16)[:, :]
    assert Tone.of(image).apply(image).max() > 200


@pytest.mark.parametrize("value", [0, 7, 255])
def test_flat_frames_have_a_tone(value: int) -> None:
    image = np.full((64, 64), value, np.uint8)
    assert Tone.of(image).apply(image).shape == (64, 64)


def test_a_black_first_frame_leaves_a_curve_for_what_follows() -> None:
    curve = Tone.of(np.zeros((96, 128), np.uint16)).curve
    dark, road, lamp = curve[[2, 100, 4000]].tolist()
    assert dark < 50 < road < 200 < lamp


def test_tone_is_for_one_depth() -> None:
    with pytest.raises(ValueError, match="one depth"):
        Tone.of(night_image()).apply(night_image(dtype=np.uint16))


def test_tracks_lie_around_their_boxes() -> None:
    frame = frame_of(1280, 960)
    boxes = [[400, 300, 440, 330], [700, 500, 800, 600], [900, 200, 940, 240]]
    states = [TrackState.CONFIRMED, TrackState.COASTING, TrackState.TENTATIVE]
    tracks = tracks_of(boxes, states, ranges_m=[80.0, np.nan, 20.0])
    result = dataclasses.replace(result_of(frame, boxes, [0.9, 0.2, 0.9]), tracks=tracks)
    picture, plain = annotate(frame, result), annotate(frame, result_of(frame, boxes, [0.9, 0.2, 0.9]))
    confirmed, coasting = (
        int((picture[y1 - 20 : y2 + 20, x1 - 20 : x2 + 20] == TRACK_BGR).all(axis=2).sum())
        for x1, y1, x2, y2 in boxes[:2]
    )
    assert confirmed > 1.5 * 2 * (40 + 30)  # two pixels wide
    assert 2 * (100 + 100) < coasting < 1.5 * 2 * (100 + 100 + 40)
    assert (picture[160:280, 860:980] == plain[160:280, 860:980]).all()
    for x1, y1, x2, y2 in boxes:
        assert (picture[y1:y2, x1:x2] == plain[y1:y2, x1:x2]).all()


def test_a_track_that_has_left_the_image_has_no_box() -> None:
    frame = Frame(np.zeros((960, 1280), np.uint8), 0)
    tracks = tracks_of([(1320, 10, 1340, 20), (10, -60, 30, -40)], [TrackState.CONFIRMED, TrackState.COASTING])
    result = dataclasses.replace(result_of(frame, [], []), tracks=tracks)
    plain = dataclasses.replace(result_of(frame, [], []), tracks=tracks_of([], []))
    np.testing.assert_array_equal(annotate(frame, result)[:960], annotate(frame, plain)[:960])


def test_words_of_a_track() -> None:
    kinds = np.array([[0.1, 0.2, 0.3, 0.4], [np.nan] * 4])
    tracks = tracks_of([[0, 0, 9, 9], [20, 0, 29, 9]], ids=[3, 12], ranges_m=[85.0, np.nan])
    assert track_text(tracks, 0) == "#3 85+-8 m"
    told = dataclasses.replace(tracks, light_kinds=kinds)
    assert [track_text(told, index) for index in (0, 1)] == ["#3 85+-8 m, light of a rear lamp", "#12"]
