"""Calibration files of all formats, by their endings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from foreglow.calibration.kitti import read_kitti_intrinsics
from foreglow.calibration.ros import read_ros_intrinsics
from foreglow.calibration.toml_file import read_toml_calibration, read_toml_intrinsics
from foreglow.calibration.values import ImageChoice, Intrinsics, Mount
from foreglow.files import checked_path
from foreglow.geometry import Camera
from foreglow.types.arrays import check_kind, check_optional

READERS: dict[str, Callable[[Path, ImageChoice], Intrinsics]] = {
    ".toml": read_toml_intrinsics,
    ".txt": read_kitti_intrinsics,
    ".yaml": read_ros_intrinsics,
    ".yml": read_ros_intrinsics,
}
"""Readers by the ending of the file."""


def read_intrinsics(path: Path | str, choice: ImageChoice | None = None) -> Intrinsics:
    """The camera in the file `path`, without its mount: TOML, KITTI's .txt or ROS's .yaml.

    Args:
        path: The file.
        choice: The kind of images, where the file has several; None for images as camera 0 took them.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If its ending is another, or it cannot be used; the message names path, field and expectation.
    """
    path = checked_path(path)
    check_optional("choice", choice, ImageChoice)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise ValueError(f"{path}: expected a calibration that ends in {', '.join(READERS)}, got {path.suffix!r}")
    return reader(path, choice or ImageChoice())


def read_calibration(path: Path | str, mount: Mount | None = None) -> Camera:
    """The camera in the file `path`.

    Args:
        path: A file as `read_intrinsics` takes it, for images as they were taken.
        mount: The camera's mount, in place of that of a TOML file; other files have none.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it cannot be used, or there is no mount; the message names path and field.
    """
    path = checked_path(path)
    if mount is not None:
        check_kind("mount", mount, Mount)
        return read_intrinsics(path).camera(mount)
    if path.suffix.lower() == ".toml":
        intrinsics, own = read_toml_calibration(path)
        return intrinsics.camera(own)
    read_intrinsics(path)
    raise ValueError(
        f"{path}: mount: missing, such a file has none; give a mount, or write a TOML file with a mount with "
        "`foreglow calibrate convert`"
    )
