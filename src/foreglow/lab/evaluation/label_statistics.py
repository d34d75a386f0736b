"""Statistics of labels, by which simulated labels are compared with real ones: number, positions and times."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeAlias

from pydantic import Field, RootModel

from foreglow.datasets import LabelledSource
from foreglow.datasets.json_files import Record, read_json
from foreglow.datasets.pvdn import PVDN_RATE_HZ
from foreglow.lab.evaluation.ratios import percentiles, ratio

Point: TypeAlias = tuple[float, float]

PERCENTILES = (10, 50, 90)
MAX_RATIO = 1.5
"""Simulated labels resemble real ones where each figure is within this factor of the real one."""


@dataclass(frozen=True, slots=True)
class LabelledImage:
    """The labels of an image.

    Attributes:
        direct: Lamps, positions x, y as shares of the image's width and height.
        indirect: Their indirect light, likewise.
    """

    num_vehicles: int
    direct: tuple[Point, ...] = ()
    indirect: tuple[Point, ...] = ()


@dataclass(frozen=True, slots=True)
class Spread:
    """Median and quartiles; NaN if there are no values."""

    num: int
    lower_quartile: float
    median: float
    upper_quartile: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """That of `values`, linear in between."""
        return cls(len(values), *percentiles(values, (25, 50, 75)))


@dataclass(frozen=True, slots=True)
class LabelStatistics:
    """Statistics of a set of sequences. An undefined share or mean is NaN; null in JSON.

    Hidden images have indirect instances only, images in sight have a direct instance.

    Attributes:
        num_instances: Direct and indirect instances.
        share_without_vehicle: Images without any vehicle.
        instances_per_image: Over all images.
        share_direct: Share of direct instances.
        share_one_when_hidden: Hidden images with exactly one instance.
        num_indirect_first: Sequences in which an indirect instance comes before the first direct instance.
        num_direct_first: Sequences in which a direct instance comes first, or both come in the same image.
        num_begun: Sequences whose first image already has an instance: their first times are unknown, and they count
            neither as indirect first nor as direct first.
        lead_frames: Images from the first indirect to the first direct instance, over the sequences in which the
            indirect instance comes first.
        hidden_frames: Hidden images of each sequence that has instances.
        in_sight_frames: Images in sight of each sequence that has instances.
        positions: Percentiles of the shares of width and height, by names such as `direct_x_p10`.
    """

    num_sequences: int
    num_images: int
    num_instances: int
    share_without_vehicle: float
    instances_per_image: float
    share_direct: float
    share_hidden: float
    share_in_sight: float
    indirect_per_hidden_image: float
    share_one_when_hidden: float
    indirect_per_image_in_sight: float
    direct_per_image_in_sight: float
    num_indirect_first: int
    num_direct_first: int
    num_begun: int
    lead_frames: Spread
    hidden_frames: Spread
    in_sight_frames: Spread
    positions: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Comparison:
    """A figure of real and simulated labels.

    Attributes:
        ratio: Simulated over real; NaN where either is undefined, or only the real figure is 0.
        is_close: Whether the ratio is within `MAX_RATIO` both ways.
    """

    name: str
    real: float
    simulated: float
    ratio: float
    is_close: bool


def label_statistics(sequences: Iterable[Sequence[LabelledImage]], rate_hz: float = PVDN_RATE_HZ) -> LabelStatistics:
    """Statistics of `sequences`, each with its images in the order of time, at `rate_hz` images a second.

    Times are in frames at PVDN's rate, whatever the rate of the sequences.
    """
    frames = PVDN_RATE_HZ / rate_hz
    drives = [list(images) for images in sequences]
    images = [image for drive in drives for image in drive]
    direct = [point for image in images for point in image.direct]
    indirect = [point for image in images for point in image.indirect]
    hidden = [len(image.indirect) for image in images if image.indirect and not image.direct]
    in_sight = [image for image in images if image.direct]
    num_instances = len(direct) + len(indirect)

    labelled = [drive for drive in drives if any(image.direct or image.indirect for image in drive)]
    begun = [drive for drive in labelled if drive[0].direct or drive[0].indirect]
    leads = [_lead_frames(drive) for drive in labelled if not (drive[0].direct or drive[0].indirect)]
    return LabelStatistics(
        num_sequences=len(drives),
        num_images=len(images),
        num_instances=num_instances,
        share_without_vehicle=ratio(sum(image.num_vehicles == 0 for image in images), len(images)),
        instances_per_image=ratio(num_instances, len(images)),
        share_direct=ratio(len(direct), num_instances),
        share_hidden=ratio(len(hidden), len(images)),
        share_in_sight=ratio(len(in_sight), len(images)),
        indirect_per_hidden_image=ratio(sum(hidden), len(hidden)),
        share_one_when_hidden=ratio(hidden.count(1), len(hidden)),
        indirect_per_image_in_sight=ratio(sum(len(image.indirect) for image in in_sight), len(in_sight)),
        direct_per_image_in_sight=ratio(len(direct), len(in_sight)),
        num_indirect_first=sum(lead > 0 for lead in leads),
        num_direct_first=sum(lead <= 0 for lead in leads),
        num_begun=len(begun),
        lead_frames=Spread.of([frames * lead for lead in leads if 0 < lead < math.inf]),
        hidden_frames=Spread.of(
            [frames * sum(bool(image.indirect and not image.direct) for image in drive) for drive in labelled]
        ),
        in_sight_frames=Spread.of([frames * sum(bool(image.direct) for image in drive) for drive in labelled]),
        positions=_percentiles("direct", direct) | _percentiles("indirect", indirect),
    )


def compare_labels(real: LabelStatistics, simulated: LabelStatistics) -> tuple[Comparison, ...]:
    """Every figure that does not depend on the number of sequences, of real and simulated labels side by side."""
    others, rows = _figures(simulated), []
    for name, value in _figures(real).items():
        quotient = 1.0 if value == others[name] else ratio(others[name], value)
        rows.append(Comparison(name, value, others[name], quotient, 1 / MAX_RATIO <= quotient <= MAX_RATIO))
    return tuple(rows)


def labels_of_split(dataset: LabelledSource) -> tuple[tuple[LabelledImage, ...], ...]:
    """The labels of the selected images, by sequence.

    Raises:
        FileNotFoundError: If a keypoint file is missing.
        ValueError: If a keypoint file is broken.
    """
    drives: dict[int, list[LabelledImage]] = {}
    for image_id in dataset.frame_ids:
        image, vehicles = dataset.image(image_id), dataset.annotations(image_id)
        points: dict[bool, list[Point]] = {True: [], False: []}
        for light in (light for vehicle in vehicles for light in vehicle.instances):
            x, y = light.position_px
            points[light.is_direct].append((x / image.width_px, y / image.height_px))
        found = LabelledImage(len(vehicles), tuple(points[True]), tuple(points[False]))
        drives.setdefault(dataset.sequence(image_id).id, []).append(found)
    return tuple(map(tuple, drives.values()))


class _DigestImage(Record):
    id: Annotated[int, Field(ge=0)]
    vehicles: tuple[Point, ...]
    direct: tuple[Point, ...]
    indirect: tuple[Point, ...]


class _Digest(RootModel[dict[str, tuple[_DigestImage, ...]]]):
    """Images with positions in pixels, by sequence."""


def read_label_digest(path: Path, width_px: int = 1280, height_px: int = 960) -> tuple[tuple[LabelledImage, ...], ...]:
    """The labels in a digest of a split: a JSON object of lists of images by sequence, in order of time.

    Each image has an `id` and lists of pixels x, y: `vehicles`, `direct` and `indirect`; other fields are ignored.

    Args:
        path: The file.
        width_px: Columns of all images, as the file does not have them.
        height_px: Rows of all images.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not JSON, or a field is missing or wrong.
    """

    def shares(points: Iterable[Point]) -> tuple[Point, ...]:
        return tuple((x / width_px, y / height_px) for x, y in points)

    return tuple(
        tuple(LabelledImage(len(image.vehicles), shares(image.direct), shares(image.indirect)) for image in images)
        for images in read_json(path, _Digest).root.values()
    )


def _lead_frames(drive: Sequence[LabelledImage]) -> float:
    """Images from the first indirect to the first direct instance; infinite without a direct instance."""
    first_indirect = next((number for number, image in enumerate(drive) if image.indirect), math.inf)
    first_direct = next((number for number, image in enumerate(drive) if image.direct), math.inf)
    return first_direct - first_indirect


def _percentiles(name: str, points: Sequence[Point]) -> dict[str, float]:
    by_axis = {axis: percentiles([point[column] for point in points], PERCENTILES) for column, axis in enumerate("xy")}
    return {
        f"{name}_{axis}_p{percent}": value
        for axis, values in by_axis.items()
        for percent, value in zip(PERCENTILES, values, strict=True)
    }


def _figures(statistics: LabelStatistics) -> dict[str, float]:
    num_known = statistics.num_indirect_first + statistics.num_direct_first
    names = (
        "instances_per_image",
        "share_direct",
        "share_without_vehicle",
        "share_hidden",
        "share_in_sight",
        "indirect_per_hidden_image",
        "share_one_when_hidden",
        "indirect_per_image_in_sight",
        "direct_per_image_in_sight",
    )
    spreads = ("lead_frames", "hidden_frames", "in_sight_frames")
    return {
        **{name: getattr(statistics, name) for name in names},
        "share_indirect_first": ratio(statistics.num_indirect_first, num_known),
        **{
            f"{name}_{quartile}": getattr(getattr(statistics, name), quartile)
            for name in spreads
            for quartile in ("lower_quartile", "median", "upper_quartile")
        },
        **statistics.positions,
    }
