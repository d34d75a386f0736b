"""KITTI's calibration files: `calib_cam_to_cam.txt` of the raw drives, and the odometry and object sets' `calib.txt`.

A line is `key: numbers`. For camera NN the first kind of file has

    S_NN, K_NN, D_NN                   size, camera matrix and distortion k1 k2 p1 p2 k3 of the images as taken
    S_rect_NN, P_rect_NN               size and projection (3x4) of the rectified images

and the second has only `P0` to `P3`: projections of rectified images, without their size. The left 3x3 of a projection
is the camera matrix; its last column, the offset between the cameras, belongs to the mount and is not used.

Source: Geiger et al., Vision meets Robotics: The KITTI Dataset, IJRR 2013.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from foreglow.calibration.values import (
    NO_DISTORTION,
    Five,
    ImageChoice,
    Intrinsics,
    checked_distortion,
)
from foreglow.files import MIB, check_each_once, number_in, read_text
from foreglow.geometry import MAX_IMAGE_SIDE_PX, Floats

MAX_CALIBRATION_BYTES = MIB
"""Largest file of KITTI's: theirs have 4 kB."""


def read_kitti_intrinsics(path: Path, choice: ImageChoice) -> Intrinsics:
    """The camera in a file of KITTI's; a `calib.txt` is always about rectified images.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not text, an entry is missing, twice there, or not of the right count of finite numbers, a
            focal length is not positive, or the size is missing or differs from that asked for.
    """
    entries = _Entries(path)
    number = f"{choice.camera:02d}"
    if entries.has(f"P{choice.camera}"):
        size_px = choice.checked_size_px(None, f"{path}: size")
        return entries.pinhole(f"P{choice.camera}", size_px)
    if choice.is_rectified:
        size_px = choice.checked_size_px(entries.size_px(f"S_rect_{number}"), f"{path}: S_rect_{number}")
        return entries.pinhole(f"P_rect_{number}", size_px)
    size_px = choice.checked_size_px(entries.size_px(f"S_{number}"), f"{path}: S_{number}")
    k1, k2, p1, p2, k3 = entries.numbers(f"D_{number}", 5).tolist()
    distortion = checked_distortion((k1, k2, p1, p2, k3), f"{path}: D_{number}")
    return entries.pinhole(f"K_{number}", size_px, distortion).undistorted(f"{path}: D_{number}")


class _Entries:
    def __init__(self, path: Path) -> None:
        self._path = path
        lines = (line.partition(":") for line in read_text(path, MAX_CALIBRATION_BYTES).splitlines())
        entries = [(key.strip(), text) for key, colon, text in lines if colon]
        check_each_once((key for key, _ in entries), f"{path}: entries")
        self._texts = dict(entries)

    def has(self, key: str) -> bool:
        return key in self._texts

    def numbers(self, key: str, count: int) -> Floats:
        """The `count` finite numbers of an entry."""
        if key not in self._texts:
            known = ", ".join(list(self._texts)[:20]) or "none, expected lines such as `P0: numbers`"
            raise ValueError(f"{self._path}: {key}: missing, the file's entries are: {known}")
        words = self._texts[key].split()
        try:
            values = np.array([number_in(word) for word in words])
        except ValueError as error:
            raise ValueError(f"{self._path}: {key}: expected {count} numbers: {error}") from None
        if len(values) != count:
            raise ValueError(f"{self._path}: {key}: expected {count} numbers, got {len(values)}")
        if not np.isfinite(values).all():
            raise ValueError(f"{self._path}: {key}: expected finite numbers, got {' '.join(words)}")
        return values

    def size_px(self, key: str) -> tuple[int, int]:
        """Width and height in an entry."""
        width, height = self.numbers(key, 2).tolist()
        if not (width.is_integer() and height.is_integer() and min(width, height) >= 1):
            raise ValueError(
                f"{self._path}: {key}: expected a width and a height in whole pixels, got {width}x{height}"
            )
        if max(width, height) > MAX_IMAGE_SIDE_PX:
            expected = f"expected a width and a height of at most {MAX_IMAGE_SIDE_PX} px"
            raise ValueError(f"{self._path}: {key}: {expected}, got {width:g}x{height:g}")
        return int(width), int(height)

    def pinhole(self, key: str, size_px: tuple[int, int], distortion: Five = NO_DISTORTION) -> Intrinsics:
        """The camera whose matrix is in an entry."""
        values = self.numbers(key, 12 if key.startswith("P") else 9)
        return Intrinsics.of_matrix(values, size_px, f"{self._path}: {key}", distortion)
