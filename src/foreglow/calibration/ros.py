"""ROS's calibration files: the YAML that `camera_calibration` writes and `camera_info_manager` reads.

    image_width: 1280
    image_height: 960
    camera_name: front
    camera_matrix: {rows: 3, cols: 3, data: [1312, 0, 639.5, 0, 1312, 479.5, 0, 0, 1]}
    distortion_model: plumb_bob
    distortion_coefficients: {rows: 1, cols: 5, data: [-0.05, 0.02, 0, 0, 0]}
    rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
    projection_matrix: {rows: 3, cols: 4, data: [1300, 0, 639.5, 0, 0, 1300, 479.5, 0, 0, 0, 1, 0]}

A message as `ros2 topic echo --once` prints it (sensor_msgs/CameraInfo) can be read, too: `width`, `height`, `k`, `d`,
`p`. Its images must be whole: `binning_x` and `binning_y` 0 or 1, and `roi` empty.

Images as taken have `camera_matrix` and the distortion, rectified images have `projection_matrix` and no distortion.
The `rectification_matrix` turns a camera of a stereo pair: it belongs to the mount, and is not used.

Source: sensor_msgs/CameraInfo, docs.ros.org.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np
from pydantic import BeforeValidator, Field

from foreglow.calibration.values import NO_DISTORTION, Five, ImageChoice, Intrinsics, Side, checked_distortion
from foreglow.config import FrozenModel, validated
from foreglow.files import number_in, read_yaml

MODELS = ("plumb_bob", "rational_polynomial")
"""Distortion models that can be read; the second only if its terms beyond k3 are 0."""

NUM_TERMS = 5


def _number(value: Any) -> Any:
    """A number that YAML 1.1 reads as a text, such as 1e-05 without a dot; the C++ tools of ROS write it."""
    if isinstance(value, str):
        try:
            return number_in(value)
        except ValueError:
            return value
    return value


_Number: TypeAlias = Annotated[float, BeforeValidator(_number)]


class _Matrix(FrozenModel):
    rows: Annotated[int, Field(ge=0, le=1000)]
    cols: Annotated[int, Field(ge=0, le=1000)]
    data: Annotated[tuple[_Number, ...], Field(strict=False)]


_MATRICES = ("camera_matrix", "distortion_coefficients", "rectification_matrix", "projection_matrix")


class _File(FrozenModel):
    image_width: Side
    image_height: Side
    camera_name: Any = ""
    camera_matrix: _Matrix
    distortion_model: str
    distortion_coefficients: _Matrix
    rectification_matrix: _Matrix | None = None
    projection_matrix: _Matrix | None = None


_Whole: TypeAlias = Annotated[int, Field(ge=0, le=2**32 - 1)]


class _Region(FrozenModel):
    x_offset: _Whole = 0
    y_offset: _Whole = 0
    height: _Whole = 0
    width: _Whole = 0
    do_rectify: bool = False


class _Message(FrozenModel):
    """A CameraInfo; ROS 1 has its matrices in capitals."""

    header: Any = None
    height: Side
    width: Side
    distortion_model: str
    d: Annotated[tuple[_Number, ...], Field(strict=False)]
    k: Annotated[tuple[_Number, ...], Field(strict=False, min_length=9, max_length=9)]
    r: Annotated[tuple[_Number, ...], Field(strict=False, min_length=9, max_length=9)]
    p: Annotated[tuple[_Number, ...], Field(strict=False, min_length=12, max_length=12)]
    binning_x: _Whole = 0
    binning_y: _Whole = 0
    roi: _Region = _Region()

    def file(self, path: Path) -> _File:
        """The same as a calibration file has it.

        Raises:
            ValueError: If the images are not whole.
        """
        region = self.roi
        cut = (region.x_offset, region.y_offset, region.width, region.height)
        if max(self.binning_x, self.binning_y) > 1 or cut not in ((0, 0, 0, 0), (0, 0, self.width, self.height)):
            raise ValueError(
                f"{path}: binning_x, binning_y, roi: expected those of whole images, binning 0 or 1 and an empty roi, "
                f"got {self.binning_x}, {self.binning_y} and {cut[2]}x{cut[3]} px at {cut[:2]}; calibrate the "
                "images as they come"
            )
        k, r, p = (_Matrix(rows=3, cols=len(data) // 3, data=data) for data in (self.k, self.r, self.p))
        return _File(
            image_width=self.width,
            image_height=self.height,
            camera_matrix=k,
            distortion_model=self.distortion_model,
            distortion_coefficients=_Matrix(rows=1, cols=len(self.d), data=self.d),
            rectification_matrix=r,
            projection_matrix=p,
        )


def read_ros_intrinsics(path: Path, choice: ImageChoice) -> Intrinsics:
    """The camera in a file of ROS's.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not YAML, a field is missing, unknown, not a finite number or of the wrong count, the
            distortion model is unknown or needs terms beyond k3, or the size differs from that asked for.
    """
    file = _read(path)
    size_px = choice.checked_size_px((file.image_width, file.image_height), f"{path}: image_width, image_height")
    if choice.camera != 0:
        raise ValueError(f"{path}: camera: expected 0, a ROS file has one camera, got {choice.camera}")
    used, columns = ("projection_matrix", 4) if choice.is_rectified else ("camera_matrix", 3)
    given = file.projection_matrix if choice.is_rectified else file.camera_matrix
    if given is None:
        raise ValueError(f"{path}: {used}: missing, rectified images need it")
    if (given.rows, given.cols, len(given.data)) != (3, columns, 3 * columns):
        raise ValueError(
            f"{path}: {used}: expected 3 rows, {columns} columns and {3 * columns} numbers, got {given.rows} rows, "
            f"{given.cols} columns and {len(given.data)} numbers"
        )
    distortion = (
        NO_DISTORTION
        if choice.is_rectified
        else distortion_of(file.distortion_model, file.distortion_coefficients.data, str(path))
    )
    for name in _MATRICES:
        matrix = getattr(file, name)
        if matrix is not None and matrix.rows * matrix.cols != len(matrix.data):
            raise ValueError(
                f"{path}: {name}: expected as many numbers as rows and cols say, {matrix.rows} x {matrix.cols}, got "
                f"{len(matrix.data)}"
            )
    found = Intrinsics.of_matrix(np.array(given.data), size_px, f"{path}: {used}", distortion)
    return found.undistorted(f"{path}: distortion_coefficients")


def _read(path: Path) -> _File:
    fields = read_yaml(path)
    if not isinstance(fields, dict):
        raise ValueError(f"{path}: expected the fields {', '.join(_File.model_fields)}, got {type(fields).__name__}")
    message = {key.lower() if key in ("D", "K", "R", "P") else key: value for key, value in fields.items()}
    if "k" in message:
        return validated(_Message, message if len(message) == len(fields) else fields, str(path)).file(path)
    return validated(_File, fields, str(path))


def distortion_of(model: str, terms: tuple[float, ...], origin: str) -> Five:
    """k1, k2, p1, p2, k3 of ROS's distortion `model`.

    Raises:
        ValueError: If the model is unknown, needs terms beyond k3, or a term is that of no lens; the message begins
            with `origin`.
    """
    if model not in MODELS:
        raise ValueError(
            f"{origin}: distortion_model: expected one of {', '.join(MODELS)}, got {model!r}; rectify the images and "
            "ask for rectified ones"
        )
    if any(terms[NUM_TERMS:]):
        raise ValueError(
            f"{origin}: distortion_coefficients: expected k1, k2, p1, p2, k3 and no further term but 0, got "
            f"{list(terms)}; calibrate with plumb_bob, or rectify the images and ask for rectified ones"
        )
    if len(terms) not in (0, 4) and len(terms) < NUM_TERMS:
        raise ValueError(f"{origin}: distortion_coefficients: expected 0, 4, 5 or more numbers, got {len(terms)}")
    k1, k2, p1, p2, k3 = (*terms[:NUM_TERMS], *[0.0] * (NUM_TERMS - len(terms[:NUM_TERMS])))
    return checked_distortion((k1, k2, p1, p2, k3), f"{origin}: distortion_coefficients")
