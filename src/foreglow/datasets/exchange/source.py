"""A file of an annotation tool, with its images, as a data set with labels."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath

from foreglow.datasets.exchange.files import read_labels_file
from foreglow.datasets.exchange.image_ids import (
    frame_number,
    ids_in_folder,
    ids_in_video,
    left_out_frames,
    named_images,
    sequences_of,
)
from foreglow.datasets.exchange.marks import (
    EARLIER_IMAGE,
    ImageLabels,
    Kind,
    LabelSet,
    check_near,
    doubtful_of,
    lost_lines,
    numbered,
    vehicles_of,
)
from foreglow.datasets.image_folder import (
    MAX_STEP,
    earlier_name,
    has_earlier,
    is_one_drive,
    steps_in,
)
from foreglow.datasets.images import read_coloured_image
from foreglow.datasets.labelled import LabelledSource
from foreglow.datasets.pvdn.reader import PVDN, PVDN_RATE_HZ
from foreglow.datasets.pvdn.schema import ImageCategory, ImageRecord, Instance, Sequence, Vehicle
from foreglow.datasets.pvdn.splits import is_split
from foreglow.datasets.source import OnError
from foreglow.datasets.vehicle_data import timestamp_ns
from foreglow.datasets.video import Video
from foreglow.files import checked_path
from foreglow.types import Frame
from foreglow.types.white import full_scale

PLACES = (".", "images", "../images")
"""Where the images of a file of labels may lie, seen from its folder, if nobody says where they are."""


EARLIER_S = 0.25
"""The moment of the past that our recipe shows a classifier."""

EARLIER_STEP_S = 0.015
"""Frames that come nearer to each other than this are not all kept until one from then is wanted."""


class LabelFile(LabelledSource):
    """Labels of CVAT, COCO or Label Studio, and the images that they are about.

    The folder that an image lies in is its sequence. An image's id is the frame that a run on the same video or folder
    has for it; where the images lie in several folders, the number that its file is called, where all are called by
    numbers as in PVDN, else its place in the natural order of all names. Labels of a video are about the frames of a
    video or about the images of a folder, by their order. Labels of images that are called `frame_000012.png` may be
    about the frames of a video, too.

    Whatever part of a drive is labelled, its images have the times of the drive: those of the video, of which `time_s`
    tells as if its rate were steady, or those that a run on their folder has: in a split those of its labels, elsewhere
    at PVDN's rate. Where images have no place in their folder, or other places than by their ids, each is a frame later
    than the one before. A frame comes with one of a quarter of a second before, `Frame.earlier`, or the one that the
    split has for it, unless that is labelled, too: a classifier may want to see what was there before, and nobody
    labels all frames of a drive. What cannot be read and has no labels is passed over, as a run that skips it does. So
    is a frame of a video that the file lists without any label, as tools list all of them.

    Attributes:
        labels: What the file says.
        folder: The folder of the images; that of the video.
        passed_over: Lines about what cannot be read and has no labels, by its frame or image, or by itself; all copies
            share them.
    """

    passed_over: dict[int | Path | str, str]

    def __init__(self, path: Path | str, images: Path | str | None = None, *, on_error: OnError = "stop") -> None:
        """Reads the labels.

        Args:
            path: The file.
            images: The folder of the images, or the video; None looks beside the file.
            on_error: What an image that is missing, broken or of the wrong size does.

        Raises:
            FileNotFoundError: If there is no such file, or the images are not there.
            ValueError: If it cannot be used.
        """
        super().__init__(path, on_error)
        self.path = self.origin
        self.root = self.path.parent
        self.labels: LabelSet = read_labels_file(self.path)
        self.folder, self._video = self._images_at(None if images is None else checked_path(images, "images"))
        self.passed_over = {}
        self._splits: dict[Path, PVDN | None] = {}
        self._ids_in_split: dict[Path, dict[str, int]] = {}
        self._images = self._by_id()
        self._labelled = {self.folder / image.name: id_ for id_, image in self._images.items()}
        self._sequences = sequences_of(self._images, self.path)
        self._sequence_of = {id_: each for each in self._sequences for id_ in each.image_ids}
        self.rate_hz = self._rate_hz()
        self._drives = {each.id: self._drive_of(each) for each in self._sequences}
        self._times_ns = {id_: time_ns for each in self._sequences for id_, time_ns in self._times_of(each).items()}
        self.frame_ids = tuple(id_ for each in self._sequences for id_ in each.image_ids)

    @property
    def name(self) -> str:
        """Name of the file."""
        return self.path.name

    @property
    def sequences(self) -> tuple[Sequence, ...]:
        """As in `LabelledSource`."""
        selected = {self.sequence(image_id).id for image_id in self.frame_ids}
        return tuple(sequence for sequence in self._sequences if sequence.id in selected)

    def __iter__(self) -> Iterator[Frame]:
        """The selected frames."""
        self.skipped = []
        if self._video is not None:
            return self._of_video(self._video)
        reads = (functools.partial(self.read, image_id) for image_id in self.frame_ids)
        return self._read_each(reads)

    @property
    def places(self) -> frozenset[Path]:
        """What a run on the same images may have been made from: the video, or its folders and their split."""
        if self._video is not None:
            return frozenset({self._video.path})
        folders = {self.folder, *(path.parent for path in self._labelled)}
        splits = {folder.resolve().parents[1] for folder in folders if len(folder.resolve().parents) > 1}
        return frozenset({*folders, *filter(is_split, splits)})

    def _of_video(self, video: Video) -> Iterator[Frame]:
        """The selected frames of a video, each with its earlier one."""
        wanted = {frame_number(self._images[image_id].name): image_id for image_id in self.frame_ids}
        selected = frozenset(wanted)
        recent: list[Frame] = []
        for frame in video:
            earliest_ns = frame.timestamp_ns - round(2e9 * EARLIER_S)
            recent = [kept for kept in recent if kept.timestamp_ns >= earliest_ns and kept.sequence == frame.sequence]
            if frame.frame in wanted:
                earlier = _earlier({kept.frame: kept.timestamp_ns for kept in recent}, frame.timestamp_ns)
                kept_with_it = next((kept for kept in recent if kept.frame == earlier), None)
                yield self._checked(frame, wanted.pop(frame.frame), None if earlier in selected else kept_with_it)
            if not wanted:
                break
            if not recent or frame.timestamp_ns - recent[-1].timestamp_ns >= EARLIER_STEP_S * 1e9:
                recent.append(frame)
        self._pass_over(video, wanted)

    def _pass_over(self, video: Video, missing: Mapping[int, int]) -> None:
        """Notes what the latest iteration of a video left out; `missing` are ids of selected images, by their frames.

        Raises:
            ValueError: If one of them has labels, or is beyond the end of the video; with `skip` and `mark` it is
                noted as skipped.
        """
        left_out = left_out_frames(video)
        needed = [
            number
            for number, image_id in missing.items()
            if number not in left_out or self._images[image_id].marks or self._images[image_id].categories
        ]
        lines = [self._missing(number, left_out) for number in needed]
        if lines and self.on_error == "stop":
            raise ValueError(lines[0] + (f"; {len(lines) - 1} more of its frames are missing" if lines[1:] else ""))
        self.skipped += lines
        self.passed_over |= {key: line for key, line in left_out.items() if key not in needed}

    def read(self, image_id: int) -> Frame:
        """As in `LabelledSource`; of a video, all frames before it are decoded."""
        name = self._image(image_id).name
        if self._video is not None:
            number = frame_number(name)
            for frame in self._video:
                if frame.frame == number:
                    return self._checked(frame, image_id)
            raise ValueError(self._missing(number, left_out_frames(self._video)))
        try:
            frame = self._at(self.image_path(image_id), self._times_ns[image_id], self._pauses_s[image_id])
        except ValueError as error:
            raise ValueError(f"{error}; {self.path} has labels of it") from error
        return self._checked(frame, image_id, self._beside(image_id))

    def _at(self, path: Path, time_ns: int, pauses_s: float) -> Frame:
        if not path.is_file():
            raise FileNotFoundError(f"{path}: no such image, expected that of {self.path}")
        image, chroma = read_coloured_image(path)
        return Frame(image, time_ns + round(1e9 * pauses_s), path=str(path), red_chroma=chroma)

    def _beside(self, image_id: int) -> Frame | None:
        """The earlier image: the split's, or of those in its folder; None without one, or if it is a selected one.

        Where one cannot be read, it is the next best, as in a run that skips it.
        """
        time_ns, drive = self._times_ns[image_id], self._drives[self.sequence(image_id).id]
        path = self.image_path(image_id)
        split, ids = self._split_around(path.parent)
        if split is not None and path.name in ids and split.image(ids[path.name]).earlier is not None:
            with self._passing_over(path.with_name(earlier_name(path.name))):
                return split.earlier(ids[path.name])
        times_ns = {each: each for each in drive if time_ns - 2e9 * EARLIER_S <= each < time_ns}
        while (earlier := _earlier(times_ns, time_ns)) is not None:
            del times_ns[earlier]
            if self._labelled.get(drive[earlier]) in self.frame_ids:
                return None
            with self._passing_over(drive[earlier]):
                is_before = is_one_drive(drive[earlier], path)
                return self._at(drive[earlier], earlier, self._pauses_s[image_id]) if is_before else None
        return None

    @contextlib.contextmanager
    def _passing_over(self, path: Path) -> Iterator[None]:
        """Notes that the image at `path`, which has no labels, cannot be read."""
        try:
            yield
        except (ValueError, FileNotFoundError) as error:
            self.passed_over[path] = " ".join(str(error).split())

    def _drive_of(self, sequence: Sequence) -> dict[int, Path]:
        """By their times in ns, the images in the folder of a sequence.

        Empty if nobody knows when these, or labelled ones, were taken.
        """
        if self._video is not None:
            return {}
        paths = [self.folder / self._images[image_id].name for image_id in sequence.image_ids]
        folder = paths[0].parent
        with contextlib.suppress(OSError, ValueError):
            places = {folder / name: time_ns for name, time_ns in self._taken_ns(folder).items()}
            times_ns = [places.get(path, -math.inf) for path in paths]
            if all(before < after for before, after in itertools.pairwise([-math.inf, *times_ns])):
                return {time_ns: path for path, time_ns in places.items()}
        return {}

    def _taken_ns(self, folder: Path) -> dict[str, int]:
        """By name, when the images in a folder were taken, as a run on it has it."""
        split, ids = self._split_around(folder)
        if split is None:
            return {name: round(step * 1e9 / PVDN_RATE_HZ) for name, step in steps_in(folder).items()}
        return {name: timestamp_ns(split, image_id) for name, image_id in ids.items()}

    def _split_around(self, folder: Path) -> tuple[PVDN | None, dict[str, int]]:
        """The split in which a folder of images is a sequence, with the numbers of its images; None without one."""
        place = folder.resolve()
        root = place.parent.parent
        if root not in self._splits:
            self._splits[root] = PVDN(root) if place.parent.name == "images" and is_split(root) else None
        split = self._splits[root]
        if split is None:
            return None, {}
        if place not in self._ids_in_split:
            ids = (id_ for each in split.sequences if each.directory == place.name for id_ in each.image_ids)
            self._ids_in_split[place] = {split.image(id_).file_name: id_ for id_ in ids}
        return split, self._ids_in_split[place]

    def _rate_hz(self) -> float:
        if self._video is not None:
            return self._video.rate_hz or PVDN_RATE_HZ
        splits = {self._split_around(folder)[0] for folder in {path.parent for path in self._labelled}}
        return max(PVDN_RATE_HZ if split is None else split.rate_hz for split in splits)

    def _times_of(self, sequence: Sequence) -> dict[int, int]:
        """By id, when each image was taken: in its drive, or as if it were a frame later than the one before."""
        if self._video is not None:
            return {image_id: round(image_id * 1e9 / self.rate_hz) for image_id in sequence.image_ids}
        times_ns = {self._labelled.get(path): time_ns for time_ns, path in self._drives[sequence.id].items()}
        places = enumerate(sequence.image_ids)
        return {image_id: times_ns.get(image_id, round(place * 1e9 / self.rate_hz)) for place, image_id in places}

    @property
    def coco_ids(self) -> dict[int, int]:
        """By the id that COCO's file gives them, the images that have another one here; empty for other files."""
        numbers = {image.number: id_ for id_, image in self._images.items() if image.number is not None}
        return {} if all(number == id_ for number, id_ in numbers.items()) else numbers

    def has_earlier(self, image_id: int) -> bool:
        """Whether a file beside the image is its earlier one, whose age nobody knows, and that has no labels."""
        if self._video is not None:
            return False
        path = self.image_path(image_id)
        if path.name in self._split_around(path.parent)[1]:
            return False
        return has_earlier(path) and path.with_name(earlier_name(path.name)) not in self._labelled

    @property
    def lost(self) -> Counter[str]:
        """By what it is, how much of the file and beside its images is not among the selected frames."""
        num_earlier = sum(map(self.has_earlier, self.frame_ids))
        return +Counter({**self.labels.lost, EARLIER_IMAGE: num_earlier})

    @property
    def images_read(self) -> tuple[ImageLabels, ...]:
        """The labels, without those frames of a video that were `passed_over`."""
        return tuple(image for id_, image in self._images.items() if id_ not in self.passed_over)

    @property
    def notes(self) -> list[str]:
        """As in `LabelledSource`."""
        return [*lost_lines(self.labels.lost), *self.unknown_vehicles]

    @property
    def unknown_vehicles(self) -> list[str]:
        """A line if there are lights of which nobody says of which vehicle they are."""
        marks = [mark for image in self.labels.images for mark in image.marks if mark.kind == Kind.LIGHT]
        num_alone = sum(mark.oid is None and mark.iid is None and mark.track is None for mark in marks)
        words = "have neither oid nor iid: each is of a vehicle of its own, hidden if it is no lamp"
        return [f"{num_alone} of {len(marks)} lights {words}"] if num_alone else []

    def annotations(self, image_id: int) -> tuple[Vehicle, ...]:
        """As in `LabelledSource`."""
        image = self._image(image_id)
        return vehicles_of(image.marks, f"{self.path}: {image.name}")

    def doubtful(self, image_id: int) -> tuple[Instance, ...]:
        """As in `LabelledSource`."""
        return doubtful_of(self._image(image_id).marks)

    def image(self, image_id: int) -> ImageRecord:
        """As in `LabelledSource`; the size is that of the image where the file does not say it."""
        image = self._image(image_id)
        width_px, height_px = image.size_px or self.read(image_id).image.shape[::-1]
        name = PurePosixPath(image.name).name
        return ImageRecord(id=image_id, file_name=name, height_px=height_px, width_px=width_px)

    def image_path(self, image_id: int) -> Path:
        """As in `LabelledSource`; the video of its frames."""
        name = self._image(image_id).name
        return self.folder / name if self._video is None else self._video.path

    def sequence(self, image_id: int) -> Sequence:
        """As in `LabelledSource`."""
        self._image(image_id)
        return self._sequence_of[image_id]

    def categories(self, image_id: int) -> tuple[ImageCategory, ...]:
        """As in `LabelledSource`."""
        return self._image(image_id).categories or (ImageCategory.NONE,)

    def time_s(self, image_id: int) -> float:
        """As in `LabelledSource`."""
        first_id = self.sequence(image_id).image_ids[0]
        return (self._times_ns[image_id] - self._times_ns[first_id]) / 1e9 + self._pauses_s[image_id]

    @functools.cached_property
    def _pauses_s(self) -> dict[int, float]:
        """By image, the least time for which the camera was off before it: between photographs that are of no drive."""
        found: dict[int, float] = {}
        for sequence in self._sequences:
            paths = [self.image_path(image_id) for image_id in sequence.image_ids]
            are_there = [self._video is None and path.is_file() for path in paths]
            pauses = [
                MAX_STEP.total_seconds() if all(are_there[k : k + 2]) and not is_one_drive(*paths[k : k + 2]) else 0.0
                for k in range(len(paths) - 1)
            ]
            found |= zip(sequence.image_ids, itertools.accumulate(pauses, initial=0.0), strict=True)
        return found

    def _missing(self, number: int, left_out: Mapping[int | str, str]) -> str:
        """Why a frame of the labels did not come, by what was left out of the video."""
        if number in left_out:
            return f"{left_out[number]}; {self.path} has labels of it"
        rest = next(iter(left_out.values()), "")
        path = self.image_path(self.frame_ids[0])
        return f"{path}: expected frame {number} as in {self.path}, the video ends before{rest and f'; {rest}'}"

    def _image(self, image_id: int) -> ImageLabels:
        if image_id not in self._images:
            raise ValueError(f"{self.path}: image_id: expected an image of this file, got {image_id}")
        return self._images[image_id]

    def _checked(self, frame: Frame, image_id: int, earlier: Frame | None = None) -> Frame:
        """The frame of an image as this data set has it, with an earlier one that is as large.

        Raises:
            ValueError: If it does not have the size in the labels, or a point lies far outside of it.
        """
        size_px = self._images[image_id].size_px
        if size_px is not None and size_px != (frame.width_px, frame.height_px):
            raise ValueError(
                f"{frame.path}: image size: expected {size_px[0]}x{size_px[1]} px as in {self.path}, got "
                f"{frame.width_px}x{frame.height_px} px"
            )
        check_near(self._images[image_id], (frame.width_px, frame.height_px), self.path)
        directory = self._sequence_of[image_id].directory
        if frame.sequence:  # a later recording of the video, whose times begin anew
            directory = f"{directory[:150]}_{frame.sequence.replace(' ', '_')}"
        if earlier is not None:
            is_alike = (earlier.image.shape, earlier.image.dtype) == (frame.image.shape, frame.image.dtype)
            earlier = dataclasses.replace(earlier, sequence=directory) if is_alike else None
        named = dataclasses.replace(frame, frame=image_id, sequence=directory, earlier=earlier)
        return full_scale(named, self.white_level)

    def _by_id(self) -> dict[int, ImageLabels]:
        """The images by their ids, with numbers for all vehicles and lights."""
        if self._video is None:
            named = numbered(named_images(self.labels, self.folder, self.path))
            ids = ids_in_folder([image.name for image in named], self.folder)
        else:
            named = numbered(self.labels.images)
            ids = ids_in_video([image.name for image in named], self._video.path, self.path)
        return dict(zip(ids, named, strict=True))

    def _images_at(self, given: Path | None) -> tuple[Path, Video | None]:
        """The folder of the images, and the video if they are its frames."""
        if given is not None and given.is_file():
            return given.parent, Video(given, on_error="mark" if self.on_error == "mark" else "skip")
        if given is not None and not given.is_dir():
            raise FileNotFoundError(f"{given}: no such folder, expected the images of {self.path}")
        first = self.labels.images[0].name
        if given is not None:
            above = f"{given.resolve().name}/"
            is_elsewhere = not (self.labels.is_video or (given / first).exists())
            if is_elsewhere and all(image.name.startswith(above) for image in self.labels.images):
                return given.resolve().parent, None  # of a sequence with whose name theirs begin
            return given, None
        for place in PLACES:
            if not self.labels.is_video and (self.root / place / first).is_file():
                return self.root / place, None
        raise FileNotFoundError(
            f"{self.root / first}: no such image, expected that of {self.path}; `foreglow labels import` with --images "
            "says where they are"
        )


def _earlier(times_ns: Mapping[int, int], now_ns: int) -> int | None:
    """The key of the time whose age is nearest to `EARLIER_S`, and at least half of it; None without one."""
    ages_ns = {key: now_ns - time_ns for key, time_ns in times_ns.items() if now_ns - time_ns >= 5e8 * EARLIER_S}
    return min(ages_ns, key=lambda key: abs(ages_ns[key] - 1e9 * EARLIER_S)) if ages_ns else None
