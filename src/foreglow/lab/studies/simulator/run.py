"""How close a simulated set comes to real drives: its labels, its pixels, and the time that indirect light leads."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from foreglow.datasets import LabelledSource, open_labelled, read_image, to_grey
from foreglow.datasets.pvdn.splits import found_name
from foreglow.datasets.simulated import SequenceTruth, read_truth
from foreglow.lab.evaluation.label_statistics import (
    Comparison,
    LabelStatistics,
    compare_labels,
    label_statistics,
    labels_of_split,
    read_label_digest,
)
from foreglow.lab.simulation.camera.optics import REFERENCE_WIDTH_PX
from foreglow.lab.simulation.labels.categories import is_oncoming
from foreglow.lab.simulation.writing.scene_files import scene_of
from foreglow.lab.studies.simulator.metrics import (
    FACTORS,
    ImageStatistics,
    PeaksOfFrame,
    PixelComparison,
    RuleEffect,
    compare_images,
    first_times,
    image_statistics,
    rule_effects,
)

NUM_IMAGES = 24
"""Images whose pixels are measured: those with a lamp in sight, evenly spread over the set."""


@dataclass(frozen=True, slots=True)
class SimulatorResults:
    """Everything that the report shows.

    Attributes:
        name: The split that was examined.
        label_rows: These statistics beside those of real labels; None without real labels.
        has_lamps: Whether the images whose pixels are measured show a lamp; they do unless no image does.
        pixel_rows: These statistics beside those of a real image; None without a real image.
        effects: How first times move with the rule of what is perceivable.
        leads_s: First lamp minus first indirect light, for each drive that has both; negative if the lamp comes first.
        production_delays_s: First report of the modelled production system minus first indirect light, for each drive
            that has both.
    """

    name: str
    labels: LabelStatistics
    label_rows: tuple[Comparison, ...] | None
    pixels: ImageStatistics
    has_lamps: bool
    pixel_rows: tuple[PixelComparison, ...] | None
    effects: tuple[RuleEffect, ...]
    leads_s: tuple[float, ...]
    production_delays_s: tuple[float, ...]


def examine(split: Path, real_labels: Path | None = None, real_image: Path | None = None) -> SimulatorResults:
    """Examines the simulated split (or a folder that holds one).

    Args:
        split: The data set.
        real_labels: A digest of real labels, as `read_label_digest` takes it, or a real PVDN split.
        real_image: A real image of the same exposure.

    Raises:
        FileNotFoundError: If a file is missing.
        ValueError: If one is broken.
    """
    dataset = open_labelled(split)
    truth = read_truth(dataset.root)
    own_labels = label_statistics(labels_of_split(dataset), dataset.mean_rate_hz)
    with_lamp = _ids_with_lamp(truth)
    own_pixels = image_statistics(_some_images(dataset, with_lamp or dataset.frame_ids))
    drives = [peaks_of_drive(drive) for drive in truth]
    rule = scene_of(next(iter(truth))).labels
    scale = next(iter(truth)).camera.width_px / REFERENCE_WIDTH_PX
    label_rows = None if real_labels is None else compare_labels(real_statistics(real_labels), own_labels)
    pixel_rows = None
    if real_image is not None:
        pixel_rows = compare_images(image_statistics(np.asarray(to_grey(read_image(real_image)), np.uint8)), own_pixels)
    times = [first_times(drive, rule, scale) for drive in drives]
    delays = []
    for drive, time in zip(truth, times, strict=True):
        reports_s = (frame.timestamp_ns / 1e9 for frame in drive.frames if frame.is_production_detected)
        delays.append(next(reports_s, np.inf) - time.indirect_s)
    return SimulatorResults(
        name=found_name(split),
        labels=own_labels,
        label_rows=label_rows,
        pixels=own_pixels,
        has_lamps=bool(with_lamp),
        pixel_rows=pixel_rows,
        effects=rule_effects(drives, rule, FACTORS, scale),
        leads_s=tuple(time.lead_s for time in times if np.isfinite(time.lead_s)),
        production_delays_s=tuple(delay for delay in delays if np.isfinite(delay)),
    )


def peaks_of_drive(drive: SequenceTruth) -> tuple[PeaksOfFrame, ...]:
    """What the images of a drive offer to another rule: candidates of oncoming vehicles."""
    oncoming = {number for number, vehicle in enumerate(scene_of(drive).vehicles) if is_oncoming(vehicle)}
    frames = []
    for frame in drive.frames:
        vehicles = [vehicle for vehicle in frame.vehicles if vehicle.vehicle_id in oncoming]
        has_direct = any(
            artifact.is_direct and not artifact.is_rear and not artifact.is_doubtful
            for vehicle in vehicles
            for artifact in vehicle.artifacts
        )
        candidates = tuple(vehicle.candidates for vehicle in vehicles)
        frames.append(PeaksOfFrame(frame.timestamp_ns / 1e9, has_direct, candidates))
    return tuple(frames)


def real_statistics(path: Path) -> LabelStatistics:
    """The statistics of real labels: of a digest, or of a split, however many of its images are labelled.

    Raises:
        FileNotFoundError: If a file is missing.
        ValueError: If one is broken.
    """
    if path.is_dir():
        dataset = open_labelled(path)
        return label_statistics(labels_of_split(dataset), dataset.mean_rate_hz)
    return label_statistics(read_label_digest(path))


def _ids_with_lamp(truth: Iterable[SequenceTruth]) -> list[int]:
    """The images that show a lamp, as the one real image does."""
    return [
        frame.image_id
        for drive in truth
        for frame in drive.frames
        if any(artifact.is_direct for vehicle in frame.vehicles for artifact in vehicle.artifacts)
    ]


def _some_images(dataset: LabelledSource, shown: Sequence[int]) -> Sequence[NDArray[np.uint8]]:
    chosen = np.unique(np.linspace(0, len(shown) - 1, min(NUM_IMAGES, len(shown))).round().astype(int))
    return [np.asarray(dataset.read(shown[index]).image, np.uint8) for index in chosen]
