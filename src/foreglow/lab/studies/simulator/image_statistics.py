"""What pixels look like: levels, noise, fixed pattern and lamps of grey images; to hold simulated beside real ones."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.config import preset
from foreglow.lab.simulation.camera.optics import REFERENCE_WIDTH_PX
from foreglow.pipeline import Pipeline

DARK_ROWS = 0.4
"""The upper share of the rows is night sky or forest: noise and pattern are measured there."""

PERCENTILES = (1.0, 5.0, 25.0, 50.0, 75.0, 95.0, 99.0, 99.9)
LAMP_RADII_PX = (0.0, 1.0, 2.0, 4.0, 6.0, 8.0, 11.0, 15.0, 20.0, 30.0, 45.0, 65.0)
COLUMN_WINDOW_PX = 21
RESIDUAL_SIGMA_PX = 8.0


@dataclass(frozen=True, slots=True)
class ImageStatistics:
    """Of one image, or the mean over several. Grey levels of 8 bits; lengths are pixels of 1280 columns.

    The dark area is the upper 40 % of the rows. NaN where an image is too small or has no lamp.

    Attributes:
        num_images: How many.
        dark_grey: Mean of the dark area: the black level, if nothing is lit there.
        percentiles_grey: Of all pixels, at `PERCENTILES`.
        column_grey: Standard deviation of the dark area's column means, less their moving mean over 21 columns.
        row_parity_grey: Standard deviation of half the difference between even and odd rows' column means.
        row_grey: The same as `column_grey` for the means of the rows.
        noise_grey: Standard deviation in the dark area, less its column means and what changes slowly (sigma 8).
        correlation_x: Of that residual with its neighbour in the same row.
        correlation_y: With its neighbour in the same column.
        correlation_y2: With the next but one in the same column: above `correlation_y` where rows alternate.
        lamp_grey: Around the brightest spot, median grey of rings between `LAMP_RADII_PX`, in the half-plane above
            it, where no road shines.
        num_saturated: Pixels at 255.
        num_proposals: Boxes that the detector proposes, preset `paper`.
    """

    num_images: int
    dark_grey: float
    percentiles_grey: tuple[float, ...]
    column_grey: float
    row_parity_grey: float
    row_grey: float
    noise_grey: float
    correlation_x: float
    correlation_y: float
    correlation_y2: float
    lamp_grey: tuple[float, ...]
    num_saturated: float
    num_proposals: float

    def to_json(self) -> dict[str, Any]:
        """All fields by name, for JSON: null instead of NaN."""
        values = dataclasses.asdict(self)
        return {
            name: [_or_none(part) for part in value] if isinstance(value, tuple) else _or_none(value)
            for name, value in values.items()
        }


@dataclass(frozen=True, slots=True)
class PixelComparison:
    """One number of real and simulated images.

    Attributes:
        name: What it is.
        real: Of the real ones.
        simulated: Of the simulated ones.
    """

    name: str
    real: float
    simulated: float

    @property
    def ratio(self) -> float:
        """Simulated over real; NaN where the real one is 0 or the signs differ."""
        return self.simulated / self.real if self.real * self.simulated > 0 else math.nan

    def to_json(self) -> dict[str, Any]:
        """All fields and the ratio by name, for JSON: null instead of NaN."""
        values = dataclasses.asdict(self) | {"ratio": self.ratio}
        return {name: _or_none(value) for name, value in values.items()}


def image_statistics(images: NDArray[np.uint8] | Sequence[NDArray[np.uint8]]) -> ImageStatistics:
    """The statistics of one grey image, shape (H, W), or the mean over several of the same size.

    Raises:
        ValueError: If there is none, or one is not two-dimensional, smaller than 32x32, or not uint8.
    """
    listed = [images] if isinstance(images, np.ndarray) and images.ndim == 2 else list(images)
    if not listed:
        raise ValueError("image_statistics: expected at least one image, got none")
    for image in listed:
        if image.ndim != 2 or min(image.shape) < 32 or image.dtype != np.uint8:
            raise ValueError(
                f"image_statistics: expected grey uint8 images of at least 32x32, got {image.dtype} {image.shape}"
            )
    pipeline = Pipeline(preset("paper"))
    each = [_of_one(image, pipeline) for image in listed]
    means: dict[str, Any] = {}
    for field in dataclasses.fields(ImageStatistics):
        values = np.array([getattr(statistics, field.name) for statistics in each], np.float64)
        mean = values.mean(0)
        means[field.name] = tuple(map(float, mean)) if mean.ndim else float(mean)
    return ImageStatistics(**{**means, "num_images": len(listed)})


def compare(real: ImageStatistics, simulated: ImageStatistics) -> tuple[PixelComparison, ...]:
    """Both, number by number, as the rows of a table."""
    rows = []
    for field in dataclasses.fields(ImageStatistics):
        if field.name == "num_images":
            continue
        one, other = getattr(real, field.name), getattr(simulated, field.name)
        if field.name == "percentiles_grey":
            names = [f"grey level, percentile {share:g}" for share in PERCENTILES]
        elif field.name == "lamp_grey":
            names = [f"lamp, {a:g} to {b:g} px" for a, b in itertools.pairwise(LAMP_RADII_PX)]
        else:
            names, one, other = [field.name.replace("_", " ")], (one,), (other,)
        rows += [PixelComparison(*row) for row in zip(names, one, other, strict=True)]
    return tuple(rows)


def _of_one(image: NDArray[np.uint8], pipeline: Pipeline) -> ImageStatistics:
    scale = image.shape[1] / REFERENCE_WIDTH_PX
    dark = image[: int(DARK_ROWS * image.shape[0])].astype(np.float64)
    columns = dark.mean(0)
    parity = (dark[::2].mean(0) - dark[1::2].mean(0)) / 2.0
    window = max(3, 2 * round(COLUMN_WINDOW_PX * scale / 2) + 1)
    residual = dark - columns
    residual -= cv2.GaussianBlur(residual, (0, 0), max(2.0, RESIDUAL_SIGMA_PX * scale))
    return ImageStatistics(
        num_images=1,
        dark_grey=float(dark.mean()),
        percentiles_grey=tuple(map(float, np.percentile(image, PERCENTILES))),
        column_grey=_rough(columns, window),
        row_parity_grey=_rough(parity, window),
        row_grey=_rough(dark.mean(1), window),
        noise_grey=float(residual.std()),
        correlation_x=_correlation(residual[:, :-1], residual[:, 1:]),
        correlation_y=_correlation(residual[:-1], residual[1:]),
        correlation_y2=_correlation(residual[:-2], residual[2:]),
        lamp_grey=_lamp(image, scale),
        num_saturated=int((image == 255).sum()),
        num_proposals=len(pipeline.step(image).proposals),
    )


def _rough(values: NDArray[np.float64], window: int) -> float:
    """Standard deviation of a profile less its moving mean."""
    smooth = cv2.blur(values[np.newaxis], (window, 1), borderType=cv2.BORDER_REFLECT)[0]
    return float((values - smooth).std())


def _correlation(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    power = math.sqrt(float((one**2).mean() * (other**2).mean()))
    return float((one * other).mean()) / power if power > 0 else math.nan


def _lamp(image: NDArray[np.uint8], scale: float) -> tuple[float, ...]:
    """Median grey over rings above the brightest spot; NaN for rings that hold no pixel."""
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), max(0.5, 1.5 * scale))
    row, column = np.unravel_index(int(smooth.argmax()), image.shape)
    radii_px = np.asarray(LAMP_RADII_PX) * scale
    reach = math.ceil(radii_px[-1])
    x0, y0 = max(0, int(column) - reach), max(0, int(row) - reach)
    above = image[y0 : int(row) + 1, x0 : int(column) + reach + 1]
    rows, columns = np.mgrid[: above.shape[0], : above.shape[1]]
    distances = np.hypot(rows + y0 - row, columns + x0 - column)
    rings = [above[(distances >= a) & (distances < b)] for a, b in itertools.pairwise(radii_px)]
    return tuple(float(np.median(ring)) if ring.size else math.nan for ring in rings)


def _or_none(value: Any) -> Any:
    return None if isinstance(value, float) and math.isnan(value) else value
