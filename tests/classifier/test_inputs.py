"""What a classifier reads: the crop, its levels, and the same place a moment ago."""

from __future__ import annotations

import numpy as np
import pytest

from foreglow.classifier import FEATURES, InputMaker, InputSpec
from foreglow.types import Frame, Image, Proposals

BOX = Proposals(np.array([[40, 30, 60, 42]], np.int32))
NOTHING = Proposals(np.zeros((0, 4), np.int32))
LAG = InputSpec(16, 2, lag_s=0.25, num_features=len(FEATURES))
FIRST_EARLIER = 1


def image(seed: int, dtype: type = np.uint8) -> Image:
    return np.random.default_rng(seed).integers(5, 200, (96, 128)).astype(dtype)


def frame(seed: int, time_s: float) -> Frame:
    return Frame(image(seed), round(time_s * 1e9))


def test_one_channel_and_no_features_by_default() -> None:
    inputs = InputMaker(InputSpec()).make(frame(0, 0.0), BOX)
    assert inputs.crops.shape == (1, 1, 64, 64)
    assert inputs.crops.min() == 0.0
    assert inputs.crops.max() == 1.0
    assert inputs.features.shape == (1, 0)


def test_second_channel_is_the_same_place_earlier() -> None:
    maker = InputMaker(LAG)
    first = maker.make(frame(0, 0.0), BOX)
    assert not first.crops[:, 1].any()
    assert first.features[0, FEATURES.index("has_earlier")] == 0.0
    second = maker.make(frame(0, 0.25), BOX)
    np.testing.assert_array_equal(second.crops[:, 0], first.crops[:, 0])
    np.testing.assert_array_equal(second.crops[:, 1], first.crops[:, 0])
    assert second.features[0, FEATURES.index("has_earlier")] == 1.0


def test_the_last_channel_shows_the_surroundings() -> None:
    spec = InputSpec(16, 2, lag_s=0.25, num_features=len(FEATURES), context=5)
    maker = InputMaker(spec)
    first = maker.make(frame(0, 0.0), BOX)
    second = maker.make(frame(1, 0.25), BOX)
    assert spec.num_channels == 3
    plain = InputMaker(LAG)
    plain.make(frame(0, 0.0), BOX)
    np.testing.assert_array_equal(second.crops[:, :2], plain.make(frame(1, 0.25), BOX).crops)
    assert not first.crops[:, 1].any()
    for number, inputs in enumerate((first, second)):
        wide = InputMaker(InputSpec(16, 5)).make(frame(number, 0.0), BOX).crops
        np.testing.assert_array_equal(inputs.crops[:, 2:], wide)


def test_the_place_in_the_frame_is_known_alike_on_both_sides() -> None:
    boxes = Proposals(np.array([[0, 0, 16, 12], [144, 0, 160, 12], [72, 54, 88, 66]], np.int32))
    dark = Frame(np.zeros((120, 160), np.uint8), 0)
    features = InputMaker(InputSpec(16, 2, None, len(FEATURES))).make(dark, boxes).features
    names = {name: index for index, name in enumerate(FEATURES)}
    np.testing.assert_allclose(features[:, names["column"]], [1.8, 1.8, 0.0])
    np.testing.assert_allclose(features[:, names["row"]], [-1.35, -1.35, 0.0])
    fewer = InputMaker(InputSpec(16, 2, None, 7)).make(dark, boxes).features
    np.testing.assert_array_equal(fewer, features[:, :7])


def test_what_brightened_was_darker_in_the_crops_own_range() -> None:
    maker = InputMaker(LAG)
    dark = (image(0) // 2).astype(np.uint8)
    maker.make(Frame(dark, 0), BOX)
    inputs = maker.make(Frame(dark * 2, 250_000_000), BOX)
    assert (inputs.crops[:, 1] <= inputs.crops[:, 0] + 0.02).all()
    assert inputs.crops[:, 1].mean() < inputs.crops[:, 0].mean() - 0.1


@pytest.mark.parametrize(("rate_hz", "age_s"), [(18.0, 4 / 18), (9.0, 2 / 9), (4.0, 0.25), (60.0, 0.25)])
def test_the_frame_nearest_to_the_lag_is_shown(rate_hz: float, age_s: float) -> None:
    maker = InputMaker(LAG)
    count = round(2 * rate_hz)
    for number in range(count):
        inputs = maker.make(frame(number, number / rate_hz), BOX)
    shown = InputMaker(InputSpec(16)).make(frame(count - 1, 0.0), BOX).crops
    candidates = []
    for number in range(count - 1):
        again = InputMaker(LAG)
        again.make(frame(number, 0.0), BOX)
        candidates.append(again.make(frame(count - 1, 0.25), BOX).crops[:, 1])
    matches = [number for number, crop in enumerate(candidates) if np.array_equal(crop, inputs.crops[:, 1])]
    np.testing.assert_array_equal(shown, inputs.crops[:, :1])
    assert [(count - 1 - number) / rate_hz for number in matches] == [pytest.approx(age_s, abs=0.06)]


@pytest.mark.parametrize("time_s", [0.0, -1.0, 0.1, 0.5])
def test_no_earlier_frame_of_the_right_age(time_s: float) -> None:
    maker = InputMaker(LAG)
    maker.make(frame(0, 0.0), BOX)
    assert not maker.make(frame(1, time_s), BOX).crops[:, 1].any()


def test_reset_and_another_size_forget() -> None:
    maker = InputMaker(LAG)
    maker.make(frame(0, 0.0), BOX)
    maker.reset()
    assert not maker.make(frame(0, 0.25), BOX).crops[:, 1].any()
    maker.make(Frame(image(0)[:-1], 500_000_000), BOX)
    assert not maker.make(frame(0, 0.75), BOX).crops[:, 1].any()


def test_a_reused_buffer_does_not_change_the_past() -> None:
    maker = InputMaker(LAG)
    buffer = image(0)
    first = maker.make(Frame(buffer, 0), BOX)
    buffer[:] = 255
    second = maker.make(frame(0, 0.25), BOX)
    np.testing.assert_array_equal(second.crops[:, 1], first.crops[:, 0])


def test_a_frame_may_bring_its_earlier_image() -> None:
    maker = InputMaker(LAG)
    maker.make(frame(3, -5.0), BOX)
    brought = maker.make(Frame(image(1), 250_000_000, earlier=frame(0, 0.0)), BOX)
    seen = InputMaker(LAG)
    seen.make(frame(0, 0.0), NOTHING)
    np.testing.assert_array_equal(brought.crops, seen.make(frame(1, 0.25), BOX).crops)


@pytest.mark.parametrize(("earlier_s", "is_taken"), [(0.05, True), (0.22, False)])
def test_of_all_earlier_images_that_nearest_to_the_lag_is_taken(earlier_s: float, is_taken: bool) -> None:
    """Whatever else of a drive is labelled, a labelled image is seen beside the same earlier one."""
    maker, lone = InputMaker(LAG), InputMaker(LAG)
    for number in range(3):
        maker.make(frame(number, 0.1 * number), NOTHING)
    found = maker.make(Frame(image(4), 300_000_000, earlier=frame(9, earlier_s)), BOX)
    lone.make(frame(9, earlier_s) if is_taken else frame(0, 0.0), NOTHING)
    np.testing.assert_array_equal(found.crops, lone.make(frame(4, 0.3), BOX).crops)


def test_frames_without_proposals_are_remembered() -> None:
    maker = InputMaker(LAG)
    inputs = maker.make(frame(0, 0.0), NOTHING)
    assert inputs.crops.shape == (0, 2, 16, 16)
    assert inputs.features.shape == (0, len(FEATURES))
    assert maker.make(frame(0, 0.25), BOX).crops[:, 1].any()


def test_features_say_what_stretching_hides() -> None:
    names = {name: index for index, name in enumerate(FEATURES)}
    maker = InputMaker(InputSpec(16, 2, None, len(FEATURES)))
    flat = np.full((96, 128), 10, np.uint8)
    flat[30:42, 40:60] = 250
    features = maker.make(Frame(flat, 0), BOX).features[0]
    assert features[names["darkest"]] == pytest.approx(np.log1p(10) / np.log(256), abs=1e-6)
    assert features[names["brightest"]] == pytest.approx(np.log1p(250) / np.log(256), abs=1e-6)
    assert features[names["width"]] == pytest.approx(np.log2(20 / 128) / 10 + 1)
    assert features[names["height"]] == pytest.approx(np.log2(12 / 128) / 10 + 1)
    wide = maker.make(Frame(flat.astype(np.uint16) * 257, 0), BOX).features[0]
    np.testing.assert_allclose(wide, features, atol=1e-5)


@pytest.mark.parametrize(
    "fields", [{"size_px": 0}, {"support": 0}, {"lag_s": 0.0}, {"lag_s": 60.0}, {"num_features": 3}]
)
def test_bad_spec(fields: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="InputSpec"):
        InputSpec(**fields)  # type: ignore[arg-type]
