"""A run repeated from its tracks on: only the beam is computed again."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping

from foreglow.beam import BeamStage
from foreglow.config import PipelineConfig
from foreglow.types import Frame, FrameResult


class Replay:
    """Takes the place of a pipeline: it returns the results of an earlier run, each with a new beam command.

    Attributes:
        config: Configuration of the earlier run, but for the beam.
    """

    dispatch = None
    """The native core is not used."""

    def __init__(self, config: PipelineConfig, results: Mapping[int, FrameResult], origin: str) -> None:
        """Makes the beam stage.

        Args:
            config: With a beam policy.
            results: By frame, the results of the earlier run, with tracks.
            origin: Name of that run in messages.

        Raises:
            FileNotFoundError: If the file that describes the headlamps is missing.
            ValueError: If it is broken.
        """
        self.config = config
        self._beam = BeamStage(config.beam, config.guard, lit_street=config.lit_street)
        self._results = results
        self._origin = origin

    def step(self, frame: Frame) -> FrameResult:
        """The earlier result of `frame` with a new beam command; `stage_ms` has the run-time of the beam alone.

        Raises:
            ValueError: If the earlier run did not have this frame.
        """
        result = self._results.get(frame.frame)
        if result is None or result.tracks is None or result.timestamp_ns != frame.timestamp_ns:
            raise ValueError(
                f"{self._origin}: expected the frames of its source, has no frame {frame.frame} "
                f"at {frame.timestamp_ns / 1e9:.3f} s"
            )
        before_ns = time.perf_counter_ns()
        beam = self._beam.command(frame, result.tracks)
        stage_ms = {"beam": (time.perf_counter_ns() - before_ns) / 1e6}
        return dataclasses.replace(result, beam=beam, stage_ms=stage_ms)

    def reset(self) -> None:
        """Forgets earlier frames, as at the start of a sequence."""
        self._beam.reset()
