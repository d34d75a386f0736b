"""The report on a run: one HTML page with everything in it, made from the run's folder."""

from __future__ import annotations

import html
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from foreglow.config import config_to_toml
from foreglow.display.overlay import annotate
from foreglow.display.tone import Tone
from foreglow.files import write_atomic
from foreglow.lab.reports.html import STYLE, html_figure, html_table
from foreglow.lab.reports.numbers import DASH, number
from foreglow.lab.reports.run_plots import sequence_figure, stage_figure
from foreglow.lab.studies.detector.tables import Table
from foreglow.photometry import read_headlamps
from foreglow.runs.recorded_run import RecordedRun, read_frames, read_run
from foreglow.types import Frame, FrameResult, TrackState

MAX_SEQUENCES = 12
"""So many sequences have a section; each takes about half a megabyte."""

PICTURE_WIDTH_PX = 960
PICTURE_QUALITY = 80

MAX_EVENTS = 50
"""Of the faults of a live run."""


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
    write_atomic(path, "\n".join(_lines(run)).encode())
    return path


def key_moments(results: Sequence[FrameResult]) -> tuple[KeyMoment, ...]:
    """First light, first confirmed track, first gap and the slowest frame of a sequence, as far as there are any."""
    tests = {
        "first light artifact": lambda one: one.detections is not None and one.detections.is_accepted.any(),
        "first confirmed track": lambda one: (
            one.tracks is not None and (one.tracks.states == TrackState.CONFIRMED).any()
        ),
        "first dark gap": lambda one: one.beam is not None and len(one.beam.gaps_rad) > 0,
    }
    found = [(words, next(filter(test, results), None)) for words, test in tests.items()]
    timed = [one for one in results if one.stage_ms]
    if timed:
        slowest = max(timed, key=lambda one: sum(one.stage_ms.values()))
        found.append((f"slowest frame, {sum(slowest.stage_ms.values()):.1f} ms", slowest))
    begin_ns = results[0].timestamp_ns
    return tuple(KeyMoment(words, (one.timestamp_ns - begin_ns) / 1e9, one) for words, one in found if one is not None)


def _lines(run: RecordedRun) -> Iterator[str]:
    summary = run.summary
    title = html.escape(f"Run of {summary.source}")
    yield f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
    yield f"<style>{STYLE}</style></head><body><h1>{title}</h1>"
    yield from html_table(_facts(run))
    yield "<h2>Faults</h2>"
    yield from _fault_lines(run)
    shown = dict(list(run.sequences.items())[:MAX_SEQUENCES])
    moments = {name: key_moments(results) for name, results in shown.items()}
    frames, reason = _frames(run, moments)
    num_columns = read_headlamps(run.config.beam.headlamps).num_columns
    for name, results in shown.items():
        yield f"<h2>{html.escape(f'Sequence {name}' if name else 'Over time')}</h2>"
        figure = sequence_figure(results, num_columns)
        yield html_figure(figure, _figure_words(results))
        yield from _pictures(moments[name], frames)
    if reason:
        yield f"<p>There are no pictures: {html.escape(reason)}</p>"
    if len(run.sequences) > len(shown):
        left_out = ", ".join(list(run.sequences)[len(shown) :])
        yield f"<p>Left out after the first {len(shown)} sequences: {html.escape(left_out)}.</p>"
    yield "<h2>Run-time</h2>"
    yield from html_table(_time_table(run))
    timed = [one for its in run.sequences.values() for one in its if one.stage_ms]
    if timed:
        words = "Run-times of all frames: median, quartiles, and whiskers from 5 % to 95 %."
        yield html_figure(stage_figure(timed), words)
    yield "<h2>Configuration</h2>"
    yield f"<details><summary>all of it</summary><pre>{html.escape(config_to_toml(run.config))}</pre></details>"
    yield "</body></html>"


def _facts(run: RecordedRun) -> Table:
    """What was run, and what came of it."""
    summary = run.summary
    made_with = f"Foreglow {summary.version}"
    if summary.commit is not None:
        made_with += f", commit {summary.commit}{' with local changes' if summary.has_local_changes else ''}"
    rows = [
        ["source", summary.source],
        ["made with", made_with],
        ["processor", summary.processor],
        ["frames", f"{summary.num_frames}{'' if summary.is_complete else ', interrupted'}"],
        ["sequences", str(len(run.sequences))],
        ["unreadable frames skipped", str(summary.num_skipped)],
        ["proposals", str(summary.num_proposals)],
        ["light artifacts", _count(summary.num_accepted)],
        ["plausible tracks", _count(summary.num_tracks)],
    ]
    if summary.beam is not None:
        counts = [f"{getattr(summary.beam, f'num_{mode}')} {words}" for mode, words in _MODE_WORDS.items()]
        rows.append(["frames with", ", ".join(counts)])
    if summary.live is not None:
        rows.append(["dropped for a newer frame", str(summary.live.num_dropped)])
        rows.append(["later than a frame's time", str(summary.live.num_late)])
    return Table(["", ""], rows, [""] * len(rows))


_MODE_WORDS = {"full": "full high beam", "glare_free": "glare-free high beam", "low": "low beam"}


def _fault_lines(run: RecordedRun) -> Iterator[str]:
    """Why there was low beam, by frames, and the events of a live run."""
    results = [one for its in run.sequences.values() for one in its]
    commands = [one.beam for one in results if one.beam is not None]
    counts = Counter(fault for command in commands for fault in command.faults)
    live = run.summary.live
    if not counts and (live is None or not live.faults):
        yield "<p>None.</p>" if commands else "<p>None were looked for: the run commanded no beam.</p>"
        return
    if counts:
        rows = [[_words(fault), str(count), f"{count / len(commands):.1%}"] for fault, count in counts.most_common()]
        yield from html_table(Table(["low beam because of", "frames", "share"], rows, [""] * len(rows)))
    if live is not None and live.faults:
        begin_ns = min((one.timestamp_ns for one in results), default=live.faults[0].from_ns)
        rows = [
            [
                _words(event.fault),
                f"{(event.from_ns - begin_ns) / 1e9:.2f}",
                DASH if event.until_ns is None else f"{(event.until_ns - event.from_ns) / 1e9:.2f}",
                event.detail,
            ]
            for event in live.faults[:MAX_EVENTS]
        ]
        yield from html_table(Table(["fault", "at, s", "for, s", "what is known"], rows, [""] * len(rows)))
        if len(live.faults) > MAX_EVENTS:
            yield f"<p>{len(live.faults) - MAX_EVENTS} later ones are left out; all are in summary.json.</p>"


def _words(fault: str) -> str:
    return fault.replace("_", " ")


def _count(count: int | None) -> str:
    return DASH if count is None else str(count)


def _figure_words(results: Sequence[FrameResult]) -> str:
    """What the figure of a sequence shows."""
    words = f"{len(results)} frames."
    if any(one.tracks is not None for one in results):
        words += " Plausible tracks, pale while nothing of them is detected; their ranges, filtered, and confidences."
    if any(one.beam is not None for one in results):
        words += " The beam's mode and dark gaps; the LEDs, each column's mean level, as the driver sees them."
    return words


def _frames(run: RecordedRun, moments: Mapping[str, Sequence[KeyMoment]]) -> tuple[Mapping[int, Frame], str]:
    """The images of the moments by their numbers, or why there are none."""
    wanted = [moment.result for its in moments.values() for moment in its]
    try:
        return read_frames(run, wanted), ""
    except FileNotFoundError:
        return {}, f"the frames are no longer at {run.summary.source}."
    except (ValueError, OSError) as error:
        return {}, f"{error}."


def _pictures(moments: Iterable[KeyMoment], frames: Mapping[int, Frame]) -> Iterator[str]:
    """The moments' annotated pictures."""
    shown = [moment for moment in moments if moment.result.frame in frames]
    if not shown:
        return
    yield '<div class="pictures">'
    for moment in shown:
        words = f"{moment.time_s:.2f} s, frame {moment.result.frame}: {moment.words}"
        yield html_figure(_picture(frames[moment.result.frame], moment.result), words, "jpeg")
    yield "</div>"


def _picture(frame: Frame, result: FrameResult) -> bytes:
    """The annotated frame as JPEG, no wider than `PICTURE_WIDTH_PX`."""
    picture = annotate(frame, result, Tone.of(frame.image))
    scale = min(1.0, PICTURE_WIDTH_PX / picture.shape[1])
    small = np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)
    return cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, PICTURE_QUALITY])[1].tobytes()


def _time_table(run: RecordedRun) -> Table:
    names = ("median", "p95", "p99")
    rows = [[stage, *(number(its.get(name), 3) for name in names)] for stage, its in run.summary.run_time_ms.items()]
    return Table(["stage", *(f"{name}, ms" for name in names)], rows, [""] * len(rows))
