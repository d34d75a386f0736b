"""Which frames of a drive the calibration looks at."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from foreglow.calibration.auto.views import views_of
from foreglow.types import Frame


def chosen(times_ms: Sequence[float], rate_hz: float | None, num_frames: int | None = None) -> list[int]:
    image = np.zeros((64, 96), np.uint8)
    frames = [Frame(image, round(time_ms * 1e6), frame=number) for number, time_ms in enumerate(times_ms)]
    return [frame.frame for frame, _ in views_of(frames, rate_hz, num_frames)]


@pytest.mark.parametrize(
    ("rate_hz", "gap"), [(4, 1), (18, 1), (20, 1), (25, 2), (29.97, 2), (30, 2), (60, 3), (120, 6)]
)
def test_frames_are_no_nearer_to_each_other_than_they_show_motion(rate_hz: float, gap: int) -> None:
    times_ms = [1000 * number / rate_hz for number in range(48)]
    assert chosen(times_ms, rate_hz) == list(range(0, 48, gap))
    assert chosen([1.7e12 + round(time_ms) for time_ms in times_ms], None) == list(range(0, 48, gap))


def test_frames_are_chosen_by_their_times_where_the_rate_varies() -> None:
    """A phone takes fewer frames where it is dark; each of these is as far from the one before as it has to be."""
    times_ms = [*range(0, 330, 33), *range(330, 1000, 67)]
    assert chosen(times_ms, 18.0) == [0, 2, 4, 6, 8, *range(10, 20)]


def test_pairs_of_a_long_drive_are_spread_over_it() -> None:
    assert chosen([number * 1000 / 18 for number in range(1200)], 18.0, 1200)[:6] == [0, 1, 6, 7, 12, 13]
