"""Trackers by name."""

from __future__ import annotations

import pytest

from foreglow.config import OUR_TRACKER, PUBLISHED_TRACKER, TrackerConfig
from foreglow.tracking import TRACKERS, make_tracker


def test_by_name() -> None:
    for config in (TrackerConfig(), PUBLISHED_TRACKER, OUR_TRACKER):
        assert type(make_tracker(config)) is TRACKERS[config.method]


def test_none_is_no_tracker() -> None:
    with pytest.raises(ValueError, match=r"tracker\.method: expected one of alpha_beta, published, .*got 'none'"):
        make_tracker(TrackerConfig(method="none"))
