"""Asks of a light without a lamp in sight whose it is, before a gap opens: a shallow, short dip, and what follows it.

A question takes the time from camera to lamps and then that of the dip, `ASK_S`. By the answer, `own_light`, a light
is refused for `AGAIN_S`, or it opens the gap that it would have opened without a question. No question is put, and the
gap opens at once, where the answer would say nothing: in the light of the low beam above all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from foreglow.beam.bearings import Bearing
from foreglow.beam.own_light import OwnLight, evidence
from foreglow.config import BeamConfig
from foreglow.photometry import Headlamps
from foreglow.types import BeamCommand, Frame, Tracks

DIP = 0.3
"""Share of the LEDs' light that a question takes."""

ASK_S, NUM_IMAGES = 0.16, 1.5
"""For so long; the three images of it at 18 Hz, beside those before, are worth as much as so many without a trend."""

AGAIN_S = 2.0
"""A light is asked again, or believed again, no sooner than so."""

MIN_WORTH = 1.0
"""Least worth of an answer, as a log-likelihood ratio: below it, nothing is asked and nothing is refused."""


class Questions:
    """The questions that are put, and what came of them, by the tracks' ids."""

    def __init__(self, config: BeamConfig, headlamps: Headlamps) -> None:
        self._own = OwnLight(config, headlamps)
        self._answers_ns = round((config.latency_s + ASK_S) * 1e9)
        self._least = _log_odds(config.min_hidden_confidence)
        self.reset()

    def reset(self) -> None:
        """As `BeamPolicy.reset`."""
        self._own.reset()
        self._asked_ns: dict[int, int] = {}
        self._refused_ns: dict[int, int] = {}

    def shone(self, command: BeamCommand) -> None:
        """As `BeamPolicy.shone`."""
        self._own.shone(command)

    def look(self, frame: Frame, tracks: Tracks, bearings: Mapping[int, Bearing]) -> None:
        """Takes the next image, with the bearings of all tracks in it."""
        self._own.update(frame, tracks, bearings)
        self._asked_ns = {track_id: since for track_id, since in self._asked_ns.items() if track_id in bearings}
        self._refused_ns = {track_id: since for track_id, since in self._refused_ns.items() if track_id in bearings}

    def believed(self, now_ns: int, lights: Mapping[int, Bearing], *, is_open: bool) -> dict[int, Bearing]:
        """Those of `lights` for which a gap may open; while one is open, which `is_open` says, nothing is asked."""
        return {
            track_id: bearing
            for track_id, bearing in lights.items()
            if self._is_believed(now_ns, track_id, bearing, is_open=is_open)
        }

    def dipped(self, now_ns: int, bearings: Mapping[int, Bearing]) -> list[Bearing]:
        """Those of `bearings` that are asked in this frame, whatever else has become of them."""
        return [
            bearing
            for track_id, bearing in bearings.items()
            if 0 <= now_ns - self._asked_ns.get(track_id, now_ns + 1) < ASK_S * 1e9
        ]

    def _is_believed(self, now_ns: int, track_id: int, bearing: Bearing, *, is_open: bool) -> bool:
        if 0 <= now_ns - self._refused_ns.get(track_id, now_ns + 1) < AGAIN_S * 1e9:
            return False
        since_ns = now_ns - self._asked_ns.get(track_id, now_ns + 1)
        if 0 <= since_ns < self._answers_ns:
            return False
        worth, ratio = self._own.answer(track_id)
        if worth >= MIN_WORTH:
            if _log_odds(bearing.confidence) + evidence(ratio) < self._least:
                self._refused_ns[track_id] = now_ns
                return False
            return True
        if is_open or 0 <= since_ns < AGAIN_S * 1e9 or self._own.worth(track_id, DIP, NUM_IMAGES) < MIN_WORTH:
            return True
        self._asked_ns[track_id] = now_ns
        return False


def _log_odds(probability: float) -> float:
    probability = min(max(probability, 1e-6), 1.0 - 1e-6)
    return math.log(probability / (1.0 - probability))
