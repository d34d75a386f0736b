"""`summary.json`: what a run did, how long it took, and on what."""

from __future__ import annotations

import dataclasses
import functools
import json
import math
from collections import Counter, defaultdict, deque
from collections.abc import Collection, Mapping, Sequence
from importlib import metadata
from typing import TypeAlias

import numpy as np

from foreglow.provenance import checkout_state, processor_name
from foreglow.runtime.stepper import Described
from foreglow.types import BeamCommand, BeamMode, Frame, FrameResult, Tracks

RunTime: TypeAlias = dict[str, float | None]
"""`median`, `p95` and `p99` of one stage in milliseconds; None where no frame was run."""


@dataclasses.dataclass(frozen=True, slots=True)
class BeamSummary:
    """What the headlamps were told in a run.

    Attributes:
        num_low: Frames that commanded low beam.
        num_glare_free: High beam with dark gaps, or with LEDs that are not back yet.
        num_full: High beam.
        mean_gap_deg: Mean width of a gap; None where there never was one.
        faults: Why there was low beam: by fault, in how many frames, the most frequent first.
    """

    num_low: int
    num_glare_free: int
    num_full: int
    mean_gap_deg: float | None
    faults: Mapping[str, int]


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class RunSummary:
    """What a run did.

    Attributes:
        source: Where the frames came from, as the user gave it.
        is_complete: False where the run was interrupted; what it had done by then is kept.
        is_classified: Whether a model scored the proposals.
        num_frames: Frames that were run.
        num_proposals: Boxes proposed, over all frames.
        num_scored: Boxes that the model scored; None without a model.
        num_accepted: Boxes scored above the threshold; None without a model.
        num_ranged: Scored boxes that have a range; None where nothing estimates ranges.
        num_tracks: Tracks that were plausible at some time; None without a tracker.
        beam: What the headlamps were told; None where no beam was wanted.
        num_skipped: Files that could not be read and were passed over.
        skipped: One line a skipped file: its path and why.
        frame_sizes_px: The (width, height) that occurred, in order of their first frame.
        run_time_ms: Median, p95 and p99 over the latest `NUM_TIMES` frames of every stage and of `total`, their sum, in
            milliseconds.
        version: Of Foreglow.
        commit: The checkout that Foreglow ran from; None where it was installed.
        has_local_changes: Whether that checkout differed from its commit; None where it was installed.
        processor: The machine's own name of its processor; of many machines, each kind once.
        dispatch: Instruction set that the native core used, likewise; None with another back end.
    """

    source: str
    is_complete: bool
    is_classified: bool
    num_frames: int
    num_proposals: int
    num_scored: int | None
    num_accepted: int | None
    num_ranged: int | None
    num_tracks: int | None
    beam: BeamSummary | None
    num_skipped: int
    skipped: Sequence[str]
    frame_sizes_px: Sequence[tuple[int, int]]
    run_time_ms: Mapping[str, RunTime]
    version: str
    commit: str | None
    has_local_changes: bool | None
    processor: str
    dispatch: str | None

    def to_json(self) -> str:
        """The summary as indented JSON; absent values are null, never NaN."""
        return json.dumps(dataclasses.asdict(self), indent=2, allow_nan=False) + "\n"


NUM_TIMES = 20_000
"""Run-times of so many frames, the latest, are kept: a live run may last for days."""


class Tally:
    """Counts and run-times, gathered frame by frame; those of the parts of a run can be put together."""

    def __init__(self) -> None:
        self.num_frames = 0
        self._num_proposals = 0
        self._num_accepted = 0
        self._num_ranged = 0
        self._num_tracks: int | None = None
        self._sequence = ""
        self._counted: set[int] = set()
        self._beam: BeamTally | None = None
        self._sizes_px: dict[tuple[int, int], None] = {}
        self._stage_ms: defaultdict[str, deque[float]] = defaultdict(functools.partial(deque, (), NUM_TIMES))

    def add(self, frame: Frame, result: FrameResult) -> None:
        """Counts one frame."""
        self.num_frames += 1
        self._num_proposals += len(result.proposals)
        if result.detections is not None:
            self._num_accepted += int(result.detections.is_accepted.sum())
        if result.ranges is not None:
            self._num_ranged += int(np.isfinite(result.ranges.ranges_m).sum())
        if result.tracks is not None:
            self._count_tracks(frame.sequence, result.tracks)
        if result.beam is not None:
            self._beam = self._beam or BeamTally()
            self._beam.add(result.beam)
        self._sizes_px[frame.width_px, frame.height_px] = None
        for name, value in result.stage_ms.items():
            self._stage_ms[name].append(value)
        self._stage_ms["total"].append(sum(result.stage_ms.values()))

    def extend(self, later: Tally) -> None:
        """Counts all that `later` counted, of other sequences, as if it had been added after the frames so far."""
        self.num_frames += later.num_frames
        self._num_proposals += later._num_proposals
        self._num_accepted += later._num_accepted
        self._num_ranged += later._num_ranged
        if later._num_tracks is not None:
            self._num_tracks = (self._num_tracks or 0) + later._num_tracks
        if later._beam is not None:
            self._beam = self._beam or BeamTally()
            self._beam.extend(later._beam)
        self._sizes_px |= later._sizes_px
        for name, values in later._stage_ms.items():
            self._stage_ms[name] += values

    def summary(
        self,
        source: str,
        skipped: Sequence[str],
        pipeline: Described,
        *,
        is_complete: bool,
        processor: str | None = None,
    ) -> RunSummary:
        """The summary of all frames so far, with what is known about this Foreglow and the machine.

        Args:
            source: Where the frames came from.
            skipped: A line a file.
            pipeline: What ran.
            is_complete: Whether all frames were run.
            processor: What it ran on; None for this machine.
        """
        is_classified = pipeline.config.classifier.model is not None
        is_ranging = is_classified and pipeline.config.distance.estimator != "none"
        commit, has_local_changes = checkout_state()
        return RunSummary(
            source=source,
            is_complete=is_complete,
            is_classified=is_classified,
            num_frames=self.num_frames,
            num_proposals=self._num_proposals,
            num_scored=self._num_proposals if is_classified else None,
            num_accepted=self._num_accepted if is_classified else None,
            num_ranged=self._num_ranged if is_ranging else None,
            num_tracks=self._num_tracks,
            beam=None if self._beam is None else self._beam.summary(),
            num_skipped=len(skipped),
            skipped=tuple(skipped),
            frame_sizes_px=tuple(self._sizes_px),
            run_time_ms={name: run_time(values) for name, values in self._stage_ms.items()} or {"total": run_time([])},
            version=metadata.version("foreglow"),
            commit=commit,
            has_local_changes=has_local_changes,
            processor=processor or processor_name(),
            dispatch=pipeline.dispatch,
        )

    def _count_tracks(self, sequence: str, tracks: Tracks) -> None:
        """Counts the tracks that are plausible for the first time; those that ended are forgotten."""
        if sequence != self._sequence:
            self._sequence = sequence
            self._counted.clear()
        plausible = set(tracks.ids[tracks.is_plausible].tolist())
        self._num_tracks = (self._num_tracks or 0) + len(plausible - self._counted)
        self._counted = (self._counted | plausible) & set(tracks.ids.tolist())


class BeamTally:
    """Counts modes, faults and gaps, command by command."""

    def __init__(self) -> None:
        self._modes: Counter[int] = Counter()
        self._faults: Counter[str] = Counter()
        self._sum_gaps_rad = 0.0
        self._num_gaps = 0

    def add(self, command: BeamCommand) -> None:
        """Counts one command."""
        self._modes[command.mode] += 1
        self._faults.update(command.faults)
        self._num_gaps += len(command.gaps_rad)
        self._sum_gaps_rad += float(np.diff(command.gaps_rad).sum())

    def extend(self, later: BeamTally) -> None:
        """Counts all that `later` counted."""
        self._modes.update(later._modes)
        self._faults.update(later._faults)
        self._num_gaps += later._num_gaps
        self._sum_gaps_rad += later._sum_gaps_rad

    def summary(self) -> BeamSummary:
        """Of all commands so far."""
        mean_gap_deg = round(math.degrees(self._sum_gaps_rad / self._num_gaps), 3) if self._num_gaps else None
        return BeamSummary(
            num_low=self._modes[BeamMode.LOW],
            num_glare_free=self._modes[BeamMode.GLARE_FREE],
            num_full=self._modes[BeamMode.FULL],
            mean_gap_deg=mean_gap_deg,
            faults=dict(self._faults.most_common()),
        )


def run_time(values_ms: Collection[float]) -> RunTime:
    """Median, p95 and p99 (linear between ranks), in milliseconds to 0.1 us; None for no values.

    >>> run_time([1.0, 2.0, 3.0])
    {'median': 2.0, 'p95': 2.9, 'p99': 2.98}
    """
    if not values_ms:
        return dict.fromkeys(("median", "p95", "p99"))
    median, p95, p99 = np.percentile(list(values_ms), (50, 95, 99)).round(4).tolist()
    return {"median": median, "p95": p95, "p99": p99}
