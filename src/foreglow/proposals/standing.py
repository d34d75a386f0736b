"""What stands still in the image while we drive: reflections of our own car, dirt, stickers and logos are left out.

A light outside cannot keep its place: our car pitches and sways by many times the tolerance, even behind a vehicle
that we follow at a constant distance. So a region is learnt only if its patch keeps its place to a fraction of a pixel,
and its look, through a long time of driving; and it hides a box only in a frame in which its patch is still the same.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foreglow.config import StandingConfig
from foreglow.types import Frame, Image, Proposals

MAX_REGIONS = 16
"""Regions that are learnt or may be, together: bounds the memory and the time of a frame."""

MAX_SAMPLES = 16
"""Samples of a patch along each axis; larger patches are sampled with a stride."""

CHECK_S = 0.25
"""Time between two checks of a region that is not learnt yet."""

MIN_CHECKS = 10
"""Checks that a region must pass to be learnt, also where frames are rare."""

RIM_SHARE = 0.25
"""A region is a box with a rim of this share of its shorter side, so that edges of its light lie within."""

MIN_RIM_PX = 2
GAIN_LIMITS = 0.5, 2.0
"""A patch is the same if its contrast is so many times that of the first one: what lights it may change."""

FLOW_S = 5.0
"""Time constant of the share of boxes that flow, by which we are driving where nobody knows our speed."""

MIN_FLOW = 0.6
"""Without a known speed we are driving if at least this share of the boxes is in no region that stood for a second."""

MIN_STOOD = 4
"""So many checks are a second."""

MIN_PART = 1e-6
"""Least determinant of what the patch and its derivatives have in common, 1 for nothing: a patch that is made of its
derivatives, as one that doubles from pixel to pixel, moves where it only brightens."""

MIN_CORNER = 0.01
"""Least determinant of the structure tensor over its squared trace: that is 1/4 for a round light, 0 for an edge."""

_SIGNS = np.array([1, 1, -1, -1], np.int32)


@dataclass(slots=True, eq=False)
class _Region:
    """A patch that may stand still.

    Attributes:
        edges_px: x1, y1, x2, y2 of the patch, half-open.
        stride_px: From one sample to the next.
        normal: Shape (3, 3), B^T B for the basis B: the first patch less its mean, and its derivatives by x and y.
        solver: Shape (3, n), the pseudo-inverse of B.
        born_driven_s: How long we had driven when it was made.
        checked_ns: Time of its last check.
        same_ns: Time of the last check in which it was the same.
        num_same: Checks in which it was the same.
    """

    edges_px: tuple[int, int, int, int]
    stride_px: int
    normal: NDArray[np.float32]
    solver: NDArray[np.float32]
    born_driven_s: float
    checked_ns: int
    same_ns: int
    num_same: int = 0

    @property
    def area_px(self) -> int:
        x1, y1, x2, y2 = self.edges_px
        return (x2 - x1) * (y2 - y1)

    def samples(self, image: Image) -> NDArray[np.float32]:
        x1, y1, x2, y2 = self.edges_px
        samples = image[y1 : y2 : self.stride_px, x1 : x2 : self.stride_px].astype(np.float32).ravel()
        samples -= np.add.reduce(samples) / np.float32(samples.size)
        return samples


class StandingLight:
    """Learns which regions of the image stand still while we drive, and leaves out the boxes in them."""

    def __init__(self, config: StandingConfig) -> None:
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Forgets everything, as at the start of a sequence."""
        self._waiting: deque[_Region] = deque()  # the one that was checked longest ago is first
        self._learnt: list[_Region] = []
        self._driven_s = 0.0
        self._flow = 0.0
        self._num_frames = 0
        self._last_ns: int | None = None
        self._looked_ns = 0
        self._shape: tuple[int, ...] = ()

    @property
    def regions_xyxy_px(self) -> NDArray[np.int32]:
        """The learnt regions, shape (R, 4), half-open."""
        return np.array([region.edges_px for region in self._learnt], np.int32).reshape(-1, 4)

    def leave_out(self, frame: Frame, proposals: Proposals) -> Proposals:
        """The proposals without those in a region that stands still.

        Args:
            frame: The frame; frames must come in order.
            proposals: Boxes in this frame.
        """
        now_ns = frame.timestamp_ns
        if not self._continues(frame):
            self.reset()
            self._shape, self._looked_ns = frame.image.shape, now_ns
        elapsed_s = 0.0 if self._last_ns is None else (now_ns - self._last_ns) * 1e-9
        self._last_ns = now_ns
        self._num_frames += 1
        if self._is_driving(frame):
            self._driven_s += elapsed_s
        if not self._check_next(frame) and len(proposals):
            self._look_at(frame, proposals.boxes_xyxy_px[self._num_frames % len(proposals)].tolist())
        return self._without_standing(frame, proposals)

    def _continues(self, frame: Frame) -> bool:
        """Whether the frame is soon after the last one, and of the same size."""
        if self._last_ns is None or frame.image.shape != self._shape:
            return False
        return 0 <= frame.timestamp_ns - self._last_ns <= self.config.forget_s * 1e9

    def _is_driving(self, frame: Frame) -> bool:
        if frame.motion is not None:
            return frame.motion.speed_mps >= self.config.min_speed_mps
        return self._flow >= MIN_FLOW

    def _check_next(self, frame: Frame) -> bool:
        """Checks the region that waits longest, if it is time: it stays, is learnt, or is dropped."""
        now_ns = frame.timestamp_ns
        if not self._waiting or now_ns - self._waiting[0].checked_ns < CHECK_S * 1e9:
            return False
        region = self._waiting.popleft()
        if not self._is_same(region, frame):
            return True
        is_proven = self._driven_s - region.born_driven_s >= self.config.learn_s and region.num_same >= MIN_CHECKS
        if is_proven and self._has_room(region):
            self._learnt.append(region)
        else:
            self._waiting.append(region)
        return True

    def _has_room(self, region: _Region) -> bool:
        learnt_px = sum(learnt.area_px for learnt in self._learnt)
        return learnt_px + region.area_px <= self.config.max_area * self._shape[0] * self._shape[1]

    def _is_same(self, region: _Region, frame: Frame) -> bool:
        """Whether the patch is where it was, and looks as it did, up to its contrast.

        With the first patch T, a patch that has moved by d and changed its contrast by the factor a is, to first order,
        a T - a d · grad T: a linear fit gives both.
        """
        region.checked_ns = frame.timestamp_ns
        samples = region.samples(frame.image)
        fit = region.solver @ samples
        gain, *moved = fit.tolist()
        if not GAIN_LIMITS[0] <= gain <= GAIN_LIMITS[1]:
            return False
        if max(map(abs, moved)) > self.config.max_shift_px * gain:
            return False
        if fit @ region.normal @ fit < (1.0 - self.config.max_change) * (samples @ samples):
            return False
        region.same_ns = frame.timestamp_ns
        region.num_same += 1
        return True

    def _look_at(self, frame: Frame, box: list[int]) -> None:
        """Notes whether a box, a different one in each frame, flows; makes a region of it if it is in none yet."""
        regions = [*self._waiting, *self._learnt]
        holding = [region for region in regions if _holds(region, box)]
        is_flowing = all(region.num_same < MIN_STOOD for region in holding)
        seconds = (frame.timestamp_ns - self._looked_ns) * 1e-9
        self._flow += (is_flowing - self._flow) * min(1.0, seconds / FLOW_S)
        self._looked_ns = frame.timestamp_ns
        if holding or len(regions) >= MAX_REGIONS:
            return
        region = _region(frame, box, self._driven_s)
        if region is not None and region.area_px <= self.config.max_area * frame.image.size:
            self._waiting.append(region)

    def _without_standing(self, frame: Frame, proposals: Proposals) -> Proposals:
        if not self._learnt:
            return proposals
        forget_ns = frame.timestamp_ns - self.config.forget_s * 1e9
        same = [region.edges_px for region in self._learnt if self._is_same(region, frame)]
        self._learnt = [region for region in self._learnt if region.same_ns >= forget_ns]
        if not same:
            return proposals
        # A box lies in a region if its first two edges are not below, and its last two not above.
        boxes = proposals.boxes_xyxy_px
        is_beyond = boxes[:, np.newaxis] * _SIGNS < np.array(same, np.int32) * _SIGNS
        is_out = np.all(np.any(is_beyond, axis=2), axis=1)
        return proposals if is_out.all() else Proposals(boxes[is_out])


def _holds(region: _Region, box: list[int]) -> bool:
    x1, y1, x2, y2 = region.edges_px
    return x1 <= box[0] and y1 <= box[1] and box[2] <= x2 and box[3] <= y2


def _region(frame: Frame, box: list[int], driven_s: float) -> _Region | None:
    """The region of a box, cut to where the image has derivatives; None if its place cannot be told in both axes."""
    height, width = frame.image.shape
    x1, y1, x2, y2 = box
    rim = max(MIN_RIM_PX, round(RIM_SHARE * min(x2 - x1, y2 - y1)))
    x1, y1, x2, y2 = max(1, x1 - rim), max(1, y1 - rim), min(width - 1, x2 + rim), min(height - 1, y2 + rim)
    if x2 - x1 < 3 or y2 - y1 < 3:
        return None
    stride = -(-max(x2 - x1, y2 - y1) // MAX_SAMPLES)

    def samples(down: int, across: int) -> NDArray[np.float32]:
        rows, columns = slice(y1 + down, y2 + down, stride), slice(x1 + across, x2 + across, stride)
        return frame.image[rows, columns].astype(np.float32).ravel()

    by_x, by_y = 0.5 * (samples(0, -1) - samples(0, 1)), 0.5 * (samples(-1, 0) - samples(1, 0))
    basis = np.stack([samples(0, 0), by_x, by_y], 1)
    basis -= basis.mean(0)
    normal = basis.T.astype(np.float64) @ basis
    xx, xy, yy = (float(normal[row, column]) for row, column in ((1, 1), (1, 2), (2, 2)))
    if xx * yy - xy * xy <= MIN_CORNER * (xx + yy) ** 2 or normal[0, 0] <= len(basis):
        return None
    lengths = np.sqrt(normal.diagonal())
    if np.linalg.det(normal / np.outer(lengths, lengths)) <= MIN_PART:
        return None
    solver = (np.linalg.inv(normal) @ basis.T).astype(np.float32)
    now_ns = frame.timestamp_ns
    return _Region((x1, y1, x2, y2), stride, normal.astype(np.float32), solver, driven_s, now_ns, now_ns)
