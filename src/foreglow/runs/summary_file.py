"""`summary.json`: what a run did, how long it took, and on what.

The classes are the format: their fields are the keys of the file, written and read by name. A field that is added needs
a default, or the folders of earlier versions can no longer be read.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, TypeAlias

from pydantic import ConfigDict, Field, RootModel

from foreglow.datasets.json_files import read_json
from foreglow.files import fields_to_json, path_from_unicode, path_in_unicode
from foreglow.runs.json_lines import no_run_file

Count: TypeAlias = Annotated[int, Field(ge=0)]

RunTime: TypeAlias = dict[str, float | None]
"""`median`, `p95` and `p99` of one stage in milliseconds; None where no frame was run."""


class _Strict:
    """Its subclasses are read strictly: values must have the types of the fields, and NaN is refused."""

    __slots__ = ()
    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(strict=True, allow_inf_nan=False)


@dataclass(frozen=True, slots=True)
class BeamSummary(_Strict):
    """The beam commands of a run.

    Attributes:
        num_low: Frames with low beam.
        num_glare_free: Frames with high beam and dark gaps, or with LEDs that are still coming back.
        num_full: Frames with full high beam.
        mean_gap_deg: Mean width of a gap; None if there was none.
        faults: By fault that caused low beam, in how many frames it did, the most frequent first.
    """

    num_low: Count
    num_glare_free: Count
    num_full: Count
    mean_gap_deg: float | None
    faults: Mapping[str, Count]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSummary(_Strict):
    """What a run did.

    Attributes:
        source: Where the frames came from: an absolute path, or what the user gave.
        source_digest: As `origin_digest` of that path; None where there is no file, and in folders of earlier versions.
        topic: The topic of a recording that was read; None of other sources, and like the next in folders of earlier
            versions.
        on_error: What bad frames did: `stop`, `skip` or `mark`; None of sources without files.
        source_lack: What the source lacks, as it says itself or shows: a recording that was interrupted or never
            finished, or whose end is missing.
        is_complete: False if the run, the one whose results it takes, or the recording that it read was interrupted
            or lacks something; the results until then are kept.
        is_interrupted: Whether that was the run itself; false in folders of earlier versions.
        is_classified: Whether a model scored the proposals.
        model_sha256: SHA-256 of the model's file when the run began, which tells it from others at the same path; as in
            the run whose results it takes; None without a model or its file, and in folders of earlier versions.
        num_frames: Frames that were run.
        num_proposals: Boxes proposed, over all frames.
        num_scored: Boxes that the model scored; None without a model.
        num_accepted: Boxes scored above the threshold; None without a model.
        num_ranged: Scored boxes that have a range; None if nothing estimates ranges.
        num_tracks: Tracks that were plausible at some time; None without a tracker.
        num_with_camera: Frames with a calibration; None in folders of earlier versions, like the next two.
        num_with_motion: Frames with the motion of the car.
        num_with_road: Frames with the road ahead.
        num_damaged: Frames of which the source knows that they are damaged: their lines say `is_damaged`.
        calibration: Of the first frame that had one, as its file has it: the ranges were made with it. None if none
            had, and in folders of earlier versions.
        beam_calibration: That of the beam, if the ranges of the run that it takes were made with another one or none.
        beam: The beam commands; None if no beam was configured.
        num_skipped: Files that could not be read and were skipped.
        skipped: One line for each of them: its path and the reason.
        frames_sha256: SHA-256 of `frames.jsonl` as it was when the run ended, by which a later change is noticed; None
            until then, and in folders of earlier versions.
        num_lost_parts: How many of these lines are about a part of the file in which there may be any number of frames.
        frame_sizes_px: Each (width, height) that occurred, in order of the first frame that had it.
        run_time_ms: Median, p95 and p99 of every stage and of `total`, the sum of a frame's stages, in milliseconds;
            of the latest `tally.NUM_TIMES` frames.
        version: Version of Foreglow.
        commit: Commit of the checkout that Foreglow ran from; None if it was installed.
        has_local_changes: Whether that checkout differed from its commit; None if Foreglow was installed.
        processor: Name that the processor gives itself; of several machines, each name once.
        dispatch: Instruction set that the native core used; None with another back end.
        command: Command of Foreglow that wrote it; None in Python, and in folders of earlier versions.
    """

    source: str
    source_digest: str | None = None
    topic: str | None = None
    on_error: str | None = None
    source_lack: str | None = None
    is_complete: bool
    is_interrupted: bool = False
    is_classified: bool
    model_sha256: str | None = None
    num_frames: Count
    num_proposals: Count
    num_scored: Count | None
    num_accepted: Count | None
    num_ranged: Count | None
    num_tracks: Count | None
    num_with_camera: Count | None = None
    num_with_motion: Count | None = None
    num_with_road: Count | None = None
    num_damaged: Count | None = None
    calibration: Mapping[str, Mapping[str, Any]] | None = None
    beam_calibration: Mapping[str, Mapping[str, Any]] | None = None
    beam: BeamSummary | None
    num_skipped: Count
    skipped: Sequence[str]
    frame_sizes_px: Sequence[tuple[Count, Count]]
    run_time_ms: Mapping[str, RunTime]
    version: str
    commit: str | None
    has_local_changes: bool | None
    processor: str
    dispatch: str | None
    command: str | None = None
    num_lost_parts: Count = 0
    frames_sha256: str | None = None

    def to_json(self) -> dict[str, Any]:
        """The fields; a `source` that is not UTF-8 is written as a URI."""
        return fields_to_json(self) | {"source": path_in_unicode(self.source)}

    def with_frames(self, sha256: str) -> Self:
        """The same of a run whose `frames.jsonl` has this SHA-256."""
        return dataclasses.replace(self, frames_sha256=sha256)


@dataclass(slots=True)
class FaultEvent(_Strict):
    """A fault of a live run from its beginning to its end.

    Attributes:
        fault: Its name.
        from_ns: When it was noticed, by the frames' clock.
        until_ns: When it was over; None while it lasts.
        detail: Its cause, as far as it is known, for people to read.
    """

    fault: str
    from_ns: int
    until_ns: int | None = None
    detail: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class LivePart(_Strict):
    """What a live run lost and what went wrong in it.

    Attributes:
        num_dropped: Frames that were skipped because a newer one had come.
        num_late: Frames whose command came later than a frame's time after the image.
        num_out_of_order: Frames that were not used, as their times did not follow those before; 0 in folders of
            earlier versions, which did not count them.
        num_unrecorded: Results that sinks did not get, added up over all sinks.
        sink_errors: Why sinks failed.
        fault_counts: How often each fault began.
        faults: The latest events.
    """

    num_dropped: Count
    num_late: Count
    num_unrecorded: Count
    sink_errors: Sequence[str]
    fault_counts: Mapping[str, Count]
    faults: Sequence[FaultEvent]
    num_out_of_order: Count = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveSummary(LivePart):
    """What a live run did.

    Attributes:
        run: The same as for an off-line run; its run-times also have `capture`, `queue` and `send`, and `total` is the
            time from exposure until the command was sent.
    """

    run: RunSummary

    def to_json(self) -> dict[str, Any]:
        """The form of `SummaryFile`: the fields of `run`, and all others under `live`."""
        live = fields_to_json(self)
        return {**live.pop("run"), "live": live}

    def with_frames(self, sha256: str) -> Self:
        """As `RunSummary.with_frames`."""
        return dataclasses.replace(self, run=self.run.with_frames(sha256))


@dataclass(frozen=True, slots=True, kw_only=True)
class SummaryFile(RunSummary):
    """A `summary.json`.

    Attributes:
        live: The part that only live runs have.
    """

    live: LivePart | None = None


def lack_of_run(folder: Path, num_frames: int | None = None) -> str | None:
    """What the run in `folder` lacks, and so all that is made from it, as one line; None if it is complete or no run.

    Args:
        folder: The folder, which has a `frames.jsonl`.
        num_frames: How many frames were read from there; None if that does not matter.

    Raises:
        ValueError: If its summary is broken; the message names the field.
    """
    path = folder / "summary.json"
    if not path.is_file():
        is_run = any((folder / name).is_file() for name in ("config.toml", "times.jsonl"))
        return (
            f"{folder}: no summary.json: the run was not finished, what is made from it is incomplete"
            if is_run
            else None
        )
    summary = read_summary(path)
    if summary.source_lack is not None and not summary.is_interrupted:
        return f"{folder}: made from {summary.source_lack}"
    if not summary.is_complete:
        num = f"{summary.num_frames} frame" + "s" * (summary.num_frames != 1)
        return f"{folder}: the run was interrupted after {num}, what is made from it is incomplete"
    if summary.num_lost_parts:
        return f"{folder}: frames may be missing from the run, its recording is damaged: {summary.skipped[0]}"
    if num_frames is not None and num_frames < summary.num_frames and summary.live is None:  # a live run may lose some
        words = f"{num_frames} of {summary.num_frames} frames are left"
        return f"{folder}: {words} of the run, what is made from it is incomplete"
    return None


def read_summary(path: Path) -> SummaryFile:
    """The summary in the file at `path`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is broken; the message names the field.
    """
    if not path.exists():
        raise no_run_file(path, "that of a run")
    summary = read_json(path, RootModel[SummaryFile]).root
    return dataclasses.replace(summary, source=path_from_unicode(summary.source))
