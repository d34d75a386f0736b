"""Every combination of many inputs of the guard: `python -m benchmarks.guard_sweep [--out FILE.json] [--quick]`.

The invariants are stated here without the guard's code: by rays through pixels, points along them and the lamps' own
intensities. Each state that breaks one is a counter-example.
"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from benchmarks.timing import CONSOLE, options, table, write_results
from foreglow.beam.guard import Guard
from foreglow.beam.known_images import NUM_KNOWN
from foreglow.beam.led_bounds import Lamps as GuardedLamps
from foreglow.config import GuardConfig
from foreglow.geometry import Camera, Floats, Pose, rotation
from foreglow.photometry import read_headlamps
from foreglow.types import BeamCommand, BeamMode, EgoMotion, Frame, Image, Tracks, TrackState

FRAME_S = 0.05
FRAME_NS = 50_000_000
NUM_BEFORE = 30
"""Frames before each state, all at one wanted level: more than a second, so that it is reached."""

MOUNT = Pose(np.array([1.8, 0.02, 1.35]), rotation(0.004, -0.008, 0.002))
CAMERA = Camera(320, 240, (337.5, 337.5), (160.0, 122.5), (-0.07, 0.015, 1e-4, -2e-5, 0.0), MOUNT)
"""PVDN's, reduced to a quarter: most of the time would go into looking at images, which are not what is swept."""


def _image(seed: int) -> Image:
    """Squares of noise, and a light that is elsewhere for each seed."""
    image = np.random.default_rng(seed).integers(5, 60, (24, 32), np.uint8).repeat(10, 0).repeat(10, 1)
    column = 20 + 90 * seed % 250
    image[100:120, column : column + 32] = 200
    return image


IMAGES = [_image(seed) for seed in range(2 * NUM_KNOWN + 2)]  # so many that none comes again soon

EXCESS = 1.00001
"""A limit may be exceeded by so much, for rounding."""


NEAR_DEG = 2.0
"""An LED that shines only further than this, and half the box, from the box has nothing to do with it."""


DIPPED = 0.7
"""Level of some neighbouring LEDs of either lamp, while the others are at full."""


class Lamps(GuardedLamps, Protocol):
    """Lamps, and what they shine in a direction, of which the guard knows nothing."""

    def intensities_cd(self, directions: Floats, /) -> tuple[Floats, Floats]:
        """Of the low beams, shape (P, 2), and of the LEDs at level 1, shape (P, 2, L)."""
        ...


@dataclass(frozen=True)
class Grid:
    """What is combined. Speeds are after frames at 20 m/s, and None is unknown.

    Levels are those of all LEDs. NaN stands for random ones, and `DIPPED` for full beam with a question in it.
    """

    azimuths_deg: Sequence[float] = (-22, -12, -7, -3, -1, 0, 0.5, 2, 5, 9, 16)
    elevations_deg: Sequence[float] = (-2.0, -0.5, 0.5, 2.0)
    widths_deg: Sequence[float] = (0.1, 0.6, 3.0)
    ranges_m: Sequence[float] = (math.nan, 9.0, 45.0, 80.0, 130.0, 400.0)
    relative_sigmas: Sequence[float] = (0.02, 0.3)
    are_plausible: Sequence[bool] = (True, False)
    wanted: Sequence[float] = (0.02, 0.5, 1.0, math.nan, DIPPED)
    before: Sequence[float] = (0.0, 0.4, 1.0, DIPPED)
    speeds_mps: Sequence[float | None] = (20.0, 9.0, 8.8, 0.0, None)
    ages_s: Sequence[float] = (0.0, 0.3, 0.301, -0.001)
    faults: Sequence[str] = ("", "pipeline")


QUICK = Grid(
    azimuths_deg=(-12, -1, 0.5, 5),
    elevations_deg=(-0.5, 0.5),
    widths_deg=(0.1, 3.0),
    ranges_m=(math.nan, 9.0, 130.0),
    relative_sigmas=(0.1,),
    wanted=(0.5, 1.0, math.nan, DIPPED),
    speeds_mps=(20.0, 8.8, None),
    ages_s=(0.0, 0.301),
)


@dataclass(frozen=True, eq=False)
class Place:
    """A track, and the directions in which no more than the limit may be shone.

    Attributes:
        tracks: The track alone.
        is_plausible: Whether the guard has to protect it.
        leds_cd: Shape (P, 2, L): what the LEDs of each lamp shine towards sampled points of the box.
        is_far: Shape (2, L): which LEDs shine nowhere near the box.
        limit_cd: The limit of either lamp.
        azimuths_rad: Shape (2,): the least and the greatest of the sampled directions.
    """

    tracks: Tracks
    is_plausible: bool
    leds_cd: Floats
    is_far: NDArray[np.bool_]
    limit_cd: float
    azimuths_rad: Floats


NUM_SIGMAS, BRIGHTENING_S = 0.5, 0.5
"""Defaults, said once more."""


@dataclass
class Outcome:
    """How many states were tried, how many of them had light, and those that broke an invariant, by its name."""

    num_states: int = 0
    num_lit: int = 0
    greatest_share_of_limit: float = 0.0
    counter_examples: dict[str, list[Any]] = field(default_factory=dict)

    def broken(self, invariant: str, state: Any) -> None:
        self.counter_examples.setdefault(invariant, []).append(state)

    @property
    def num_counter_examples(self) -> int:
        return sum(map(len, self.counter_examples.values()))


def limit_cd(range_m: float, sigma_m: float) -> float:
    """The default limits, said once more: by the least range that may be, the strictest where it is unknown."""
    nearest_m = range_m - NUM_SIGMAS * sigma_m
    for from_m, limit in ((200, 5100.0), (100, 1400.0), (50, 275.0)):
        if nearest_m >= from_m:
            return limit
    return 150.0


def places(lamps: Lamps, grid: Grid) -> Iterator[tuple[Any, Place]]:
    """All tracks of the grid, with their parameters."""
    for azimuth_deg, elevation_deg, width_deg, range_m, relative, is_plausible in itertools.product(
        grid.azimuths_deg,
        grid.elevations_deg,
        grid.widths_deg,
        grid.ranges_m,
        grid.relative_sigmas,
        grid.are_plausible,
    ):
        azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
        ahead = rotation(azimuth, elevation)[:, 0]
        x, y = CAMERA.project(ahead @ MOUNT.rotation)
        half_px = CAMERA.focal_px[0] * np.tan(np.radians(width_deg) / 2)
        box = np.array([x - half_px, y - half_px, x + half_px, y + half_px])
        sigma_m = math.inf if math.isnan(range_m) else relative * range_m
        leds, azimuths = _towards(lamps, box, range_m, sigma_m)
        around = box + np.array([-1, -1, 1, 1]) * (np.radians(NEAR_DEG) * CAMERA.focal_px[0] + half_px / 2)
        is_far = _towards(lamps, around, range_m, sigma_m, 15)[0].max(axis=0) < 1e-3
        tracks = Tracks(
            ids=np.arange(1),
            states=np.array([TrackState.CONFIRMED if is_plausible else TrackState.TENTATIVE], np.int64),
            boxes_xyxy_px=box[np.newaxis],
            confidences=np.full(1, 0.9),
            num_hits=np.full(1, 9),
            num_misses=np.zeros(1, np.int64),
            ages_s=np.full(1, 1.0),
            ranges_m=np.full(1, range_m),
            sigmas_m=np.full(1, sigma_m),
            detections=np.zeros(1, np.int64),
        )
        state = (azimuth_deg, elevation_deg, width_deg, range_m, relative, is_plausible)
        yield state, Place(tracks, is_plausible, leds, is_far, limit_cd(range_m, sigma_m), azimuths)


def _towards(lamps: Lamps, box: Floats, range_m: float, sigma_m: float, count: int = 5) -> tuple[Floats, Floats]:
    """What the LEDs shine towards points of the box, shape (P, 2, L), and the extremes of their azimuths."""
    columns, rows = np.clip(np.linspace(box[:2], box[2:], count), 0, [CAMERA.width_px, CAMERA.height_px]).T
    rays = CAMERA.rays(np.stack(np.meshgrid(columns, rows), -1).reshape(-1, 2)) @ MOUNT.rotation.T
    ranges_m = np.array([15.0, 25.0, 60.0, 1e6])
    if not math.isnan(range_m):
        ranges_m = np.linspace(range_m - NUM_SIGMAS * sigma_m, range_m + NUM_SIGMAS * sigma_m, 4)
    lights = MOUNT.position_m + rays * ranges_m[:, np.newaxis, np.newaxis]
    points = np.concatenate([lights + np.array([0.0, 0.0, up_m]) for up_m in (0.0, 0.25, 0.5)]).reshape(-1, 3)
    leds, azimuths = [], []
    for side, lamp in enumerate((lamps.left, lamps.right)):
        seen = points - lamp.vehicle_from_lamp.position_m
        leds.append(lamps.intensities_cd(seen / np.linalg.norm(seen, axis=1, keepdims=True))[1][:, side])
        azimuths.append(np.arctan2(seen[:, 1], seen[:, 0]))
    return np.stack(leds, 1), np.array([np.min(azimuths), np.max(azimuths)])


def sweep(lamps: Lamps, grid: Grid) -> Outcome:
    """Tries all states."""
    guard, outcome = Guard(GuardConfig(), lamps), Outcome()
    num_leds = lamps.intensities_cd(np.eye(3)[:1])[1].shape[-1]
    prepared = {level: _prepared(guard, levels_of(level, num_leds)) for level in grid.before}
    frame_ns = NUM_BEFORE * FRAME_NS
    wanted = [BeamCommand(frame_ns, BeamMode.FULL, levels_of(level, num_leds)) for level in grid.wanted]
    motions = [None if speed_mps is None else EgoMotion(speed_mps, 0.0) for speed_mps in grid.speeds_mps]
    frames = [[Frame(image, frame_ns, camera=CAMERA, motion=motion) for image in IMAGES] for motion in motions]
    conditions = list(itertools.product(grid.before, wanted, frames, grid.ages_s, grid.faults))
    for where, place in places(lamps, grid):
        lit, states = [], []
        for before, command, same_but_images, age_s, fault in conditions:
            # Copies of a guard share the eye on the camera, which has seen the first images.
            frame = same_but_images[(NUM_BEFORE + 1 + outcome.num_states) % len(IMAGES)]
            checked = copy.copy(prepared[before]).check(
                command,
                place.tracks,
                frame,
                time_ns=frame_ns + round(age_s * 1e9),
                pipeline_faults=(fault,) if fault else (),
            )
            outcome.num_states += 1
            speed = None if frame.motion is None else frame.motion.speed_mps
            state = (where, before, float(command.levels.mean()), speed, age_s, fault)
            must_be_low = bool(fault) or speed is None or speed < 32 / 3.6 or not 0 <= age_s <= 0.3
            if checked.mode != mode_of(checked):
                outcome.broken("the mode says what shines", state)
            if must_be_low != (checked.mode == BeamMode.LOW) or must_be_low != bool(checked.faults):
                outcome.broken("low beam where, and only where, something is wrong", state)
            if checked.levels.any():
                lit.append((before, command.levels, checked))
                states.append(state)
            elif not must_be_low:
                outcome.broken("light where nothing is wrong", state)
        outcome.num_lit += len(lit)
        if lit:
            _check_light(outcome, place, lit, states)
    return outcome


def levels_of(level: float, num_leds: int) -> Floats:
    """Shape (2, num_leds), as `Grid` calls them."""
    if math.isnan(level):
        return np.random.default_rng(0).random((2, num_leds))
    levels = np.full((2, num_leds), 1.0 if level == DIPPED else level)
    if level == DIPPED:
        levels[:, num_leds // 3 : num_leds // 2] = DIPPED
    return levels


def mode_of(command: BeamCommand) -> BeamMode:
    """Low beam while all LEDs are off, full beam only if all are at 1 and there is no gap."""
    if not command.levels.any():
        return BeamMode.LOW
    is_full = bool((command.levels == 1.0).all()) and not len(command.gaps_rad)
    return BeamMode.FULL if is_full else BeamMode.GLARE_FREE


def _prepared(guard: Guard, levels: Floats) -> Guard:
    """The guard after it has let `levels` through."""
    guard.reset()
    for number in range(NUM_BEFORE):
        frame = Frame(IMAGES[(number + 1) % len(IMAGES)], number * FRAME_NS, camera=CAMERA, motion=EgoMotion(20.0, 0.0))
        result = guard.check(BeamCommand(frame.timestamp_ns, BeamMode.FULL, levels), _no_tracks(), frame)
    assert not result.faults
    np.testing.assert_allclose(result.levels, levels)
    return copy.copy(guard)


def _no_tracks() -> Tracks:
    whole, real = np.zeros(0, np.int64), np.zeros(0)
    return Tracks(whole, whole, np.zeros((0, 4)), real, whole, whole, real, real, real, whole)


def _check_light(
    outcome: Outcome, place: Place, lit: Sequence[tuple[float, Floats, BeamCommand]], states: Sequence[Any]
) -> None:
    """Holds the states with light at one place to the invariants."""
    before = np.stack([levels_of(level, levels.shape[1]) for level, levels, _ in lit])
    wanted = np.stack([levels for _, levels, _ in lit])
    levels = np.stack([checked.levels for _, _, checked in lit])
    slow = np.minimum(wanted, before + FRAME_S / BRIGHTENING_S)
    holds: Mapping[str, Any] = {
        "levels are from 0 to 1": (levels >= 0) & (levels <= 1),
        "no LED is brighter than wanted": levels <= wanted,
        "no LED brightens faster than allowed": levels <= before + FRAME_S / BRIGHTENING_S + 1e-12,
    }
    for invariant, is_kept in holds.items():
        for number in np.flatnonzero(~is_kept.all(axis=(1, 2))).tolist():
            outcome.broken(invariant, states[number])
    if not place.is_plausible:
        for number in np.flatnonzero((np.abs(levels - slow) > 1e-12).any(axis=(1, 2))).tolist():
            outcome.broken("nothing is dimmed without a vehicle", states[number])
        return
    shares = np.einsum("psl,nsl->nps", place.leds_cd, levels).max(axis=(1, 2)) / place.limit_cd
    outcome.greatest_share_of_limit = max(outcome.greatest_share_of_limit, float(shares.max()))
    for number in np.flatnonzero(shares > EXCESS).tolist():
        outcome.broken("no more than the limit towards a vehicle", states[number])
    for number in np.flatnonzero((place.is_far & (np.abs(levels - slow) > 1e-12)).any(axis=(1, 2))).tolist():
        outcome.broken("an LED that shines elsewhere is not dimmed", states[number])
    for (_, _, checked), state in zip(lit, states, strict=True):
        right, left = checked.gaps_rad[0]
        if not (right <= place.azimuths_rad[0] + 1e-4 and place.azimuths_rad[1] - 1e-4 <= left):
            outcome.broken("a gap covers the vehicle", state)
        if checked.mode != BeamMode.GLARE_FREE:
            outcome.broken("no full beam beside a vehicle", state)


def outcome_table(outcome: Outcome) -> Table:
    shown = table("The guard, swept", ("",), ("states",))
    shown.add_row("tried", f"{outcome.num_states}")
    shown.add_row("of them with light", f"{outcome.num_lit}")
    shown.add_row("greatest share of a limit", f"{outcome.greatest_share_of_limit:.4f}")
    shown.add_row("counter-examples", f"{outcome.num_counter_examples}")
    for invariant, states in outcome.counter_examples.items():
        shown.add_row(f"not kept: {invariant}, such as {states[0]}", f"{len(states)}")
    return shown


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(__doc__, "guard_sweep", arguments)
    outcome = sweep(read_headlamps(), QUICK if given.quick else Grid())
    CONSOLE.print(outcome_table(outcome))
    write_results(
        given.out,
        {
            "num_states": outcome.num_states,
            "num_lit": outcome.num_lit,
            "greatest_share_of_limit": outcome.greatest_share_of_limit,
            "num_counter_examples": outcome.num_counter_examples,
        },
    )
    CONSOLE.print(f"look in {given.out}")


if __name__ == "__main__":
    main()
