"""A whole run, read back from the folder that it wrote: summary, configuration, and every frame's result."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from foreglow.config import PipelineConfig, read_config
from foreglow.datasets import LabelledSource, open_source
from foreglow.runs.frames_file import FrameLine, FrameLineModel, line_to_result
from foreglow.runs.json_lines import read_lines
from foreglow.runs.summary import SummaryFile, read_summary
from foreglow.runs.tables import TableName, to_pandas, write_coco, write_parquet
from foreglow.runs.times_file import read_stage_times
from foreglow.types import Frame, FrameResult

if TYPE_CHECKING:
    import pandas as pd


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
        return to_pandas(self.sequences, table)

    def write_parquet(self, path: Path | str, table: TableName = "boxes") -> None:
        """Writes a table of the results as Parquet, whole or not at all.

        Raises:
            ModuleNotFoundError: If pyarrow is not installed (extra `parquet`).
            ValueError: If there is no such table.
            OSError: If the file cannot be written.
        """
        write_parquet(self.sequences, Path(path), table)

    def write_coco(self, path: Path | str) -> None:
        """Writes all scored boxes in the form of COCO's results; an image's id is its frame.

        Raises:
            OSError: If the file cannot be written.
        """
        write_coco(self.sequences, Path(path))


def read_run(folder: Path | str) -> RecordedRun:
    """The run that was written to `folder`.

    Raises:
        FileNotFoundError: If one of its files is missing.
        ValueError: If one is broken; the message names path, line and field.
    """
    folder = Path(folder)
    frames = folder / "frames.jsonl"
    if not frames.is_file():
        raise FileNotFoundError(f"{frames}: no such file, expected the folder of a run")
    summary = read_summary(folder / "summary.json")
    config = read_config(folder / "config.toml")
    times = read_stage_times(folder / "times.jsonl")

    def convert(line: FrameLine) -> tuple[str, FrameResult]:
        result = line_to_result(line, config.classifier.score_threshold)
        return line.get("sequence", ""), dataclasses.replace(result, stage_ms=times.get(result.frame, {}))

    sequences: dict[str, list[FrameResult]] = {}
    for name, result in read_lines(frames, FrameLineModel, convert).values():
        sequences.setdefault(name, []).append(result)
    return RecordedRun(folder, summary, config, {name: tuple(results) for name, results in sequences.items()})


def read_frames(run: RecordedRun, results: Iterable[FrameResult]) -> Mapping[int, Frame]:
    """By number, the frames from which the run made these results.

    Raises:
        FileNotFoundError: If the frames are no longer where they were.
        ValueError: If they cannot be read, or other frames are there now.
    """
    wanted = {result.frame: result.timestamp_ns for result in results}
    source = open_source(source_of_run(run.folder), on_error="mark")
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
        raise ValueError(f"{run.summary.source}: expected the frames of the run, there are others now")
    return frames


def source_of_run(run: Path) -> Path:
    """Where the frames of the run in the folder `run` are, by its `summary.json`.

    Raises:
        FileNotFoundError: If it has no summary, or the frames are no longer where they were.
        ValueError: If the summary is broken.
    """
    path = run / "summary.json"
    source = Path(read_summary(path).source)
    if not source.exists():
        raise FileNotFoundError(
            f"{path}: source: expected the run's frames, there is nothing at {source}; where they are elsewhere now, "
            f"give them in place of {run}, with --config {run / 'config.toml'}"
        )
    return source
