"""The report on a run: one HTML page with everything in it, made from the run's folder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from foreglow.config import config_to_toml
from foreglow.display.overlay import annotate
from foreglow.display.tone import Tone
from foreglow.lab.reports.figures import jpeg
from foreglow.lab.reports.page import DASH, Figure, Page, Table, number
from foreglow.lab.reports.run_figures import sequence_figure, stage_figure
from foreglow.photometry import read_headlamps
from foreglow.runs.recorded_run import RecordedRun, read_frames, read_run
from foreglow.runs.tally import NUM_TIMES
from foreglow.types import Frame, FrameResult, TrackState
from foreglow.whole_files import write_atomic

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
    """First light, first confirmed track, first gap and the slowest frame of a sequence, as far as there are any.

    A frame that is several of them is there once.
    """
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
    words_of = {id(result): "; ".join(each for each, other in found if other is result) for _, result in found}
    return tuple(
        KeyMoment(words_of.pop(id(result)), (result.timestamp_ns - begin_ns) / 1e9, result)
        for _, result in found
        if result is not None and id(result) in words_of
    )


def _page(run: RecordedRun) -> Page:
    page = Page(f"Run of {run.summary.source}")
    if not run.summary.is_complete:
        page.text("Incomplete: the run was interrupted, or was made from a run or a recording that was.")
    page.table(_facts(run))
    page.section("Faults")
    _add_faults(page, run)
    _add_sequences(page, run)
    page.section("Run-time")
    if run.summary.num_frames > NUM_TIMES:
        page.text(f"The table is of the latest {NUM_TIMES} frames.")
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
    if summary.source_lack is not None:
        rows.append(["what the source lacks", summary.source_lack])
    if summary.num_damaged:
        rows.append(["damaged frames, marked", summary.num_damaged])
    if summary.num_lost_parts:
        rows.append(["lost parts of the source, of any number of frames", summary.num_lost_parts])
    if summary.beam is not None:
        counts = [f"{getattr(summary.beam, f'num_{mode}')} {words}" for mode, words in MODE_WORDS.items()]
        rows.append(["frames with", ", ".join(counts)])
    if summary.live is not None:
        rows.append(["dropped for a newer frame", summary.live.num_dropped])
        rows.append(["later than a frame's time", summary.live.num_late])
        if summary.live.num_unrecorded:
            rows.append(["results that were not recorded", summary.live.num_unrecorded])
        if summary.live.sink_errors:
            rows.append(["not recorded", "; ".join(summary.live.sink_errors)])
    return Table(["", ""], rows)


def _add_faults(page: Page, run: RecordedRun) -> None:
    """Why there was low beam, by frames, and the events of a live run."""
    results = [result for results in run.sequences.values() for result in results]
    commands = [result.beam for result in results if result.beam is not None]
    counts = Counter(fault for command in commands for fault in command.faults)
    live = run.summary.live
    events = () if live is None else live.faults
    if not counts and not events:
        page.text("None." if commands else "None were looked for: the run commanded no beam.")
    if counts:
        rows = [[_words(fault), count, f"{count / len(commands):.1%}"] for fault, count in counts.most_common()]
        page.table(Table(["low beam because of", "frames", "share"], rows))
    if events:
        begin_ns = min((result.timestamp_ns for result in results), default=events[0].from_ns)
        if len(run.sequences) > 1:
            begin_ns = 0
            page.text("Times of faults are by the frames' clock, which may begin anew with each sequence.")
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
        num_forgotten = 0 if live is None else sum(live.fault_counts.values()) - len(events)
        if num_forgotten > 0:
            page.text(f"{num_forgotten} earlier ones are left out: a live run keeps the latest {len(events)}.")


def _words(fault: str) -> str:
    return fault.replace("_", " ")


def _add_sequences(page: Page, run: RecordedRun) -> None:
    """What happened over time in the first sequences, with a picture of each key moment."""
    shown = dict(list(run.sequences.items())[:MAX_SEQUENCES])
    moments = {name: key_moments(results) for name, results in shown.items()}
    frames, reason = _frames(run, [moment.result for of_sequence in moments.values() for moment in of_sequence])
    num_columns, why_no_leds = _num_columns(run)
    for name, results in shown.items():
        page.section(f"Sequence {name}" if name else "Over time")
        page.figure(
            Figure(sequence_figure(results, num_columns), _figure_words(results, has_leds=num_columns is not None))
        )
        page.pictures(
            Figure(
                _picture(frames[moment.result.frame], moment.result),
                f"{moment.time_s:.2f} s, frame {moment.result.frame}: {moment.words}",
            )
            for moment in moments[name]
            if moment.result.frame in frames
        )
    if why_no_leds:
        page.text(f"The LEDs are not drawn: {why_no_leds}.")
    if reason:
        page.text(f"There are no pictures: {reason}")
    if len(run.sequences) > len(shown):
        left_out = ", ".join(list(run.sequences)[len(shown) :])
        page.text(f"Left out after the first {len(shown)} sequences: {left_out}.")


def _picture(frame: Frame, result: FrameResult) -> bytes:
    return jpeg(annotate(frame, result, Tone.of(frame.image)), PICTURE_WIDTH_PX, PICTURE_QUALITY)


def _num_columns(run: RecordedRun) -> tuple[int | None, str]:
    """LEDs in a row of a lamp of the run, or why that is not known; neither where it commanded no beam."""
    commands = (result.beam for results in run.sequences.values() for result in results)
    nums_leds = {command.levels.shape[1] for command in commands if command is not None}
    if not nums_leds:
        return None, ""
    try:
        headlamps = read_headlamps(run.config.beam.headlamps)
    except (ValueError, OSError) as error:
        return None, _said(error)
    if nums_leds != {headlamps.num_leds}:
        found = ", ".join(map(str, sorted(nums_leds)))
        path = run.config.beam.headlamps or run.folder / "config.toml"
        return None, f"{path}: expected lamps of {found} LEDs, as the run's, got {headlamps.num_leds}"
    return headlamps.num_columns, ""


def _said(error: Exception) -> str:
    """An error in words, with the path that an error of the system has for itself."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return f"{error}"


def _figure_words(results: Sequence[FrameResult], *, has_leds: bool) -> str:
    words = f"{len(results)} frames."
    if any(result.tracks is not None for result in results):
        words += " Plausible tracks, pale while nothing of them is detected; their ranges, filtered, and confidences."
    if any(result.beam is not None for result in results):
        words += " The beam's mode and dark gaps, blank where no frame says for long what the lamps got."
    if has_leds:
        words += " The LEDs, each column's mean level, as the driver sees them."
    return words


def _frames(run: RecordedRun, results: Sequence[FrameResult]) -> tuple[Mapping[int, Frame], str]:
    """The images of `results` by their numbers, or why there are none."""
    try:
        return read_frames(run, results), ""
    except FileNotFoundError:
        return {}, f"the frames are no longer at {run.summary.source}."
    except (ValueError, OSError) as error:
        return {}, f"{_said(error)}."
