"""Which drive is shown: one in which all happens that the paper's scene shows."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from foreglow.lab.studies.reproduction.drive import chosen_story

LIGHT_S, SIGHT_S = 1.0, 2.0


def story(*, lead_s: float = 0.5, gap_s: float = 1.5, num_images_before: int = 3) -> Any:
    times = SimpleNamespace(light_s=LIGHT_S, found_s=SIGHT_S - lead_s, lamp_s=SIGHT_S, lead_s=lead_s)
    gaps_rad = {gap_s: (0.0, 0.1)}
    facts = {"gap_s": gap_s, "gaps_rad": gaps_rad, "num_images_before": num_images_before, "is_hidden_first": True}
    return SimpleNamespace(times=times, confirmed_s=1.6, production_s=2.5, **facts)


@pytest.mark.parametrize("other", [{"gap_s": 0.9}, {"num_images_before": 0}])
def test_a_scene_like_the_papers_comes_before_a_longer_lead(other: dict[str, Any]) -> None:
    like, longer = story(), story(lead_s=0.9, **other)
    assert chosen_story([longer, like]) is like
    assert chosen_story([longer]) is longer


def test_a_gap_for_something_else_is_worse_than_light_from_the_first_image() -> None:
    early, other = story(num_images_before=0), story(gap_s=0.9)
    assert chosen_story([other, early]) is early
