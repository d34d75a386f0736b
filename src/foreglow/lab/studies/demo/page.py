"""The story of a drive in words that need no explanation."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence

from rich.table import Table

from foreglow.lab.evaluation.vehicles import UNKNOWN_VEHICLE, share_found_ahead
from foreglow.lab.reports.page import number, percent
from foreglow.lab.studies.demo.metrics import Moment, Story
from foreglow.lab.studies.reproduction.claims import paper_words

PLACES = {
    "lamp": "its lamp",
    "rail": "on the rail",
    "road": "on the road",
    "verge": "on the verge",
    "foliage": "in the leaves",
    "wall": "on the wall",
    "sign": "on a sign",
    "vehicle": "on another vehicle",
    "haze": "in the haze",
    "indirect": "reflected light",
}
"""Where light is seen, by its kind; of other kinds, the kind itself is said."""

MAX_ROWS = 40
"""Rows of a table of stories; more are counted only."""


def story_lines(story: Story, *, is_classified: bool) -> list[str]:
    """What happens, one moment a line with its time from the beginning, and then what it comes to.

    Args:
        story: What happens.
        is_classified: Whether a model accepted the boxes; without one the boxes are mere proposals, and it says so.
    """
    rows = [(first_words(story), story.light.time_s, on_what(story.light))]
    if story.found is not None:
        score = "" if math.isnan(story.found.score) else f", score {story.found.score:.2f}"
        rows.append((found_word(is_classified), story.found.time_s, on_what(story.found) + score))
    if not math.isnan(story.confirmed_s):
        rows.append(("confirmed by the tracker", story.confirmed_s, ""))
    if story.sight is not None:
        rows.append((f"{story.vehicle} in sight", story.sight.time_s, ""))
    if not math.isnan(story.production_s):
        rows.append(("reported by the production system", story.production_s, ""))
    width = max(len(words) for words, _, _ in rows)
    lines = [f"{words:<{width}}  {time_s:6.2f} s{f'   ({note})' if note else ''}" for words, time_s, note in rows]
    lines.append(f"=> {conclusion(story, is_classified=is_classified)}")
    if story.num_images_before:
        boxes = "false boxes" if is_classified else "boxes of other things"
        lines.append(
            f"   {boxes} before its first light: {_per_image(story.num_boxes_before, story.num_images_before)}"
        )
    return lines


def papers_scene() -> str:
    """What the paper states of its own scene."""
    single, tracker, production = (paper_words(f"scene-{name}") for name in ("single", "tracker", "production"))
    return f"   the paper's scene, after first light: detected {single}, confirmed {tracker}, reported {production}"


def first_words(story: Story) -> str:
    """What is visible first."""
    hidden = "hidden " if story.is_hidden_first else ""
    return f"first light of the {hidden}{story.vehicle} visible"


def found_word(is_classified: bool) -> str:
    """What happens to a light in a box."""
    return "detected" if is_classified else "proposed"


def on_what(moment: Moment) -> str:
    """What the light is on; `light` where that is unknown."""
    return "light" if moment.light.kind == "indirect" else moment.light.kind


def conclusion(story: Story, *, is_classified: bool) -> str:
    """What it comes to: by how much it was detected and confirmed, and the beam dark, before it was there."""
    found = found_word(is_classified)
    if story.sight is None:
        return f"not {found}" if story.found is None else f"{found}, and never in sight"
    parts = [f"not {found}" if story.found is None else f"{found} {_before(story.times.lead_s, is_whole=True)}"]
    if not math.isnan(story.confirmed_s):
        parts.append(f"confirmed {_before(story.sight.time_s - story.confirmed_s)}")
    if story.gaps_rad is not None:
        is_other = story.gap_s < story.light.time_s
        gap = f"dark gap there {_before(story.sight.time_s - story.gap_s)}{', for something else' if is_other else ''}"
        parts.append(gap if story.gaps_rad else "no dark gap there")
    return ", ".join(parts)


def _before(lead_s: float, *, is_whole: bool = False) -> str:
    """By how much something was before the vehicle came into sight; only the first of several says before what."""
    if lead_s == 0:
        return "as it came into sight"
    words, moment = ("before", "it was there") if lead_s > 0 else ("after", "it came into sight")
    return f"{abs(lead_s):.2f} s {words} {moment}" if is_whole else f"{abs(lead_s):.2f} s {words}"


def story_table(stories: Sequence[Story], *, is_classified: bool) -> Table:
    """The stories of several sequences, a row each; a caption says how many were found ahead, and by how much."""
    table = Table("", "vehicle", "first light", "on", found_word(is_classified), "confirmed")
    for name in ("in sight", "production", "ahead"):
        table.add_column(name)
    for column in table.columns[2:]:
        column.justify = "left" if column.header == "on" else "right"
    for story in stories[:MAX_ROWS]:
        times_s = (story.times.found_s, story.confirmed_s, story.times.lamp_s, story.production_s, story.times.lead_s)
        vehicle = "" if story.vehicle == UNKNOWN_VEHICLE else story.vehicle
        seconds = (number(time_s, missing="-") for time_s in times_s)
        table.add_row(story.sequence, vehicle, number(story.light.time_s), on_what(story.light), *seconds)
    table.caption = "\n".join(_table_notes(stories, is_classified))
    table.caption_justify = "left"
    return table


def _table_notes(stories: Sequence[Story], is_classified: bool) -> list[str]:
    notes = ["seconds from each sequence's beginning; ahead: from the first box to the first lamp"]
    if len(stories) > MAX_ROWS:
        notes.append(f"and {len(stories) - MAX_ROWS} more sequences")
    hidden = [story for story in stories if story.is_hidden_first and story.sight is not None]
    ahead_s = [story.times.lead_s for story in hidden if story.times.lead_s > 0]
    if hidden:
        share = percent(share_found_ahead([story.times for story in hidden]))
        line = f"{len(ahead_s)} of {len(hidden)} hidden vehicles ({share}) {found_word(is_classified)} before"
        line += " they were in sight"
        notes.append(f"{line}, by {statistics.median(ahead_s):.2f} s in the median" if ahead_s else line)
    return notes


def _per_image(num_boxes: int, num_images: int) -> str:
    """How many, and how many that is an image.

    >>> _per_image(3, 30)
    '3 in 30 images (0.1 an image)'
    """
    return f"{num_boxes} in {num_images} image{'' if num_images == 1 else 's'} ({num_boxes / num_images:.1f} an image)"
