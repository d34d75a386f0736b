"""The pipeline's input: an image, and what the car knew when it was taken."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike
from types import MappingProxyType, NoneType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.geometry import Camera, check_mount
from foreglow.numbers import checked_floats, checked_number
from foreglow.types.arrays import Image, Value, check_unmasked, checked_time_ns, frozen_view
from foreglow.wording import shortened

MAX_SPEED_MPS, MAX_YAW_RATE_RADPS, MAX_PITCH_RAD = 150.0, 3.0, 0.35
"""No car drives faster (540 km/h), or turns faster: at the limit of its tyres it is 1 rad/s, in a spin about 2. None
dives or squats by 20 degrees."""

MAX_HALF_WIDTH_M, MAX_CROSS_SLOPE, MAX_ROAD_NUMBER = 200.0, 1.6, 1e9
"""No carriageway of a map is so wide, or so steep across: that of OpenDRIVE's steepest road is 1.56, and 2.5 is one in
percent; and no coordinate is so large, of which others can be computed."""

COLOURLESS = 128
"""`Frame.red_chroma` of white, in 8 bits; `colourless` has that of 16 bits."""

MIN_STEP_S = 1e-3
"""No camera takes images in shorter intervals."""


def colourless(chroma: Image) -> int:
    """The value of white in `chroma`: half of those that its type has.

    >>> colourless(np.zeros((1, 1), np.uint8)), colourless(np.zeros((1, 1), np.uint16))
    (128, 32768)
    """
    return COLOURLESS << 8 * (chroma.itemsize - 1)


@dataclass(frozen=True, slots=True, eq=False)
class EgoMotion(Value):
    """Motion of our vehicle at the time of an image.

    Attributes:
        speed_mps: Forward speed.
        yaw_rate_radps: Rate of turn to the left.
        pitch_rad: Pitch of the body against the road, nose up, relative to its rest; NaN without a sensor.

    Raises:
        ValueError: If one is no number, speed or yaw rate is not finite, or the pitch is infinite.
    """

    speed_mps: float
    yaw_rate_radps: float
    pitch_rad: float = math.nan

    @property
    def is_possible(self) -> bool:
        """Whether a car can move so: within `MAX_SPEED_MPS`, `MAX_YAW_RATE_RADPS` and, if known, `MAX_PITCH_RAD`."""
        is_level = not abs(self.pitch_rad) > MAX_PITCH_RAD
        return is_level and abs(self.speed_mps) <= MAX_SPEED_MPS and abs(self.yaw_rate_radps) <= MAX_YAW_RATE_RADPS

    def __post_init__(self) -> None:
        for name in ("speed_mps", "yaw_rate_radps"):
            number = checked_number(f"EgoMotion.{name}", getattr(self, name))
            if not math.isfinite(number):
                raise ValueError(f"EgoMotion.{name}: expected a finite number, got {number}")
            object.__setattr__(self, name, number)
        pitch_rad = checked_number("EgoMotion.pitch_rad", self.pitch_rad)
        if math.isinf(pitch_rad):
            raise ValueError(f"EgoMotion.pitch_rad: expected a finite number or NaN, got {pitch_rad}")
        object.__setattr__(self, "pitch_rad", pitch_rad)


@dataclass(frozen=True, slots=True, eq=False)
class RoadAhead(Value):
    """The road in front of us by a map or a street message: a ribbon around the carriageway's centre line.

    Points are in the frame of the vehicle as the map assumes it to stand: on the road, and heading along it.

    Attributes:
        points_m: Shape (N, 3), N >= 2, the centre line in the vehicle's frame, metres, in the direction of driving, no
            two neighbours the same. It may end anywhere; the road beyond its end is unknown.
        half_width_m: From the centre line to either edge.
        cross_slopes: Shape (N,), rise for each metre to the left, no unit. An empty array, for a map without cross
            slopes, becomes zeros.
        error_bound_m: Largest error of the assumed position along the road; infinite where unknown.

    Raises:
        ValueError: If a shape is wrong, a number is not finite (the bound: NaN or negative) or that of no road, or two
            neighbouring points are the same.
    """

    points_m: NDArray[np.float64]
    half_width_m: float
    cross_slopes: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    error_bound_m: float = math.inf

    def __post_init__(self) -> None:
        points = checked_floats("RoadAhead.points_m", self.points_m)
        half_width_m = checked_number("RoadAhead.half_width_m", self.half_width_m)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2:
            raise ValueError(f"RoadAhead.points_m: expected shape (N, 3) with N >= 2, got {points.shape}")
        if not np.isfinite(points).all():
            raise ValueError("RoadAhead.points_m: expected finite numbers, got NaN or infinity")
        if np.abs(points).max() > MAX_ROAD_NUMBER:
            raise ValueError(
                f"RoadAhead.points_m: expected at most {MAX_ROAD_NUMBER:g} m, got {np.abs(points).max():g}"
            )
        is_same = ~np.diff(points, axis=0).any(axis=1)
        if is_same.any():
            raise ValueError(
                f"RoadAhead.points_m: expected neighbours that differ, points {int(np.flatnonzero(is_same)[0])} and "
                "the next are the same"
            )
        if not (math.isfinite(half_width_m) and half_width_m > 0):
            raise ValueError(f"RoadAhead.half_width_m: expected a positive number, got {self.half_width_m}")
        if half_width_m > MAX_HALF_WIDTH_M:
            raise ValueError(f"RoadAhead.half_width_m: expected at most {MAX_HALF_WIDTH_M:g}, got {self.half_width_m}")
        error_bound_m = checked_number("RoadAhead.error_bound_m", self.error_bound_m)
        if not error_bound_m >= 0:
            raise ValueError(f"RoadAhead.error_bound_m: expected a number of at least 0, got {error_bound_m}")
        slopes = checked_floats("RoadAhead.cross_slopes", self.cross_slopes)
        if not slopes.size:
            slopes = np.zeros(len(points))
        if slopes.shape != (len(points),) or not np.isfinite(slopes).all():
            raise ValueError(f"RoadAhead.cross_slopes: expected {len(points)} finite numbers, got {slopes.shape}")
        if np.abs(slopes).max() > MAX_CROSS_SLOPE:
            expected = f"expected rises for each metre of at most {MAX_CROSS_SLOPE:g}, not percent"
            raise ValueError(f"RoadAhead.cross_slopes: {expected}, got {np.abs(slopes).max():g}")
        object.__setattr__(self, "points_m", frozen_view(points))
        object.__setattr__(self, "half_width_m", half_width_m)
        object.__setattr__(self, "cross_slopes", frozen_view(slopes))
        object.__setattr__(self, "error_bound_m", error_bound_m)

    def __len__(self) -> int:
        return len(self.points_m)


@dataclass(frozen=True, slots=True, eq=False)
class Frame(Value):
    """One grey camera image, when it was taken, and what the car knew at that time.

    Attributes:
        image: Shape (height, width), uint8 or uint16, at least 1x1; any strides.
        timestamp_ns: Time of exposure in nanoseconds, of 64 bits; the zero is the source's own.
        frame: Number that identifies the image in its source: in PVDN its id, in a folder of images that are called by
            numbers its own, otherwise its index from 0.
        sequence: Name of the sequence; empty if the source has none.
        path: Origin of the image, for messages; empty for an array in memory.
        camera: Calibration for images of this size; without it, nothing has a range.
        motion: Motion of our vehicle; None where unknown.
        road: The road ahead by a map or a street message; None without either.
        is_damaged: Whether the source knows that the image is damaged, such as by a decoder that lost packets.
        is_reported: Whether the car's production system, if it has one, reports a vehicle; None where unknown.
        earlier: The image from shortly before that the source keeps beside this one, as data sets of single images do;
            None without one.
        red_chroma: Of a camera with colour, shape (ceil(height / 2), ceil(width / 2)), uint8 or uint16: how much
            redder than white light of any colour temperature it is, as a share of white, which is the greatest value of
            either type; see `datasets.images.red_chroma`. `colourless` for white, more for red. None without colour.

    Raises:
        ValueError: If the image is not two-dimensional, is empty, has masked pixels, or is neither uint8 nor uint16,
            the camera is for images of another size or not mounted as one that looks ahead, the number or the time is
            no whole number of 64 bits, another field is of a wrong type, the earlier image is not earlier, or of
            another size or dtype, or the chroma has another shape or type.
    """

    image: Image
    timestamp_ns: int
    frame: int = 0
    sequence: str = ""
    path: str = ""
    camera: Camera | None = None
    motion: EgoMotion | None = None
    road: RoadAhead | None = None
    is_damaged: bool = False
    is_reported: bool | None = None
    earlier: Frame | None = None
    red_chroma: Image | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.path, str):
            raise ValueError(f"Frame.path: expected a text, got {type(self.path).__name__}")
        origin = f"{self.path}: " if self.path else ""
        if not isinstance(self.image, np.ndarray) or self.image.ndim != 2:
            shape = getattr(self.image, "shape", type(self.image).__name__)
            raise ValueError(
                f"{origin}Frame.image: expected a grey array of shape (height, width), got {shape}; "
                f"{_remedy(self.image)}"
            )
        if self.image.dtype not in (np.uint8, np.uint16):
            raise ValueError(
                f"{origin}Frame.image: expected uint8 or uint16, got {_dtype_words(self.image)}; {_remedy(self.image)}"
            )
        if self.image.size == 0:
            raise ValueError(f"{origin}Frame.image: expected at least one pixel, got shape {self.image.shape}")
        check_unmasked(f"{origin}Frame.image", self.image)
        for name, (kinds, wanted) in _KINDS.items():
            value = getattr(self, name)
            if not isinstance(value, kinds) or (name == "frame" and isinstance(value, bool)):
                raise ValueError(f"{origin}Frame.{name}: expected {wanted}, got {type(value).__name__}")
        if not -(2**63) <= self.frame < 2**63:
            raise ValueError(f"{origin}Frame.frame: expected a whole number of 64 bits, got {shortened(self.frame)}")
        object.__setattr__(self, "frame", int(self.frame))
        if not isinstance(self.camera, Camera | None):
            raise ValueError(
                f"{origin}Frame.camera: expected a Camera, such as of foreglow.calibration.read_calibration(path), "
                f"got {type(self.camera).__name__}"
            )
        if self.camera is not None:
            check_mount(self.camera.vehicle_from_camera, f"{origin}Frame.camera.vehicle_from_camera")
        if self.camera is not None and (self.camera.height_px, self.camera.width_px) != self.image.shape:
            raise ValueError(
                f"{origin}Frame.camera: expected a calibration for images of {self.image.shape[1]}x"
                f"{self.image.shape[0]} px, got one for {self.camera.width_px}x{self.camera.height_px} px"
            )
        object.__setattr__(self, "timestamp_ns", checked_time_ns(f"{origin}Frame.timestamp_ns", self.timestamp_ns))
        object.__setattr__(self, "image", frozen_view(self.image))
        if self.earlier is not None and self.earlier.timestamp_ns >= self.timestamp_ns:
            raise ValueError(
                f"{origin}Frame.earlier: expected an image from before {self.timestamp_ns} ns, got one from "
                f"{self.earlier.timestamp_ns} ns"
            )
        earlier = self.image if self.earlier is None else self.earlier.image
        if (earlier.shape, earlier.dtype) != (self.image.shape, self.image.dtype):
            wanted, got = (f"{each.shape[1]}x{each.shape[0]} px, {each.dtype}" for each in (self.image, earlier))
            raise ValueError(f"{origin}Frame.earlier: expected an image of {wanted}, got {got}")
        if self.red_chroma is not None:
            check_unmasked(f"{origin}Frame.red_chroma", self.red_chroma)
            half = (-(-self.image.shape[0] // 2), -(-self.image.shape[1] // 2))
            shape, dtype = self.red_chroma.shape, self.red_chroma.dtype
            if shape != half or dtype not in (np.uint8, np.uint16):
                raise ValueError(
                    f"{origin}Frame.red_chroma: expected shape {half}, uint8 or uint16, got {shape}, {dtype}"
                )
            object.__setattr__(self, "red_chroma", frozen_view(self.red_chroma))

    @property
    def width_px(self) -> int:
        """Number of columns."""
        return int(self.image.shape[1])

    @property
    def height_px(self) -> int:
        """Number of rows."""
        return int(self.image.shape[0])


_KINDS: Mapping[str, tuple[tuple[type, ...], str]] = MappingProxyType(
    {
        "frame": ((int, np.integer), "a whole number"),
        "sequence": ((str,), "a name"),
        "motion": ((EgoMotion, NoneType), "an EgoMotion or None"),
        "road": ((RoadAhead, NoneType), "a RoadAhead or None"),
        "is_damaged": ((bool, np.bool_), "True or False"),
        "is_reported": ((bool, np.bool_, NoneType), "True, False or None"),
        "earlier": ((Frame, NoneType), "a Frame or None"),
        "red_chroma": ((np.ndarray, NoneType), "an array or None"),
    }
)
"""What the value of a field is."""


def _dtype_words(image: NDArray[Any]) -> str:
    own = image.dtype.newbyteorder("=")
    return f"{own}" if own == image.dtype else f"{own} with the bytes of each pixel in another order"


def _remedy(image: object) -> str:
    """What to call for a value that is no grey image."""
    if isinstance(image, str | PathLike):
        return "foreglow.open_source(path) yields the frames of an image, a folder or a video"
    if isinstance(image, np.ndarray) and image.ndim == 2 and not image.dtype.isnative:
        return f"image.astype('{image.dtype.newbyteorder('=')}') has them in this machine's"
    return "foreglow.to_grey(image) takes colour (R, G, B) and floats in [0, 1]"
