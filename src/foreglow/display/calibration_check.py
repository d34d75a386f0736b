"""A calibration seen on an image: horizon, vanishing point and a metre grid on the road, and what its numbers mean."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from foreglow.display.overlay import Colour, Measures, Picture, Rectangle, darken, overlap_px
from foreglow.display.tone import Tone
from foreglow.geometry import Camera, Floats, MountSigmas, rotation_angles_rad
from foreglow.own_files import CHECK, named_png
from foreglow.types import Image
from foreglow.whole_files import write_atomic

NEAR_STEP_M, NEAR_END_M, FAR_STEP_M, FAR_END_M = 5, 50, 10, 100
"""Lines across: each 5 m up to 50 m, then each 10 m up to 100 m."""

SIDES_M = (-10, -5, 0, 5, 10)
"""Lines along, metres to the left of the camera."""

LANE_WIDTH_M = 3.5
"""Of the lane that is drawn around the camera's own way."""

ROW_RANGES_M = (50.0, 100.0)

MAX_CENTRE_SHARE = 0.1
MAX_FOCAL_RATIO = 1.05
MAX_ROLL_DEG = 5.0
"""Beyond these a warning is given: few cameras have their principal point a tenth of a side from the middle, pixels
that are not square, or a roll that one sees at once."""

GRID_BGR: Colour = (150, 190, 90)
LANE_BGR: Colour = (70, 190, 250)
HORIZON_BGR: Colour = (240, 150, 90)
VANISHING_BGR: Colour = (90, 90, 250)
MASK_BGR: Colour = (200, 70, 190)
_FONT = cv2.FONT_HERSHEY_SIMPLEX

_STEP_M = 0.1
_STEP_RAD = np.radians(0.25)
_ROUND_TRIP = 1e-6


@dataclass(frozen=True, slots=True)
class CameraFigures:
    """What a calibration says, in numbers that one can check with a tape measure and a look at the image.

    Attributes:
        height_m: Of the camera above the road.
        yaw_deg: How far its axis points to the left of the way ahead.
        pitch_deg: How far its axis points upwards.
        roll_deg: How far it is turned to the right.
        horizontal_fov_deg: From the middle of the image's left edge to that of the right one.
        vertical_fov_deg: From the middle of the image's upper edge to that of the lower one.
        vanishing_px: Where the straight level way ahead vanishes, pixels x, y; NaN if the camera looks elsewhere.
        row_m: Metres of flat road that one row covers, at each of `ROW_RANGES_M` ahead; NaN where that is not seen.
    """

    height_m: float
    yaw_deg: float
    pitch_deg: float
    roll_deg: float
    horizontal_fov_deg: float
    vertical_fov_deg: float
    vanishing_px: tuple[float, float]
    row_m: tuple[float, ...]

    @property
    def is_ahead(self) -> bool:
        """Whether the way ahead vanishes in or near the image."""
        return bool(np.isfinite(self.vanishing_px).all())

    @classmethod
    def of(cls, camera: Camera) -> CameraFigures:
        """The figures of `camera`."""
        yaw, pitch, roll = np.degrees(rotation_angles_rad(camera.vehicle_from_camera.rotation)).tolist()
        middle_x, middle_y = camera.width_px / 2, camera.height_px / 2
        edges = _rays(camera, [[0, middle_y], [camera.width_px, middle_y], [middle_x, 0], [middle_x, camera.height_px]])
        across, down = np.degrees(np.arccos(np.clip([edges[0] @ edges[1], edges[2] @ edges[3]], -1, 1))).tolist()
        x, y = _project_directions(camera, [1.0, 0.0, 0.0]).tolist()
        return cls(
            height_m=float(camera.vehicle_from_camera.position_m[2]),
            yaw_deg=yaw,
            pitch_deg=pitch,
            roll_deg=roll,
            horizontal_fov_deg=across,
            vertical_fov_deg=down,
            vanishing_px=(x, y),
            row_m=tuple(_row_m(camera, range_m) for range_m in ROW_RANGES_M),
        )


def _turn(angle_deg: float, positive: str, negative: str) -> str:
    return f"{abs(angle_deg):.2f} degrees {positive if angle_deg >= 0 else negative}"


def check_lines(camera: Camera) -> list[str]:
    """What the calibration says, a line each, and a line for each warning."""
    figures = CameraFigures.of(camera)
    place = "({:.1f}, {:.1f}) px".format(*figures.vanishing_px)
    lines = [
        f"image          {camera.width_px}x{camera.height_px} px, field of view "
        f"{figures.horizontal_fov_deg:.1f} x {figures.vertical_fov_deg:.1f} degrees",
        f"camera         {figures.height_m:.2f} m above the road, points {_turn(figures.pitch_deg, 'up', 'down')} and "
        f"{_turn(figures.yaw_deg, 'to the left', 'to the right')}, rolled {_turn(figures.roll_deg, 'right', 'left')}",
        f"vanishing at   {place if figures.is_ahead else 'no pixel in or near the image'}",
    ]
    lines += [
        f"one row        is {row_m:.2f} m of flat road at {range_m:g} m"
        for range_m, row_m in zip(ROW_RANGES_M, figures.row_m, strict=True)
        if np.isfinite(row_m)
    ]
    sigmas = camera.mount_sigmas
    if sigmas != MountSigmas():
        angles = zip(("pitch", "yaw", "roll"), (sigmas.pitch_rad, sigmas.yaw_rad, sigmas.roll_rad), strict=True)
        known = ", ".join(f"{name} +-{np.degrees(sigma):.2f}" for name, sigma in angles)
        lines.append(f"known to       {known} degrees, height +-{sigmas.height_m:.2f} m")
    return lines + [f"warning: {warning}" for warning in warnings_of(camera)]


def warnings_of(camera: Camera) -> list[str]:
    """What is hardly true of a camera that looks along the road; empty if nothing is."""
    figures, found = CameraFigures.of(camera), []
    x, y = figures.vanishing_px
    if not figures.is_ahead:
        found.append("the camera does not look along the drive, which is behind it or far outside the image")
    elif not 0 <= x < camera.width_px:
        found.append(f"the camera does not look along the drive, which is outside the image: column {x:.0f}")
    elif not 0 <= y < camera.height_px:
        found.append(f"the horizon is outside the image: row {y:.0f} of {camera.height_px}")
    for name, centre_px, side_px in zip("xy", camera.centre_px, (camera.width_px, camera.height_px), strict=True):
        if abs(centre_px - side_px / 2) > MAX_CENTRE_SHARE * side_px:
            found.append(f"the principal point is far off the middle: c{name} {centre_px:g} of {side_px} px")
    if max(camera.focal_px) > MAX_FOCAL_RATIO * min(camera.focal_px):
        found.append(f"the pixels are not square: fx {camera.focal_px[0]:g}, fy {camera.focal_px[1]:g} px")
    if abs(figures.roll_deg) > MAX_ROLL_DEG:
        found.append(f"the camera is turned about its axis: roll {figures.roll_deg:.1f} degrees")
    return found


def write_check(path: Path, camera: Camera, image: Image, origin: str, mask: NDArray[np.bool_] | None = None) -> None:
    """Writes `draw_check` of `image` as PNG.

    Args:
        path: The file, which ends in .png.
        camera: The calibration.
        image: The image.
        origin: Where the image came from, for messages.
        mask: What stands still in the image; None where that is not known.

    Raises:
        ValueError: If `path` has another ending, or the image is not of the calibration's size.
        OSError: If it cannot be written.
    """
    if path.suffix.lower() != ".png":
        raise ValueError(f"{path}: expected a picture that ends in .png, got {path.suffix!r}")
    picture = cv2.imencode(".png", draw_check(camera, image, origin, mask))[1].tobytes()
    write_atomic(path, named_png(picture, CHECK))


def draw_check(camera: Camera, image: Image, origin: str = "image", mask: NDArray[np.bool_] | None = None) -> Picture:
    """`image` brightened, with horizon, vanishing point, metre grid, lane and mask; at least 960 px wide.

    Distances are ahead of the camera along the vehicle's x, on a flat road (z = 0); numbers stand to the right of the
    lines across.

    Raises:
        ValueError: If the image is not of the calibration's size.
    """
    if image.shape != (camera.height_px, camera.width_px):
        raise ValueError(
            f"{origin}: size: expected {camera.width_px}x{camera.height_px} px as the calibration has it, got "
            f"{image.shape[1]}x{image.shape[0]} px"
        )
    measures = Measures.of(camera.width_px, camera.height_px)
    grey = cv2.resize(
        Tone.of(image).apply(image),
        None,
        fx=measures.enlargement,
        fy=measures.enlargement,
        interpolation=cv2.INTER_CUBIC,
    )
    picture = np.ascontiguousarray(np.repeat(np.asarray(grey, np.uint8)[:, :, None], 3, axis=2))
    if mask is not None:
        is_still = cv2.resize(mask.astype(np.uint8), picture.shape[1::-1], interpolation=cv2.INTER_NEAREST) > 0
        picture[is_still] = picture[is_still] // 2 + np.array(MASK_BGR, np.uint8) // 2
    across = [*range(NEAR_STEP_M, NEAR_END_M, NEAR_STEP_M), *range(NEAR_END_M, FAR_END_M + 1, FAR_STEP_M)]
    ways_m = np.arange(1.0, FAR_END_M + _STEP_M / 2, _STEP_M)
    sides_m = np.arange(SIDES_M[0], SIDES_M[-1] + _STEP_M / 2, _STEP_M)
    for line_m in SIDES_M:
        _draw_line(picture, _project_road(camera, ways_m, line_m), GRID_BGR, measures)
    for ahead_m in across:
        _draw_line(picture, _project_road(camera, ahead_m, sides_m), GRID_BGR, measures)
    for edge_m in (-LANE_WIDTH_M / 2, LANE_WIDTH_M / 2):
        _draw_line(picture, _project_road(camera, ways_m, edge_m), LANE_BGR, measures)
    azimuths = np.arange(-np.pi / 2, np.pi / 2, _STEP_RAD)
    level = np.stack([np.cos(azimuths), np.sin(azimuths), np.zeros_like(azimuths)], -1)
    _draw_line(picture, _project_directions(camera, level), HORIZON_BGR, measures)
    _draw_vanishing_point(picture, _project_directions(camera, [1.0, 0.0, 0.0]), measures)
    _draw_labels(picture, camera, across, measures)
    return picture


def _project_directions(camera: Camera, directions_vehicle: ArrayLike) -> Floats:
    """Pixels, shape (..., 2), at which directions of shape (..., 3) in the vehicle's frame vanish; NaN outside."""
    return seen_px(camera, np.asarray(directions_vehicle, np.float64) @ camera.vehicle_from_camera.rotation)


def _project_road(camera: Camera, ahead_m: ArrayLike, left_m: ArrayLike) -> Floats:
    """Pixels, shape (..., 2), of places on the flat road, ahead of the camera and to its left; NaN outside."""
    position_m = camera.vehicle_from_camera.position_m
    if position_m[2] <= 0:
        return np.full((*np.broadcast(ahead_m, left_m).shape, 2), np.nan)
    ahead, left = np.broadcast_arrays(np.asarray(ahead_m, np.float64), np.asarray(left_m, np.float64))
    points = np.stack([ahead + position_m[0], left + position_m[1], np.zeros_like(ahead)], -1)
    return seen_px(camera, camera.vehicle_from_camera.to_body(points))


def seen_px(camera: Camera, points_camera: Floats) -> Floats:
    """Pixels, shape (..., 2), of points of shape (..., 3) in the camera's frame.

    NaN half an image outside or more, behind the camera, and where the distortion would fold them back into the image.
    """
    pixels = camera.project(points_camera)
    size = np.array([camera.width_px, camera.height_px])
    is_near = np.asarray((np.abs(pixels - size / 2) < size).all(-1))
    directions = points_camera / np.linalg.norm(points_camera, axis=-1, keepdims=True)
    rays = _rays(camera, np.where(is_near[..., None], pixels, size / 2))
    is_seen = is_near & (np.linalg.norm(rays - directions, axis=-1) < _ROUND_TRIP)
    return np.where(is_seen[..., None], pixels, np.nan)


def _rays(camera: Camera, pixels: ArrayLike) -> Floats:
    """`Camera.rays`; where the distortion folds they may run away, and then are anything or NaN."""
    with np.errstate(all="ignore"):
        return camera.rays(pixels)


def _row_m(camera: Camera, range_m: float) -> float:
    """Metres of flat road that the row which sees `range_m` ahead covers."""
    x, y = _project_road(camera, range_m, 0.0)
    rays = _rays(camera, [[x, y - 0.5], [x, y + 0.5]]) @ camera.vehicle_from_camera.rotation.T
    with np.errstate(divide="ignore", invalid="ignore"):
        far_m, near_m = -camera.vehicle_from_camera.position_m[2] * rays[:, 0] / rays[:, 2]
    return float(far_m - near_m) if far_m > near_m else np.nan


def _draw_line(picture: Picture, pixels: Floats, colour_bgr: Colour, measures: Measures) -> None:
    is_seen = np.isfinite(pixels).all(-1)
    cuts = np.flatnonzero(np.diff(is_seen.astype(int))) + 1
    for piece, seen in zip(np.split(pixels, cuts), np.split(is_seen, cuts), strict=True):
        if seen[0]:
            # Four more bits: the places of far lines differ by less than a pixel.
            ends = np.rint((piece * measures.enlargement - 0.5) * 16).astype(np.int32)
            cv2.polylines(picture, [ends], False, colour_bgr, measures.thin_px, cv2.LINE_AA, shift=4)


def _draw_vanishing_point(picture: Picture, pixel: Floats, measures: Measures) -> None:
    if np.isfinite(pixel).all():
        x, y = np.rint(pixel * measures.enlargement - 0.5).astype(int).tolist()
        cv2.drawMarker(picture, (x, y), VANISHING_BGR, cv2.MARKER_CROSS, 24 * measures.thin_px, measures.bold_px)


def _draw_labels(picture: Picture, camera: Camera, across: list[int], measures: Measures) -> None:
    """Writes the distances beside the lines across, 100 m and 50 m first, then from near to far where there is room."""
    taken: list[Rectangle] = []
    for ahead_m in (FAR_END_M, NEAR_END_M, *across):
        line = _project_road(camera, float(ahead_m), np.arange(0.0, SIDES_M[0] - _STEP_M / 2, -_STEP_M))
        line = line[np.isfinite(line).all(-1)] * measures.enlargement
        text = f"{ahead_m} m"
        (width_px, height_px), _ = cv2.getTextSize(text, _FONT, measures.label_scale, measures.thin_px)
        line = line[(line[:, 0] >= 0) & (line[:, 0] + width_px + 8 < picture.shape[1])]
        if not len(line) or not height_px < line[-1, 1] < picture.shape[0] - height_px:
            continue
        x, y = round(float(line[-1, 0])) + 4, round(float(line[-1, 1])) + height_px // 2
        label = (x - 2, y - height_px - 3, x + width_px + 2, y + 4)
        if any(overlap_px(label, other) for other in taken):
            continue
        taken.append(label)
        darken(picture, label)
        cv2.putText(picture, text, (x, y), _FONT, measures.label_scale, GRID_BGR, measures.thin_px, cv2.LINE_AA)
