"""The results of a live run in its folder, of which as much is kept as the disk has room for."""

from __future__ import annotations

import dataclasses

from foreglow.config import PipelineConfig
from foreglow.runs.folder import OutputFolder
from foreglow.runs.summary_file import LiveSummary
from foreglow.runs.tally import Tally
from foreglow.runtime.health import Health
from foreglow.runtime.run import KeepingSink
from foreglow.types import Frame, FrameResult


class KeptResults(KeepingSink):
    """A live sink for the lines of a run's folder. After a write that failed they end with the frame before it.

    Attributes:
        is_whole: Whether the files were completed, without a write that failed.
    """

    def __init__(self, folder: OutputFolder) -> None:
        """Opens the files.

        Raises:
            OSError: If one cannot be written; the message names the path.
        """
        folder.keep_room()
        self._sinks = folder.line_sinks()
        self._tally = Tally()
        self._has_failed = False
        self.is_whole = False

    @property
    def num_kept(self) -> int:
        """Frames whose lines are whole in each file."""
        return self._tally.num_frames

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Adds a line to each file.

        Raises:
            OSError: If the disk is full; the message names the path.
        """
        before = [sink.num_bytes for sink in self._sinks]
        try:
            for sink in self._sinks:
                sink.write(frame, result)
        except BaseException:
            self._has_failed = True
            for sink, num_bytes in zip(self._sinks, before, strict=True):
                sink.cut(num_bytes)
            raise
        self._tally.add(frame, result)

    def write_health(self, health: Health) -> None:
        """Does nothing."""

    def close(self) -> None:
        """Completes the files.

        Raises:
            OSError: If the disk is full; the message names the path.
        """
        for sink in self._sinks:
            sink.close()
        self.is_whole = not self._has_failed

    def discard(self) -> None:
        """Closes the files."""
        for sink in self._sinks:
            sink.discard()

    def summary(self, live: LiveSummary, config: PipelineConfig) -> LiveSummary:
        """The summary for the folder: that of the run, or if a write failed, of the frames until then.

        Args:
            live: The summary of the run.
            config: Its configuration.
        """
        if self.is_whole:
            return live
        run = live.run
        kept = self._tally.summary(
            run.source,
            run.skipped,
            config,
            is_complete=False,
            is_interrupted=run.is_interrupted,
            dispatch=run.dispatch,
            num_lost_parts=run.num_lost_parts,
            topic=run.topic,
            on_error=run.on_error,
            source_lack=run.source_lack,
        )
        return dataclasses.replace(live, run=dataclasses.replace(kept, model_sha256=run.model_sha256))
