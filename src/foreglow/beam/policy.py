"""From tracks to LED levels: the paper's policy, our own, and plain low and high beam for comparison."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from foreglow.beam.bearings import NO_VEHICLE, Bearing, Bearings
from foreglow.beam.gap_writer import GapWriter
from foreglow.beam.gaps import Gap
from foreglow.beam.in_sight import SURE_DIRECT, VEHICLE_M
from foreglow.beam.interface import BeamPolicy
from foreglow.beam.occurrence import Occurrence, occurrence
from foreglow.beam.questions import Questions
from foreglow.config import BeamConfig
from foreglow.geometry import Floats
from foreglow.photometry import Headlamps
from foreglow.plugins import METHODS, find, make
from foreglow.types import BeamCommand, BeamMode, Frame, Image, Tracks
from foreglow.types.arrays import check_kind
from foreglow.wording import shortened

OUTSIDE_M = 0.6
"""The same away from the vehicle's other lamp, where that is in sight: to the outside of the body and its mirrors."""

BOX_SHARE = 0.15
"""Standard deviation of a lamp's position in its box, as a share of the box's width."""

NEAREST_M = 20.0
"""Smallest range for which a gap is made. Nearer vehicles are beside the brightest part of the beam, and a gap for one
at 10 m would be as wide as the whole beam."""

LOWEST_LAMP_RAD = math.radians(-5.0)
"""Lowest elevation of a lamp: that of a lamp 0.5 m high at 10 m, seen from a car. Any light further down is light on
the road, unless it was a lamp before: that passes us."""

LOWEST_LAMP_M, BEFORE_LORRY_M = 0.5, 12.0
"""From higher cameras, such a lamp is seen further down: it is a lamp from here on."""

LEAST_HALF_RAD = math.radians(0.01)
"""Half the width of a gap at least: a box wholly beside the image has none."""

MAX_LEAD_RAD = math.pi / 2
"""A lamp is not expected further aside than this from where it is: then it is out of the light, however fast it is."""

UNKNOWN_NEAR_M = 40.0
"""A light without a range may be at this distance or any greater one."""

MIN_COMING_FRONT, MIN_COMING_CONFIDENCE, MIN_COMING_M = 0.8, 0.2, 30.0
"""A lamp that comes into sight gets a gap before its track is confirmed if it is this likely to be a front lamp, this
likely to be light at all, and this far away: nearer lamps would have been seen earlier. Rear lamps come slowly."""

EXPLAINED_S = 3.0
"""Light beside a lamp that then passed us is that vehicle's, or was lit by it or by us, for so long after it has gone:
until then what reflects it has passed us as well."""

HIDDEN = -1
"""The key of a hidden vehicle's gap is this less twice the id of the track whose light the gap is at, or less one and
twice the id of the vehicle: ids of both are small numbers from 0 on."""


class _Held(NamedTuple):
    """A gap, which vehicle it is for, and when that was last seen."""

    since_ns: int
    vehicle: int
    gap: Gap


class SteadyBeam(BeamPolicy):
    """What the beams that never change have in common: they need to know how many LEDs a lamp has, and nothing else."""

    def __init__(self, config: BeamConfig, headlamps: Headlamps) -> None:
        check_kind("config", config, BeamConfig)
        check_kind("headlamps", headlamps, Headlamps)
        self._num_leds = headlamps.num_leds


class LowBeam(SteadyBeam):
    """Low beam, always."""

    def command(self, frame: Frame, tracks: Tracks) -> BeamCommand:
        """As `BeamPolicy.command`."""
        check_kind("frame", frame, Frame)
        check_kind("tracks", tracks, Tracks)
        return BeamCommand.low(frame.timestamp_ns, self._num_leds)


class HighBeam(SteadyBeam):
    """High beam, always."""

    def command(self, frame: Frame, tracks: Tracks) -> BeamCommand:
        """As `BeamPolicy.command`."""
        check_kind("frame", frame, Frame)
        check_kind("tracks", tracks, Tracks)
        return BeamCommand(frame.timestamp_ns, BeamMode.FULL, np.ones((2, self._num_leds)))


class PaperPolicy(BeamPolicy):
    """The paper's policy: a gap with a margin for the brightest plausible track, and for nothing else.

    It is silent while the car's production system reports a vehicle (`Frame.is_reported`), as in the paper's car, where
    that system then controls the beam. Lamps that get both must shine the darker of the two.

    Source: Ewecker et al., arXiv 2107.11302, section on the use case.
    """

    def __init__(self, config: BeamConfig, headlamps: Headlamps) -> None:
        check_kind("config", config, BeamConfig)
        check_kind("headlamps", headlamps, Headlamps)
        self._margin_rad = math.radians(config.margin_deg)
        self._bearings = Bearings()
        self._writer = GapWriter(config, headlamps)

    def reset(self) -> None:
        """As `BeamPolicy.reset`."""
        self._bearings.reset()
        self._writer.reset()

    def command(self, frame: Frame, tracks: Tracks) -> BeamCommand:
        """As `BeamPolicy.command`."""
        check_kind("frame", frame, Frame)
        check_kind("tracks", tracks, Tracks)
        return self._writer.command(frame.timestamp_ns, self.gaps(frame, tracks))

    def gaps(self, frame: Frame, tracks: Tracks) -> list[Gap]:
        """The gap for the brightest plausible track; none without one, or while the production system reports."""
        plausible = np.flatnonzero(tracks.is_plausible)
        if frame.camera is None or frame.is_reported or not len(plausible):
            return []
        brightest = max(plausible.tolist(), key=lambda index: brightness(frame.image, tracks.boxes_xyxy_px[index]))
        bearing = self._bearings.update(frame, tracks)[int(tracks.ids[brightest])]
        half_rad = max(bearing.half_width_rad + self._margin_rad, LEAST_HALF_RAD)
        return [_around(bearing, half_rad)]


class ForeglowPolicy(BeamPolicy):
    """Our policy: a gap for every tracked lamp, and one where each vehicle is expected that shows only by its light.

    A vehicle is acted on as soon as it is confirmed, by its leading track, however sure each of its tracks is.

    * The gap of a lamp holds it, and the whole vehicle where that will be after the latency. Rear lamps count as front
      lamps: mirrors dazzle, too.
    * Light on the road or the roadside, of front or rear lamps, needs no protection, but its vehicle does, which is
      further along the road: the gap covers most of the probability of where it will appear (`occurrence`). Without a
      road, it is at the light.
    * While a lamp is in sight, any other light is attributed to it, and gets no gap.
    * A lamp that leaves the image at its side has passed: its gap is not held, and the light that was attributed to it
      is not taken for another vehicle's for `EXPLAINED_S`.
    * While a gap is open, front lamps get gaps before their tracks are confirmed, in frames in which they are detected.
      A vehicle that comes into sight needs a few frames to be confirmed, and its gap must not close in the meantime.
    * With `ask`, light without a lamp in sight is asked whose it is before it opens a gap (`questions`).

    Attributes:
        expected: Where and when a hidden vehicle was expected in the latest frame; None without one, or without a road.
    """

    def __init__(self, config: BeamConfig, headlamps: Headlamps) -> None:
        check_kind("config", config, BeamConfig)
        check_kind("headlamps", headlamps, Headlamps)
        self._config = config
        self._margin_rad = math.radians(config.margin_deg)
        self._hold_ns = round(config.hold_s * 1e9)
        self._bearings = Bearings(config.min_direct)
        self._writer = GapWriter(config, headlamps)
        self._questions = Questions(config, headlamps) if config.ask else None
        self.reset()

    def reset(self) -> None:
        """As `BeamPolicy.reset`."""
        self._bearings.reset()
        self._writer.reset()
        if self._questions is not None:
            self._questions.reset()
        self._dips: list[Gap] = []
        self._held: dict[int, _Held] = {}
        self._lamps: dict[int, Bearing] = {}
        self._lights: frozenset[int] = frozenset()
        self._explained_ns: dict[int, int] = {}
        self.expected: Occurrence | None = None

    def command(self, frame: Frame, tracks: Tracks) -> BeamCommand:
        """As `BeamPolicy.command`."""
        check_kind("frame", frame, Frame)
        check_kind("tracks", tracks, Tracks)
        gaps = self.gaps(frame, tracks)
        return self._writer.command(frame.timestamp_ns, gaps, self._dips)

    def shone(self, command: BeamCommand) -> None:
        """As `BeamPolicy.shone`."""
        if self._questions is not None:
            self._questions.shone(command)

    def gaps(self, frame: Frame, tracks: Tracks) -> list[Gap]:
        """The gaps for the tracks of this frame, and those for tracks of a moment ago."""
        self.expected, self._dips = None, []
        if frame.camera is None:
            return []
        now_ns, held = frame.timestamp_ns, self._held
        bearings = self._bearings.update(frame, tracks)
        lowest_rad = _lowest_rad(float(frame.camera.vehicle_from_camera.position_m[2]))
        seen = {
            track_id: bearing
            for track_id, bearing in bearings.items()
            if track_id in self._lamps or not (bearing.is_lamp and bearing.elevation_rad < lowest_rad)
        }
        acted = {track_id: bearing for track_id, bearing in seen.items() if self._is_sure(bearing)}
        if acted or held:
            acted |= {track_id: bearing for track_id, bearing in seen.items() if _is_coming(bearing)}
        lamps = {track_id: bearing for track_id, bearing in acted.items() if bearing.is_lamp}
        passed = {track_id for track_id, bearing in self._lamps.items() if bearing.is_leaving and track_id not in lamps}
        self._explain(now_ns, lamps, passed, bearings)
        certain_rad: dict[int, list[float]] = {}  # of each vehicle, azimuths of the lamps that are certain
        for bearing in lamps.values():
            if bearing.vehicle != NO_VEHICLE and bearing.direct > SURE_DIRECT:
                certain_rad.setdefault(bearing.vehicle, []).append(bearing.azimuth_rad)
        self._held = {
            track_id: _Held(now_ns, bearing.vehicle, self._lamp_gap(bearing, certain_rad.get(bearing.vehicle, ())))
            for track_id, bearing in lamps.items()
        }
        unexplained = {track_id: bearing for track_id, bearing in acted.items() if track_id not in self._explained_ns}
        if self._questions is not None:
            self._questions.look(frame, tracks, bearings)
            if not lamps:
                is_open = any(track_id <= HIDDEN for track_id in held)
                believed = self._questions.believed(now_ns, unexplained, is_open=is_open)
                self._dips = [self._light_gap(bearing) for bearing in self._questions.dipped(now_ns, bearings)]
                unexplained = believed
        for vehicle, key, gap in self._hidden_gaps(frame, unexplained):
            self._held[key] = _Held(now_ns, vehicle, gap)
        for key, before in held.items():
            is_over = key in passed or before.vehicle in certain_rad
            if key not in self._held and not is_over and 0 <= now_ns - before.since_ns <= self._hold_ns:
                self._held[key] = before
        return [kept.gap for kept in self._held.values()]

    def _explain(
        self, now_ns: int, lamps: Mapping[int, Bearing], passed: Collection[int], bearings: Mapping[int, Bearing]
    ) -> None:
        """Remembers which light was seen beside the last lamp in sight, once that has passed us."""
        self._explained_ns = {
            track_id: since_ns
            for track_id, since_ns in self._explained_ns.items()
            if track_id in bearings and 0 <= now_ns - since_ns <= EXPLAINED_S * 1e9
        }
        if lamps:
            self._explained_ns = {}
            self._lights = frozenset(bearings.keys() - lamps.keys())
        elif passed and passed == self._lamps.keys():
            self._explained_ns |= dict.fromkeys(self._lights & bearings.keys(), now_ns)
        self._lamps = dict(lamps)

    def _is_sure(self, bearing: Bearing) -> bool:
        """Whether a track is acted on; for light without a lamp this needs more confidence than for a lamp."""
        config = self._config
        wanted = config.min_confidence if bearing.is_lamp else config.min_hidden_confidence
        return bearing.is_plausible and bearing.confidence >= wanted

    def _lamp_gap(self, bearing: Bearing, certain_rad: Collection[float]) -> Gap:
        """The gap that holds the vehicle of a lamp: less on the outside where its other lamp is certain.

        Args:
            bearing: The lamp.
            certain_rad: Azimuths of all lamps of its vehicle that are certain.
        """
        near_m, far_m = _bounds_m(bearing)
        vehicle_rad, outside_rad = math.atan2(VEHICLE_M, near_m), math.atan2(OUTSIDE_M, near_m)
        right_rad = left_rad = vehicle_rad
        apart_rad = [azimuth_rad - bearing.azimuth_rad for azimuth_rad in certain_rad]
        is_right = any(outside_rad <= apart <= 2.0 * vehicle_rad for apart in apart_rad)
        is_left = any(outside_rad <= -apart <= 2.0 * vehicle_rad for apart in apart_rad)
        if is_right != is_left:
            right_rad, left_rad = (outside_rad, vehicle_rad) if is_right else (vehicle_rad, outside_rad)
        edge_rad = 2.0 * BOX_SHARE * bearing.half_width_rad + self._margin_rad
        lead_rad = min(max(bearing.rate_radps * self._config.latency_s, -MAX_LEAD_RAD), MAX_LEAD_RAD)
        return Gap(
            bearing.azimuth_rad - edge_rad + min(lead_rad - right_rad, 0.0),
            bearing.azimuth_rad + edge_rad + max(lead_rad + left_rad, 0.0),
            near_m,
            far_m,
            not math.isnan(bearing.range_m),
        )

    def _hidden_gaps(self, frame: Frame, acted: Mapping[int, Bearing]) -> list[tuple[int, int, Gap]]:
        """A gap for each hidden vehicle, if there is light but no lamp in sight: vehicle, key and gap.

        The keys are `HIDDEN` or smaller. Where no vehicles are known, all light is one vehicle's.
        """
        if any(bearing.direct > self._config.min_direct for bearing in acted.values()):
            return []
        by_vehicle: dict[int, dict[int, Bearing]] = {}
        for track_id, bearing in acted.items():
            by_vehicle.setdefault(bearing.vehicle, {})[track_id] = bearing
        gaps: list[tuple[int, int, Gap]] = []
        for vehicle, lights in by_vehicle.items():
            expected = self._expected(frame, lights.values())
            if expected is None:
                gaps += [
                    (vehicle, HIDDEN - 2 * track_id, self._light_gap(bearing)) for track_id, bearing in lights.items()
                ]
                continue
            self.expected = self.expected or expected
            tail = 0.5 * (1.0 - self._config.coverage)
            right, left = expected.quantiles_rad((tail, 1.0 - tail))
            near_m = expected.nearest_m(tail)
            half_rad = math.atan2(VEHICLE_M, near_m) + self._margin_rad
            key = HIDDEN - 1 - 2 * max(vehicle, 0)
            gaps.append((vehicle, key, Gap(right - half_rad, left + half_rad, near_m, math.inf)))
        return gaps

    def _expected(self, frame: Frame, lights: Collection[Bearing]) -> Occurrence | None:
        """Where the vehicle of these lights will come into sight; None without a road."""
        if frame.road is None:
            return None
        ranges_m = [bearing.range_m - bearing.sigma_m for bearing in lights if not math.isnan(bearing.range_m)]
        speed_mps = 0.0 if frame.motion is None else frame.motion.speed_mps
        return occurrence(frame.road, max(ranges_m, default=math.nan), speed_mps)

    def _light_gap(self, bearing: Bearing) -> Gap:
        return _around(bearing, bearing.half_width_rad + self._margin_rad)


POLICIES: Mapping[str, type[BeamPolicy]] = MappingProxyType(
    {"low": LowBeam, "high": HighBeam, "paper": PaperPolicy, "foreglow": ForeglowPolicy}
)
"""Our policies by name."""


def policy_class(name: str, field: str = "beam.policy") -> type[BeamPolicy]:
    """The policy called `name`: one of `POLICIES`, or a plug-in.

    Raises:
        ValueError: If there is none, or it cannot be imported; the message starts with `field`.
    """
    if not isinstance(name, str):
        raise ValueError(f"{field}: expected the name of a policy, got {shortened(name)}")
    return find(field, name, POLICIES, "foreglow.policies")


def make_policy(config: BeamConfig, headlamps: Headlamps) -> BeamPolicy:
    """The policy that `config.policy` names.

    Raises:
        ValueError: As `policy_class`, or if it cannot be made of these two, or they are something else.
    """
    check_kind("config", config, BeamConfig)
    check_kind("headlamps", headlamps, Headlamps)
    return make(
        "beam.policy", config.policy, POLICIES, "foreglow.policies", config, headlamps, methods=METHODS["policy"]
    )


def _lowest_rad(height_m: float) -> float:
    """The lowest elevation of a lamp, seen from a camera at this height; what looks like one below is on the road."""
    return min(LOWEST_LAMP_RAD, -math.atan2(height_m - LOWEST_LAMP_M, BEFORE_LORRY_M))


def _is_coming(bearing: Bearing) -> bool:
    """Whether it may be a lamp of a vehicle that comes into sight: what was not detected in this frame does not."""
    is_sure = bearing.front >= MIN_COMING_FRONT and bearing.confidence >= MIN_COMING_CONFIDENCE
    return bearing.is_seen and is_sure and bearing.range_m >= MIN_COMING_M


def _around(bearing: Bearing, half_rad: float) -> Gap:
    has_range = not math.isnan(bearing.range_m)
    return Gap(bearing.azimuth_rad - half_rad, bearing.azimuth_rad + half_rad, *_bounds_m(bearing), has_range)


def _bounds_m(bearing: Bearing) -> tuple[float, float]:
    if math.isnan(bearing.range_m):
        return UNKNOWN_NEAR_M, math.inf
    range_m = max(bearing.range_m, NEAREST_M)
    return range_m, range_m


def brightness(image: Image, box_xyxy_px: Floats) -> float:
    """The greatest grey level in the part of a box that lies in the image; 0 if there is none."""
    x1, y1, x2, y2 = (max(int(edge), 0) for edge in np.ceil(box_xyxy_px))
    inside = image[y1:y2, x1:x2]
    return float(inside.max()) if inside.size else 0.0
