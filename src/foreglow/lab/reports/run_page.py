"""The report on a run: one HTML page with everything in it, made from the run's folder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from foreglow.config import config_to_toml
from foreglow.display.overlay import annotate
from foreglow.display.tone import Tone
from foreglow.files import write_atomic
from foreglow.lab.reports.figures import jpeg
from foreglow.lab.reports.numbers import DASH, number
from foreglow.lab.reports.page import Figure, Page, Table
from foreglow.lab.reports.run_plots import sequence_figure, stage_figure
from foreglow.photometry import read_headlamps
from foreglow.runs.recorded_run import RecordedRun, read_frames, read_run
from foreglow.types import Frame, FrameResult, TrackState

MAX_SEQUENCES = 12
"""Sequences with a section of their own; each takes about half a megabyte."""

PICTURE_WIDTH_PX = 960
PICTURE_QUALITY = 80

MAX_EVENTS = 50
"""Of the faults of a live run."""

MODES = {"full": "full high beam", "glare_free": "glare-free high beam", "low": "low beam"}


@dataclass(frozen=True, slots=True)
class KeyMoment:
    """A frame worth looking at.

    Attributes:
        words: Why.
        time_s: From the first frame of its sequence.
        result: Its result.
    """

    words: str
    time_s: float
    result: FrameResult


def write_report(folder: Path, path: Path | None = None) -> Path:
    """Writes the report on the run in `folder` to `path`, by default `report.html` in it, and returns that path.

    Raises:
        FileNotFoundError: If that is no folder of a run.
        ValueError: If one of its files is broken.
        OSError: If the report cannot be written.
        ModuleNotFoundError: If matplotlib is not installed.
    """
    run = read_run(folder)
    path = path or folder / "report.html"
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
    """What was run, and what came of it."""
    summary = run.summary
    made_with = f"Foreglow {summary.version}"
    if summary.commit is not None:
        made_with += f", commit {summary.commit}{' with local changes' if summary.has_local_changes else ''}"
    rows: list[list[object]] = [
        ["source", summary.source],
        ["made with", made_with],
        ["processor", summary.processor],
        ["frames", f"{summary.num_frames}{'' if summary.is_complete else ', interrupted'}"],
        ["sequences", len(run.sequences)],
        ["unreadable frames skipped", summary.num_skipped],
        ["proposals", summary.num_proposals],
        ["light artifacts", DASH if summary.num_accepted is None else summary.num_accepted],
        ["plausible tracks", DASH if summary.num_tracks is None else summary.num_tracks],
    ]
    if summary.beam is not None:
        counts = [f"{getattr(summary.beam, f'num_{mode}')} {words}" for mode, words in MODES.items()]
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
            page.text(f"{len(events) - MAX_EVENTS} later ones are left out; all are in summary.json.")


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
                jpeg(_annotated(frames[moment.result.frame], moment.result), PICTURE_WIDTH_PX, PICTURE_QUALITY),
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


def _annotated(frame: Frame, result: FrameResult) -> NDArray[np.uint8]:
    return annotate(frame, result, Tone.of(frame.image))


def _figure_words(results: Sequence[FrameResult]) -> str:
    """What the figure of a sequence shows."""
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
