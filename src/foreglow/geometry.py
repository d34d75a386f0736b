"""Coordinate frames: the world, a vehicle, a camera and its pixels. No other file defines them.

* World: x east, y north, z up, metres.
* Vehicle: x forward, y left, z up, metres; the origin lies on the road under the middle of the rear axle.
* Camera and lamp: x along the axis, y left, z up, metres, like the vehicle.
* Image: x = column to the right, y = row downwards, pixels; the centre of the upper left pixel is (0.5, 0.5).

A rotation `world_from_vehicle` has the vehicle's forward, left and up as columns, written in the world.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foreglow.numbers import checked_floats, checked_number, checked_points, checked_whole
from foreglow.wording import shortened

Floats = NDArray[np.float64]

MAX_FOCAL_PX = 1e6
"""Far beyond any lens, as is `MAX_DISTORTION`; what is computed from other numbers overflows."""

MAX_DISTORTION = 1e6
"""Of each coefficient; fits of long lenses, which do not show k3, have given 1e4."""

MAX_IMAGE_SIDE_PX = 2**20
"""Far beyond any sensor; a calibration may be for larger images than those that are read, which are scaled."""

MAX_FOV_DEG = 170.0
"""Of a lens whose images are flat; a focal length in millimetres in place of pixels gives more."""

MAX_MOUNT_M = (30.0, 10.0, 10.0)
"""Forward of the rear axle or behind it, to either side, and above the road: ranges of a camera anywhere else, or
below the road, would be nonsense."""

MAX_TURN_DEG = 45.0
"""Yaw, pitch or roll: beyond it a camera no longer looks along the road ahead, of which all ranges are, or what is to
the right of something is no longer to the right in its image."""

MAX_CENTRE_SIDES = 2.0
"""How far a principal point may lie outside its image, in longer sides of it: images are cut out of larger ones."""

NUM_UNDISTORTION_STEPS, LEAST_UNDISTORTION_STEP = 60, 1e-13
"""Fixed-point steps that invert the distortion, unless all are smaller, in focal lengths. With ordinary lenses the
error is below 1e-9 after ten, and at the corners of KITTI's wide ones each step halves it."""

MAX_REPROJECTION = 1e-6
"""A pixel whose ray does not project back to it this closely, in longer sides of the image, has no ray, because the
distortion folds over there."""

NUM_CHECKED_NODES = 33
"""Pixels a side, corners included, at which the distortion of a calibration is undone when it is read."""


def rotation(yaw_rad: float = 0.0, pitch_rad: float = 0.0, roll_rad: float = 0.0) -> Floats:
    """Rotation dst_from_body, shape (3, 3): yaw to the left about z, then pitch upwards, then roll to the right.

    Raises:
        ValueError: If an angle is no number.

    >>> bool(rotation(pitch_rad=0.1)[2, 0] > 0)  # the nose goes up
    True
    """
    yaw_rad, pitch_rad = checked_number("yaw_rad", yaw_rad), checked_number("pitch_rad", pitch_rad)
    roll_rad = checked_number("roll_rad", roll_rad)
    cy, sy, cp, sp = np.cos(yaw_rad), np.sin(yaw_rad), np.cos(pitch_rad), np.sin(pitch_rad)
    cr, sr = np.cos(roll_rad), np.sin(roll_rad)
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    about_y = np.array([[cp, 0.0, -sp], [0.0, 1.0, 0.0], [sp, 0.0, cp]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return np.asarray(about_z @ about_y @ about_x)


def rotation_angles_rad(turned: ArrayLike) -> tuple[float, float, float]:
    """Yaw, pitch and roll whose `rotation` is `turned`, shape (3, 3); roll is 0 where the axis points up or down.

    >>> np.allclose(rotation_angles_rad(rotation(2.0, -0.3, 0.1)), (2.0, -0.3, 0.1))
    True
    """
    matrix = checked_points("turned", turned, 3)
    if matrix.shape != (3, 3):
        raise ValueError(f"turned: expected numbers of shape (3, 3), got shape {matrix.shape}")
    forward = float(np.hypot(matrix[0, 0], matrix[1, 0]))
    pitch = float(np.arctan2(matrix[2, 0], forward))
    if forward < 1e-9:  # yaw and roll turn about the same axis
        return float(np.arctan2(-matrix[0, 1], matrix[1, 1])), pitch, 0.0
    yaw, roll = np.arctan2(matrix[1, 0], matrix[0, 0]), np.arctan2(matrix[2, 1], matrix[2, 2])
    return float(yaw), pitch, float(roll)


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Position and orientation of a body in an outer frame: dst_from_body. It is equal to itself alone, not to copies.

    Attributes:
        position_m: Shape (3,), the body's origin in the outer frame.
        rotation: Shape (3, 3), columns are the body's forward, left and up in the outer frame.

    Raises:
        ValueError: If a shape is wrong, a value is not finite, or the matrix is not a rotation.
    """

    position_m: Floats
    rotation: Floats

    def __post_init__(self) -> None:
        position, turned = (
            checked_floats("Pose.position_m", self.position_m),
            checked_floats("Pose.rotation", self.rotation),
        )
        if position.shape != (3,) or not np.isfinite(position).all():
            raise ValueError(f"Pose.position_m: expected three finite numbers, got {shortened(self.position_m)}")
        is_rotation = turned.shape == (3, 3) and np.allclose(turned @ turned.T, np.eye(3), atol=1e-6)
        if not is_rotation or np.linalg.det(turned) < 0:  # not a reflection either
            raise ValueError(f"Pose.rotation: expected a rotation of shape (3, 3), got {shortened(self.rotation)}")
        for name, array in (("position_m", position), ("rotation", turned)):
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def to_outer(self, points_body: ArrayLike) -> Floats:
        """Points of shape (..., 3) in the body's frame, transformed to the outer frame."""
        return checked_points("points_body", points_body, 3) @ self.rotation.T + self.position_m

    def to_body(self, points_outer: ArrayLike) -> Floats:
        """Points of shape (..., 3) in the outer frame, transformed to the body's frame."""
        return np.asarray((checked_points("points_outer", points_outer, 3) - self.position_m) @ self.rotation)

    def __matmul__(self, inner: Pose) -> Pose:
        """The pose, in this pose's outer frame, of a body whose pose in this body's frame is `inner`.

        Raises:
            ValueError: If `inner` is no pose.
        """
        if not isinstance(inner, Pose):
            raise ValueError(f"inner: expected Pose, got {type(inner).__name__}")
        return Pose(self.to_outer(inner.position_m), self.rotation @ inner.rotation)


@dataclass(frozen=True, slots=True)
class MountSigmas:
    """Standard deviations of a camera's mount; all zero for a calibration that counts as exact.

    Attributes:
        yaw_rad: Of the yaw.
        pitch_rad: Of the pitch.
        roll_rad: Of the roll.
        height_m: Of the height above the road.

    Raises:
        ValueError: If one is negative or not finite.
    """

    yaw_rad: float = 0.0
    pitch_rad: float = 0.0
    roll_rad: float = 0.0
    height_m: float = 0.0

    def __post_init__(self) -> None:
        for name in ("yaw_rad", "pitch_rad", "roll_rad", "height_m"):
            sigma = checked_number(f"MountSigmas.{name}", getattr(self, name))
            if not 0.0 <= sigma < np.inf:
                raise ValueError(f"MountSigmas.{name}: expected a number of at least 0, got {sigma}")
            object.__setattr__(self, name, sigma)


def check_lens(size_px: tuple[int, int], focal_px: tuple[float, float], field: str) -> None:
    """Checks that a lens whose images are flat may have these focal lengths fx, fy in an image of this size.

    Raises:
        ValueError: If it would see more than `MAX_FOV_DEG`; the message begins with `field`.
    """
    for side_px, length_px in zip(size_px, focal_px, strict=True):
        fov_deg = math.degrees(2 * math.atan2(side_px / 2, length_px))
        if fov_deg > MAX_FOV_DEG:
            expected = f"focal lengths in pixels, for a field of view of at most {MAX_FOV_DEG:g} degrees"
            got = f"{length_px:g} px, {fov_deg:.1f} degrees for {side_px} px"
            raise ValueError(f"{field}: expected {expected}, got {got}")


def check_mount(vehicle_from_camera: Pose, field: str) -> None:
    """Checks that a camera may be mounted so in a vehicle.

    Raises:
        ValueError: If its position is beyond `MAX_MOUNT_M` or not above the road, or an angle is beyond `MAX_TURN_DEG`;
            the message begins with `field`.
    """
    fault = _mount_fault(vehicle_from_camera)
    if fault:
        raise ValueError(f"{field}.{fault}")


@lru_cache(maxsize=8)  # a camera is that of many frames
def _mount_fault(vehicle_from_camera: Pose) -> str:
    position_m = vehicle_from_camera.position_m
    if not ((np.abs(position_m) <= MAX_MOUNT_M).all() and position_m[2] > 0.0):
        ahead_m, aside_m, above_m = MAX_MOUNT_M
        expected = f"at most {ahead_m:g} m from the rear axle, {aside_m:g} m from the middle, 0 to {above_m:g} m high"
        return f"position_m: expected a camera {expected}, got {position_m.tolist()}"
    angles_deg = np.degrees(rotation_angles_rad(vehicle_from_camera.rotation))
    if np.abs(angles_deg).max() > MAX_TURN_DEG + 1e-6:
        expected = f"yaw, pitch and roll of at most {MAX_TURN_DEG:g} degrees"
        return f"rotation: expected {expected}, got {', '.join(f'{angle:.1f}' for angle in angles_deg)}"
    return ""


def check_centre(centre_px: tuple[float, float], size_px: tuple[int, int], field: str) -> None:
    """Checks that a principal point is near its image.

    Args:
        centre_px: Principal point cx, cy.
        size_px: Width and height of the image.
        field: Path and field, for messages.

    Raises:
        ValueError: If it is further outside than `MAX_CENTRE_SIDES`.
    """
    margin_px = MAX_CENTRE_SIDES * max(size_px)
    if not all(-margin_px <= at_px <= side_px + margin_px for at_px, side_px in zip(centre_px, size_px, strict=True)):
        expected = f"expected a principal point at most {margin_px:g} px outside the image of {size_px[0]}x{size_px[1]}"
        raise ValueError(f"{field}: {expected} px, got ({centre_px[0]:g}, {centre_px[1]:g})")


@lru_cache(maxsize=64)  # the cameras of many scenes are one camera
def check_distortion(
    size_px: tuple[int, int],
    focal_px: tuple[float, float],
    centre_px: tuple[float, float],
    distortion: tuple[float, float, float, float, float],
    field: str,
) -> None:
    """Checks that a distortion can be undone everywhere in its image.

    Args:
        size_px: Width and height of the image.
        focal_px: Focal lengths fx, fy.
        centre_px: Principal point cx, cy.
        distortion: k1, k2, p1, p2, k3.
        field: Path and field, for messages.

    Raises:
        ValueError: If it folds over at one of `NUM_CHECKED_NODES` pixels a side, or another number is not of a camera.
    """
    if any(distortion):
        camera = Camera(*size_px, focal_px, centre_px, distortion, Pose(np.zeros(3), np.eye(3)))
        columns_px, rows_px = (np.linspace(0.0, side_px, NUM_CHECKED_NODES) for side_px in size_px)
        camera.node_rays(columns_px, rows_px, field)


@dataclass(frozen=True)
class Camera:
    """A calibrated pinhole camera with Brown-Conrady distortion.

    Attributes:
        width_px: Columns of the image.
        height_px: Rows of the image.
        focal_px: Focal lengths fx, fy.
        centre_px: Principal point cx, cy.
        distortion: k1, k2, p1, p2, k3, no unit (OpenCV's order).
        vehicle_from_camera: Pose of the camera in the vehicle.
        mount_sigmas: How well that pose is known.

    Raises:
        ValueError: If a field is of a wrong type or number, a size is not positive or beyond `MAX_IMAGE_SIDE_PX`, or a
            number is not finite or not of a lens.
    """

    width_px: int
    height_px: int
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float]
    vehicle_from_camera: Pose
    mount_sigmas: MountSigmas = MountSigmas()

    def __post_init__(self) -> None:
        for name in ("width_px", "height_px"):
            value = getattr(self, name)
            if not isinstance(value, int | np.integer) or isinstance(value, bool):
                raise ValueError(f"Camera.{name}: expected a whole number, got {shortened(value)}")
            object.__setattr__(self, name, int(value))
        if not (min(self.width_px, self.height_px) >= 1 and max(self.width_px, self.height_px) <= MAX_IMAGE_SIDE_PX):
            expected = f"expected a size of 1x1 to {MAX_IMAGE_SIDE_PX}x{MAX_IMAGE_SIDE_PX}"
            raise ValueError(f"Camera: {expected}, got {shortened(f'{self.width_px}x{self.height_px}')}")
        for name, count in (("focal_px", 2), ("centre_px", 2), ("distortion", 5)):
            numbers = checked_floats(f"Camera.{name}", getattr(self, name))
            if numbers.shape != (count,):
                raise ValueError(f"Camera.{name}: expected {count} numbers, got {shortened(getattr(self, name))}")
            if not np.isfinite(numbers).all():
                raise ValueError(f"Camera.{name}: expected finite numbers, got {getattr(self, name)}")
            object.__setattr__(self, name, tuple(numbers.tolist()))  # what is compared and cannot change later
        for name, kind in (("vehicle_from_camera", Pose), ("mount_sigmas", MountSigmas)):
            if not isinstance(getattr(self, name), kind):
                got = type(getattr(self, name)).__name__
                raise ValueError(f"Camera.{name}: expected {kind.__name__}, got {got}")
        if not (min(self.focal_px) > 0 and max(self.focal_px) <= MAX_FOCAL_PX):
            expected = f"expected two positive numbers of at most {MAX_FOCAL_PX:g}"
            raise ValueError(f"Camera.focal_px: {expected}, got {self.focal_px}")
        check_lens((self.width_px, self.height_px), self.focal_px, "Camera.focal_px")
        check_centre(self.centre_px, (self.width_px, self.height_px), "Camera.centre_px")
        if max(map(abs, self.distortion)) > MAX_DISTORTION:
            raise ValueError(f"Camera.distortion: expected at most {MAX_DISTORTION:g}, got {self.distortion}")

    def has_shape_of(self, width_px: int, height_px: int) -> bool:
        """Whether an image of this size has the aspect ratio of the camera's, to a pixel, so that it may be scaled.

        Raises:
            ValueError: If a side is no whole number of at least 1.
        """
        width_px, height_px = checked_whole("width_px", width_px, 1), checked_whole("height_px", height_px, 1)
        return abs(self.height_px * width_px / self.width_px - height_px) <= 1.0

    def scaled(self, width_px: int, height_px: int) -> Camera:
        """The same camera with an image of another size and the same field of view.

        Raises:
            ValueError: If a side is no whole number of at least 1, or no camera's.
        """
        width_px, height_px = checked_whole("width_px", width_px, 1), checked_whole("height_px", height_px, 1)
        fx, fy = width_px / self.width_px, height_px / self.height_px
        return replace(
            self,
            width_px=width_px,
            height_px=height_px,
            focal_px=(self.focal_px[0] * fx, self.focal_px[1] * fy),
            centre_px=(self.centre_px[0] * fx, self.centre_px[1] * fy),
        )

    def project(self, points_camera: ArrayLike) -> Floats:
        """Pixels (x, y), shape (..., 2), of points of shape (..., 3) in the camera's frame; NaN behind the camera, and
        for points that are NaN, infinite, or so far aside that the pixel would be.

        Beyond the field of view, the distortion polynomial may fold back into the image; check the size of the image
        and the angle.

        Raises:
            ValueError: If they are no numbers of that shape.
        """
        points = checked_points("points_camera", points_camera, 3)
        forward = np.where((points[..., 0] > 1e-9) & (points[..., 0] < np.inf), points[..., 0], np.nan)
        with np.errstate(over="ignore", invalid="ignore"):
            u, v = self._distorted(-points[..., 1] / forward, -points[..., 2] / forward)
            x, y = self.centre_px[0] + self.focal_px[0] * u, self.centre_px[1] + self.focal_px[1] * v
            is_anywhere = np.isfinite(x + y)
        pixels = np.stack([x, y], -1)
        if not is_anywhere.all():
            pixels[~is_anywhere] = np.nan
        return pixels

    def rays(self, pixels: ArrayLike) -> Floats:
        """Unit directions, shape (..., 3), in the camera's frame, through the pixels (x, y) of shape (..., 2);
        NaN for pixels that are NaN or infinite.

        Raises:
            ValueError: If they are no numbers of that shape.

        >>> mount = Pose(np.array([1.9, 0.0, 1.3]), np.eye(3))
        >>> camera = Camera(64, 48, (60.0, 60.0), (32.0, 24.0), (-0.2, 0.05, 1e-3, 0.0, 0.0), mount)
        >>> np.allclose(camera.project(camera.rays([[3.0, 40.0]])), [[3.0, 40.0]])
        True
        """
        points = checked_points("pixels", pixels, 2)
        points = np.where(np.isinf(points), np.nan, points)
        wanted_u, wanted_v = np.moveaxis((points - self.centre_px) / self.focal_px, -1, 0)
        u, v = wanted_u, wanted_v
        if any(self.distortion):
            for _ in range(NUM_UNDISTORTION_STEPS):
                found_u, found_v = self._distorted(u, v)
                du, dv = wanted_u - found_u, wanted_v - found_v
                u, v = u + du, v + dv
                if max(np.abs(du).max(initial=0.0), np.abs(dv).max(initial=0.0)) < LEAST_UNDISTORTION_STEP:
                    break
        rays = np.stack([np.ones_like(u), -u, -v], -1)
        return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))

    def node_rays(self, columns_px: ArrayLike, rows_px: ArrayLike, field: str = "camera.distortion") -> Floats:
        """`rays` through the nodes of a grid, shape (columns, rows, 3).

        Raises:
            ValueError: If the distortion cannot be undone at one of them; the message begins with `field`.
        """
        pixels = np.stack(np.meshgrid(columns_px, rows_px, indexing="ij"), -1)
        with np.errstate(over="ignore", invalid="ignore"):
            rays = self.rays(pixels)
            errors_px = np.abs(self.project(rays) - pixels).max(-1)
        is_inverse = errors_px <= MAX_REPROJECTION * max(self.width_px, self.height_px)
        if not is_inverse.all():
            x, y = pixels[~is_inverse][0]
            raise ValueError(
                f"{field}: expected one that can be undone everywhere in the image, {list(self.distortion)} cannot at "
                f"pixel ({x:g}, {y:g})"
            )
        return rays

    @cached_property
    def pixel_solid_angle_sr(self) -> float:
        """Solid angle of a pixel at the principal point, steradian."""
        return 1.0 / (self.focal_px[0] * self.focal_px[1])

    def _distorted(self, u: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Source: Brown, Decentering distortion of lenses, 1966, in OpenCV's notation."""
        k1, k2, p1, p2, k3 = self.distortion
        r2 = u * u + v * v
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return (
            u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u),
            v * radial + p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * u * v,
        )
