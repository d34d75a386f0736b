"""The report on a run: one HTML page with everything in it, made from the run's folder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from foreglow.config import config_to_toml
from foreglow.display.beam_view import MODES
from foreglow.display.overlay import annotate
from foreglow.display.tone import Tone
from foreglow.geometry import Floats
from foreglow.lab.reports.figures import AMBER, BLUE, DPI, GREY, PALE, jpeg, png, subplots
from foreglow.lab.reports.page import DASH, Figure, Page, Table, number
from foreglow.photometry import read_headlamps
from foreglow.runs.recorded_run import RecordedRun, read_frames, read_run
from foreglow.types import Frame, FrameResult, TrackState
from foreglow.whole_files import write_atomic

MAX_ROWS = 30
"""Of the lights in a timeline; the longest are shown."""

WIDTH_IN = 1080 / DPI

HEIGHTS_IN = {"lights": 2.2, "ranges": 1.7, "confidences": 1.2, "beam": 1.7, "leds": 1.6}


def sequence_figure(results: Sequence[FrameResult], num_columns: int) -> bytes:
    """What happened in one sequence over time, as PNG; what the run did not compute is left out.

    Raises:
        ModuleNotFoundError: If matplotlib is not installed.
    """
    from matplotlib.figure import Figure as Sheet

    has_tracks = any(result.tracks is not None for result in results)
    has_beam = any(result.beam is not None for result in results)
    names = ["lights", "ranges", "confidences"] * has_tracks + ["beam", "leds"] * has_beam or ["proposals"]
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
        elif name == "leds":
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
    axes.plot(times_s, [len(result.proposals) for result in results], color=GREY, label="proposals")
    if any(result.detections is not None for result in results):
        accepted = [0 if result.detections is None else int(result.detections.is_accepted.sum()) for result in results]
        axes.plot(times_s, accepted, color=AMBER, label="light artifacts")
    axes.set(ylabel="boxes a frame")
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False, fontsize=8)


def _draw_tracks(axes: Any, name: str, results: Sequence[FrameResult], times_s: Floats) -> None:
    histories = _histories(results, times_s)
    longest = sorted(histories, key=lambda track: -len(histories[track]))[:MAX_ROWS]
    period_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.05
    for row, track in enumerate(sorted(longest)):
        history = histories[track]
        if name == "lights":
            begins = [(time_s - period_s / 2, period_s) for time_s in history[:, 0]]
            axes.broken_barh(begins, (row - 0.35, 0.7), color=[_colour(row) for row in history])
        elif name == "ranges":
            (line,) = axes.plot(history[:, 0], history[:, 1], linewidth=1.2)
            sigmas = np.where(np.isfinite(history[:, 2]), history[:, 2], 0.0)
            below, above = history[:, 1] - sigmas, history[:, 1] + sigmas
            axes.fill_between(history[:, 0], below, above, color=line.get_color(), alpha=0.15, linewidth=0)
        else:
            axes.plot(history[:, 0], history[:, 3], linewidth=1.2)
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


def _colour(row: Floats) -> tuple[str, float]:
    direct, is_coasting = row[4], row[5]
    kind = GREY if np.isnan(direct) else BLUE if direct > 0.5 else AMBER
    return kind, 0.4 if is_coasting else 1.0


def _draw_beam(axes: Any, results: Sequence[FrameResult], times_s: Floats) -> None:
    """The mode as ground, and the dark gaps as azimuths."""
    ends_s = np.append(times_s[1:], times_s[-1])
    for mode, (words, (blue, green, red)) in MODES.items():
        colour = (red / 255, green / 255, blue / 255)
        is_mode = [result.beam is not None and result.beam.mode == mode for result in results]
        spans = [(begin, end - begin) for begin, end, is_on in zip(times_s, ends_s, is_mode, strict=True) if is_on]
        axes.broken_barh(spans, (-30.0, 60.0), color=colour, alpha=0.25, linewidth=0)
        axes.plot([], [], color=colour, alpha=0.5, linewidth=6, label=words.lower())
    gaps = [
        (begin, end, *np.degrees(borders_rad))
        for begin, end, result in zip(times_s, ends_s, results, strict=True)
        if result.beam is not None
        for borders_rad in result.beam.gaps_rad
    ]
    for begin, end, right_deg, left_deg in gaps:
        axes.fill_between([begin, end], right_deg, left_deg, color="#222222", alpha=0.8, linewidth=0)
    axes.set_ylabel("gaps, degrees\nto the left", fontsize=8)
    axes.set_ylim(-30.0, 30.0)
    axes.legend(frameon=False, fontsize=7, loc="lower left", ncols=3)


def _draw_leds(axes: Any, results: Sequence[FrameResult], times_s: Floats, num_columns: int) -> None:
    """The LEDs' levels, mean of each column: from above the left lamp's from left to right, then the right lamp's."""
    columns = np.full((len(results), 2 * num_columns), np.nan)
    for index, result in enumerate(results):
        if result.beam is not None:
            columns[index] = result.beam.levels.reshape(2, -1, num_columns).mean(axis=1)[:, ::-1].ravel()
    edges_s = np.append(times_s, times_s[-1] + (times_s[-1] - times_s[-2] if len(times_s) > 1 else 0.05))
    mesh = axes.pcolormesh(edges_s, np.arange(2 * num_columns + 1), columns.T, cmap="inferno", vmin=0.0, vmax=1.0)
    axes.axhline(num_columns, color=PALE, linewidth=1.0)
    axes.set_yticks([num_columns / 2, 1.5 * num_columns], ["left\nlamp", "right\nlamp"], fontsize=8)
    axes.invert_yaxis()
    axes.figure.colorbar(mesh, ax=axes, label="level", pad=0.01)


MAX_SEQUENCES = 12
"""Sequences with a section of their own; each takes about half a megabyte."""

PICTURE_WIDTH_PX = 960
PICTURE_QUALITY = 80

MAX_EVENTS = 50
"""Of the faults of a live run."""

MODE_WORDS = {"full": "full high beam", "glare_free": "glare-free high beam", "low": "low beam"}


@dataclass(frozen=True, slots=True)
class KeyMoment:
    """A frame worth looking at.

    Attributes:
        time_s: From the first frame of its sequence.
    """

    words: str
    time_s: float
    result: FrameResult


def write_report(folder: Path, path: Path | None = None) -> Path:
    """Writes the report on the run in `folder` to `path`, by default `report.html` in it, and returns that path.

    Raises:
        FileNotFoundError: If that is no folder of a run.
        ValueError: If one of its files is broken, or the name of the report ends as that of another kind of file.
        OSError: If the report cannot be written.
        ModuleNotFoundError: If matplotlib is not installed.
    """
    path = path or folder / "report.html"
    if path.suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"{path}: expected a report whose name ends with .html or .htm")
    run = read_run(folder)
    write_atomic(path, _page(run).html().encode())
    return path


def key_moments(results: Sequence[FrameResult]) -> tuple[KeyMoment, ...]:
    """First light, first confirmed track, first gap and the slowest frame of a sequence, as far as there are any."""
    tests = {
        "first light artifact": lambda result: result.detections is not None and result.detections.is_accepted.any(),
        "first confirmed track": lambda result: (
            result.tracks is not None and (result.tracks.states == TrackState.CONFIRMED).any()
        ),
        "first dark gap": lambda result: result.beam is not None and len(result.beam.gaps_rad) > 0,
    }
    found = [(words, next(filter(test, results), None)) for words, test in tests.items()]
    timed = [result for result in results if result.stage_ms]
    if timed:
        slowest = max(timed, key=lambda result: sum(result.stage_ms.values()))
        found.append((f"slowest frame, {sum(slowest.stage_ms.values()):.1f} ms", slowest))
    begin_ns = results[0].timestamp_ns
    return tuple(
        KeyMoment(words, (result.timestamp_ns - begin_ns) / 1e9, result)
        for words, result in found
        if result is not None
    )


def _page(run: RecordedRun) -> Page:
    page = Page(f"Run of {run.summary.source}")
    if not run.summary.is_complete:
        page.text("Incomplete: the run was interrupted, or was made from one that was.")
    page.table(_facts(run))
    page.section("Faults")
    _add_faults(page, run)
    _add_sequences(page, run)
    page.section("Run-time")
    names = ("median", "p95", "p99")
    rows = [[stage, *(number(ms.get(name), 3) for name in names)] for stage, ms in run.summary.run_time_ms.items()]
    page.table(Table(["stage", *(f"{name}, ms" for name in names)], rows))
    timed = [result for results in run.sequences.values() for result in results if result.stage_ms]
    if timed:
        words = "Run-times of all frames: median, quartiles, and whiskers from 5 % to 95 %."
        page.figure(Figure(stage_figure(timed), words))
    page.section("Configuration")
    page.listing(config_to_toml(run.config), "all of it")
    return page


def _facts(run: RecordedRun) -> Table:
    summary = run.summary
    made_with = f"Foreglow {summary.version}"
    if summary.commit is not None:
        made_with += f", commit {summary.commit}{' with local changes' if summary.has_local_changes else ''}"
    rows: list[list[object]] = [
        ["source", summary.source],
        ["made with", made_with],
        ["processor", summary.processor],
        ["frames", f"{summary.num_frames}{'' if summary.is_complete else ', incomplete'}"],
        ["sequences", len(run.sequences)],
        ["skipped as unreadable", summary.num_skipped],
        ["proposals", summary.num_proposals],
        ["light artifacts", DASH if summary.num_accepted is None else summary.num_accepted],
        ["plausible tracks", DASH if summary.num_tracks is None else summary.num_tracks],
    ]
    if summary.beam is not None:
        counts = [f"{getattr(summary.beam, f'num_{mode}')} {words}" for mode, words in MODE_WORDS.items()]
        rows.append(["frames with", ", ".join(counts)])
    if summary.live is not None:
        rows.append(["dropped for a newer frame", summary.live.num_dropped])
        rows.append(["later than a frame's time", summary.live.num_late])
    return Table(["", ""], rows)


def _add_faults(page: Page, run: RecordedRun) -> None:
    """Why there was low beam, by frames, and the events of a live run."""
    results = [result for results in run.sequences.values() for result in results]
    commands = [result.beam for result in results if result.beam is not None]
    counts = Counter(fault for command in commands for fault in command.faults)
    events = () if run.summary.live is None else run.summary.live.faults
    if not counts and not events:
        page.text("None." if commands else "None were looked for: the run commanded no beam.")
    if counts:
        rows = [[_words(fault), count, f"{count / len(commands):.1%}"] for fault, count in counts.most_common()]
        page.table(Table(["low beam because of", "frames", "share"], rows))
    if events:
        begin_ns = min((result.timestamp_ns for result in results), default=events[0].from_ns)
        rows = [
            [
                _words(event.fault),
                f"{(event.from_ns - begin_ns) / 1e9:.2f}",
                DASH if event.until_ns is None else f"{(event.until_ns - event.from_ns) / 1e9:.2f}",
                event.detail,
            ]
            for event in events[:MAX_EVENTS]
        ]
        page.table(Table(["fault", "at, s", "for, s", "what is known"], rows))
        if len(events) > MAX_EVENTS:
            page.text(f"{len(events) - MAX_EVENTS} later ones are left out; they are in summary.json.")


def _words(fault: str) -> str:
    return fault.replace("_", " ")


def _add_sequences(page: Page, run: RecordedRun) -> None:
    """What happened over time in the first sequences, with a picture of each key moment."""
    shown = dict(list(run.sequences.items())[:MAX_SEQUENCES])
    moments = {name: key_moments(results) for name, results in shown.items()}
    frames, reason = _frames(run, [moment.result for of_sequence in moments.values() for moment in of_sequence])
    num_columns = read_headlamps(run.config.beam.headlamps).num_columns
    for name, results in shown.items():
        page.section(f"Sequence {name}" if name else "Over time")
        page.figure(Figure(sequence_figure(results, num_columns), _figure_words(results)))
        page.pictures(
            Figure(
                _picture(frames[moment.result.frame], moment.result),
                f"{moment.time_s:.2f} s, frame {moment.result.frame}: {moment.words}",
            )
            for moment in moments[name]
            if moment.result.frame in frames
        )
    if reason:
        page.text(f"There are no pictures: {reason}")
    if len(run.sequences) > len(shown):
        left_out = ", ".join(list(run.sequences)[len(shown) :])
        page.text(f"Left out after the first {len(shown)} sequences: {left_out}.")


def _picture(frame: Frame, result: FrameResult) -> bytes:
    return jpeg(annotate(frame, result, Tone.of(frame.image)), PICTURE_WIDTH_PX, PICTURE_QUALITY)


def _figure_words(results: Sequence[FrameResult]) -> str:
    words = f"{len(results)} frames."
    if any(result.tracks is not None for result in results):
        words += " Plausible tracks, pale while nothing of them is detected; their ranges, filtered, and confidences."
    if any(result.beam is not None for result in results):
        words += " The beam's mode and dark gaps; the LEDs, each column's mean level, as the driver sees them."
    return words


def _frames(run: RecordedRun, results: Sequence[FrameResult]) -> tuple[Mapping[int, Frame], str]:
    """The images of `results` by their numbers, or why there are none."""
    try:
        return read_frames(run, results), ""
    except FileNotFoundError:
        return {}, f"the frames are no longer at {run.summary.source}."
    except (ValueError, OSError) as error:
        return {}, f"{error}."
