"""What stands still in the image while we drive is left out; what may be a lamp ahead is not."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from foreglow import Pipeline
from foreglow.config import StandingConfig, preset
from foreglow.proposals import StandingLight
from foreglow.proposals.standing import CHECK_S, MAX_REGIONS
from foreglow.types import EgoMotion, Frame, Proposals

HEIGHT, WIDTH = 120, 160
STICKER = (30.0, 100.0, 2.5)
LAMP = (60.0, 25.0, 1.5)
CONFIG = StandingConfig(enabled=True, learn_s=3.0, forget_s=1.0)
DRIVING = EgoMotion(20.0, 0.0)

Spot = tuple[float, float, float]


def box_of(spot: Spot) -> list[int]:
    x, y, sigma = spot
    reach = 2.0 * sigma
    return [round(x - reach), round(y - reach), round(x + reach) + 1, round(y + reach) + 1]


def frame_of(
    time_s: float, spots: Sequence[Spot], motion: EgoMotion | None = DRIVING, gain: float = 1.0, seed: int = 0
) -> tuple[Frame, Proposals]:
    """An image with noise and a Gaussian of 150 grey levels at each spot, and their boxes."""
    rng = np.random.default_rng([seed, round(time_s * 1e6)])
    light = rng.normal(10.0, 1.0, (HEIGHT, WIDTH))
    for x, y, sigma in spots:
        down, across = (np.exp(-0.5 * ((np.arange(num) - at) / sigma) ** 2) for num, at in ((HEIGHT, y), (WIDTH, x)))
        light += gain * 150.0 * np.outer(down, across)
    boxes = np.array([box_of(spot) for spot in spots], np.int32).reshape(-1, 4)
    image = np.clip(np.rint(light), 0, 255).astype(np.uint8)
    return Frame(image, round(time_s * 1e9), motion=motion), Proposals(boxes)


def passing(time_s: float) -> list[Spot]:
    """Two lights by the road that come towards us, again and again."""
    return [(80.0 + side * 70.0 * (time_s + phase) ** 2 % 60.0, 50.0, 1.5) for side, phase in ((1, 0.3), (-1, 0.7))]


def times(duration_s: float, rate_hz: float = 10.0) -> Iterator[float]:
    return (index / rate_hz for index in range(round(duration_s * rate_hz)))


def is_left_out(standing: StandingLight, time_s: float, spots: Sequence[Spot], **image: object) -> bool:
    """Whether the first spot's box is left out, and that the others are not."""
    frame, proposals = frame_of(time_s, spots, **image)  # type: ignore[arg-type]
    boxes = standing.leave_out(frame, proposals).boxes_xyxy_px.tolist()
    first, *others = proposals.boxes_xyxy_px.tolist()
    assert [box for box in boxes if box != first] == others
    return first not in boxes


def learnt(motion: EgoMotion | None = DRIVING) -> StandingLight:
    """After six seconds with a sticker on the windscreen."""
    standing = StandingLight(CONFIG)
    for time_s in times(6.0):
        is_left_out(standing, time_s, [STICKER, *passing(time_s)], motion=motion)
    assert len(standing.regions_xyxy_px)
    return standing


@pytest.mark.parametrize("rate_hz", [8.0, 25.0])
def test_a_sticker_is_left_out_after_the_time_to_learn(rate_hz: float) -> None:
    standing = StandingLight(CONFIG)
    left_out = [time_s for time_s in times(6.0, rate_hz) if is_left_out(standing, time_s, [STICKER, *passing(time_s)])]
    assert CONFIG.learn_s < left_out[0] < CONFIG.learn_s + 4 * CHECK_S + 4 / rate_hz
    assert len(left_out) == sum(time_s >= left_out[0] for time_s in times(6.0, rate_hz))


def test_what_lights_a_sticker_may_change() -> None:
    standing = learnt()
    assert is_left_out(standing, 6.0, [STICKER, *passing(6.0)], gain=0.7)


@pytest.mark.parametrize("sway_px", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("sigma_px", [1.5, 4.0])
def test_a_lamp_that_we_follow_is_never_left_out(sway_px: float, sigma_px: float) -> None:
    """At a constant distance, and as bright all the time: all that moves it is the sway of two cars."""
    standing = StandingLight(CONFIG.model_copy(update={"max_area": 0.1}))
    rng = np.random.default_rng(3)
    moved = np.zeros(2)
    for time_s in times(20.0):
        moved += -0.3 * moved + rng.normal(0.0, sway_px * np.sqrt(1 - 0.7**2), 2)
        lamp = (LAMP[0] + moved[0], LAMP[1] + moved[1], sigma_px)
        assert not is_left_out(standing, time_s, [lamp, *passing(time_s)])
    assert len(standing.regions_xyxy_px) == 0


@pytest.mark.parametrize("motion", [EgoMotion(0.0, 0.0), None], ids=["speed known", "speed unknown"])
def test_nothing_is_learnt_while_we_stand(motion: EgoMotion | None) -> None:
    standing = StandingLight(CONFIG)
    for time_s in times(20.0):
        assert not is_left_out(standing, time_s, [LAMP, STICKER], motion=motion)


def test_the_image_tells_that_we_drive_where_nobody_knows_our_speed() -> None:
    standing = StandingLight(CONFIG)
    flow = [
        is_left_out(
            standing, time_s, [STICKER, *passing(time_s), *passing(time_s + 0.21), *passing(time_s + 0.4)], motion=None
        )
        for time_s in times(40.0)
    ]
    assert flow[-1]


def test_a_lamp_in_the_place_of_a_sticker_is_seen_at_once() -> None:
    standing = learnt()
    x, y, sigma = STICKER
    assert not is_left_out(standing, 6.0, [(x, y, 0.5 * sigma), *passing(6.0)])
    assert not is_left_out(standing, 6.1, [(x + 1.0, y, sigma), *passing(6.1)])
    assert is_left_out(standing, 6.2, [STICKER, *passing(6.2)])  # not forgotten yet
    for time_s in times(CONFIG.forget_s + 0.2):
        assert not is_left_out(standing, 6.3 + time_s, [LAMP, *passing(time_s)])
    assert not len(standing.regions_xyxy_px)


def test_a_large_region_is_not_learnt() -> None:
    large = StandingLight(CONFIG.model_copy(update={"max_area": 0.005}))
    assert not any(is_left_out(large, time_s, [STICKER, *passing(time_s)]) for time_s in times(8.0))


def test_all_regions_together_are_bounded() -> None:
    stickers = [(16.0 + 24.0 * index, 100.0, 2.5) for index in range(6)]
    standing = StandingLight(CONFIG)
    for time_s in times(15.0):
        standing.leave_out(*frame_of(time_s, [*stickers, *passing(time_s)]))
    regions = standing.regions_xyxy_px
    assert 0 < len(regions) < len(stickers)
    assert np.prod(regions[:, 2:] - regions[:, :2], axis=1).sum() <= CONFIG.max_area * HEIGHT * WIDTH


def test_memory_is_bounded() -> None:
    standing = StandingLight(CONFIG)
    rng = np.random.default_rng(1)
    for time_s in times(4.0, 40.0):
        spots = [(x, y, 1.5) for x, y in rng.uniform((10, 10), (WIDTH - 10, HEIGHT - 10), (30, 2))]
        standing.leave_out(*frame_of(time_s, spots))
        assert len(standing._waiting) + len(standing._learnt) <= MAX_REGIONS


@pytest.mark.parametrize("change", ["reset", "time back", "pause", "size"])
def test_another_sequence_begins_anew(change: str) -> None:
    standing = learnt()
    frame, proposals = frame_of({"time back": 1.0, "pause": 60.0}.get(change, 6.0), [STICKER])
    if change == "reset":
        standing.reset()
    if change == "size":
        frame = Frame(frame.image[:, :-1], frame.timestamp_ns, motion=DRIVING)
    assert len(standing.leave_out(frame, proposals)) == 1
    assert not len(standing.regions_xyxy_px)


def test_frames_of_16_bits_are_the_same() -> None:
    standing = StandingLight(CONFIG)
    for time_s in times(6.0):
        frame, proposals = frame_of(time_s, [STICKER, *passing(time_s)])
        frame = Frame(frame.image.astype(np.uint16) * 256, frame.timestamp_ns, motion=DRIVING)
        left = standing.leave_out(frame, proposals)
    assert len(left) == len(proposals) - 1


def test_light_that_doubles_from_pixel_to_pixel_is_no_region() -> None:
    """It is the sum of its derivatives, so that no fit can tell them apart; it raised an error."""
    ramp = 2 ** np.minimum(np.arange(20), 6)
    standing = StandingLight(StandingConfig(enabled=True))
    boxes = Proposals(np.array([[2, 2, 3, 3]], np.int32))
    for time_s in range(3):
        frame = Frame(np.add.outer(ramp, ramp).astype(np.uint8), time_s * 10**9, motion=DRIVING)
        assert len(standing.leave_out(frame, boxes)) == 1


def test_boxes_at_the_border_and_none_at_all() -> None:
    standing = StandingLight(CONFIG)
    for time_s in times(2.0):
        frame, _ = frame_of(time_s, [])
        boxes = [[0, 0, WIDTH, HEIGHT], [0, 0, 1, 1], [WIDTH - 1, HEIGHT - 1, WIDTH, HEIGHT]]
        assert len(standing.leave_out(frame, Proposals(np.array(boxes, np.int32)))) == 3
        assert len(standing.leave_out(frame, Proposals(np.zeros((0, 4), np.int32)))) == 0


def test_the_pipeline_leaves_out_and_forgets() -> None:
    config = preset("paper").model_copy(update={"standing": CONFIG}).changed("tracker", method="none")
    config = config.changed("proposals", reference_width_px=WIDTH, reduction=1)
    pipeline, without = Pipeline(config), Pipeline(config.changed("standing", enabled=False))

    def num_left_out(time_s: float) -> int:
        frame, _ = frame_of(time_s, [STICKER, *passing(time_s)])
        return len(without.step(frame).proposals) - len(pipeline.step(frame).proposals)

    counts = [num_left_out(time_s) for time_s in times(8.0)]
    assert counts[0] == 0
    assert counts[-1] >= 1
    pipeline.reset()
    assert num_left_out(8.0) == 0
