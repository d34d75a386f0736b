"""Counts and run-times of a run, gathered frame by frame."""

from __future__ import annotations

import math
from array import array
from collections import Counter, defaultdict
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

import numpy as np

from foreglow.calibration import calibration_values
from foreglow.config import PipelineConfig
from foreglow.files import file_digest
from foreglow.geometry import Camera
from foreglow.models import model_path
from foreglow.outputs import running_command
from foreglow.provenance import checkout_state, processor_name
from foreglow.runs.origin import full_name, origin_digest
from foreglow.runs.summary_file import BeamSummary, RunSummary, RunTime
from foreglow.types import BeamMode, Frame, FrameResult, Tracks

NUM_TIMES = 20_000
"""Number of frames whose run-times are kept, always the latest: a live run may last for days."""


class LatestTimes:
    """The latest `NUM_TIMES` values of many, without an object for each.

    Objects that live for minutes among those of single frames leave memory in pieces, which grows for hours.
    """

    def __init__(self) -> None:
        self.values = array("d")
        self._oldest = 0

    def add(self, value: float) -> None:
        """Adds a value, in place of the oldest one if there are `NUM_TIMES`."""
        if len(self.values) < NUM_TIMES:
            self.values.append(value)
        else:
            self.values[self._oldest] = value
            self._oldest = (self._oldest + 1) % NUM_TIMES

    def extend(self, later: LatestTimes) -> None:
        """Adds the values of `later`, in their order."""
        for value in later.values[later._oldest :] + later.values[: later._oldest]:
            self.add(value)


MAX_FAULT_NAMES, OTHER_FAULTS = 1000, "other_faults"
"""Names of faults that are counted, and what others are counted as: those of a plug-in may have numbers in them."""


class FaultCounts(Counter[str]):
    """How often each fault was; no more than `MAX_FAULT_NAMES` of them have counts of their own."""

    def add(self, name: str, num: int = 1) -> None:
        """Counts a fault `num` times more."""
        self[name if name in self or len(self) < MAX_FAULT_NAMES else OTHER_FAULTS] += num


class Tally:
    """Counts and run-times of a run or of a part of it; `extend` joins the tallies of parts.

    Attributes:
        model_sha256: Of the model's file when it began; None without one, and of a part.
    """

    def __init__(self, config: PipelineConfig | None = None) -> None:
        """Begins to count.

        Args:
            config: Of the pipeline that was just made, whose model may have another one in its place at the end of the
                run; None for a part of a run.
        """
        self.model_sha256 = None if config is None else model_digest(config.classifier.model)
        self._is_begun = config is not None
        self.num_frames = 0
        self._num_proposals = 0
        self._num_accepted = 0
        self._num_ranged = 0
        self._num_with_camera = 0
        self._camera: Camera | None = None
        self._num_with_motion = 0
        self._num_with_road = 0
        self._num_damaged = 0
        self._num_tracks: int | None = None
        self._sequence = ""
        self._counted: set[int] = set()
        self._modes: Counter[int] = Counter()
        self._faults = FaultCounts()
        self._num_gaps = 0
        self._sum_gaps_rad = 0.0
        self._sizes_px: dict[tuple[int, int], None] = {}
        self._stage_ms: defaultdict[str, LatestTimes] = defaultdict(LatestTimes)

    def add(self, frame: Frame, result: FrameResult) -> None:
        """Counts one frame."""
        self.num_frames += 1
        self._num_with_camera += frame.camera is not None
        self._camera = self._camera or frame.camera
        self._num_with_motion += frame.motion is not None
        self._num_with_road += frame.road is not None
        self._num_damaged += frame.is_damaged
        self._num_proposals += len(result.proposals)
        if result.detections is not None:
            self._num_accepted += int(result.detections.is_accepted.sum())
        if result.ranges is not None:
            self._num_ranged += int(np.isfinite(result.ranges.ranges_m).sum())
        if result.tracks is not None:
            self._count_tracks(frame.sequence, result.tracks)
        if result.beam is not None:
            self._modes[result.beam.mode] += 1
            for name in result.beam.faults:
                self._faults.add(name)
            self._num_gaps += len(result.beam.gaps_rad)
            self._sum_gaps_rad += float(np.diff(result.beam.gaps_rad).sum())
        self._sizes_px[frame.width_px, frame.height_px] = None
        for name, value in result.stage_ms.items():
            self._stage_ms[name].add(value)
        self._stage_ms["total"].add(sum(result.stage_ms.values()))

    def extend(self, later: Tally) -> None:
        """Adds the counts of `later`, of other sequences, as if its frames had been added after the ones so far."""
        counts = ("num_frames", "_num_proposals", "_num_accepted", "_num_ranged", "_num_gaps", "_sum_gaps_rad")
        for name in (*counts, "_num_with_camera", "_num_with_motion", "_num_with_road", "_num_damaged"):
            setattr(self, name, getattr(self, name) + getattr(later, name))
        self._camera = self._camera or later._camera
        if later._num_tracks is not None:
            self._num_tracks = (self._num_tracks or 0) + later._num_tracks
        self._modes.update(later._modes)
        for name, num in later._faults.items():
            self._faults.add(name, num)
        self._sizes_px |= later._sizes_px
        for name, values in later._stage_ms.items():
            self._stage_ms[name].extend(values)

    def summary(
        self,
        source: str,
        skipped: Sequence[str],
        config: PipelineConfig,
        *,
        is_complete: bool,
        is_interrupted: bool = False,
        dispatch: str | None,
        processor: str | None = None,
        num_lost_parts: int = 0,
        topic: str | None = None,
        on_error: str | None = None,
        source_lack: str | None = None,
    ) -> RunSummary:
        """The summary of all frames so far, with the version of Foreglow and the machine.

        Args:
            source: Where the frames came from; a path becomes absolute, since it is read from anywhere.
            skipped: One line for each file that was skipped.
            config: Configuration of the pipeline.
            is_complete: Whether all frames were run that the source has.
            is_interrupted: Whether the run was interrupted.
            dispatch: As `Pipeline.dispatch`.
            processor: Name of the processor that it ran on; None for that of this machine.
            num_lost_parts: As in `RunSummary`, as are the next three.
            topic: The topic of a recording that was read.
            on_error: What bad frames did.
            source_lack: What the source lacks: then the run is not complete either.
        """
        is_classified = config.classifier.model is not None
        is_ranging = is_classified and config.distance.estimator != "none"
        commit, has_local_changes = checkout_state()
        name = full_name(source)
        run_times = {name: run_time(times.values) for name, times in self._stage_ms.items()}
        return RunSummary(
            source=name,
            source_digest=origin_digest(Path(name)),
            topic=topic,
            on_error=on_error,
            source_lack=source_lack,
            is_complete=is_complete and source_lack is None,
            is_interrupted=is_interrupted,
            is_classified=is_classified,
            model_sha256=self.model_sha256 if self._is_begun else model_digest(config.classifier.model),
            num_frames=self.num_frames,
            num_proposals=self._num_proposals,
            num_scored=self._num_proposals if is_classified else None,
            num_accepted=self._num_accepted if is_classified else None,
            num_ranged=self._num_ranged if is_ranging else None,
            num_tracks=self._num_tracks,
            num_with_camera=self._num_with_camera,
            num_with_motion=self._num_with_motion,
            num_with_road=self._num_with_road,
            num_damaged=self._num_damaged,
            calibration=None if self._camera is None else calibration_values(self._camera),
            beam=self._beam_summary() if self._modes else None,
            num_skipped=len(skipped),
            skipped=tuple(skipped),
            frame_sizes_px=tuple(self._sizes_px),
            run_time_ms=run_times or {"total": run_time([])},
            version=metadata.version("foreglow"),
            commit=commit,
            has_local_changes=has_local_changes,
            processor=processor or processor_name(),
            dispatch=dispatch,
            command=running_command(),
            num_lost_parts=num_lost_parts,
        )

    def _count_tracks(self, sequence: str, tracks: Tracks) -> None:
        """Counts the tracks that are plausible for the first time; forgets those that have ended."""
        if sequence != self._sequence:
            self._sequence = sequence
            self._counted.clear()
        plausible = set(tracks.ids[tracks.is_plausible].tolist())
        self._num_tracks = (self._num_tracks or 0) + len(plausible - self._counted)
        self._counted = (self._counted | plausible) & set(tracks.ids.tolist())

    def _beam_summary(self) -> BeamSummary:
        return BeamSummary(
            num_low=self._modes[BeamMode.LOW],
            num_glare_free=self._modes[BeamMode.GLARE_FREE],
            num_full=self._modes[BeamMode.FULL],
            mean_gap_deg=round(math.degrees(self._sum_gaps_rad / self._num_gaps), 3) if self._num_gaps else None,
            faults=dict(self._faults.most_common()),
        )


def model_digest(model: Path | None) -> str | None:
    """SHA-256 of a model's file; None without one, or if it cannot be read any more."""
    try:
        return None if model is None else file_digest(model_path(model))
    except (OSError, ValueError):
        return None


def run_time(values_ms: Sequence[float]) -> RunTime:
    """Median, p95 and p99 (linear between ranks), in milliseconds to 0.1 us; None for no values.

    >>> run_time([1.0, 2.0, 3.0])
    {'median': 2.0, 'p95': 2.9, 'p99': 2.98}
    """
    if not values_ms:
        return dict.fromkeys(("median", "p95", "p99"))
    median, p95, p99 = np.percentile(values_ms, (50, 95, 99)).round(4).tolist()
    return {"median": median, "p95": p95, "p99": p99}
