"""Courses of roads: the bends and hills of each scenario's road, and the land beside it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from foreglow.lab.simulation.scenes.draw import Draw
from foreglow.lab.simulation.scenes.roadside import Style
from foreglow.lab.simulation.scenes.scene import Branch
from foreglow.lab.simulation.scenes.surroundings import Profile

Bend: TypeAlias = tuple[float, float, float]
"""Begin, end, and signed curvature in 1/m."""


@dataclass(frozen=True, slots=True)
class Course:
    """The course of a road, and the land beside it."""

    style: Style = "open"
    bends: tuple[Bend, ...] = ()
    elevation_m: Profile = ((0.0, 0.0),)
    branches: tuple[Branch, ...] = ()


Layout: TypeAlias = Callable[[Draw, float], Course]
"""Draws a course around the arc length, in metres, at which the view should open."""


def curve(draw: Draw, focus_m: float) -> Course:
    """One bend, to either side."""
    style: Style = draw.choice(["open", "forest", "rocky"], [0.5, 0.3, 0.2])
    return Course(style, _winding(draw, _bend(draw, focus_m)), _gentle_hills(draw, focus_m))


def s_bend(draw: Draw, focus_m: float) -> Course:
    """Two bends in opposite directions."""
    first = _bend(draw, focus_m - 30.0)
    start = first[1] + draw.uniform(15.0, 60.0)
    second = (start, start + draw.uniform(60.0, 140.0), float(-np.sign(first[2])) / draw.log_uniform(90.0, 300.0))
    style: Style = draw.choice(["open", "forest", "rocky"], [0.5, 0.3, 0.2])
    return Course(style, (first, *_winding(draw, second)), _gentle_hills(draw, focus_m))


def crest(draw: Draw, focus_m: float) -> Course:
    """A hill that hides the other car."""
    half, height = draw.uniform(90.0, 150.0), draw.uniform(1.8, 4.5)
    profile = ((focus_m - half, 0.0), (focus_m, height), (focus_m + half, draw.uniform(-2.0, 1.0)))
    bends = _winding(draw, _bend(draw, focus_m, gentle=True)) if draw.chance(0.5) else ()
    return Course(draw.choice(["open", "forest"]), bends, profile)


def sag(draw: Draw, focus_m: float) -> Course:
    """A dip between two slopes, often with a bend in it."""
    half, depth = draw.uniform(90.0, 160.0), draw.uniform(3.0, 8.0)
    profile = ((focus_m - half, 0.0), (focus_m, -depth), (focus_m + half, draw.uniform(-1.0, 3.0)))
    bends = (_bend(draw, focus_m),) if draw.chance(0.7) else ()
    return Course(draw.choice(["open", "forest"]), bends, profile)


def straight(draw: Draw, focus_m: float) -> Course:
    """A straight road, on which the other car is seen from afar."""
    return Course(draw.choice(["open", "forest"]), (), _gentle_hills(draw, focus_m))


def junction(draw: Draw, focus_m: float) -> Course:
    """A side road that joins ours, with a car on it."""
    branch = Branch(s_m=round(focus_m, 1), angle_deg=draw.choice([-1, 1]) * draw.uniform(60.0, 115.0))
    bends = (_bend(draw, focus_m + 110.0),) if draw.chance(0.6) else ()
    return Course(draw.choice(["open", "open", "village"]), bends, ((0.0, 0.0),), (branch,))


def village(draw: Draw, focus_m: float) -> Course:
    """A street with houses, lamps and parked cars."""
    return Course("village", (_bend(draw, focus_m),) if draw.chance(0.8) else (), _gentle_hills(draw, focus_m))


def forest(draw: Draw, focus_m: float) -> Course:
    """A winding road through a wood."""
    return Course("forest", _winding(draw, _bend(draw, focus_m)), _gentle_hills(draw, focus_m))


def _bend(draw: Draw, focus_m: float, *, gentle: bool = False) -> Bend:
    radius_m = draw.log_uniform(300.0, 900.0) if gentle else draw.log_uniform(110.0, 500.0)
    length_m = min(draw.uniform(80.0, 220.0), 1.7 * radius_m)
    start = max(focus_m - length_m * draw.uniform(0.25, 0.6), 5.0)
    sign = -1 if draw.chance(0.7) else 1  # in PVDN more cars appear to the right than to the left
    return (round(start, 1), round(start + length_m, 1), sign / radius_m)


def _winding(draw: Draw, first: Bend) -> tuple[Bend, ...]:
    """`first` and further bends: on a winding road, the light of a car is hidden until the last bend."""
    bends = [first]
    while len(bends) < 4 and draw.chance(0.8):
        start = bends[-1][1] + draw.uniform(10.0, 50.0)
        sign = float(np.sign(bends[-1][2])) * (-1 if draw.chance(0.7) else 1)
        bend = (start, start + draw.uniform(50.0, 140.0), sign / draw.log_uniform(100.0, 350.0))
        bends.append((round(bend[0], 1), round(bend[1], 1), bend[2]))
    return tuple(bends)


def _gentle_hills(draw: Draw, focus_m: float) -> Profile:
    if draw.chance(0.4):
        return ((0.0, 0.0),)
    points_m = (0.0, focus_m * 0.6, focus_m * 1.3, focus_m * 2.2)
    return tuple((round(s_m, 1), draw.uniform(-2.0, 2.0) if s_m else 0.0) for s_m in points_m)
