"""What is said of a drive."""

from __future__ import annotations

import dataclasses
import io
import math

import pytest
from rich.console import Console

from foreglow.lab.evaluation.vehicles import FirstFound
from foreglow.lab.studies.demo.metrics import Moment, Story
from foreglow.lab.studies.demo.page import MAX_ROWS, conclusion, papers_scene, story_lines, story_table
from foreglow.lab.studies.reproduction.claims import paper_words
from tests.lab.evaluation.scored_boxes import light

NEVER = math.nan


def story_of(
    light_s: float,
    found_s: float,
    lamp_s: float,
    production_s: float = NEVER,
    score: float = 0.83,
    confirmed_s: float = NEVER,
) -> Story:
    lamp = light(9, 30, 20)
    rail = light(1, 10, 10, kind="rail", is_hidden=True)
    return Story(
        sequence="S00001",
        vehicle="car",
        times=FirstFound(1, 0, light_s, found_s, lamp_s, NEVER),
        light=Moment(light_s, rail if light_s < lamp_s or math.isnan(lamp_s) else lamp, NEVER),
        found=None if math.isnan(found_s) else Moment(found_s, light(5, 12, 10, kind="rail"), score),
        sight=None if math.isnan(lamp_s) else Moment(lamp_s, lamp, NEVER),
        confirmed_s=confirmed_s,
        production_s=production_s,
        duration_s=5.0,
        num_images_before=round(18 * light_s) if light_s > 2 else 0,
        num_boxes_before=19,
    )


def test_a_story_line_by_line() -> None:
    assert story_lines(story_of(2.1, 2.3, 3.5, 4.25), is_classified=True) == [
        "first light of the hidden car visible    2.10 s   (rail)",
        "detected                                 2.30 s   (rail, score 0.83)",
        "car in sight                             3.50 s",
        "reported by the production system        4.25 s",
        "=> detected 1.20 s before it was there",
        "   false boxes before its first light: 19 in 38 images (0.5 an image)",
    ]


def test_what_the_tracker_says() -> None:
    lines = story_lines(story_of(2.1, 2.3, 3.5, confirmed_s=2.35), is_classified=True)
    assert lines[2].split() == ["confirmed", "by", "the", "tracker", "2.35", "s"]


@pytest.mark.parametrize(
    ("gap_s", "expected"),
    [
        ((), "no dark gap there"),
        ((3.5,), "dark gap there as it came into sight"),
        ((2.25, 3.5), "dark gap there 1.25 s before"),
        ((1.5, 3.5), "dark gap there 2.00 s before, for something else"),
    ],
)
def test_what_the_beam_did(gap_s: tuple[float, ...], expected: str) -> None:
    gaps_rad = dict.fromkeys(gap_s, (0.1, 0.2))
    story = dataclasses.replace(story_of(2.0, 2.3, 3.5, confirmed_s=3.75), gaps_rad=gaps_rad)
    wanted = f"detected 1.20 s before it was there, confirmed 0.25 s after, {expected}"
    assert conclusion(story, is_classified=True) == wanted
    assert story_lines(story, is_classified=True)[-1] == f"=> {wanted}"


def test_without_a_model_it_is_only_proposed() -> None:
    lines = story_lines(story_of(2.0, 2.3, 3.5, score=NEVER), is_classified=False)
    assert lines[1].split() == ["proposed", "2.30", "s", "(rail)"]
    assert lines[-1] == "=> proposed 1.20 s before it was there"
    assert len(lines) == 4
    assert "   boxes of other things before its first light: 19 in 38 images (0.5 an image)" in story_lines(
        story_of(2.1, 2.3, 3.5, score=NEVER), is_classified=False
    )


@pytest.mark.parametrize(
    ("story", "expected"),
    [
        (story_of(1.0, 3.0, 3.0), "detected as it came into sight"),
        (story_of(1.0, 3.5, 3.0), "detected 0.50 s after it came into sight"),
        (story_of(1.0, NEVER, 3.0), "not detected"),
        (story_of(1.0, 2.0, NEVER), "detected, and never in sight"),
    ],
)
def test_conclusions(story: Story, expected: str) -> None:
    assert conclusion(story, is_classified=True) == expected


def test_a_car_in_the_open_is_not_called_hidden() -> None:
    lines = story_lines(story_of(1.0, 1.0, 1.0), is_classified=True)
    assert lines[0].startswith("first light of the car visible")
    assert lines[0].endswith("(lamp)")


def shown(stories: list[Story]) -> str:
    console = Console(file=io.StringIO(), width=160)
    console.print(story_table(stories, is_classified=True))
    return " ".join(console.file.getvalue().split())  # type: ignore[attr-defined]


def test_several_stories_as_a_table() -> None:
    text = shown([story_of(2.0, 2.5, 3.5), story_of(2.0, NEVER, 3.0), story_of(1.0, 1.5, 1.0)])
    assert "1 of 2 hidden vehicles (50%) detected before they were in sight, by 1.00 s in the median" in text
    assert "-0.50" in text
    assert "production" in text
    assert "1 of" not in shown([story_of(1.0, 1.5, 1.0)])


def test_a_long_table_is_cut() -> None:
    many = [dataclasses.replace(story_of(2.0, 2.5, 3.5), sequence=f"S{k:05d}") for k in range(MAX_ROWS + 3)]
    text = shown(many)
    assert "and 3 more sequences" in text
    assert f"S{MAX_ROWS - 1:05d}" in text
    assert f"S{MAX_ROWS:05d}" not in text


def test_the_papers_scene_is_what_its_claims_say() -> None:
    for name in ("single", "tracker", "production"):
        assert f" {paper_words(f'scene-{name}')}" in papers_scene()
