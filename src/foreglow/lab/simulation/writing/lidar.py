"""A sparse, noisy depth image such as a LiDAR beside the camera gives, made from an exact depth image."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from foreglow.config import FrozenModel
from foreglow.datasets.simulated.files import encoded_depth
from foreglow.geometry import Camera

_Share = Annotated[float, Field(ge=0, le=1)]
_Elevation = Annotated[float, Field(ge=-90, le=90)]


class LidarConfig(FrozenModel):
    """The scanner; it is at the camera's position and level with the vehicle.

    Attributes:
        num_rings: Rings, evenly spread over the elevation.
        lowest_deg: Elevation of the lowest ring.
        highest_deg: Elevation of the highest ring.
        azimuth_step_deg: Step between two shots of a ring.
        max_range_m: There are no echoes from beyond; at most 255 m can be stored.
        noise_m: Standard deviation of the range.
        near_loss: Share of the shots without an echo right before the scanner.
        far_loss: The same at `max_range_m`; in between it grows with the square of the range, as echoes get weaker.
    """

    num_rings: Annotated[int, Field(ge=1, le=1024)] = 64
    lowest_deg: _Elevation = -25.0
    highest_deg: _Elevation = 15.0
    azimuth_step_deg: Annotated[float, Field(ge=0.01, le=10)] = 0.2
    max_range_m: Annotated[float, Field(gt=0, le=255)] = 200.0
    noise_m: Annotated[float, Field(ge=0, le=10)] = 0.02
    near_loss: _Share = 0.02
    far_loss: _Share = 0.5


def lidar_depth(
    depth_m: NDArray[np.floating], camera: Camera, rng: np.random.Generator, config: LidarConfig | None = None
) -> NDArray[np.uint16]:
    """What the scanner sees of an exact depth image, shape (height, width), uint16, as `encoded_depth` stores it.

    A shot has the depth of the pixel that it falls into; of several in one pixel the nearest counts.

    Args:
        depth_m: Shape (height, width) as the camera has it, distance along each pixel's ray; NaN where there is none.
        camera: Its calibration.
        rng: For noise and losses.
        config: The scanner.

    Raises:
        ValueError: If the shape is not the camera's.
    """
    config = config or LidarConfig()
    if depth_m.shape != (camera.height_px, camera.width_px):
        raise ValueError(f"depth_m: expected shape {(camera.height_px, camera.width_px)}, got {depth_m.shape}")
    pixels = scan_pixels(camera, config)
    ranges_m = depth_m[pixels[:, 1], pixels[:, 0]].astype(np.float64)
    losses = config.near_loss + (config.far_loss - config.near_loss) * (ranges_m / config.max_range_m) ** 2
    # Both are drawn for every shot, so that a shot into the sky does not change the others.
    measured_m = ranges_m + rng.normal(0.0, config.noise_m, len(ranges_m))
    is_echo = rng.random(len(ranges_m)) >= losses
    is_echo &= (ranges_m <= config.max_range_m) & (measured_m > 0)
    order = np.flatnonzero(is_echo)[np.argsort(-measured_m[is_echo], kind="stable")]
    depth = np.zeros(depth_m.shape, np.uint16)
    depth[pixels[order, 1], pixels[order, 0]] = encoded_depth(measured_m[order])
    return depth


def scan_pixels(camera: Camera, config: LidarConfig) -> NDArray[np.intp]:
    """Pixels (column, row) of the shots inside the image, ring by ring from below, shape (N, 2)."""
    corners = camera.rays([[x, y] for x in (0, camera.width_px) for y in (0, camera.height_px)])
    reach_deg = float(np.degrees(np.arccos(corners[:, 0].min())))
    mount = camera.vehicle_from_camera.rotation
    middle_deg = float(np.degrees(np.arctan2(mount[1, 0], mount[0, 0])))
    num = int(reach_deg / config.azimuth_step_deg) + 1
    azimuths = np.radians(middle_deg + np.arange(-num, num + 1) * config.azimuth_step_deg)
    elevations = np.radians(np.linspace(config.lowest_deg, config.highest_deg, config.num_rings))[:, None]
    shots_vehicle = np.stack(
        np.broadcast_arrays(
            np.cos(elevations) * np.cos(azimuths), np.cos(elevations) * np.sin(azimuths), np.sin(elevations)
        ),
        -1,
    ).reshape(-1, 3)
    shots = shots_vehicle @ mount
    # Beyond the corners the lens's polynomial may fold back into the image.
    shots = shots[shots[:, 0] >= corners[:, 0].min()]
    pixels = np.floor(camera.project(shots)).astype(np.intp)
    is_inside = ((pixels >= 0) & (pixels < [camera.width_px, camera.height_px])).all(-1)
    return np.asarray(pixels[is_inside])
