"""Lamps, tracks, frames and commands without images of the road, for the tests of the fifth stage."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.beam.known_images import NUM_KNOWN
from foreglow.config import GuardConfig
from foreglow.geometry import Camera, Floats, Pose
from foreglow.photometry import Headlamp, Headlamps, low_beam, read_headlamps
from foreglow.photometry.matrix import LedGrid, grid_lamp
from foreglow.types import BeamCommand, BeamMode, EgoMotion, Frame, Image, Tracks, TrackState

Floats32 = NDArray[np.float32]

FRAME_NS = 55_555_556
FAST_MPS = 20.0


def guard_config(**changes: Any) -> GuardConfig:
    """A guard that takes ranges as two sigmas off, and a second to brighten: the numbers of these tests."""
    return GuardConfig(**({"range_sigmas": 2.0, "brightening_s": 1.0} | changes))


@dataclass(frozen=True, eq=False)
class FakeLamp:
    vehicle_from_lamp: Pose


@dataclass(frozen=True, eq=False)
class FakeLamps:
    """LEDs with Gaussian light: `num_rows` rows 1.5 degrees apart, each of columns 2 degrees apart."""

    num_rows: int = 2
    num_columns: int = 8
    left: FakeLamp = field(default_factory=lambda: FakeLamp(Pose(np.array([3.6, 0.6, 0.7]), np.eye(3))))
    right: FakeLamp = field(default_factory=lambda: FakeLamp(Pose(np.array([3.6, -0.6, 0.7]), np.eye(3))))

    @property
    def num_leds(self) -> int:
        return self.num_rows * self.num_columns

    def intensities_cd(self, directions: Floats, /) -> tuple[Floats, Floats]:
        x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
        azimuths, elevations = np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))
        columns = (np.arange(self.num_columns) - (self.num_columns - 1) / 2) * 2.0
        rows = np.arange(self.num_rows) * 1.5 + 0.2
        turns = np.array([0.4, -0.4])  # the lamps mesh
        across = np.exp(-0.5 * ((azimuths[:, None, None] - columns - turns[:, None]) / 0.8) ** 2)
        along = np.exp(-0.5 * ((elevations[:, None] - rows) / 0.7) ** 2)
        leds = 20_000.0 * along[:, None, :, None] * across[:, :, None, :]
        return np.full((len(azimuths), 2), 200.0), leds.reshape(len(azimuths), 2, -1)

    def greatest_cd(self, azimuths_deg: Floats, elevations_deg: Floats, /) -> tuple[Floats32, Floats32]:
        columns = (np.arange(self.num_columns) - (self.num_columns - 1) / 2) * 2.0
        rows = np.arange(self.num_rows) * 1.5 + 0.2
        below = np.maximum(elevations_deg[:-1, None] - rows, 0) + np.maximum(rows - elevations_deg[1:, None], 0)
        along = np.exp(-0.5 * (below / 0.7) ** 2)
        tables = []
        for middles in (columns + 0.4, columns - 0.4):
            aside = np.maximum(azimuths_deg[:-1, None] - middles, 0) + np.maximum(middles - azimuths_deg[1:, None], 0)
            across = np.exp(-0.5 * (aside / 0.8) ** 2)
            leds = 20_000.0 * along[:, None, :, None] * across[None, :, None, :]
            tables.append(leds.reshape(len(along), len(across), -1).astype(np.float32))
        return tables[0], tables[1]


def lamps_of(grid: LedGrid) -> Headlamps:
    """Two lamps with these LEDs, where those that ship are."""
    shipped = read_headlamps()
    left, right = (
        Headlamp(lamp.vehicle_from_lamp, grid_lamp(low_beam(), grid)) for lamp in (shipped.left, shipped.right)
    )
    return Headlamps("made up", left, right)


def camera(distortion: tuple[float, float, float, float, float] = (-0.07, 0.015, 1e-4, -2e-5, 0.0)) -> Camera:
    """As those of simulated drives: a little turned, with distortion."""
    mount = Pose(np.array([1.8, 0.02, 1.35]), np.eye(3))
    return Camera(1280, 960, (1350.0, 1350.0), (640.0, 490.0), distortion, mount)


CAMERA = camera()


def noisy_image(seed: int) -> Image:
    """A dark image of noise, with a light that is elsewhere for each seed, off the grid of encoders."""
    image = np.random.default_rng(seed).integers(10, 35, (960, 1280), np.uint8)
    column = 101 + 370 * seed % 1000
    image[401:561, column : column + 160] = 200
    return image


IMAGES = [noisy_image(seed) for seed in range(NUM_KNOWN + 12)]  # a few may be left out, and none comes again soon


def frame_at(
    number: int,
    *,
    speed_mps: float | None = FAST_MPS,
    image: Image | None = None,
    timestamp_ns: int | None = None,
    with_camera: bool = True,
) -> Frame:
    """Frame `number` of a drive at 18 Hz; each image is another than the one before."""
    return Frame(
        IMAGES[number % len(IMAGES)] if image is None else image,
        number * FRAME_NS if timestamp_ns is None else timestamp_ns,
        frame=number,
        camera=CAMERA if with_camera else None,
        motion=None if speed_mps is None else EgoMotion(speed_mps, 0.0),
    )


def box_around(azimuth_rad: float, elevation_rad: float, width_rad: float) -> Floats:
    """The box in the camera's image whose middle is seen in a direction of the vehicle's frame, as wide as high."""
    ahead = np.array(
        [
            np.cos(elevation_rad) * np.cos(azimuth_rad),
            np.cos(elevation_rad) * np.sin(azimuth_rad),
            np.sin(elevation_rad),
        ]
    )
    x, y = CAMERA.project(ahead @ CAMERA.vehicle_from_camera.rotation)
    half_px = CAMERA.focal_px[0] * np.tan(width_rad / 2)
    return np.array([x - half_px, y - half_px, x + half_px, y + half_px])


def tracks_of(
    boxes: list[Floats],
    ranges_m: list[float],
    *,
    sigmas_m: list[float] | None = None,
    ages_s: float = 1.0,
    states: list[TrackState] | None = None,
    first_id: int = 0,
) -> Tracks:
    """Confirmed tracks, all equally old; the sigma is a tenth of the range where none is given."""
    count, ranges = len(boxes), np.array(ranges_m, np.float64)
    sigmas = np.where(np.isnan(ranges), np.inf, 0.1 * ranges) if sigmas_m is None else np.array(sigmas_m, np.float64)
    return Tracks(
        ids=np.arange(first_id, first_id + count),
        states=np.array(states if states is not None else [TrackState.CONFIRMED] * count, np.int64),
        boxes_xyxy_px=np.array(boxes, np.float64).reshape(-1, 4),
        confidences=np.full(count, 0.9),
        num_hits=np.full(count, 9),
        num_misses=np.zeros(count, np.int64),
        ages_s=np.full(count, ages_s),
        ranges_m=ranges,
        sigmas_m=sigmas,
        detections=np.full(count, -1),
    )


def full(frame: Frame, num_leds: int, level: float = 1.0) -> BeamCommand:
    """Full high beam, as far as a level tells."""
    return BeamCommand(frame.timestamp_ns, BeamMode.FULL, np.full((2, num_leds), level))


def from_origin(azimuth_rad: float, range_m: float) -> tuple[float, float]:
    """Azimuth and range from the vehicle's origin of what `CAMERA` sees."""
    x, y, _ = CAMERA.vehicle_from_camera.position_m
    point = complex(x + range_m * np.cos(azimuth_rad), y + range_m * np.sin(azimuth_rad))
    return float(np.angle(point)), abs(point)
