"""The two halves of a calibration, the camera itself and its mount, and the choice of images that a file has."""

from __future__ import annotations

from typing import Annotated, Self, TypeAlias

import numpy as np
from pydantic import Field

from foreglow.config import FrozenModel
from foreglow.geometry import (
    MAX_DISTORTION,
    MAX_FOCAL_PX,
    MAX_IMAGE_SIDE_PX,
    MAX_MOUNT_M,
    MAX_TURN_DEG,
    Camera,
    Floats,
    MountSigmas,
    Pose,
    check_centre,
    check_distortion,
    check_lens,
    rotation,
)

# TOML has lists where Python has tuples; what is in them stays strict.
Two: TypeAlias = Annotated[tuple[float, float], Field(strict=False)]
Three: TypeAlias = Annotated[tuple[float, float, float], Field(strict=False)]
_Term: TypeAlias = Annotated[float, Field(ge=-MAX_DISTORTION, le=MAX_DISTORTION)]
Five: TypeAlias = Annotated[tuple[_Term, _Term, _Term, _Term, _Term], Field(strict=False)]
MIN_FOCAL_PX = 1.0
"""Far beyond any lens, as is `MAX_FOCAL_PX`."""

_Length: TypeAlias = Annotated[float, Field(ge=MIN_FOCAL_PX, le=MAX_FOCAL_PX)]
Focal: TypeAlias = Annotated[tuple[_Length, _Length], Field(strict=False)]
Side: TypeAlias = Annotated[int, Field(ge=1, le=MAX_IMAGE_SIDE_PX)]
Turn: TypeAlias = Annotated[float, Field(ge=-MAX_TURN_DEG, le=MAX_TURN_DEG)]
_Sigma: TypeAlias = Annotated[float, Field(ge=0, le=90)]

Position: TypeAlias = Annotated[
    tuple[
        Annotated[float, Field(ge=-MAX_MOUNT_M[0], le=MAX_MOUNT_M[0])],
        Annotated[float, Field(ge=-MAX_MOUNT_M[1], le=MAX_MOUNT_M[1])],
        Annotated[float, Field(gt=0, le=MAX_MOUNT_M[2])],
    ],
    Field(strict=False),
]

HALF_PIXEL_PX = 0.5
"""KITTI, ROS and OpenCV have the centre of the upper left pixel at (0, 0); here it is (0.5, 0.5)."""

NO_DISTORTION: Five = (0.0, 0.0, 0.0, 0.0, 0.0)


class Mount(FrozenModel):
    """How a camera is mounted in its vehicle; no angle has a default, as one that was forgotten makes ranges wrong.

    Attributes:
        position_m: Forward of the rear axle, left of the middle, above the road.
        yaw_deg: Angle of its axis to the left.
        pitch_deg: Angle of its axis upwards.
        roll_deg: Rotation to the right about its axis.
        yaw_sigma_deg: Standard deviation of the yaw; this and the next three are 0 for a mount that counts as exact.
        pitch_sigma_deg: Standard deviation of the pitch.
        roll_sigma_deg: Standard deviation of the roll.
        height_sigma_m: Standard deviation of the height above the road.
    """

    position_m: Position
    yaw_deg: Turn
    pitch_deg: Turn
    roll_deg: Turn
    yaw_sigma_deg: _Sigma = 0.0
    pitch_sigma_deg: _Sigma = 0.0
    roll_sigma_deg: _Sigma = 0.0
    height_sigma_m: Annotated[float, Field(ge=0, le=10)] = 0.0

    @property
    def pose(self) -> Pose:
        """vehicle_from_camera."""
        turned = rotation(*np.radians([self.yaw_deg, self.pitch_deg, self.roll_deg]))
        return Pose(np.array(self.position_m), turned)

    @property
    def sigmas(self) -> MountSigmas:
        """How well the pose is known."""
        yaw, pitch, roll = np.radians([self.yaw_sigma_deg, self.pitch_sigma_deg, self.roll_sigma_deg]).tolist()
        return MountSigmas(yaw, pitch, roll, self.height_sigma_m)


class Intrinsics(FrozenModel):
    """A camera without its mount.

    Attributes:
        width_px: Columns of the image.
        height_px: Rows of the image.
        focal_px: Focal lengths fx, fy.
        centre_px: Principal point cx, cy; the centre of the upper left pixel is (0.5, 0.5).
        distortion: k1, k2, p1, p2, k3, no unit (OpenCV's order).
    """

    width_px: Side
    height_px: Side
    focal_px: Focal
    centre_px: Two
    distortion: Five = NO_DISTORTION

    @classmethod
    def of_matrix(
        cls, values: Floats, size_px: tuple[int, int], field: str, distortion: Five = NO_DISTORTION
    ) -> Intrinsics:
        """The camera of a matrix in OpenCV's convention, with the centre of the first pixel at (0, 0).

        Args:
            values: The matrix by rows: 9 numbers of a camera matrix, or 12 of a projection, whose last column is not
                used.
            size_px: Width and height.
            field: Path and field, for messages.
            distortion: k1, k2, p1, p2, k3.

        Raises:
            ValueError: If a focal length is not positive, the principal point is far from the image, or the matrix is
                not fx 0 cx, 0 fy cy, 0 0 1.
        """
        matrix = values.reshape(3, -1)[:, :3]
        fx, fy, cx, cy = matrix[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
        for name, focal_px in (("fx", fx), ("fy", fy)):
            if not focal_px > 0:
                raise ValueError(f"{field}: {name}: expected a positive focal length, got {focal_px:g}")
            if not MIN_FOCAL_PX <= focal_px <= MAX_FOCAL_PX:
                expected = f"expected a focal length of {MIN_FOCAL_PX:g} to {MAX_FOCAL_PX:g} px"
                raise ValueError(f"{field}: {name}: {expected}, got {focal_px:g}")
        if matrix.tolist() != [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]:
            raise ValueError(f"{field}: expected fx 0 cx, 0 fy cy, 0 0 1, got {matrix.tolist()}")
        centre_px = cx + HALF_PIXEL_PX, cy + HALF_PIXEL_PX
        check_centre(centre_px, size_px, f"{field}: cx, cy")
        return cls(
            width_px=size_px[0],
            height_px=size_px[1],
            focal_px=(fx, fy),
            centre_px=centre_px,
            distortion=distortion,
        ).of_a_lens(field)

    def of_a_lens(self, field: str) -> Self:
        """These, if they are those of a lens.

        Raises:
            ValueError: If it would see more than any; the message begins with `field`.
        """
        check_lens((self.width_px, self.height_px), self.focal_px, field)
        return self

    def undistorted(self, field: str) -> Self:
        """These, if their distortion can be undone everywhere in the image.

        Raises:
            ValueError: If it cannot; the message begins with `field`.
        """
        size_px = self.width_px, self.height_px
        check_distortion(size_px, self.focal_px, self.centre_px, self.distortion, field)
        return self

    def camera(self, mount: Mount) -> Camera:
        """The camera on its mount."""
        return Camera(
            width_px=self.width_px,
            height_px=self.height_px,
            focal_px=self.focal_px,
            centre_px=self.centre_px,
            distortion=self.distortion,
            vehicle_from_camera=mount.pose,
            mount_sigmas=mount.sigmas,
        )


def checked_distortion(terms: Five, field: str) -> Five:
    """`terms`, if they are those of a lens.

    Raises:
        ValueError: If one is beyond `MAX_DISTORTION`; the message begins with `field`.
    """
    if max(map(abs, terms)) > MAX_DISTORTION:
        raise ValueError(f"{field}: expected coefficients of at most {MAX_DISTORTION:g}, got {list(terms)}")
    return terms


class ImageChoice(FrozenModel):
    """The images that a calibration is wanted for, where a file has several kinds.

    Attributes:
        camera: Number of the camera, in a file of KITTI: 0 and 1 grey, 2 and 3 colour.
        is_rectified: Whether the images were rectified: then they have no distortion, and their own projection.
        size_px: Width and height, if the file does not have them; otherwise they must be the file's.
    """

    camera: Annotated[int, Field(ge=0, le=99)] = 0
    is_rectified: bool = False
    size_px: Annotated[tuple[Side, Side], Field(strict=False)] | None = None

    def checked_size_px(self, file_px: tuple[int, int] | None, field: str) -> tuple[int, int]:
        """The size in the file, or else the size asked for.

        Args:
            file_px: Width and height in the file; None if it has none.
            field: Path and field, for messages.

        Raises:
            ValueError: If there is no size, or the two differ.
        """
        size_px = file_px or self.size_px
        if size_px is None:
            raise ValueError(f"{field}: missing, and the file says no other size: give the images' size")
        if self.size_px not in (None, size_px):
            raise ValueError(
                f"{field}: expected {_size(self.size_px or size_px)} px as asked for, got {_size(size_px)}"
            )
        return size_px


def _size(size_px: tuple[int, int]) -> str:
    return f"{size_px[0]}x{size_px[1]}"
