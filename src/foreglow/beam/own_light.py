"""Whether a light is our own: what our lamps light dims with them, and the light of a vehicle does not.

The light L on a pixel follows from its grey level g by the camera's response: with the black level g0, in proportion up
to a knee, and from there on by slope levels for each factor e,

    L = g - g0 up to the knee K,   else K + slope (exp((g - g0 - K) / slope) - 1)                               (1)

The brightest pixels of a box have the mean light c. By photometry our lamps give its place the share q of what they
give it with all LEDs at full. As we come nearer, light grows or fades at a rate b, so that

    log c(t) = a + b t + k log q(t),   k = 1 for what is ours, k = 0 for what is others'                        (2)

Light of others on something that is lit by us as well lies in between. Where y and x are what is left of log c and
log q after a straight line in t is taken out of either, over the images of the last `MEMORY_S`, the answer is a
log-likelihood ratio of ours to others', from images of the deviation s, that of the better of both fits and at least
`SIGMA`:

    R = (2 x.y - x.x) / (2 s^2)                                                                                 (3)

An answer is worth x.x / (2 s^2) on average: nothing while our light there does not change, little in the light of the
low beam, whose share of q stays, and little where a light flickers, as that of a vehicle along a rail does. What is no
vehicle's is ours with the probability `OURS`, and else lit by fixed lamps, which answer as a vehicle does. So the
evidence of a vehicle changes by

    dE = -log(OURS e^R + 1 - OURS)                                                                              (4)

Source: our own; the partial regression of (3) is that of Frisch and Waugh, 1933.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

import numpy as np

from foreglow.beam.bearings import Bearing
from foreglow.config import BeamConfig
from foreglow.geometry import Floats
from foreglow.photometry import Headlamps
from foreglow.types import BeamCommand, Frame, Image, Tracks

MEMORY_S = 0.9
"""So far back images count: light does not change evenly for longer."""

SIGMA = 0.08
"""Least standard deviation s of log c from image to image about (2): noise, pitch and boxes that breathe."""

MIN_IMAGES = 5
"""Fewer say nothing of how a light flickers."""

OURS = 0.8
"""Share of our own light among what is taken for a vehicle's and is none."""

MIN_GREY = 8.0
"""Above black, in 255ths of white; fainter lights are noise, and no answer."""

NUM_BRIGHTEST = 9
"""So many pixels, or a quarter of a small box: fewer are noise, and more change as the box breathes."""

MAX_BRIGHTNESS = 0.97
"""Of white; what is brighter may be brighter than the image shows."""

UNKNOWN_M, NEAREST_M = 60.0, 10.0
"""Where a light without a range is taken to be, and one that is nearer than this, before our lamps."""

DARKEST_LX = 1e-4
"""Less light of ours is none that would be seen."""

MAX_COMMANDS = 256
"""So many commands are remembered at most, should time stand still."""


class OwnLight:
    """What our own light did at the places of tracks, and how their light answered."""

    def __init__(self, config: BeamConfig, headlamps: Headlamps) -> None:
        """Takes our lamps, and the camera's response and the time from an image to the light that follows from it."""
        self._headlamps = headlamps
        self._response = config.response
        self._latency_ns = round(config.latency_s * 1e9)
        self.reset()

    def reset(self) -> None:
        """Forgets all tracks, and what was shone."""
        self._shone: deque[tuple[int, Floats]] = deque(maxlen=MAX_COMMANDS)
        self._seen: dict[int, deque[tuple[float, float, float]]] = {}
        self._shares: dict[int, float] = {}
        self._white = 255

    def shone(self, command: BeamCommand) -> None:
        """Takes a command as the guard let it pass."""
        self._shone.append((command.timestamp_ns, command.levels))

    def update(self, frame: Frame, tracks: Tracks, bearings: Mapping[int, Bearing]) -> None:
        """Looks at the tracks in `frame`."""
        if frame.image.dtype != np.uint8:
            self._white = max(self._white, (1 << int(frame.image.max()).bit_length()) - 1)
        levels = self._levels_at(frame.timestamp_ns)
        known, self._seen, self._shares = self._seen, {}, {}
        if levels is None or not len(tracks):
            return
        assert frame.camera is not None
        height_m = float(frame.camera.vehicle_from_camera.position_m[2])
        points_m = [_place(bearings[track_id], height_m) for track_id in tracks.ids.tolist()]
        base_lx, leds_lx = self._headlamps.illuminance_lx(points_m)
        whole_lx = np.maximum(base_lx + leds_lx.sum(axis=(1, 2)), DARKEST_LX)
        shares = np.maximum(base_lx + (leds_lx * levels).sum(axis=(1, 2)), DARKEST_LX) / whole_lx
        of_leds = leds_lx.sum(axis=(1, 2)) / whole_lx
        self._shares = dict(zip(tracks.ids.tolist(), of_leds.tolist(), strict=True))
        now_s = frame.timestamp_ns / 1e9
        for track_id, box, share in zip(tracks.ids.tolist(), tracks.boxes_xyxy_px, shares.tolist(), strict=True):
            seen = self._seen[track_id] = known.get(track_id, deque())
            value = brightest(frame.image, box, self._white, self._response)
            if not math.isnan(value):
                seen.append((now_s, math.log(value), math.log(share)))
            while seen and not now_s - MEMORY_S <= seen[0][0] <= now_s:
                seen.popleft()

    def answer(self, track_id: int) -> tuple[float, float]:
        """How much an answer is worth, x.x / (2 s^2), and R, by (3); both 0 without one."""
        x, y = self._changes(track_id)
        if len(x) < MIN_IMAGES:
            return 0.0, 0.0
        doubled = 2.0 * _variance(min(y @ y, (y - x) @ (y - x)), len(x))
        return float(x @ x) / doubled, float(2.0 * x @ y - x @ x) / doubled

    def worth(self, track_id: int, dip: float, num_images: float) -> float:
        """What the answer to a dip of all LEDs by the share `dip` would be worth, seen in so many images."""
        x, y = self._changes(track_id)
        if len(x) < MIN_IMAGES:
            return 0.0
        change = math.log(1.0 - dip * self._shares[track_id])
        return num_images * change * change / (2.0 * _variance(min(y @ y, (y - x) @ (y - x)), len(x)))

    def _changes(self, track_id: int) -> Floats:
        """The rows x and y of (3), shape (2, images)."""
        seen = self._seen.get(track_id, ())
        if len(seen) < MIN_IMAGES:
            return np.zeros((2, 0))
        times, lights, shares = np.array(seen).T
        times -= times.mean()
        changes = np.stack([shares - shares.mean(), lights - lights.mean()])
        return np.asarray(changes - np.outer(changes @ times, times) / max(times @ times, 1e-9))

    def _levels_at(self, timestamp_ns: int) -> Floats | None:
        """What was shone when an image was exposed; None where that is not known."""
        while len(self._shone) > 1 and self._shone[1][0] <= timestamp_ns - self._latency_ns:
            self._shone.popleft()
        return self._shone[0][1] if self._shone and self._shone[0][0] <= timestamp_ns - self._latency_ns else None


def _variance(squares: float, num_images: int) -> float:
    """s^2 of (3), from the squares that the better fit leaves; a line and a mean were taken out before."""
    return max(SIGMA * SIGMA, squares / (num_images - 2))


def evidence(ratio: float) -> float:
    """The change of the evidence by (4), from R.

    >>> round(evidence(-20.0), 2), round(evidence(8.0), 2)
    (1.61, -7.78)
    """
    most = max(ratio, 0.0)
    return -most - math.log(OURS * math.exp(ratio - most) + (1.0 - OURS) * math.exp(-most))


def brightest(image: Image, box_xyxy_px: Floats, white: int, response: tuple[float, float, float]) -> float:
    """The light c of a box; NaN if that says nothing, where the box is cut off, faint, or the camera is saturated."""
    x1, y1, x2, y2 = (round(edge) for edge in box_xyxy_px.tolist())
    height, width = image.shape
    if x1 < 0 or y1 < 0 or x2 > width or y2 > height or x1 >= x2 or y1 >= y2:
        return math.nan
    inside = image[y1:y2, x1:x2].ravel()
    num = min(-(-inside.size // 4), NUM_BRIGHTEST)
    grey = float(np.partition(inside, inside.size - num)[-num:].mean()) * 255.0 / white
    if grey - response[0] < MIN_GREY or grey > MAX_BRIGHTNESS * 255.0:
        return math.nan
    return light(grey, response)


def light(grey: float, response: tuple[float, float, float]) -> float:
    """L by (1), in grey levels of the proportional part.

    >>> light(30.0, (10.0, 40.0, 14.0)), round(light(64.0, (10.0, 40.0, 14.0)))
    (20.0, 64)
    """
    black, knee, slope = response
    above = grey - black
    return above if above <= knee else knee + slope * math.expm1((above - knee) / slope)


def _place(bearing: Bearing, height_m: float) -> tuple[float, float, float]:
    """Where a light is in the vehicle's frame, metres, seen by a camera at this height."""
    range_m = UNKNOWN_M if math.isnan(bearing.range_m) else max(bearing.range_m, NEAREST_M)
    along_m = range_m * math.cos(bearing.elevation_rad)
    up_m = height_m + range_m * math.sin(bearing.elevation_rad)
    return along_m * math.cos(bearing.azimuth_rad), along_m * math.sin(bearing.azimuth_rad), up_m
