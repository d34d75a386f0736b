from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from foreglow.photometry.limits import (
    FMVSS_ONCOMING,
    FMVSS_PRECEDING,
    UN_R123,
    IlluminanceLimits,
)


def test_oncoming_by_range() -> None:
    ranges_m = np.array([[0.0, 14.99, 15.0, 29.99], [30.0, 60.0, 119.0, 120.0], [219.9, 220.0, 220.1, 1e4]])
    expected = [[np.inf, np.inf, 3.1, 3.1], [1.8, 0.6, 0.6, 0.3], [0.3, 0.3, np.inf, np.inf]]
    np.testing.assert_array_equal(FMVSS_ONCOMING.at(ranges_m), expected)


def test_preceding_by_range() -> None:
    assert FMVSS_PRECEDING.at([14.0, 15.0, 59.9, 60.0, 100.0, 101.0]).tolist() == [np.inf, 18.9, 18.9, 4, 4, np.inf]


@pytest.mark.parametrize("limits", [FMVSS_ONCOMING, FMVSS_PRECEDING])
def test_limits_do_not_grow_with_range(limits: IlluminanceLimits) -> None:
    ranges_m = np.linspace(limits.edges_m[0], limits.edges_m[-1], 500)
    assert (np.diff(limits.at(ranges_m)) <= 0).all()
    assert set(limits.bins(ranges_m)) == set(range(len(limits.bin_names)))


def test_unknown_ranges_have_no_limit() -> None:
    assert FMVSS_ONCOMING.at(np.nan) == np.inf
    assert FMVSS_ONCOMING.bins([np.nan, -1.0, np.inf]).tolist() == [-1, -1, -1]


def test_bins_have_names() -> None:
    assert FMVSS_ONCOMING.bin_names == ("15-30 m", "30-60 m", "60-120 m", "120-220 m")


def test_candela_become_lux_at_their_distance() -> None:
    at = {(limit.towards, limit.distance_m): limit.illuminance_lx() for limit in reversed(UN_R123)}
    assert at["oncoming", 50.0] == pytest.approx(0.5)
    assert at["oncoming", 100.0] == pytest.approx(0.35)
    assert at["oncoming", 200.0] == pytest.approx(0.2725)
    assert at["preceding", 50.0] == pytest.approx(1.48)
    assert UN_R123[0].illuminance_lx(num_lamps=1) == pytest.approx(0.25)


def test_limits_are_data_with_source_and_doubt() -> None:
    for limit in (FMVSS_ONCOMING, FMVSS_PRECEDING, *UN_R123):
        assert "third-party" in limit.doubt
        assert limit.source
        with pytest.raises(dataclasses.FrozenInstanceError):
            limit.source = "the official text"  # type: ignore[misc]
    for limit in UN_R123:
        if limit.zone_deg is not None:
            assert limit.zone_deg[2] == pytest.approx(np.degrees(0.5 / limit.distance_m), abs=0.02)
