"""What a live run did: that of any run, and what was lost or went wrong."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence

from foreglow.runs.summary import RunSummary
from foreglow.runtime.live.faults import FaultBook, FaultEvent


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class LiveSummary:
    """What a live run did.

    Attributes:
        run: As of a run off line; its run-times also have `capture`, `queue` and `send`, and `total` is from exposure
            until the command was sent.
        num_dropped: Frames passed over for a newer one.
        num_late: Frames whose command came later than a frame's time after the image.
        num_unrecorded: Results that sinks were not given, all sinks together.
        sink_errors: Why sinks failed.
        fault_counts: How often each fault began.
        faults: The latest events.
    """

    run: RunSummary
    num_dropped: int
    num_late: int
    num_unrecorded: int
    sink_errors: Sequence[str]
    fault_counts: Mapping[str, int]
    faults: Sequence[FaultEvent]

    def to_json(self) -> str:
        """The run's summary, with the rest under `live`; indented JSON, absent values are null."""
        live = dataclasses.asdict(self)
        run = live.pop("run")
        return json.dumps({**run, "live": live}, indent=2, allow_nan=False) + "\n"


def live_summary(
    run: RunSummary, book: FaultBook, num_dropped: int, num_late: int, num_unrecorded: int, sink_errors: Sequence[str]
) -> LiveSummary:
    """The summary, with what stands in the book of faults."""
    return LiveSummary(
        run=run,
        num_dropped=num_dropped,
        num_late=num_late,
        num_unrecorded=num_unrecorded,
        sink_errors=tuple(sink_errors),
        fault_counts=dict(book.counts.most_common()),
        faults=tuple(book.events),
    )
