"""A whole run, read back from the folder that it wrote: summary, configuration, and every frame's result.

Its results become tables with a row a frame, a box or a track, for pandas, Parquet and COCO.
"""

from __future__ import annotations

import dataclasses
import json
import warnings
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from foreglow.config import PipelineConfig, read_config
from foreglow.datasets import FrameSource, LabelledSource, open_source
from foreglow.datasets.exchange import is_labels
from foreglow.datasets.source import also_left_out
from foreglow.files import checked_path
from foreglow.outputs import check_kinds, check_outputs, exists
from foreglow.own_files import COCO_RESULTS, TABLE, FileKind
from foreglow.runs.frame_line import FrameLine
from foreglow.runs.frames_file import line_to_result, read_frame_lines
from foreglow.runs.json_lines import no_run_file
from foreglow.runs.origin import origin_digest
from foreglow.runs.summary_file import SummaryFile, lack_of_run, read_summary
from foreglow.runs.times_file import read_stage_times
from foreglow.types import BeamMode, Frame, FrameResult, TrackState
from foreglow.whole_files import atomic_path, write_atomic
from foreglow.wording import check_one_of

if TYPE_CHECKING:
    import pandas as pd

TableName: TypeAlias = Literal["frames", "boxes", "tracks"]

COCO_LIGHT = 2
"""Id of the category `light` in the files that `foreglow labels export` writes."""

Row: TypeAlias = dict[str, Any]
Results: TypeAlias = Mapping[str, tuple[FrameResult, ...]]
"""As `RecordedRun.sequences`."""


def columns_of(sequences: Results, table: TableName) -> Mapping[str, list[Any]]:
    """The columns of a table by name, all of the same length.

    Raises:
        ValueError: If there is no such table.
    """
    rows_of = {"frames": _frame_rows, "boxes": _box_rows, "tracks": _track_rows}
    check_one_of(table, rows_of, "table")
    rows = [
        {"sequence": sequence, "frame": result.frame, "time_s": result.timestamp_ns / 1e9, **row}
        for sequence, results in sequences.items()
        for result in results
        for row in rows_of[table](result)
    ]
    return {name: [row[name] for row in rows] for name in (rows[0] if rows else ("sequence", "frame", "time_s"))}


def _frame_rows(result: FrameResult) -> Iterator[Row]:
    detections, tracks = result.detections, result.tracks
    yield {
        "num_proposals": len(result.proposals),
        "num_accepted": None if detections is None else int(detections.is_accepted.sum()),
        "num_tracks": None if tracks is None else int(tracks.is_plausible.sum()),
        "mode": None if result.beam is None else result.beam.mode.name.lower(),
        "time_ms": sum(result.stage_ms.values()) if result.stage_ms else np.nan,
    }


def _box_rows(result: FrameResult) -> Iterator[Row]:
    detections, ranges = result.detections, result.ranges
    kinds = None if detections is None else detections.kind_names
    for index, box in enumerate(result.proposals.boxes_xyxy_px.tolist()):
        yield {
            **_edges(box),
            "score": np.nan if detections is None else float(detections.scores[index]),
            "is_accepted": None if detections is None else bool(detections.is_accepted[index]),
            "kind": None if kinds is None else kinds[index],
            "direct": np.nan if detections is None else float(detections.direct_probabilities[index]),
            "range_m": np.nan if ranges is None else float(ranges.ranges_m[index]),
            "sigma_m": np.inf if ranges is None else float(ranges.sigmas_m[index]),
        }


def _track_rows(result: FrameResult) -> Iterator[Row]:
    tracks = result.tracks
    if tracks is None:
        return
    for index, box in enumerate(tracks.boxes_xyxy_px.tolist()):
        yield {
            "track": int(tracks.ids[index]),
            "state": TrackState(tracks.states[index]).name.lower(),
            **_edges(box),
            "confidence": float(tracks.confidences[index]),
            "direct": float(tracks.direct_probabilities[index]),
            "age_s": float(tracks.ages_s[index]),
            "range_m": float(tracks.ranges_m[index]),
            "sigma_m": float(tracks.sigmas_m[index]),
        }


def _edges(box: list[float]) -> Row:
    return dict(zip(("x1_px", "y1_px", "x2_px", "y2_px"), box, strict=True))


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class RecordedRun:
    """A run as its folder has it.

    Attributes:
        folder: The folder.
        summary: What the run did.
        config: The configuration that it used.
        sequences: By name, in the order of the run, the results of a sequence's frames.
    """

    folder: Path
    summary: SummaryFile
    config: PipelineConfig
    sequences: Mapping[str, tuple[FrameResult, ...]]

    def to_pandas(self, table: TableName = "boxes") -> pd.DataFrame:
        """A table of the results: a row for every frame, box or track of a frame.

        Raises:
            ModuleNotFoundError: If pandas is not installed (extra `pandas`).
            ValueError: If there is no such table.
        """
        columns = columns_of(self.sequences, table)
        try:
            import pandas as pd
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(
                "pandas is not installed: pip install 'foreglow[pandas]'", name=error.name
            ) from None
        return pd.DataFrame(columns)

    def write_parquet(self, path: Path | str, table: TableName = "boxes") -> None:
        """Writes a table of the results as Parquet, whole or not at all.

        Raises:
            ModuleNotFoundError: If pyarrow is not installed (extra `parquet`).
            ValueError: If there is no such table, or the file is a part of the run or its source, or of another kind.
            OSError: If the file cannot be written.
        """
        columns = columns_of(self.sequences, table)
        path = checked_path(path)
        self._check_output(path, TABLE)
        try:
            import pyarrow as pa
            import pyarrow.parquet as pq
        except ModuleNotFoundError as error:
            words = "pyarrow is not installed: pip install 'foreglow[parquet]'"
            raise ModuleNotFoundError(words, name=error.name) from None
        with atomic_path(path) as temporary:
            pq.write_table(pa.table(dict(columns)), temporary)

    def write_coco(self, path: Path | str) -> None:
        """Writes all scored boxes in the form of COCO's results; an image's id is its frame.

        Raises:
            ValueError: If the file is a part of the run or its source, or of another kind.
            OSError: If the file cannot be written.
        """
        path = checked_path(path)
        self._check_output(path, COCO_RESULTS)
        entries = [
            {"image_id": result.frame, "category_id": COCO_LIGHT, "bbox": [x1, y1, x2 - x1, y2 - y1], "score": score}
            for results in self.sequences.values()
            for result in results
            if result.detections is not None
            for (x1, y1, x2, y2), score in zip(
                result.detections.boxes_xyxy_px.tolist(), result.detections.scores.tolist(), strict=True
            )
        ]
        write_atomic(path, (json.dumps(entries) + "\n").encode())

    def _check_output(self, path: Path, kind: FileKind) -> None:
        """ValueError if the file is a part of the run or of its source, or one of another kind."""
        sources = {"the source of the run": Path(self.summary.source)}
        check_outputs(sources, {"path": path}, {})
        check_kinds({"path": path}, {"path": kind})


def read_run(folder: Path | str) -> RecordedRun:
    """The run that was written to `folder`; of one that was interrupted a warning says so.

    Raises:
        FileNotFoundError: If one of its files is missing.
        ValueError: If one is broken; the message names path, line and field.
    """
    folder = checked_path(folder, "folder")
    frames = folder / "frames.jsonl"
    if not frames.is_file():
        raise no_run_file(frames, "the folder of a run")
    summary = read_summary(folder / "summary.json")
    config = read_config(folder / "config.toml")
    times = read_stage_times(folder / "times.jsonl")

    def convert(line: FrameLine) -> tuple[str, FrameResult]:
        result = line_to_result(line, config.classifier.score_threshold)
        return line.get("sequence", ""), dataclasses.replace(result, stage_ms=times.get(result.frame, {}))

    sequences: dict[str, list[FrameResult]] = {}
    lines = read_frame_lines(frames, convert)
    check_frames(folder, summary, [result for _, result in lines.values()])
    lack = lack_of_run(folder)
    if lack is not None:
        warnings.warn(lack, stacklevel=2)
    for name, result in lines.values():
        sequences.setdefault(name, []).append(result)
    return RecordedRun(folder, summary, config, {name: tuple(results) for name, results in sequences.items()})


def check_frames(folder: Path, summary: SummaryFile, results: Collection[FrameResult]) -> None:
    """Checks that the frames which were read from a run's folder are those that its summary counts.

    It is for folders of earlier versions, whose summary has no digest of the frames.

    Raises:
        ValueError: If they are not.
    """
    if summary.live is not None:  # a live run may lose some
        return
    detections = [result.detections for result in results if result.detections is not None]
    modes = Counter(result.beam.mode for result in results if result.beam is not None)
    counts = {
        "frames": (summary.num_frames, len(results)),
        "proposals": (summary.num_proposals, sum(len(result.proposals) for result in results)),
        "accepted boxes": (summary.num_accepted, sum(int(each.is_accepted.sum()) for each in detections)),
        "frames with low beam": (0 if summary.beam is None else summary.beam.num_low, modes[BeamMode.LOW]),
        "frames with full beam": (0 if summary.beam is None else summary.beam.num_full, modes[BeamMode.FULL]),
    }
    for what, (wanted, found) in counts.items():
        if wanted not in (None, found):
            path = folder / "frames.jsonl"
            raise ValueError(f"{path}: expected the {wanted} {what} of summary.json, got {found}")


def read_frames(run: RecordedRun, results: Iterable[FrameResult]) -> Mapping[int, Frame]:
    """By number, the frames from which the run made these results.

    Raises:
        FileNotFoundError: If the frames are no longer where they were.
        ValueError: If they cannot be read, or other frames are there now.
    """
    wanted = {result.frame: result.timestamp_ns for result in results}
    source = open_run(run.folder)
    frames: dict[int, Frame] = {}
    if isinstance(source, LabelledSource):
        frames = {number: source.read(number) for number in sorted(wanted)}
    else:
        for frame in source:
            if frame.frame in wanted:
                frames[frame.frame] = frame
            if len(frames) == len(wanted):
                break
    if {number: frame.timestamp_ns for number, frame in frames.items()} != wanted:
        reason = also_left_out(source.skipped, run.summary.skipped)
        raise ValueError(f"{run.summary.source}: expected the frames of the run, there are others now{reason}")
    return frames


def doubt_about_source(run: Path, source: Path) -> str | None:
    """A line if nothing tells whether the run in `run` was made from `source`, and it has another name; else None.

    Raises:
        FileNotFoundError: If the run has no summary.
        ValueError: If its summary is broken, or it was made from something else than what is at `source`.
    """
    summary = read_summary(run / "summary.json")
    digests = origin_digest(source), summary.source_digest
    if None not in digests:
        if digests[0] != digests[1]:
            raise ValueError(f"{source}: expected what {run} was made from, {summary.source}, got something else")
        return None
    named, known = source.absolute(), Path(summary.source)
    is_named_so = named == known if is_labels(source) else named.name == known.name  # many are called labels.xml
    return None if is_named_so else f"{source}: taken for what {run} was made from, which was {summary.source}"


def check_suggestions_of(run: Path, suggestions: Path) -> None:
    """Checks that a file of suggestions does not lie in the folder of a run on something else than that of `run`.

    Raises:
        FileNotFoundError: If the run has no summary.
        ValueError: If it does, or a summary is broken.
    """
    home = suggestions.resolve().parent
    if home == run.resolve() or not (home / "summary.json").is_file() or not (home / "frames.jsonl").is_file():
        return
    ours, other = (read_summary(folder / "summary.json") for folder in (run, home))
    if other.source_digest is None or other.source_digest != ours.source_digest:
        raise ValueError(f"{suggestions}: expected frames of {run}, got those of another run, on {other.source}")


def open_run(run: Path, place: Path | None = None) -> FrameSource:
    """The frames of the run in the folder `run`, on its topic; damaged ones are marked, or left out.

    Args:
        run: The folder.
        place: Where the frames are; None for where the run found them.

    Raises:
        FileNotFoundError: As `source_of_run`.
        ValueError: As `source_of_run`, or if they cannot be read.
    """
    summary = run / "summary.json"
    topic = read_summary(summary).topic if summary.is_file() else None
    return open_source(place or source_of_run(run), on_error="mark", topic=topic)


def source_of_run(run: Path) -> Path:
    """Where the frames of the run in the folder `run` are, by its `summary.json`.

    Raises:
        FileNotFoundError: If it has no summary, or the frames are no longer where they were.
        ValueError: If the summary is broken, or another file or other images are there now.
    """
    path = run / "summary.json"
    summary = read_summary(path)
    source = Path(summary.source)
    if not exists(source):
        raise FileNotFoundError(
            f"{path}: source: expected the run's frames, there is nothing at {source}; where they are elsewhere now, "
            f"give them in place of {run}, with --config {run / 'config.toml'}"
        )
    if summary.source_digest is not None and origin_digest(source) != summary.source_digest:
        raise ValueError(
            f"{path}: source: expected the run's frames at {source}, what is there is not what the run was made from"
        )
    return source
