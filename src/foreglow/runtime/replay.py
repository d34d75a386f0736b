"""A run once more, from its tracks on: only the beam is worked out anew."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping

from foreglow.beam import BeamStage
from foreglow.config import PipelineConfig
from foreglow.types import Frame, FrameResult


class Replay:
    """Stands in for a pipeline: gives the results of an earlier run, each with the beam command that follows.

    Attributes:
        config: That of the earlier run, with the beam that is wanted now.
    """

    dispatch = None
    """No native core is used."""

    def __init__(self, config: PipelineConfig, results: Mapping[int, FrameResult], origin: str) -> None:
        """Makes the beam stage.

        Args:
            config: With a beam policy.
            results: By frame, what the earlier run made of it, with tracks.
            origin: What messages call that run.

        Raises:
            FileNotFoundError: If there is no such description of lamps.
            ValueError: If it is broken.
        """
        self.config = config
        self._beam = BeamStage(config.beam, config.guard)
        self._results = results
        self._origin = origin

    def step(self, frame: Frame) -> FrameResult:
        """The earlier result of `frame` with its beam command; `stage_ms` has the time of that alone.

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
