"""Generated night road frames for pictures and timing: nothing measured, nothing that would need a licence.

`python -m benchmarks.synthetic_frames FOLDER [--count N]` writes them as PNG.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

WIDTH_PX, HEIGHT_PX = 1280, 960
HORIZON_PX = 500
"""Row of the horizon."""


def night_frame(seed: int = 0, range_m: float = 70.0) -> NDArray[np.uint8]:
    """A dark country road that bends right, with an oncoming car at `range_m` and its light ahead of it.

    Light adds up linearly; the camera then answers with the logarithm, as high-dynamic-range cameras do.

    Args:
        seed: Of the noise and of the verge.
        range_m: How far away the car is; its lamps and their glow shrink with it.

    Returns:
        Shape (960, 1280), uint8.
    """
    generator = np.random.default_rng(seed)
    rows, columns = np.mgrid[:HEIGHT_PX, :WIDTH_PX].astype(np.float64)
    depth_m = 1300.0 / np.maximum(rows - HORIZON_PX, 0.5)  # flat ground, camera 1.3 m high, focal length 1000 px
    is_ground = rows > HORIZON_PX + 2
    centre_px = 620.0 + 11.0 * (depth_m / 12.0) ** 1.6  # the bend
    across_m = (columns - centre_px) * depth_m / 1000.0

    light = np.full((HEIGHT_PX, WIDTH_PX), 0.35)
    own_beam = np.exp(-(((columns - 660) / 520.0) ** 2)) * np.exp(-depth_m / 26.0) * (1 - np.exp(-depth_m / 4.5))
    texture = cv2.GaussianBlur(generator.normal(1.0, 0.5, rows.shape), (0, 0), 2.0)
    verge = 0.35 + 0.9 * np.clip(texture - 0.8, 0, None) * generator.uniform(0.6, 1.4, rows.shape)
    is_road = np.abs(across_m) < 3.2
    ground = np.where(is_road, 0.55, verge * np.exp(-np.maximum(np.abs(across_m) - 3.2, 0) / 5.0))
    is_line = np.abs(np.abs(across_m) - 2.9) < 0.07
    is_dash = (np.abs(across_m) < 0.06) & ((depth_m % 12.0) < 5.0)
    ground = np.where((is_line | is_dash) & is_road, 2.4, ground)
    light += np.where(is_ground, 10.0 * own_beam * ground, 0.0)

    _add_posts(light, depth_m[:, 0])
    _add_car(light, range_m)
    light = cv2.GaussianBlur(light, (0, 0), 1.1) + 0.05 * cv2.GaussianBlur(light, (0, 0), 14.0)  # optics, stray light
    signal = 20.0 * np.log1p(1.6 * light)
    columns_noise = generator.normal(0.0, 0.3, (1, WIDTH_PX))
    noisy = signal + generator.normal(0.0, 0.3, signal.shape) + columns_noise
    return np.asarray(np.clip(np.rint(noisy), 0, 255), np.uint8)


def _add_posts(light: NDArray[np.float64], depth_of_row_m: NDArray[np.float64]) -> None:
    """Adds the delineator posts along the right verge, each with its reflector."""
    for range_m in (16.0, 26.0, 40.0, 60.0):
        foot_px = int(np.argmin(np.abs(depth_of_row_m - range_m)))
        column_px = int(620 + 11.0 * (range_m / 12.0) ** 1.6 + 4.1 * 1000.0 / range_m)
        height_px, half_px = int(1000 / range_m), max(2, int(90 / range_m))
        if column_px + half_px < WIDTH_PX:
            across = slice(column_px - half_px, column_px + half_px + 1)
            top_px = foot_px - int(0.8 * height_px)
            light[foot_px - height_px : foot_px, across] += 160.0 / range_m
            light[top_px : top_px + max(2, height_px // 5), across] += 6000.0 / range_m


def _add_car(light: NDArray[np.float64], range_m: float) -> None:
    """Adds an oncoming car's two lamps, their glow, and their light on the road and the verge."""
    rows, columns = np.mgrid[: light.shape[0], : light.shape[1]]
    column_px = 620 + 11.0 * (range_m / 12.0) ** 1.6 - 1700.0 / range_m
    row_px = HORIZON_PX + 650.0 / range_m
    for side_m in (-0.65, 0.65):
        lamp_px = column_px + 1000.0 * side_m / range_m
        radius_px = 1.0 + 240.0 / range_m
        distance_px = np.hypot(columns - lamp_px, rows - row_px)
        light += 20000.0 * np.exp(-((distance_px / radius_px) ** 2)) + 25.0 / (1.0 + (distance_px / 9.0) ** 2)
    on_road = ((columns - column_px + 60) / 75.0) ** 2 + ((rows - row_px - 14) / 5.0) ** 2
    light += 16.0 * np.exp(-on_road)
    on_verge = ((columns - column_px + 210) / 60.0) ** 2 + ((rows - row_px + 2) / 7.0) ** 2
    light += 7.0 * np.exp(-on_verge)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=1)
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for index in range(arguments.count):
        image = night_frame(index, 70.0 - 20.0 * index / max(1, arguments.count))
        (arguments.folder / f"{index:06d}.png").write_bytes(cv2.imencode(".png", image)[1].tobytes())


if __name__ == "__main__":
    main()
