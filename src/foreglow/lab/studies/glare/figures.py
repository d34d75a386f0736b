"""The figures of the glare experiment. All of them raise ModuleNotFoundError if matplotlib is not installed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats
from foreglow.lab.evaluation.ratios import ratio
from foreglow.lab.reports.figures import AMBER, BLUE, DPI, GREEN, GREY, INK, PALE, box_plot, legend_above, png, subplots
from foreglow.lab.studies.glare.drive import AREAS, DriverEye, GlareDrive, PolicyRun
from foreglow.lab.studies.glare.eyes import BINS, LIMITS
from foreglow.lab.studies.glare.pooled import DriveScore
from foreglow.lab.studies.glare.scores import GlareResults, SensitivityPoint

PURPLE, RED, LIT, DARK = "#9a4c8f", "#e0403a", "#fdf0c8", "#4a4f5c"
COLOURS = {"low": GREY, "high": "#e3c02f", "production": AMBER, "paper": BLUE, "foreglow": GREEN, "oracle": PURPLE}
OTHERS = ("#b3651a", "#5f9ea0", "#c0587e", "#7a7a2c")
WORDS = {
    "low": "low beam",
    "high": "high beam",
    "production": "production ADB",
    "paper": "the paper's",
    "foreglow": "Foreglow",
    "oracle": "oracle",
}
FEWEST_LX = 0.01
README_WIDTH_IN = 900 / DPI


def lux_figure(
    drive: GlareDrive,
    vehicle_id: int,
    policies: Sequence[str],
    width_in: float = 9.0,
    height_in: float = 4.2,
    font_size: float = 9.0,
) -> bytes:
    """Light at one other driver's eye over time, each policy a line, limits dotted; shaded above the first.

    Raises:
        ValueError: If the drive has no such vehicle.
    """
    figure, (axes,) = subplots(1, width_in, height_in)
    _draw_lux(axes, drive, drive.eye(vehicle_id), policies)
    legend_above(figure, axes, fontsize=font_size, handlelength=1.6, columnspacing=1.3)
    return png(figure)


def corridor_figure(drive: GlareDrive, vehicle_id: int, policies: Sequence[str]) -> bytes:
    """The dark gaps over time beside the vehicle's azimuth, a panel for each policy.

    Raises:
        ValueError: If the drive has no such vehicle.
    """
    from matplotlib.collections import PolyCollection

    eye = drive.eye(vehicle_id)
    figure, panels = subplots(len(policies), width_in=max(2.6, 9.0 / max(len(policies), 1)), height_in=4.4)
    zero_s, (begin_s, end_s) = _zero_s(drive, eye), _shown_s(drive, eye)
    times_s = drive.times_s - zero_s
    for axes, name in zip(panels, policies, strict=True):
        axes.set_facecolor(LIT)
        dark = PolyCollection(
            _dark_areas(drive, drive.runs[name], zero_s), facecolor=DARK, edgecolor=DARK, linewidth=0.4
        )
        axes.add_collection(dark)
        angles_deg = np.degrees(eye.azimuths_rad)
        axes.plot(angles_deg, times_s, color=RED, linewidth=1.0, linestyle=(0, (4, 3)))
        axes.plot(np.where(eye.is_in_sight, angles_deg, math.nan), times_s, color=RED, linewidth=3.0)
        axes.set(title=_words(name), xlim=_angle_limits(eye), ylim=(end_s - zero_s, begin_s - zero_s))
        axes.title.set_fontsize(10)
        for time_s, words in _events(drive, eye):
            axes.axhline(time_s, color=INK, linewidth=0.8, linestyle=":")
            if axes is panels[0]:
                axes.text(0.02, time_s, words, transform=axes.get_yaxis_transform(), fontsize=8, va="bottom")
        axes.set_xlabel("azimuth, degrees")
    panels[0].set_ylabel("seconds from first sight")
    for axes in panels[1:]:
        axes.tick_params(labelleft=False)
    return png(figure)


def box_figure(results: GlareResults) -> bytes:
    """Box plots by policy: dose, first glare moment and road light."""
    figure, panels = subplots(4, width_in=3.3, height_in=3.8)
    titles = (
        "dose of oncoming drivers\nin a drive, lx s",
        "first glare moment of an\noncoming driver, s",
        "own lane's light while a vehicle\nis present, share of full beam",
        "verge's light while a vehicle\nis present, share of full beam",
    )
    names = [policy.name for policy in results.policies]
    for index, (axes, title) in enumerate(zip(panels, titles, strict=True)):
        values = [[value for drive in policy.drives for value in _values(drive)[index]] for policy in results.policies]
        columns = [np.array([value for value in column if not math.isnan(value)]) for column in values]
        colours = [_colour(name, names) for name in names]
        box_plot(axes, columns, colours, alpha=0.45, linewidth=0.8, widths=0.55, whis=(5, 95))
        for position, (colour, column) in enumerate(zip(colours, columns, strict=True), start=1):
            spread = np.random.default_rng(position).uniform(-0.16, 0.16, len(column))
            axes.scatter(position + spread, column, s=7, color=colour, linewidths=0, alpha=0.8)
        axes.set_title(title, fontsize=10)
        axes.set_xticks(range(1, len(names) + 1), [_words(name) for name in names], rotation=35, ha="right")
    _dose_scale(panels[0])
    for axes in panels[2:]:
        axes.set_ylim(0.0, 1.04)
    return png(figure)


def _values(drive: DriveScore) -> tuple[Sequence[float], ...]:
    met, light = drive.of_group(is_oncoming=True), drive.present
    kept = [[ratio(light.kept_lxs[area], light.full_lxs[area])] for area in range(len(AREAS))]
    return [drive.dose_lxs(is_oncoming=True)] if met else [], [eye.first_glare_s for eye in met], *kept


def seconds(time_s: float) -> str:
    """A time in words, with a decimal below 10 s.

    >>> seconds(0.22), seconds(61.3)
    ('0.2 s', '61 s')
    """
    return f"{time_s:.{0 if time_s >= 10.0 else 1}f} s"


def bin_figure(results: GlareResults) -> bytes:
    """Dose by range of the eye: oncoming drivers, and preceding ones where there are any."""
    groups = [("oncoming drivers", [policy.oncoming for policy in results.policies])]
    if results.policies[0].preceding.num_eyes:
        groups.append(("preceding drivers", [policy.preceding for policy in results.policies]))
    names = [policy.name for policy in results.policies]
    figure, panels = subplots(len(groups), width_in=6.5, height_in=3.8)
    width = 0.84 / len(names)
    for axes, (title, of_policies) in zip(panels, groups, strict=True):
        for index, (name, group) in enumerate(zip(names, of_policies, strict=True)):
            doses = [part.glare.dose_lxs for part in group.bins[:-1]]
            positions = np.arange(len(doses)) + (index - (len(names) - 1) / 2) * width
            axes.bar(positions, doses, 0.92 * width, color=_colour(name, names), label=_words(name))
        labels = [f"{part.name}\n{seconds(part.glare.in_sight_s)} in sight" for part in of_policies[0].bins[:-1]]
        axes.set_xticks(range(len(labels)), labels, fontsize=9)
        _dose_scale(axes)
        axes.set_title(f"{title} ({of_policies[0].num_eyes})", fontsize=10)
    panels[0].set_ylabel("dose above the limit, lx s")
    legend_above(figure, panels[0])
    return png(figure)


def sensitivity_figure(points: Sequence[SensitivityPoint]) -> bytes:
    """How dose, road light and wrong dimming move with the one parameter of `points`, a line for each policy."""
    figure, panels = subplots(3, width_in=3.6, height_in=3.2)
    names = list(dict.fromkeys(point.policy for point in points))
    titles = {
        "dose_vs_production": "dose of oncoming drivers,\nshare of production's",
        "road_kept": "own lane's light while a vehicle\nis present, share of full beam",
        "wrong_per_minute": "wrong dimming a minute\nin drives without any vehicle",
    }
    unit = f", {points[0].unit}" if points[0].unit else ""
    for axes, (field, title) in zip(panels, titles.items(), strict=True):
        for name in names:
            curve = sorted((point.value, getattr(point, field)) for point in points if point.policy == name)
            axes.plot(*zip(*curve, strict=True), color=_colour(name, names), marker="o", ms=4, label=_words(name))
        axes.set(xlabel=f"{points[0].parameter}{unit}")
        axes.set_title(title, fontsize=10)
        known = [getattr(point, field) for point in points if math.isfinite(getattr(point, field))]
        axes.set_ylim(0.0, 1.1 * max(known, default=1.0) or 1.0)
        axes.grid(axis="y", color=PALE, linewidth=0.6)
    panels[1].set_ylim(0.0, 1.04)
    legend_above(figure, panels[0])
    return png(figure)


def _draw_lux(axes: Any, drive: GlareDrive, eye: DriverEye, policies: Sequence[str]) -> None:
    zero_s, (begin_s, end_s) = _zero_s(drive, eye), _shown_s(drive, eye)
    times_s = drive.times_s - zero_s
    is_shown = (drive.times_s >= begin_s) & (drive.times_s <= end_s)
    limit_lx, highest = LIMITS[0].at(eye), FEWEST_LX
    for name in policies:
        lux = eye.illuminance_lx(drive.runs[name].levels)
        highest = max(highest, float(lux[is_shown].max(initial=0.0)))
        colour, label = _colour(name, list(policies)), _words(name)
        width = {"low": 5.0, "foreglow": 2.2}.get(name, 1.6)
        style = {"oracle": (0, (1, 1.2))}.get(name, "-")
        alpha = 0.45 if name == "low" else 1.0
        axes.plot(
            times_s, np.where(lux > 0, lux, math.nan), color=colour, linewidth=width, linestyle=style, alpha=alpha,
            label=label, solid_capstyle="butt",
        )  # fmt: skip
        if name not in ("low", "high"):
            axes.fill_between(times_s, lux, limit_lx, where=lux > limit_lx, color=colour, alpha=0.15, linewidth=0)
    for limits, colour, style in zip(LIMITS, (INK, GREY), ("steps-mid", "default"), strict=True):
        limit_lx = limits.at(eye)
        axes.plot(
            times_s, np.where(np.isfinite(limit_lx), limit_lx, math.nan), color=colour, linewidth=1.4,
            linestyle=(0, (1, 1.4)), drawstyle=style, label=limits.name,
        )  # fmt: skip
    axes.set_yscale("log")
    axes.set(xlim=(begin_s - zero_s, end_s - zero_s), ylim=(FEWEST_LX, max(10.0, 2.0 * highest)))
    axes.set(xlabel="seconds from first sight", ylabel="illuminance at the eye, lx")
    axes.grid(axis="y", color=PALE, linewidth=0.6)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    for time_s, words in _events(drive, eye):
        axes.axvline(time_s, color=INK, linewidth=0.8, linestyle="--", alpha=0.6)
        axes.annotate(
            words, (time_s, 0.98), xycoords=("data", "axes fraction"), xytext=(4, 0), textcoords="offset points",
            va="top", fontsize=8.5, color=INK,
        )  # fmt: skip
    _range_axis(axes, drive, eye, zero_s, is_shown)


def _range_axis(axes: Any, drive: GlareDrive, eye: DriverEye, zero_s: float, is_shown: NDArray[np.bool_]) -> None:
    """An axis above with the ranges at which limits change."""
    frames = np.flatnonzero(is_shown & ~np.isnan(eye.ranges_m))
    ticks: dict[float, str] = {}
    for edge_m in BINS.edges_m:
        is_beyond = eye.ranges_m[frames] >= edge_m
        for crossing in np.flatnonzero(is_beyond[:-1] != is_beyond[1:])[:1]:
            ticks[float(drive.times_s[frames[crossing]]) - zero_s] = f"{edge_m:g} m"
    above = axes.twiny()
    above.set(xlim=axes.get_xlim())
    above.set_xticks(list(ticks), list(ticks.values()), fontsize=8, color=GREY)
    above.tick_params(color=GREY, length=3, pad=1)
    above.spines[["top", "right"]].set_visible(False)


def _dose_scale(axes: Any) -> None:
    """Linear up to 0.1 lx s, logarithmic above: doses may be 0 and span decades."""
    axes.set_yscale("symlog", linthresh=0.1)
    axes.set_ylim(bottom=0.0)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")


def _events(drive: GlareDrive, eye: DriverEye) -> list[tuple[float, str]]:
    """What happens when, in seconds from the first sight; what was before the drive's first frame is left out."""
    zero_s = _zero_s(drive, eye)
    events = [(0.0, "first sight")] if eye.is_in_sight.any() else []
    if drive.light_s.get(eye.vehicle_id, -math.inf) >= drive.times_s[0]:
        events.append((drive.light_s[eye.vehicle_id] - zero_s, "first light"))
    ranged = np.flatnonzero(~np.isnan(eye.ranges_m))
    if len(ranged) and ranged[-1] < len(drive.times_s) - 1:
        events.append((float(drive.times_s[ranged[-1]]) - zero_s, "passed"))
    return sorted(events)


def _zero_s(drive: GlareDrive, eye: DriverEye) -> float:
    """The time of the first sight; of the first frame without."""
    return float(drive.times_s[eye.is_in_sight.argmax()])


def _shown_s(drive: GlareDrive, eye: DriverEye) -> tuple[float, float]:
    """From shortly before anything happens to shortly after it is over."""
    times_s = [time_s + _zero_s(drive, eye) for time_s, _ in _events(drive, eye)] or [float(drive.times_s[0])]
    is_passed = any(words == "passed" for _, words in _events(drive, eye))
    first_s, last_s = float(drive.times_s[0]), float(drive.times_s[-1])
    return max(first_s, min(times_s) - 0.7), min(last_s, max(times_s) + 0.7) if is_passed else last_s


def _angle_limits(eye: DriverEye) -> tuple[float, float]:
    """Degrees, left on the left, around where the vehicle is for nine tenths of the time."""
    known = np.degrees(eye.azimuths_rad[~np.isnan(eye.azimuths_rad)])
    low, high = np.percentile(known, (5, 95)).tolist() if len(known) else (0.0, 0.0)
    return max(high + 4.0, 8.0), min(low - 4.0, -8.0)


def _dark_areas(drive: GlareDrive, run: PolicyRun, zero_s: float) -> list[Floats]:
    """A rectangle (azimuth in degrees, time) for each gap of each frame; all angles where all LEDs are off."""
    areas = []
    half_s = 0.5 / drive.rate_hz
    for frame, time_s in enumerate(drive.times_s - zero_s):
        gaps = np.degrees(run.gaps_rad[frame, : run.num_gaps[frame]])
        if not run.levels[frame].any():
            gaps = np.array([[-90.0, 90.0]])
        early, late = time_s - half_s, time_s + half_s
        areas += [np.array([(right, early), (left, early), (left, late), (right, late)]) for right, left in gaps]
    return areas


def _words(name: str) -> str:
    return WORDS.get(name, name)


def _colour(name: str, names: Sequence[str]) -> str:
    others = [other for other in names if other not in COLOURS]
    return COLOURS.get(name) or OTHERS[others.index(name) % len(OTHERS)]
