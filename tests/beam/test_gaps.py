"""Gaps that overlap become one; nothing that was dark becomes light."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from foreglow.beam import GapWriter
from foreglow.beam.gaps import Gap, merged
from foreglow.config import BeamConfig
from foreglow.photometry import read_headlamps

GAPS = st.builds(
    lambda right, width, near, depth: Gap(right, right + width, near, near + depth),
    st.floats(-0.6, 0.6),
    st.floats(0.001, 0.3),
    st.floats(8, 200),
    st.floats(0, 100) | st.just(float("inf")),
)


def covers(gaps: list[Gap], inner: Gap) -> bool:
    """Whether one of `gaps` holds all of `inner`, its directions and its ranges."""
    return any(
        gap.right_rad <= inner.right_rad
        and inner.left_rad <= gap.left_rad
        and gap.near_m <= inner.near_m
        and inner.far_m <= gap.far_m
        for gap in gaps
    )


@given(st.lists(GAPS, max_size=8))
def test_merged_gaps_cover_all_and_lie_apart(gaps: list[Gap]) -> None:
    apart = merged(gaps)
    assert all(covers(apart, gap) for gap in gaps)
    assert all(before.left_rad < after.right_rad for before, after in pairwise(apart))
    borders = {border for gap in gaps for border in gap[:2]}
    assert {border for gap in apart for border in gap[:2]} <= borders
    assert merged(apart) == apart


@given(st.lists(GAPS, max_size=8), st.randoms())
def test_the_order_does_not_matter(gaps: list[Gap], random: object) -> None:
    shuffled = list(gaps)
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    assert merged(shuffled) == merged(gaps)


def test_gaps_that_touch_are_one_and_others_stay() -> None:
    first, second, third = Gap(0.0, 0.1, 50, 60), Gap(0.1, 0.2, 30, 40), Gap(0.3, 0.4, 9, 9)
    assert merged([third, second, first]) == [Gap(0.0, 0.2, 30, 60), third]
    assert merged([]) == []


@pytest.mark.parametrize(
    "gap",
    [
        Gap(0.1, -0.1, 50.0, 60.0),
        Gap(0.1, 0.1, 50.0, 60.0),
        Gap(math.nan, 0.1, 50.0, 60.0),
        Gap(-0.1, 0.1, math.nan, 60.0),
        Gap(-0.1, 0.1, 50.0, math.nan),
        Gap(-0.1, 0.1, 60.0, 50.0),
        Gap(-0.1, 0.1, -1.0, 50.0),
    ],
)
def test_a_gap_of_no_interval_is_refused(gap: Gap) -> None:
    """A policy of somebody else gives the range of a track, which may be NaN: some of these gaps were lit."""
    writer = GapWriter(BeamConfig(), read_headlamps())
    for gaps, dips in (([gap], []), ([], [gap]), ([Gap(-0.3, 0.3, 40.0, 90.0), gap], [])):
        with pytest.raises(ValueError, match=r"^gaps: expected right_rad < left_rad and .*, got Gap\(right_rad="):
            writer.command(0, gaps, dips)
    assert writer.command(0, [Gap(-0.1, 0.1, 0.0, math.inf)]).levels.min() < 0.1


def test_a_gap_has_a_range_where_all_that_it_covers_do() -> None:
    known, unknown = Gap(0.0, 0.1, 50, 60), Gap(0.1, 0.2, 40, 90, has_range=False)
    assert merged([known, unknown]) == [Gap(0.0, 0.2, 40, 90, has_range=False)]
