"""Reading PVDN (Provident Vehicle Detection at Night): frames with keypoints of oncoming vehicles."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from foreglow.datasets.images import read_image
from foreglow.datasets.json_files import read_json
from foreglow.datasets.labelled import LabelledSource
from foreglow.datasets.pvdn.labels import PVDNLabels, read_labels
from foreglow.datasets.pvdn.schema import (
    BoxLabels,
    CameraConfiguration,
    Cycle,
    EnvironmentLighting,
    ImageCategory,
    ImageRecord,
    Instance,
    KeypointsFile,
    RoadType,
    Sequence,
    Vehicle,
    Weather,
)
from foreglow.datasets.pvdn.splits import find_split
from foreglow.datasets.simulated.vehicle import SimulatedVehicle
from foreglow.datasets.source import OnError
from foreglow.datasets.vehicle_data import equip
from foreglow.files import check_is_folder, checked_path
from foreglow.types import Frame
from foreglow.types.white import full_scale
from foreglow.wording import check_one_of, shortened

PVDN_RATE_HZ = 18.0
"""Frames a second within one exposure cycle. Source: Ohnemus et al., arXiv 2012.15376."""

MIN_RATE_HZ, MAX_RATE_HZ = 0.01, 1000.0
"""Lowest and highest frame rate that a set may state."""

_MAX_TIME_MS = 2.0**53

_STORED_TO_S = 0.0015  # times are stored as whole milliseconds


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """Which images of a split are wanted: those that fulfil all fields that are not None.

    Attributes:
        scenes: Sequences, by id or folder name.
        cycle: Exposure cycle, as in `PVDN.cycle_of`.
        weathers: Weather of the sequence.
        lightings: Ambient light of the sequence.
        road_types: Road of the sequence.
        categories: At least one category of the image is among these; an image without a category counts as NONE.
        has_keypoints: Whether the image has at least one instance in its keypoint file; reads those files.

    Raises:
        ValueError: If a field is of another kind.
    """

    scenes: Collection[int | str] | None = None
    cycle: Cycle | None = None
    weathers: Collection[Weather] | None = None
    lightings: Collection[EnvironmentLighting] | None = None
    road_types: Collection[RoadType] | None = None
    categories: Collection[ImageCategory] | None = None
    has_keypoints: bool | None = None

    def __post_init__(self) -> None:
        for name in ("scenes", "weathers", "lightings", "road_types", "categories"):
            chosen = getattr(self, name)
            if chosen is None:
                continue
            kinds = (int, np.integer, str) if name == "scenes" else (int, np.integer)
            if isinstance(chosen, str) or not isinstance(chosen, Collection):
                raise ValueError(f"Selection.{name}: expected a list or a set, got {shortened(chosen)}")
            if not all(isinstance(each, kinds) for each in chosen):
                expected = "numbers or names of sequences" if name == "scenes" else "members of its enumeration"
                raise ValueError(f"Selection.{name}: expected {expected}, got {shortened([*chosen])}")
        if self.cycle is not None:
            check_one_of(self.cycle, Cycle, "Selection.cycle")
        if not isinstance(self.has_keypoints, bool | np.bool_ | None):
            raise ValueError(
                f"Selection.has_keypoints: expected a truth value or None, got {shortened(self.has_keypoints)}"
            )


class PVDN(LabelledSource):
    """A split of PVDN, such as `PVDN/day/val`, or one of its sequences, such as `PVDN/day/val/images/S00121`.

    Labels are read and checked at construction; images, keypoints and boxes when they are asked for. Iterating
    yields frames in the order of sequence and image id, where `Frame.frame` is the image's id and `Frame.sequence`
    the sequence's folder.

    Timestamps are the sequence's start time (documented as relative milliseconds) plus the image's number in its
    sequence, counted over all its images sorted by id, divided by the frame rate. That is 18 Hz, unless the `info` of
    `image_annotations.json` has a `rate_hz`, as simulated sets and imported labels do. In such sets the field
    `timestamp` of the images is in milliseconds, and says the time where images are not at equal distances; in PVDN's
    own files it is not used, nor is `date_captured`, since their units are not documented. Different sequences share
    no time axis: reset the pipeline between them.

    Frames of a simulated split carry what the car knew: calibration, motion, and the road of its street message.

    Attributes:
        rate_hz: Frames a second within a sequence.
        root: The split's folder.
        labels: The label files as they are.
        cycle: The exposure cycle that the folder is in; None outside `day` and `night`.
        frame_ids: Ids of the selected images, in order.
    """

    def __init__(
        self,
        root: Path | str,
        *,
        select: Selection | None = None,
        on_error: OnError = "stop",
    ) -> None:
        """Reads the labels.

        Args:
            root: The split's or the sequence's folder, or a folder that has this split only, one or two levels below.
            select: The wanted images; None for all.
            on_error: What an image that is missing, broken or of the wrong size does; labels must always be right.

        Raises:
            FileNotFoundError: If the folder or a label file is missing.
            ValueError: If a label file is broken, they contradict each other, a selected scene does not exist, or there
                are several splits.
        """
        folder = checked_path(root, "root")
        if not isinstance(select, Selection | None):
            raise ValueError(f"select: expected a Selection or None, got {shortened(select)}")
        super().__init__(root, on_error)
        check_is_folder(folder, "a PVDN split or sequence")
        self.root, self._directory = find_split(folder)
        self.labels: PVDNLabels = read_labels(self.root)
        self.rate_hz = rate_of(self.labels.images_file.info, self.root)
        self._stored_times_s = _stored_times_s(self.labels, self.root)
        above = self.root.resolve().parent.name
        self.cycle: Cycle | None = Cycle(above) if above in set(Cycle) else None
        self._vehicle = SimulatedVehicle(self.root)
        self.frame_ids: tuple[int, ...] = tuple(self._selected(Selection() if select is None else select))

    @property
    def name(self) -> str:
        """Split, or split and sequence, such as `day/val/S00121`."""
        parts = [*self.root.resolve().parts[-2:], *([self._directory] if self._directory else [])]
        return "/".join(parts)

    @property
    def sequences(self) -> tuple[Sequence, ...]:
        """The sequences with at least one selected image, in the file's order."""
        selected = {self.sequence(image_id).id for image_id in self.frame_ids}
        return tuple(sequence for sequence in self.labels.sequences_file.sequences if sequence.id in selected)

    def __iter__(self) -> Iterator[Frame]:
        """The selected frames; with `stop`, a missing image file raises before the first frame is yielded."""
        self.skipped = []
        if self.on_error == "stop":
            for image_id in self.frame_ids:
                self._check_exists(image_id)
        reads = (functools.partial(self.read, image_id) for image_id in self.frame_ids)
        return self._read_each(reads)

    def read(self, image_id: int) -> Frame:
        """As in `LabelledSource`."""
        self._check_exists(image_id)
        frame = equip(self._frame(image_id, self.image_path(image_id), 0.0), self._vehicle)
        earlier = self.earlier(image_id)
        return frame if earlier is None else dataclasses.replace(frame, earlier=earlier)

    def earlier(self, image_id: int) -> Frame | None:
        """`Frame.earlier` of image `image_id`, with its number; None without one.

        Raises:
            FileNotFoundError: If its file is missing.
            ValueError: If there is no such id, or the earlier image is broken or of another size.
        """
        known = self.image(image_id).earlier
        if known is None:
            return None
        path = self.image_path(image_id).with_name(known.file_name)
        if not path.is_file():
            field = f"{self.root / 'labels' / 'image_annotations.json'}: image {image_id}: earlier.file_name"
            raise FileNotFoundError(f"{field}: expected an image of the sequence, {path} is not there")
        return self._frame(image_id, path, known.age_ms / 1000)

    def _frame(self, image_id: int, path: Path, age_s: float) -> Frame:
        """The image at `path`, taken `age_s` before image `image_id`, which has the same size."""
        record, sequence = self.image(image_id), self.sequence(image_id)
        image = read_image(path)
        if image.shape != (record.height_px, record.width_px):
            raise ValueError(
                f"{path}: image size: expected {record.width_px}x{record.height_px} px as in image_annotations.json, "
                f"got {image.shape[1]}x{image.shape[0]} px"
            )
        timestamp_ns = round(sequence.start_time_ms * 1_000_000) + round((self.time_s(image_id) - age_s) * 1e9)
        frame = Frame(image, timestamp_ns, frame=image_id, sequence=sequence.directory, path=str(path))
        return full_scale(frame, self.white_level)

    def annotations(self, image_id: int) -> tuple[Vehicle, ...]:
        """As in `LabelledSource`; every image has a keypoint file, also without vehicles."""
        return self._keypoints_file(image_id).annotations

    def doubtful(self, image_id: int) -> tuple[Instance, ...]:
        """As in `LabelledSource`; simulated sets have some."""
        return self._keypoints_file(image_id).doubtful

    def boxes(self, image_id: int) -> BoxLabels | None:
        """As in `LabelledSource`."""
        self.image(image_id)
        path = self.root / "labels" / "bounding_boxes" / f"{image_id:06d}.json"
        return read_json(path, BoxLabels) if path.exists() else None

    def image(self, image_id: int) -> ImageRecord:
        """The labels' record of image `image_id`; ValueError if there is no such id."""
        is_number = isinstance(image_id, int | np.integer) and not isinstance(image_id, bool)  # True == 1 in a dict
        if not is_number or image_id not in self.labels.images:
            raise ValueError(f"{self.root}: image_id: expected an image of this split, got {image_id}")
        return self.labels.images[image_id]

    def image_path(self, image_id: int) -> Path:
        """The file of image `image_id`."""
        return self.root / "images" / self.sequence(image_id).directory / self.image(image_id).file_name

    def sequence(self, image_id: int) -> Sequence:
        """The sequence of image `image_id`."""
        return self.labels.sequence_of[self.image(image_id).id]

    def time_s(self, image_id: int) -> float:
        """As in `LabelledSource`."""
        number = self.labels.number_of[self.image(image_id).id]
        stored = self._stored_times_s.get(image_id)
        even = number / self.rate_hz
        return even if stored is None or abs(stored - even) < _STORED_TO_S else stored

    def camera_configuration(self, image_id: int) -> CameraConfiguration:
        """Camera and exposure of image `image_id` by the labels, which the folder may contradict."""
        return self.labels.images_file.camera_configurations[self.image(image_id).camera_configuration]

    def cycle_of(self, image_id: int) -> Cycle:
        """Exposure cycle of image `image_id`: the folder's, or outside `day` and `night` that of the labels.

        The folder comes first since published images in `night` carry a camera configuration that says day.
        """
        return self.cycle or self.camera_configuration(image_id).cycle

    def categories(self, image_id: int) -> tuple[ImageCategory, ...]:
        """The categories of image `image_id`, in the file's order; (NONE,) where it has none."""
        return self.labels.categories.get(self.image(image_id).id, (ImageCategory.NONE,))

    def _keypoints_file(self, image_id: int) -> KeypointsFile:
        self.image(image_id)
        path = self._keypoints_path(image_id)
        if not path.exists():
            raise FileNotFoundError(f"{path}: no such file, expected the keypoints of image {image_id}")
        keypoints = read_json(path, KeypointsFile)
        if keypoints.image_id != image_id:
            raise ValueError(f"{path}: image_id: expected {image_id} as in the file's name, got {keypoints.image_id}")
        return keypoints

    def _check_exists(self, image_id: int) -> None:
        path = self.image_path(image_id)
        if not path.is_file():
            raise FileNotFoundError(f"{path}: no such image, expected that of id {image_id} in image_annotations.json")

    def _selected(self, select: Selection) -> Iterator[int]:
        """Ids of the images in the sequence, if the folder is a sequence, that `select` wants."""
        sequences = self.labels.sequences_file.sequences
        if self._directory is not None:
            sequences = tuple(sequence for sequence in sequences if sequence.directory == self._directory)
            if not sequences:
                path = self.root / "labels" / "sequences.json"
                raise ValueError(f"{path}: sequences: expected a sequence with dir {self._directory}, found none")
        if select.scenes is not None:
            known = {key for sequence in sequences for key in (sequence.id, sequence.directory)}
            for scene in select.scenes:
                if scene not in known:
                    raise ValueError(f"{self.root}: scenes: expected ids or folders of sequences, got {scene!r}")
        for sequence in sorted(sequences, key=lambda sequence: sequence.id):
            if _is_wanted(sequence, select):
                yield from (id_ for id_ in sorted(sequence.image_ids) if self._is_wanted_image(id_, select))

    def _is_wanted_image(self, image_id: int, select: Selection) -> bool:
        if select.cycle is not None and self.cycle_of(image_id) != select.cycle:
            return False
        if select.categories is not None and not set(select.categories).intersection(self.categories(image_id)):
            return False
        return select.has_keypoints is None or select.has_keypoints == self._has_keypoints(image_id)

    def _has_keypoints(self, image_id: int) -> bool:
        return self._keypoints_path(image_id).exists() and len(self.keypoints_px(image_id)) > 0

    def _keypoints_path(self, image_id: int) -> Path:
        return self.root / "labels" / "keypoints" / f"{image_id:06d}.json"


def rate_of(info: Mapping[str, Any], root: Path) -> float:
    """Frames a second: `rate_hz` of the set's `info`, or that of PVDN.

    Raises:
        ValueError: If it is none that images can have.
    """
    rate_hz = info.get("rate_hz", PVDN_RATE_HZ)
    if isinstance(rate_hz, bool) or not isinstance(rate_hz, int | float) or not MIN_RATE_HZ <= rate_hz <= MAX_RATE_HZ:
        path = root / "labels" / "image_annotations.json"
        wanted = f"a number from {MIN_RATE_HZ:g} to {MAX_RATE_HZ:g}"
        raise ValueError(f"{path}: info.rate_hz: expected {wanted}, got {shortened(rate_hz)}")
    return float(rate_hz)


def _stored_times_s(labels: PVDNLabels, root: Path) -> dict[int, float]:
    """Seconds since the first image of its sequence, by image, where the set states a rate and has such times.

    Raises:
        ValueError: If they are no numbers, do not increase, or only some images of a sequence have one.
    """
    times_s: dict[int, float] = {}
    if "rate_hz" not in labels.images_file.info:
        return times_s
    for sequence in labels.sequences_file.sequences:
        ids = sorted(sequence.image_ids)
        if all(labels.images[image_id].timestamp is None for image_id in ids):
            continue
        known: list[float] = []
        for image_id in ids:
            time_ms = labels.images[image_id].timestamp
            if not isinstance(time_ms, int | float) or abs(time_ms) > _MAX_TIME_MS:
                wanted = f"milliseconds, or null in all images of {sequence.directory}"
            elif known and time_ms <= known[-1]:
                wanted = f"more than {known[-1]:.10g}, that of the image before in {sequence.directory}"
            else:
                known.append(time_ms)
                continue
            path, index = root / "labels" / "image_annotations.json", list(labels.images).index(image_id)
            raise ValueError(f"{path}: images.{index}.timestamp: expected {wanted}, got {shortened(time_ms)}")
        times_s |= {id_: (time_ms - known[0]) / 1000 for id_, time_ms in zip(ids, known, strict=True)}
    return times_s


def _is_wanted(sequence: Sequence, select: Selection) -> bool:
    return (
        (select.scenes is None or sequence.id in select.scenes or sequence.directory in select.scenes)
        and (select.weathers is None or sequence.weather in select.weathers)
        and (select.lightings is None or sequence.environment_lighting in select.lightings)
        and (select.road_types is None or sequence.road_type in select.road_types)
    )
