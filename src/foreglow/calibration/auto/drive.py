"""The mount of a camera from a drive: the directions of all frames, put together."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.calibration.auto.flow import Tracks, follow, is_next, turn_of
from foreglow.calibration.auto.lines import (
    MAX_WAYS,
    MIN_WAYS,
    UNKNOWN_BEND,
    Bend,
    Direction,
    Segments,
    find_segments,
    meet,
    num_ways,
    vote,
)
from foreglow.calibration.auto.views import Grey, Lens, View, views_of
from foreglow.calibration.values import Intrinsics, Mount
from foreglow.geometry import Camera, Floats
from foreglow.types import Frame

REDUCTION = 2
"""The mask is found in images that are smaller by this factor."""

BLUR_PX = (3, 3)
MIN_GRADIENT = 10.0
"""Grey levels a pixel, mean over the drive, from which there is an edge; our own light on the road has none."""

STILL_SHARE = 0.85
"""An edge whose mean gradient over the drive has at least this share of its mean strength never moves: elsewhere
gradients of all directions come by and cancel."""

STANDING_SHARE = 0.85
"""If so large a part of all edges never moves, the car stands."""

MIN_RADIAL_COSINE = 0.97
"""An edge below the vanishing point that leads to it this exactly is a lane marking, which stands still as well."""

FAR_SHARE = 0.1
"""Nearer to the vanishing point than this share of the width, far things hardly move."""

BONNET_TOP_SHARE = 0.75
BONNET_WIDTH_SHARE = 0.2
"""A thing that is in the image's lower quarter and at least so wide is the bonnet's edge: all below it is masked."""


class StillEdges:
    """Adds up the gradients of a drive's images."""

    def __init__(self) -> None:
        self._shape = (0, 0)
        self._num = 0
        self._means = np.zeros((2, 0, 0), np.float32)
        self._strengths = np.zeros((0, 0), np.float32)

    def add(self, grey: Grey) -> None:
        """Takes one more image; all have the same shape."""
        size = (grey.shape[1] // REDUCTION, grey.shape[0] // REDUCTION)
        small = cv2.GaussianBlur(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), BLUR_PX, 0)
        gradients = np.stack([cv2.Sobel(small, cv2.CV_32F, *order, scale=0.125) for order in ((1, 0), (0, 1))])
        if not self._num:
            self._shape = grey.shape
            self._means, self._strengths = np.zeros_like(gradients), np.zeros_like(gradients[0])
        self._num += 1
        self._means += gradients
        self._strengths += np.hypot(*gradients)

    def _still(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which pixels have an edge that never moves, and which have any edge."""
        is_edge = self._strengths > MIN_GRADIENT * max(self._num, 1)
        return is_edge & (np.hypot(*self._means) > STILL_SHARE * self._strengths), is_edge

    @property
    def stands(self) -> bool:
        """Whether the car stands, as nearly all edges do; also without any edge."""
        is_still, is_edge = self._still()
        return bool(is_still.sum() >= STANDING_SHARE * is_edge.sum())

    def mask(self, vanishing_px: Floats) -> NDArray[np.bool_]:
        """Shape of the images, True where something stands still.

        Args:
            vanishing_px: Shape (2,), column and row of the images at which lane markings meet; they are left out.
        """
        is_still, _ = self._still()
        height, width = is_still.shape
        columns, rows = np.meshgrid(np.arange(width), np.arange(height))
        right, down = columns - vanishing_px[0] / REDUCTION, rows - vanishing_px[1] / REDUCTION
        # The gradient of an edge that leads to the vanishing point is across the way from there.
        across = np.abs(self._means[0] * down - self._means[1] * right)
        lengths = np.hypot(*self._means) * np.hypot(right, down)
        is_still &= (down < 0) | (across < MIN_RADIAL_COSINE * lengths)
        is_still &= np.hypot(right, down) > FAR_SHARE * width
        side = max(3, width // 80) | 1
        solid = cv2.morphologyEx(is_still.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((side, side), np.uint8))
        solid = cv2.morphologyEx(solid, cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
        _, labels, boxes, _ = cv2.connectedComponentsWithStats(solid, connectivity=8)
        for label, (_, top, box_width, _, _) in enumerate(boxes[1:], start=1):
            if top > BONNET_TOP_SHARE * height and box_width > BONNET_WIDTH_SHARE * width:
                below = np.maximum.accumulate(labels == label, axis=0)
                solid[below] = 1
        solid = cv2.dilate(solid, np.ones((3, 3), np.uint8))
        resized = cv2.resize(solid, self._shape[::-1], interpolation=cv2.INTER_NEAREST)
        return np.asarray(resized, np.bool_)


HEIGHT_M, HEIGHT_SIGMA_M = 1.3, 0.15
"""Of the cameras behind the windscreens of cars."""

TAPE_SIGMA_M = 0.02
"""Of a height that someone has measured."""

FORWARD_M = 1.7
"""In front of the rear axle, in the middle of the car: no drive shows it. Ranges count from the camera, so they do not
depend on it; positions in the vehicle's frame are wrong by as much as this is."""

NUM_PARTS = 8
"""Parts of the drive whose spread is the standard deviation."""

MIN_VIEWS = 10
MIN_DIRECTIONS = 10
"""Frames that have to show where the way ahead vanishes."""

MAX_POINT_SIGMA = 0.02
"""A frame that shows the vanishing point less well than this does not count, rad."""

NUM_VOTERS = 40

ALIKE = 1.5
"""Neighbouring parts of a drive have errors in common, so that their mean is worse by this than if they had none."""

FLOOR_DEG = (0.04, 0.06)
"""Least standard deviations of yaw and pitch: roads bend, rise and bank. These and `ALIKE` were set on simulated
drives, so that 70 % of the errors are within the standard deviation."""

SLIP_M = 1.0
"""In a bend of the curvature k, the lines at a camera lead this times k to a side of where the car points: to the inner
side as far as the camera is in front of the rear axle (1.7 m), to the outer side as the rear axle slips outwards at
speed. The two cancel at some 60 km/h, so the yaw is not corrected; the term is a standard deviation."""

SPEED_MPS = 18.0
SPEED_SIGMA_SHARE = 2.0
"""The car's speed, which turns a yaw rate into a curvature, and its standard deviation as a share: a half for a single
frame, but the error is the same in all frames of a drive, so that it counts as a larger one in each. So the flow tells
that a road is straight; how sharp a bend is, the lines tell. A drive at night does not show the speed, as our own light
on the road goes with the car."""

TURN_SIGMA_RADPS = math.radians(0.3)
"""Standard deviation of the flow's yaw rate, beyond that of its features: the same error lasts over several frames."""

NUM_FITS = 3
"""Fits of the lines, each with the bends that the flow shows by the point at which the lines met before."""

ROLL_SIGMA_DEG = 1.0
"""Roll is not measured: cameras are fixed about level."""

MAX_SIGMA_DEG = 1.5
"""A worse calibration is none."""


@dataclass(frozen=True, slots=True, eq=False)
class DriveCalibration:
    """A camera that was calibrated from its own drive.

    Attributes:
        camera: With the standard deviations of its mount.
        mask: Shape (height, width) of the frames, True where something stands still, such as the bonnet.
        frame: The frame in which most lines were found.
        num_views: Frames that were looked at.
        num_lines: Frames whose lines met in a vanishing point.
        num_flows: Pairs of frames whose flow showed how fast the car turned.
    """

    camera: Camera
    mask: NDArray[np.bool_]
    frame: Frame
    num_views: int
    num_lines: int
    num_flows: int


def calibrate_drive(
    frames: Iterable[Frame],
    intrinsics: Intrinsics,
    *,
    name: str,
    rate_hz: float | None = None,
    num_frames: int | None = None,
    height_m: float | None = None,
) -> DriveCalibration:
    """The camera that took `frames`, with its mount as the drive shows it.

    Args:
        frames: The drive, in the order of time.
        intrinsics: The camera's lens.
        name: Of the drive, for messages.
        rate_hz: Frames a second; None if unknown.
        num_frames: Number of frames; None if unknown.
        height_m: Of the camera above the road, measured; None for that of most cars.

    Raises:
        ValueError: If the drive shows too little; the message says what is missing. Also if frames are of another size
            than the lens.
    """
    drive = _Drive(Lens(intrinsics))
    for frame, view in views_of(frames, rate_hz, num_frames):
        size_px = (frame.width_px, frame.height_px)
        if size_px != (intrinsics.width_px, intrinsics.height_px):
            expected = f"{intrinsics.width_px}x{intrinsics.height_px}"
            raise ValueError(f"{name}: size: expected {expected} px in all frames, got {size_px[0]}x{size_px[1]}")
        drive.add(frame, view)
    if len(drive.segments) < MIN_VIEWS or drive.frame is None:
        raise ValueError(
            f"{name}: expected a drive of at least {MIN_VIEWS} frames that are {MIN_VIEWS} times 0.05 s apart, "
            f"got {len(drive.segments)}"
        )
    if drive.still.stands:
        raise ValueError(f"{name}: expected a drive, nothing moves in it: the car stands, or it is too dark to see")
    lines, num_flows, num_streaked = drive.directions(HEIGHT_M if height_m is None else height_m)
    if num_streaked > len(lines):
        raise ValueError(
            f"{name}: expected a drive on which the road shows, streaks of snow or rain hide it in {num_streaked} of "
            f"{len(drive.segments)} frames"
        )
    if len(lines) < MIN_DIRECTIONS:
        raise ValueError(
            f"{name}: expected lane markings or edges of the road in at least {MIN_DIRECTIONS} frames, they show in "
            f"{len(lines)} of {len(drive.segments)}"
        )
    found = _Estimate.of(lines, HEIGHT_M if height_m is None else height_m)
    yaw_deg, pitch_deg = _angles_deg(found.point)
    yaw_sigma_deg, pitch_sigma_deg = np.degrees(found.sigmas).tolist()
    if max(yaw_sigma_deg, pitch_sigma_deg) > MAX_SIGMA_DEG:
        raise ValueError(
            f"{name}: expected a way ahead that shows to {MAX_SIGMA_DEG:g} degrees, the frames differ too much: yaw "
            f"+-{yaw_sigma_deg:.1f}, pitch +-{pitch_sigma_deg:.1f}"
        )
    mount = Mount(
        position_m=(FORWARD_M, 0.0, HEIGHT_M if height_m is None else height_m),
        yaw_deg=round(yaw_deg, 3),
        pitch_deg=round(pitch_deg, 3),
        roll_deg=0.0,
        yaw_sigma_deg=round(yaw_sigma_deg, 3),
        pitch_sigma_deg=round(pitch_sigma_deg, 3),
        roll_sigma_deg=ROLL_SIGMA_DEG,
        height_sigma_m=HEIGHT_SIGMA_M if height_m is None else TAPE_SIGMA_M,
    )
    camera = intrinsics.camera(mount)
    ahead = camera.project(camera.vehicle_from_camera.rotation.T @ [1.0, 0.0, 0.0])
    mask = drive.still.mask(ahead / drive.lens.reduction).astype(np.uint8)
    size_px = (intrinsics.width_px, intrinsics.height_px)
    full = cv2.resize(mask, size_px, interpolation=cv2.INTER_NEAREST).astype(np.bool_)
    return DriveCalibration(camera, full, drive.frame, len(drive.segments), len(lines), num_flows)


class _Drive:
    """What is kept of a drive while its frames come by."""

    def __init__(self, lens: Lens) -> None:
        self.lens = lens
        self.still = StillEdges()
        self.segments: list[Segments] = []
        self.is_steady: list[bool] = []
        self.tracks: list[Tracks | None] = []
        self.frame: Frame | None = None
        self._most = -1
        self._previous: View | None = None

    def add(self, frame: Frame, view: View) -> None:
        """Takes one more frame."""
        self.still.add(view.grey)
        before = self._previous
        is_near = before is not None and is_next(before, view)
        # What is bright in both frames is on the road; streaks of snow and rain are in one.
        grey = np.minimum(before.grey, view.grey) if before is not None and is_near else view.grey
        self.segments.append(find_segments(grey, self.lens))
        self.is_steady.append(is_near)
        if len(self.segments[-1]) > self._most:
            self._most, self.frame = len(self.segments[-1]), frame
        self.tracks.append(follow(before, view, self.lens) if before is not None and is_near else None)
        self._previous = view

    def directions(self, height_m: float) -> tuple[list[Direction], int, int]:
        """Where the lines of each frame meet; the number of frames whose turn is known, and of those with streaks.

        In frames with streaks, the lines are not the road's.

        Args:
            height_m: Of the camera above the road.
        """
        frames = list(zip(self.segments, self.tracks, strict=True))
        if sum(self.is_steady) >= MIN_VIEWS:
            frames = [frame for frame, is_steady in zip(frames, self.is_steady, strict=True) if is_steady]
        start = vote([segments for segments, _ in frames[:: max(1, len(frames) // NUM_VOTERS)]])
        if start is None:
            return [], 0, 0
        used, lines, num_streaked = [], [], 0
        for segments, tracks in frames:
            line = meet(segments, start, self.lens.focal_px)
            ways = 0.0 if line is None else num_ways(segments, line.point)
            if ways > MAX_WAYS:
                num_streaked += 1
            elif line is not None and ways >= MIN_WAYS and line.worst_sigma < MAX_POINT_SIGMA:
                used.append((segments, tracks))
                lines.append(line)
        for _ in range(NUM_FITS):
            if not lines:
                break
            ahead = _mean(lines)
            bends = [bend_of(tracks, ahead, self.lens.focal_px, height_m) for _, tracks in used]
            found = [
                meet(segments, ahead, self.lens.focal_px, bend) for (segments, _), bend in zip(used, bends, strict=True)
            ]
            lines = [line for line in found if line is not None]
        return lines, sum(tracks is not None for _, tracks in used), num_streaked


def bend_of(tracks: Tracks | None, ahead: Floats, focal_px: float, height_m: float) -> Bend:
    """The road's bend by the yaw rate of the flow, which is the curvature times a speed that is about known.

    Args:
        tracks: Features in two frames; None if there are none, as with a car that stands.
        ahead: Shape (2,), where the way ahead is seen.
        focal_px: Focal length in the small images.
        height_m: Of the camera above the road.
    """
    if tracks is None:
        return UNKNOWN_BEND
    turn = turn_of(tracks, ahead, focal_px)
    scale = height_m / SPEED_MPS
    sigma = scale * math.hypot(TURN_SIGMA_RADPS, turn.sigma_radps, SPEED_SIGMA_SHARE * turn.rate_radps)
    return Bend(scale * turn.rate_radps, sigma)


@dataclass(frozen=True, slots=True, eq=False)
class _Estimate:
    """A vanishing point (u, v), shape (2,), and its standard deviations, rad."""

    point: Floats
    sigmas: Floats

    @classmethod
    def of(cls, directions: Sequence[Direction], height_m: float) -> _Estimate:
        """The mean of many directions; its standard deviation is the spread of the drive's parts, and the slip."""
        parts = np.array_split(np.arange(len(directions)), min(NUM_PARTS, len(directions) // 2))
        points = np.array([_mean([directions[index] for index in part]) for part in parts])
        spreads = 1.483 * np.median(np.abs(points - np.median(points, axis=0)), axis=0)
        sigmas = np.hypot(ALIKE * spreads / math.sqrt(len(parts)), np.radians(FLOOR_DEG))
        sigmas[0] = math.hypot(sigmas[0], SLIP_M * np.mean([each.bend for each in directions]) / height_m)
        return cls(_mean(directions), sigmas)


def _mean(directions: Sequence[Direction]) -> Floats:
    """The mean of points by their information, in which those far off count little."""
    points = np.array([each.point for each in directions])
    covariances = np.linalg.inv(np.array([each.information for each in directions])) + FRAME_SIGMA**2 * np.eye(2)
    informations = np.linalg.inv(covariances)
    mean = np.median(points, axis=0)
    for _ in range(NUM_MEANS):
        squares = np.einsum("ni,nij,nj->n", points - mean, informations, points - mean)
        weighted = informations / (1.0 + squares / 4.0)[:, None, None]
        mean = np.linalg.solve(weighted.sum(0), np.einsum("nij,nj->i", weighted, points))
    return np.asarray(mean)


FRAME_SIGMA = math.radians(0.3)
"""How far the lines of a frame lead from the way of the car over the drive: it sways, and drifts in its lane."""

NUM_MEANS = 10


def _angles_deg(point: Floats) -> tuple[float, float]:
    """Yaw and pitch of a level camera that sees the way ahead at the tangents (u, v)."""
    right, down = float(point[0]), float(point[1])
    # The way ahead in the camera's frame is (1, -u, -v), which is x of the vehicle's turned back by yaw, then pitch.
    return math.degrees(math.atan2(right, math.hypot(1.0, down))), math.degrees(math.atan2(down, 1.0))
