"""A live run on the terminal: a status line, a line for each change of the faults, and what came of the run."""

from __future__ import annotations

import contextlib
import time

from rich.console import Console
from rich.markup import escape
from rich.status import Status

from foreglow.display.summary_lines import beam_lines
from foreglow.plugins import printable
from foreglow.runtime.health import Health
from foreglow.runtime.live import FaultEvent, LiveSummary
from foreglow.types import BeamMode, Frame, FrameResult

PARTS = ("capture", "queue", "proposals", "classifier", "distance", "tracking", "beam", "send", "total")


class LiveStatus:
    """A live sink that shows the health on stderr: a status line on a terminal, elsewhere changes of the faults."""

    def __init__(self) -> None:
        self._console = Console(stderr=True)
        self._status = Status("waiting for the first frame", console=self._console)
        self._said: tuple[tuple[str, ...], str] = ((), "")
        self._before = (0, time.monotonic())
        if self._console.is_terminal:
            self._status.start()

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Shows nothing: results come too fast to read."""

    def write_health(self, health: Health) -> None:
        """Shows the present state; a screen that takes no more, as a log on a full disk, is no lack of the results."""
        with contextlib.suppress(OSError):
            self._show(health)

    def _show(self, health: Health) -> None:
        now = (health.faults, health.details)
        is_well = not health.faults and not (health.beam and health.beam.faults)
        if now != self._said and (health.faults or is_well):
            self._said = now
            what = ", ".join(health.faults) or "all is well again"
            why = f" ({health.details})" if health.details else ""
            line = printable(f"{health.timestamp_ns / 1e9:10.2f} s  {what}{why}")
            self._console.print(line, highlight=False, markup=False, soft_wrap=True)
        num_frames, then_s = self._before
        now_s = time.monotonic()
        if now_s - then_s >= 0.5:
            rate_hz = (health.num_frames - num_frames) / (now_s - then_s)
            self._before = (health.num_frames, now_s)
            mode = (
                "no command yet" if health.beam is None else BeamMode(health.beam.mode).name.lower().replace("_", "-")
            )
            self._status.update(
                f"{health.num_frames} frames, {rate_hz:.1f} a second, {health.num_dropped} dropped, "
                f"{health.num_late} late; {mode}{escape(printable(f'; {health.details}') if health.details else '')}"
            )

    def close(self) -> None:
        """Removes the status line."""
        self._status.stop()

    def discard(self) -> None:
        """Removes the status line."""
        self._status.stop()


def live_lines(summary: LiveSummary) -> list[str]:
    """What came of a live run."""
    run = summary.run
    lines = [
        f"{run.num_frames} frames, {summary.num_dropped} dropped for a newer one, {summary.num_late} late; "
        f"{run.num_tracks or 0} tracks"
    ]
    if summary.num_out_of_order:
        lines.append(f"{summary.num_out_of_order} not used, as their times do not follow those of the frames before")
    if 2 * summary.num_late > run.num_frames:
        lines.append("most were late: this machine is busy, or reads frames more slowly than they follow each other")
    times = {part: run.run_time_ms[part] for part in PARTS if part in run.run_time_ms}
    if run.num_frames:
        for name in ("median", "p99"):
            shares = ", ".join(f"{part} {time_ms[name]:.2f}" for part, time_ms in times.items())
            lines.append(f"from exposure to command, ms ({name}): {shares}")
    if run.beam is not None:
        lines += beam_lines(run.beam, run.num_frames)
    lines += [_event_line(event) for event in summary.faults]
    if run.num_skipped:
        lines.append(f"{run.num_skipped} left out as unreadable, the first: {run.skipped[0]}")
    if run.source_lack is not None:
        lines.append(run.source_lack)
    if summary.num_unrecorded:
        why = "" if summary.sink_errors else ": the recording could not keep up"
        lines.append(f"{summary.num_unrecorded} results were not recorded{why}")
    lines += [f"not recorded: {error}" for error in summary.sink_errors]
    return [printable(line) for line in lines]


def _event_line(event: FaultEvent) -> str:
    lasted = "until the end" if event.until_ns is None else f"for {(event.until_ns - event.from_ns) / 1e9:.2f} s"
    detail = f" ({event.detail})" if event.detail else ""
    return f"fault at {event.from_ns / 1e9:.2f} s {lasted}: {event.fault}{detail}"
