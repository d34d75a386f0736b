"""Run-times of the ways to run the pipeline, part by part."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Floats
from foreglow.lab.evaluation.ratios import percentiles, ratio

COMPLETE = "CP"
PARTS = {
    COMPLETE: "complete pipeline",
    "PG": "proposal generation",
    "PC": "classification",
    "DE": "distance",
    "OT": "tracker",
    "BC": "beam command",
}
"""The paper's boxes, and the beam's. Source: Ewecker et al., arXiv 2107.11302, figure on run-times."""


@dataclass(frozen=True, slots=True, eq=False)
class NetworkTimes:
    """Run-times of one way to run the pipeline.

    Attributes:
        name: The way.
        parts_ms: By part, shape (F,), milliseconds, NaN for a frame that was lost; of `PARTS` and other names of what
            comes between. The complete pipeline is from the array to the beam command in process, and from exposure
            until the command was sent elsewhere.
        num_proposals: Shape (F,), of each frame; -1 where unknown.
        num_dropped: Frames that were given, and of which nothing came.
    """

    name: str
    parts_ms: Mapping[str, Floats]
    num_proposals: NDArray[np.int64]
    num_dropped: int

    @property
    def num_frames(self) -> int:
        """Frames of which a command came."""
        return int(np.isfinite(self.parts_ms[COMPLETE]).sum())

    def share_within(self, limit_s: float) -> float:
        """Share of all frames, dropped ones too, whose command was there in time."""
        return ratio((self.parts_ms[COMPLETE] <= 1e3 * limit_s).sum(), self.num_frames + self.num_dropped)


def median_p99_max(values: Floats) -> tuple[float, ...]:
    """Median, p99 and the greatest of the values that are not NaN; NaN for none.

    >>> median_p99_max(np.array([1.0, 2.0, 3.0, np.nan]))
    (2.0, 2.98, 3.0)
    """
    return percentiles(values, (50, 99, 100))


def frames_by_proposals(times: NetworkTimes, edges: Sequence[int]) -> Iterator[tuple[str, Floats]]:
    """Complete run-times by number of proposals: each group goes from one edge up to, not including, the next one."""
    for least, beyond in itertools.pairwise([*edges, math.inf]):
        is_in = (times.num_proposals >= least) & (times.num_proposals < beyond)
        words = f"{least} to {beyond - 1}" if math.isfinite(beyond) else f"{least} and more"
        complete = times.parts_ms[COMPLETE][is_in]
        yield words, complete[np.isfinite(complete)]
