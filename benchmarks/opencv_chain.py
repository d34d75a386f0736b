"""The proposal stage as a chain of OpenCV calls: the opponent of the native core in `benchmarks.detector`.

It is as quick as we could make it: float32, buffers kept between frames, the threshold without a division, strips that
stay in the second-level cache, NumPy where OpenCV is slower, and contours in place of `connectedComponentsWithStats`
(three times quicker). It runs in the thread of the caller under `one_opencv_thread`.
Single precision decides the pixels at the very threshold, so that a box may differ from the reference now and then.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.config import ProposalConfig
from foreglow.proposals.reference import working_sizes
from foreglow.types import Image, Proposals

STRIP_ROWS = 80
"""Rows of the working image that one call of the elementwise steps takes; the quickest of 20 to 480."""


@contextmanager
def one_opencv_thread() -> Iterator[None]:
    """OpenCV computes in the caller's thread only, inside the block."""
    num_threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(num_threads)


class OpenCvProposer:
    """The published proposals of uint8 frames of one size, reduced by two or four, in OpenCV."""

    def __init__(self, config: ProposalConfig, width_px: int = 1280, height_px: int = 960) -> None:
        """Makes the buffers.

        Raises:
            ValueError: If the frame is not reduced by two or four, or its size is no multiple of that.
        """
        self.config = config
        self.sizes = working_sizes(config, width_px)
        factor = self.sizes.reduction
        if factor not in (2, 4) or width_px % factor or height_px % factor:
            raise ValueError(
                f"frame: expected a size that is reduced by two or four, got {width_px}x{height_px} by {factor}"
            )
        rows, columns = self.shape = height_px // factor, width_px // factor
        h, d = self.sizes.half_window_px, self.sizes.gap_px
        self._halves = np.empty((height_px // 2, width_px // 2), np.uint16)
        self._sums = self._halves if factor == 2 else np.empty(self.shape, np.uint16)
        self._normalised = np.empty(self.shape, np.float32)
        padded = np.zeros((rows + 2 * h - 1, columns + 2 * h - 1), np.float32)  # zeros where a window leaves the frame
        self._padded, self._blurred = padded, padded[h - 1 : h - 1 + rows, h - 1 : h - 1 + columns]
        self._integral = np.empty((rows + 2 * h, columns + 2 * h), np.float32)
        self._wide = np.zeros((rows + 2 * d, columns + 2 * d), np.uint8)
        self._dilated = np.empty_like(self._wide)
        self._square = np.ones((d, d), np.uint8)
        self._fill = [_fill_factors(length, h) for length in self.shape]
        across = (STRIP_ROWS, columns)
        self._even, self._odd = (np.empty((2 * STRIP_ROWS, width_px // 2), np.uint16) for _ in range(2))
        self._tall = np.empty((STRIP_ROWS, columns + 2 * h), np.float32)
        self._mean, self._threshold = np.empty(across, np.float32), np.empty(across, np.float32)
        self._one_eps = np.full(across, 1.0 + config.eps, np.float32)

    def propose(self, image: Image) -> Proposals:
        """The proposals of `image`: uint8, contiguous, of the size given at construction."""
        self._reduce(image)
        cv2.normalize(self._sums, self._normalised, 0.0, 1.0, cv2.NORM_MINMAX, cv2.CV_32F)
        blur_size = self.config.blur_width_px, self.config.blur_height_px
        cv2.GaussianBlur(self._normalised, blur_size, self.config.blur_sigma_px, dst=self._blurred)
        self._integrate()
        self._binarise()
        return Proposals(self._boxes())

    def _reduce(self, image: Image) -> None:
        """Sums of blocks, exact; the bytes of each pair are split by a mask and a shift."""
        pairs = image.view(np.uint16)
        for top in range(0, len(self._halves), STRIP_ROWS):
            strip = pairs[2 * top : 2 * (top + STRIP_ROWS)]
            even, odd = self._even[: len(strip)], self._odd[: len(strip)]
            np.bitwise_and(strip, 255, out=even)
            np.right_shift(strip, 8, out=odd)
            np.add(even, odd, out=even)
            np.add(even[::2], even[1::2], out=self._halves[top : top + STRIP_ROWS])
        if self._sums is not self._halves:
            across = self._halves[:, ::2] + self._halves[:, 1::2]
            np.add(across[::2], across[1::2], out=self._sums)

    def _integrate(self) -> None:
        """Integral image of the blurred image without its row 0 and column 0, which no published window reads."""
        row, column = self._blurred[0].copy(), self._blurred[:, 0].copy()
        self._blurred[0] = self._blurred[:, 0] = 0.0
        cv2.integral(self._padded, self._integral, cv2.CV_32F)
        self._blurred[0], self._blurred[:, 0] = row, column

    def _binarise(self) -> None:
        """I > T. With A = 1 + eps and D = I - mu the threshold is a quadratic in D, whose lower root gives.

        T = (1 + kappa) mu + A / 2 - sqrt((A / 2)^2 + (kappa mu)^2): a function of mu alone.
        """
        kappa, two_h, gap_px = self.config.kappa, 2 * self.sizes.half_window_px, self.sizes.gap_px
        half_a, columns, integral = 0.5 * (1.0 + self.config.eps), self.shape[1], self._integral
        scale = 2.0 * kappa / two_h**2
        binary = self._wide[gap_px:-gap_px, gap_px:-gap_px]
        for top in range(0, self.shape[0], STRIP_ROWS):
            stop = min(top + STRIP_ROWS, self.shape[0])
            used = slice(0, stop - top)
            tall, mean, threshold = self._tall[used], self._mean[used], self._threshold[used]
            cv2.subtract(integral[top + two_h : stop + two_h], integral[top:stop], dst=tall)
            cv2.addWeighted(tall[:, two_h:], scale, tall[:, :columns], -scale, 0.0, dst=mean)  # 2 kappa mu
            cv2.threshold(mean, 0.0, 0.0, cv2.THRESH_TOZERO, dst=mean)  # rounding must not set pixels of black areas
            self._correct_borders(mean, top, stop)
            cv2.magnitude(mean, self._one_eps[used], threshold)
            cv2.addWeighted(mean, 0.5 * (1.0 + kappa) / kappa, threshold, -0.5, half_a, dst=threshold)
            cv2.compare(self._blurred[top:stop], threshold, cv2.CMP_GT, dst=binary[top:stop])

    def _correct_borders(self, mean: NDArray[np.float32], top: int, stop: int) -> None:
        """Divides by the pixels that a window at the frame's border really holds."""
        two_h = 2 * self.sizes.half_window_px
        down, across = self._fill
        if top < two_h or stop > self.shape[0] - two_h:
            mean *= down[top:stop, None]
        mean[:, :two_h] *= across[:two_h]
        mean[:, -two_h:] *= across[-two_h:]

    def _boxes(self) -> NDArray[np.int32]:
        """Boxes of the blobs that pass the filters, sorted, in frame pixels."""
        sizes, gap_px, boxes = self.sizes, self.sizes.gap_px, []
        cv2.dilate(self._wide, self._square, dst=self._dilated)
        contours, hierarchy = cv2.findContours(self._dilated, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
        for contour, parent in zip(contours, hierarchy[0, :, 3] if contours else (), strict=True):
            if parent >= 0:  # the edge of a hole
                continue
            x, y, width, height = cv2.boundingRect(contour)
            # A d x d square with OpenCV's anchor widens a blob by d - 1 in all, (d - 1) // 2 of it at the left and top.
            x, y = x + (gap_px - 1) // 2 - gap_px, y + (gap_px - 1) // 2 - gap_px
            width, height = width - gap_px + 1, height - gap_px + 1
            if not (sizes.min_area_px <= width * height <= sizes.max_area_px and width >= sizes.min_width_px):
                continue
            inside = self._blurred[y : y + height, x : x + width]
            deviation = cv2.mean(cv2.absdiff(inside, np.array(cv2.mean(inside))))[0]
            if deviation > self.config.min_deviation:
                boxes.append((y, x, y + height, x + width))
        return 2 * np.array(sorted(boxes), np.int32).reshape(-1, 4)[:, [1, 0, 3, 2]]


def _fill_factors(length: int, half_window_px: int) -> NDArray[np.float32]:
    """For each position, 2h over the number of pixels in max(1, x-h+1) .. min(length-1, x+h)."""
    position = np.arange(length)
    first, last = np.maximum(1, position - half_window_px + 1), np.minimum(length - 1, position + half_window_px)
    return np.asarray(2 * half_window_px / (last - first + 1), np.float32)
