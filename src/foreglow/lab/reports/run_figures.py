"""The figures of the report on a run: what happened over time, and how long the stages took."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from foreglow.display.beam_view import MODES
from foreglow.geometry import Floats
from foreglow.lab.reports.figures import AMBER, BLUE, DPI, GREY, INK, PALE, png, subplots
from foreglow.types import FrameResult, TrackState

MAX_ROWS = 30
"""Of the lights in a timeline; the longest are shown."""

WIDTH_IN = 1080 / DPI

HEIGHTS_IN = {"lights": 2.2, "ranges": 1.7, "confidences": 1.2, "beam": 1.7, "leds": 1.6}

UNKNOWN_STEP_S = 0.05
"""How long a frame is drawn where there is but one time."""

LONGEST_STEPS = 3.0
"""A command is drawn until the next frame, but for no more than so many usual steps: in a live run whose camera is gone
the lamps have long got another one, which no frame says. No line leads across a longer pause either."""


def sequence_figure(results: Sequence[FrameResult], num_columns: int | None) -> bytes:
    """What happened in one sequence over time, as PNG; what the run did not compute is left out.

    Args:
        results: Of the frames of the sequence.
        num_columns: LEDs in a row of a lamp; None where that is not known, and the LEDs are left out.

    Raises:
        ModuleNotFoundError: If matplotlib is not installed.
    """
    from matplotlib.figure import Figure as Sheet

    has_tracks = any(result.tracks is not None for result in results)
    has_beam = any(result.beam is not None for result in results)
    names = ["lights", "ranges", "confidences"] * has_tracks + ["beam"] * has_beam
    names = names + ["leds"] * (has_beam and num_columns is not None) or ["proposals"]
    heights = [HEIGHTS_IN.get(name, 2.0) for name in names]
    figure = Sheet(figsize=(WIDTH_IN, sum(heights) + 0.4), layout="constrained")
    all_axes = figure.subplots(len(names), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    times_s = np.array([result.timestamp_ns - results[0].timestamp_ns for result in results]) / 1e9
    for name, axes in zip(names, all_axes, strict=True):
        axes.spines[["top", "right"]].set_visible(False)
        if name == "proposals":
            _draw_proposals(axes, results, times_s)
        elif name == "beam":
            _draw_beam(axes, results, times_s)
        elif name == "leds" and num_columns is not None:
            _draw_leds(axes, results, times_s, num_columns)
        else:
            _draw_tracks(axes, name, results, times_s)
    all_axes[-1].set_xlabel("s from the first frame")
    return png(figure)


def stage_figure(results: Sequence[FrameResult]) -> bytes:
    """Box plots of the stages' run-times over all frames, as PNG: quartiles, and whiskers from p5 to p95.

    Raises:
        ModuleNotFoundError: If matplotlib is not installed.
    """
    stages = list(dict.fromkeys(stage for result in results for stage in result.stage_ms))
    values = [[result.stage_ms[stage] for result in results if stage in result.stage_ms] for stage in stages]
    values.append([sum(result.stage_ms.values()) for result in results if result.stage_ms])
    figure, (axes,) = subplots(1, 1.2 + 1.0 * len(values), 2.8)
    axes.boxplot(values, whis=(5, 95), showfliers=False, medianprops={"color": AMBER, "linewidth": 1.6})
    axes.set_xticks(range(1, len(values) + 1), [*stages, "total"], fontsize=8)
    axes.set(ylabel="ms")
    axes.set_ylim(bottom=0)
    return png(figure)


def _draw_proposals(axes: Any, results: Sequence[FrameResult], times_s: Floats) -> None:
    marker = _marker(times_s)
    axes.plot(times_s, [len(result.proposals) for result in results], color=GREY, marker=marker, label="proposals")
    if any(result.detections is not None for result in results):
        accepted = [0 if result.detections is None else int(result.detections.is_accepted.sum()) for result in results]
        axes.plot(times_s, accepted, color=AMBER, marker=marker, label="light artifacts")
    axes.set(ylabel="boxes a frame")
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False, fontsize=8)


def _marker(values: Floats) -> str | None:
    """What makes a single value visible, of which there is no line."""
    return "." if len(values) == 1 else None


def _draw_tracks(axes: Any, name: str, results: Sequence[FrameResult], times_s: Floats) -> None:
    histories = _histories(results, times_s)
    longest = sorted(histories, key=lambda track: -len(histories[track]))[:MAX_ROWS]
    period_s = _usual_step_s(times_s)
    for row, track in enumerate(sorted(longest)):
        history = _broken(histories[track], LONGEST_STEPS * period_s)
        if name == "lights":
            seen = histories[track]
            begins = [(time_s - period_s / 2, period_s) for time_s in seen[:, 0]]
            axes.broken_barh(begins, (row - 0.35, 0.7), color=[_colour(row) for row in seen])
        elif name == "ranges":
            (line,) = axes.plot(history[:, 0], history[:, 1], linewidth=1.2, marker=_marker(history))
            sigmas = np.where(np.isfinite(history[:, 2]), history[:, 2], 0.0)
            below, above = history[:, 1] - sigmas, history[:, 1] + sigmas
            axes.fill_between(history[:, 0], below, above, color=line.get_color(), alpha=0.15, linewidth=0)
        else:
            axes.plot(history[:, 0], history[:, 3], linewidth=1.2, marker=_marker(history))
    if name == "lights":
        axes.set_yticks(range(len(longest)), [f"#{track}" for track in sorted(longest)], fontsize=6)
        left_out = len(histories) - len(longest)
        axes.set_ylabel("tracks" if not left_out else f"tracks, {left_out} shorter ones left out", fontsize=8)
        for colour, word in ((AMBER, "indirect: provident"), (BLUE, "direct"), (GREY, "not known")):
            axes.plot([], [], color=colour, linewidth=5, label=word)
        axes.legend(frameon=False, fontsize=7, loc="upper left", ncols=3)
        axes.set_ylim(-0.6, max(len(longest), 1) + 0.9)
    elif name == "ranges":
        axes.set_ylabel("range ± sigma, m", fontsize=8)
        top_m = max((float(np.nanmax(history[:, 1], initial=0.0)) for history in histories.values()), default=0.0)
        axes.set_ylim(0.0, 1.2 * top_m or 1.0)
    else:
        axes.set_ylabel("confidence", fontsize=8)
        axes.set_ylim(0.0, 1.05)


def _histories(results: Sequence[FrameResult], times_s: Floats) -> dict[int, Floats]:
    """By track, a row for each frame in which it was plausible: time, range, sigma, confidence, direct, coasting."""
    rows: dict[int, list[tuple[float, ...]]] = {}
    for time_s, result in zip(times_s.tolist(), results, strict=True):
        tracks = result.tracks
        if tracks is None:
            continue
        is_coasting = tracks.states == TrackState.COASTING
        columns = (tracks.ranges_m, tracks.sigmas_m, tracks.confidences, tracks.direct_probabilities, is_coasting)
        for track in np.flatnonzero(tracks.is_plausible):
            row = (time_s, *(float(column[track]) for column in columns))
            rows.setdefault(int(tracks.ids[track]), []).append(row)
    return {number: np.array(history, np.float64) for number, history in rows.items()}


def _broken(history: Floats, longest_s: float) -> Floats:
    """A history with a row of NaN in every pause that is longer, so that no line leads across it."""
    pauses = np.flatnonzero(np.diff(history[:, 0]) > longest_s) + 1
    return np.insert(history, pauses, np.nan, axis=0)


def _colour(row: Floats) -> tuple[str, float]:
    direct, is_coasting = row[4], row[5]
    kind = GREY if np.isnan(direct) else BLUE if direct > 0.5 else AMBER
    return kind, 0.4 if is_coasting else 1.0


def _draw_beam(axes: Any, results: Sequence[FrameResult], times_s: Floats) -> None:
    """The mode as ground, and the dark gaps as azimuths."""
    from matplotlib.collections import PolyCollection

    ends_s = _ends_s(times_s)
    for mode, (words, (blue, green, red)) in MODES.items():
        colour = (red / 255, green / 255, blue / 255)
        is_mode = [result.beam is not None and result.beam.mode == mode for result in results]
        spans = [(begin, end - begin) for begin, end, is_on in zip(times_s, ends_s, is_mode, strict=True) if is_on]
        axes.broken_barh(spans, (-30.0, 60.0), color=colour, alpha=0.25, linewidth=0)
        axes.plot([], [], color=colour, alpha=0.5, linewidth=6, label=words.lower())
    gaps = [
        [(begin, right_deg), (end, right_deg), (end, left_deg), (begin, left_deg)]
        for begin, end, result in zip(times_s, ends_s, results, strict=True)
        if result.beam is not None
        for right_deg, left_deg in np.degrees(result.beam.gaps_rad).tolist()
    ]
    axes.add_collection(PolyCollection(gaps, facecolors=INK, alpha=0.8, linewidths=0))  # at once: there may be many
    axes.set_ylabel("gaps, degrees\nto the left", fontsize=8)
    axes.set_ylim(-30.0, 30.0)
    axes.legend(frameon=False, fontsize=7, loc="lower left", ncols=3)


def _draw_leds(axes: Any, results: Sequence[FrameResult], times_s: Floats, num_columns: int) -> None:
    """The LEDs' levels, mean of each column: from above the left lamp's from left to right, then the right lamp's."""
    columns = np.full((len(results), 2 * num_columns), np.nan)
    for index, result in enumerate(results):
        if result.beam is not None:
            columns[index] = result.beam.levels.reshape(2, -1, num_columns).mean(axis=1)[:, ::-1].ravel()
    ends_s = _ends_s(times_s)
    pauses = np.flatnonzero(ends_s[:-1] < times_s[1:])
    columns = np.insert(columns, pauses + 1, np.nan, axis=0)
    edges_s = np.append(np.insert(times_s, pauses + 1, ends_s[pauses]), ends_s[-1])
    mesh = axes.pcolormesh(edges_s, np.arange(2 * num_columns + 1), columns.T, cmap="inferno", vmin=0.0, vmax=1.0)
    axes.axhline(num_columns, color=PALE, linewidth=1.0)
    axes.set_yticks([num_columns / 2, 1.5 * num_columns], ["left\nlamp", "right\nlamp"], fontsize=8)
    axes.invert_yaxis()
    axes.figure.colorbar(mesh, ax=axes, label="level", pad=0.01)


def _usual_step_s(times_s: Floats) -> float:
    """The median time from a frame to the next one."""
    steps_s = np.diff(times_s)
    steps_s = steps_s[steps_s > 0]
    return float(np.median(steps_s)) if len(steps_s) else UNKNOWN_STEP_S


def _ends_s(times_s: Floats) -> Floats:
    """Until when the command of each frame is drawn; that of the last one for a usual step."""
    usual_s = _usual_step_s(times_s)
    steps_s = np.clip(np.append(np.diff(times_s), usual_s), 0.0, LONGEST_STEPS * usual_s)
    return np.asarray(times_s + steps_s, np.float64)
