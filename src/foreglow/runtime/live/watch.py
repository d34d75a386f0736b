"""Watches whether frames arrive in time and in order."""

from __future__ import annotations

import time

from foreglow.beam.camera_watch import NUM_UNKNOWN
from foreglow.config import LiveConfig
from foreglow.runtime.live.faults import FaultBook, LiveFault
from foreglow.types import Frame

CAMERA, GAP = "camera", "gap"
"""The origins of these faults in the `FaultBook`; a gap of one frame does not cause low beam."""

MAX_DELAY_NS = 1_000_000_000
"""A frame that is earlier by more was not merely delayed: the previous one had a wrong time, or the clock was set. The
next frame is compared with this one."""


class FrameWatch:
    """Checks the timestamps of frames, and the silence between them by the wall clock.

    And whether a sequence has images of another size or type than the one before, as where those of a folder change:
    the guard, which begins anew with each sequence, cannot know.
    """

    def __init__(
        self, config: LiveConfig, period_s: float, book: FaultBook, *, speed: float = 1.0, max_silence_s: float | None
    ) -> None:
        """Begins to watch; the first frame may take longer, by `retry_s`, as the source has to be opened.

        Args:
            config: The limits.
            period_s: The frame period, by the frames' clock.
            book: Where faults are reported.
            speed: Speed of the frames' clock relative to the wall clock.
            max_silence_s: A longer silence, by the wall clock, is a fault, and no camera is slow; None derives both
                limits from the period.
        """
        self._book, self._speed = book, speed
        self._max_silence_s = max_silence_s or config.silent_frames * period_s / speed
        self._max_pause_s = max_silence_s or config.slow_frames * period_s / speed
        self._max_step_ns = config.slow_frames * period_s * 1e9
        self._num_steady, self._period_s = config.num_steady, period_s
        self._heard_s = time.monotonic() + config.retry_s
        self._frame_s = time.monotonic()
        self._latest: Frame | None = None
        self._num_slow, self._num_in_time = 0, config.num_steady
        self._num_unknown = 0  # images until those of another size are known
        self._lost, self._slow = "", ""

    def arrived(self, frame: Frame) -> bool:
        """Checks a frame that has arrived; returns whether it is newer than the previous one and may be used."""
        before, step_ns = self._latest, 0
        if before is not None and before.sequence == frame.sequence:
            step_ns = frame.timestamp_ns - before.timestamp_ns
            if step_ns <= 0:
                used_s = self._frame_s
                self._heard(frame if step_ns < -MAX_DELAY_NS else before)
                self._frame_s = used_s
                self._note(LiveFault.OUT_OF_ORDER)
                return False
        else:
            self._book.begin_clock(self._speed)
            if before is not None and _format(before) != _format(frame):
                self._num_unknown = NUM_UNKNOWN
        self._heard(frame)
        is_slow = step_ns > self._max_step_ns
        if is_slow:
            self._slow = f"{step_ns / 1e6:.0f} ms between frames, expected {self._period_s * 1e3:.0f}"
        self._num_slow = self._num_slow + 1 if is_slow else 0
        self._num_in_time = 0 if self._num_slow >= 2 else self._num_in_time + (not is_slow)
        self._note()
        self._num_unknown = max(0, self._num_unknown - 1)
        is_lost = self._num_slow == 1  # the second in a row is a slow camera
        detail = f"{step_ns / 1e6:.0f} ms before {frame.path or f'frame {frame.frame}'}" if is_lost else ""
        self._book.note(GAP, [LiveFault.FRAME_LOST] if is_lost else [], detail)
        return True

    def _heard(self, latest: Frame) -> None:
        self._heard_s = self._frame_s = time.monotonic()
        self._latest, self._lost = latest, ""

    @property
    def silent_s(self) -> float:
        """Time since the latest frame that may be used, or since the beginning."""
        return time.monotonic() - self._frame_s

    @property
    def reason(self) -> str:
        """Why the source was lost; empty if it is not, or nothing is known."""
        return self._lost

    def lost(self, reason: str) -> None:
        """Reports that the source was lost, and why, until the next frame arrives."""
        self._lost = reason
        self._note(LiveFault.CAMERA_GONE)

    def listen(self) -> bool:
        """Whether the source is silent for too long, lost, or slow again; to be called several times a period."""
        pause_s = time.monotonic() - self._heard_s
        if self._lost or pause_s > self._max_silence_s:
            self._note(LiveFault.CAMERA_GONE)
            return True
        if self._num_slow == 1 and pause_s > self._max_pause_s:  # the second in a row is late already
            self._num_slow, self._num_in_time = 2, 0
            self._note()
        return self._num_slow >= 2 and pause_s > self._max_pause_s

    def _note(self, *faults: LiveFault) -> None:
        slow = [] if self._num_in_time >= self._num_steady else [LiveFault.CAMERA_SLOW]
        resized = [LiveFault.RESIZED] if self._num_unknown else []
        detail = self._lost or (self._slow if slow and not faults and not resized else "")
        self._book.note(CAMERA, [*faults, *slow, *resized], detail)


def _format(frame: Frame) -> tuple[object, ...]:
    return (*frame.image.shape, frame.image.dtype)
