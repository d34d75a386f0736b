"""Frames from one image file or a folder of them."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import itertools
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime, timedelta
from pathlib import Path, PurePosixPath

from foreglow.datasets.image_bytes import JPEG_SIGNATURE
from foreglow.datasets.images import IMAGE_SUFFIXES, known_formats, read_coloured_image
from foreglow.datasets.source import FileSource, OnError
from foreglow.files import in_unicode
from foreglow.numbers import checked_number
from foreglow.types import Frame
from foreglow.wording import shortened

_ANY_DATA = ".raw"
"""An ending of images without a header, and of much else, such as a video's raw stream."""

OTHER_IMAGES = frozenset(
    {
        *(".heic", ".heif", ".hif", ".avif", ".jxl", ".jp2", ".j2k", ".j2c", ".jpx", ".jpf", ".jls", ".jxr", ".gif"),
        *(".tga", ".exr", ".hdr", ".pbm", ".pfm", ".pam", ".pcx", ".ras", ".sgi", ".psd", ".qoi", ".dpx"),
        *(".dng", ".cr2", ".cr3", ".crw", ".nef", ".nrw", ".arw", ".sr2", ".raf", ".orf", ".rw2", ".pef", ".srw"),
        _ANY_DATA,
    }
)
"""Endings of images that are not read here; they are named, not passed over in silence."""

MAX_NAMED = 5
"""Folders that a message names."""

MIN_RATE_HZ, MAX_RATE_HZ = 1e-3, 1e6
"""Frames a second: a picture in a quarter of an hour, and times that differ by whole nanoseconds."""

DEFAULT_RATE_HZ = 18.0
"""Frames a second if unknown: the rate of PVDN within an exposure cycle."""

MAX_STEP = timedelta(seconds=2)
"""Photographs that were taken further apart are no drive; cameras give the time to the second."""

USUAL_STEP_SHARE = 0.75
"""Images are missing from a folder only where so many of its numbers follow the one before by the same step: of images
that were chosen here and there nobody knows the times."""

EXIF_TOLERANCE = 0.1
"""A rate that is wrong by no more than this share is not worth a line."""

_EXIF_TIME = re.compile(rb"(\d{4}:\d\d:\d\d \d\d:\d\d:\d\d)\0")
_EXIF_BYTES = 1 << 17  # Exif data are among the first segments of a JPEG, and have less than 64 KiB


def earlier_name(name: str) -> str:
    """What an image's earlier one is called beside it, if there is one.

    >>> earlier_name("000012.png")
    '000012_earlier.png'
    """
    return f"{PurePosixPath(name).stem}_earlier.png"


def has_earlier(path: Path) -> bool:
    """Whether an earlier image lies beside the image at `path`."""
    return path.with_name(earlier_name(path.name)).is_file()


def checked_rate_hz(rate_hz: object) -> float:
    """A number of frames a second, of which a time follows for every image: 0.001 to 1,000,000.

    Raises:
        ValueError: If it is another one, or none.

    >>> checked_rate_hz(1e300)
    Traceback (most recent call last):
    ValueError: rate_hz: expected a number from 0.001 to 1e+06, got 1e+300
    """
    rate = math.nan
    with contextlib.suppress(ValueError):
        rate = checked_number("rate_hz", rate_hz)
    if not MIN_RATE_HZ <= rate <= MAX_RATE_HZ:
        raise ValueError(
            f"rate_hz: expected a number from {MIN_RATE_HZ:g} to {MAX_RATE_HZ:g}, got {shortened(rate_hz)}"
        )
    return rate


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """A sort key by which numbers inside names count as numbers.

    >>> sorted(["f10.png", "f9.png", "a.png"], key=natural_key)
    ['a.png', 'f9.png', 'f10.png']
    """
    # Digits at odd indices: [0-9] alone, as other scripts' digits need not be numbers to int().
    parts = re.split(r"([0-9]+)", name)
    return [(1, int(part), part) if index % 2 else (0, 0, part) for index, part in enumerate(parts)]


def number_in(name: str) -> int | None:
    """The number that an image is called by, such as 12 for `S1/000012.png` and `frame_000012.png`; None for none."""
    found = re.fullmatch("(?:frame_)?([0-9]{1,15})", PurePosixPath(name).stem)
    return int(found[1]) if found else None


def frame_numbers(folder: Path) -> dict[str, int]:
    """By name, in natural order, the frame that each image of a folder is.

    That is the number that it is called by, where all of them are called by numbers that rise; else its place.

    Raises:
        ValueError: If the folder holds no image.
    """
    names = [path.name for path in _images_in(folder)[0]]
    numbers = [number_in(name) for name in names]
    known = [number for number in numbers if number is not None]
    is_numbered = len(known) == len(names) and all(first < later for first, later in itertools.pairwise(known))
    return dict(zip(names, known if is_numbered else range(len(names)), strict=True))


def steps_with_gaps(numbers: Sequence[int]) -> list[int]:
    """How many steps each image comes after the first, where some are missing between them; else its place.

    A step is the usual difference of two numbers that follow each other. That images are missing is taken as known
    where most have this step (`USUAL_STEP_SHARE`), the others a multiple of it, and fewer are missing than there are.

    >>> steps_with_gaps([8, 9, 11, 12, 13, 14])
    [0, 1, 3, 4, 5, 6]
    >>> steps_with_gaps([10, 12, 14, 16]), steps_with_gaps([3, 57, 120])
    ([0, 1, 2, 3], [0, 1, 2])
    """
    places = list(range(len(numbers)))
    differences = [later - before for before, later in itertools.pairwise(numbers)]
    if not differences:
        return places
    step, num_usual = Counter(differences).most_common(1)[0]
    is_so = num_usual >= USUAL_STEP_SHARE * len(differences) and not any(each % step for each in differences)
    steps = [(number - numbers[0]) // step for number in numbers] if is_so else places
    return steps if steps[-1] < 2 * len(numbers) else places


def steps_in(folder: Path) -> dict[str, int]:
    """By name, in natural order, how many steps after the first one each image of a folder was taken.

    Raises:
        ValueError: If the folder holds no image, or images that were chosen here and there, by their numbers.
    """
    numbers = frame_numbers(folder)
    steps = steps_with_gaps(list(numbers.values()))
    first = next(iter(numbers.values()))
    rises = [number - first for number in numbers.values()]
    if any(rise * steps[-1] != step * rises[-1] for rise, step in zip(rises, steps, strict=True)):
        raise ValueError(f"{folder}: expected numbers that rise by one step, but for missing images")
    return dict(zip(numbers, steps, strict=True))


class ImageFolder(FileSource):
    """One image, or the images directly inside a folder in natural order of their names.

    An image `000012_earlier.png` beside `000012.png`, as data sets of single images have it, is no frame of its own.
    Frames are numbered as `frame_numbers` says; a skipped image keeps its number. As image files carry no time, the
    timestamp is the place in that order divided by `rate_hz`, in which an image that is missing by the numbers has a
    place as well, as `steps_with_gaps` says. The images are one drive and have no sequence, unless they are
    photographs: an image of another size than the one before, or that was taken more than `MAX_STEP` from it by their
    Exif data, begins a new sequence, which has the name of its file.

    Attributes:
        path: The folder or the file.
        rate_hz: Frames a second that timestamps are made with.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        rate_hz: float = DEFAULT_RATE_HZ,
        on_error: OnError = "stop",
    ) -> None:
        """Lists the images; reads none.

        Args:
            path: The folder, or one image file; in a folder, names that begin with a dot or do not end as an image
                are ignored.
            rate_hz: Frames a second.
            on_error: What a bad image does.

        Raises:
            FileNotFoundError: If `path` does not exist.
            ValueError: If the folder holds no image, or `rate_hz` is no number from 0.001 to 1,000,000.
        """
        super().__init__(path, on_error)
        self.path = self.origin
        self.rate_hz = checked_rate_hz(rate_hz)
        if not self.path.exists():
            raise FileNotFoundError(f"{self.path}: no such file or folder")
        self._files: list[Path] = [self.path]
        self._others: list[str] = []
        self._numbers = [0]
        if self.path.is_dir():
            self._files, self._others = _images_in(self.path)
            self._numbers = list(frame_numbers(self.path).values())
            if self._others and on_error == "stop":
                raise ValueError(self._others[0])
        self._steps = steps_with_gaps(self._numbers)

    @property
    def notes(self) -> list[str]:
        """Lines for people, if need be: what is assumed of the times of several images, that their Exif data say
        something else, which are missing by their numbers or have the same one, and folders below with images.
        """
        rate = (
            f"{self.path}: images have no times: taken for {self.rate_hz:g} frames a second; speeds, leads and delays"
        )
        lines = [f"{rate} follow from it (`ffmpeg -framerate RATE` makes a video of them, which has times)"]
        lines = lines * (len(self) > 1) + [
            self._taken(),
            _missing(self.path, self._numbers, self._steps),
            _sharing(self.path, [path.name for path in self._files]),
        ]
        if self.path.is_dir():
            below = _folders_below(self.path)
            lines += [f"{self.path}: images in folders below it are not read: {below}; run each by itself"] * bool(
                below
            )
        return [line for line in lines if line]

    def _taken(self) -> str:
        """How long the images took by the Exif data of the first and the last, if these are of one drive, but not so.

        Those times are whole seconds.
        """
        first = last = None
        with contextlib.suppress(OSError):
            first, last = _exif_time(self._files[0]), _exif_time(self._files[-1])
        if first is None or last is None:
            return ""
        taken_s, assumed_s = (last - first).total_seconds(), self._steps[-1] / self.rate_hz
        is_drive = 0 < taken_s <= MAX_STEP.total_seconds() * self._steps[-1]
        if not is_drive or abs(taken_s - assumed_s) <= max(1.0, EXIF_TOLERANCE * assumed_s):
            return ""
        return (
            f"{self.path}: by their Exif data the images took {taken_s:g} s, {self._steps[-1] / taken_s:.3g} a second, "
            f"and not {assumed_s:.3g} s"
        )

    @property
    def name(self) -> str:
        """Name of the folder or file."""
        return self.path.name

    @property
    def num_frames(self) -> int:
        """Number of images."""
        return len(self._files)

    def __len__(self) -> int:
        return len(self._files)

    def __iter__(self) -> Iterator[Frame]:
        self.skipped = list(self._others)
        reads = (functools.partial(self._frame, index) for index in range(len(self._files)))
        return _in_sequences(self._read_each(reads))

    def _frame(self, index: int) -> Frame:
        path, timestamp_ns = self._files[index], round(self._steps[index] * 1e9 / self.rate_hz)
        image, chroma = read_coloured_image(path)
        return Frame(image, timestamp_ns, self._numbers[index], path=str(path), red_chroma=chroma)


def _missing(path: Path, numbers: Sequence[int], steps: Sequence[int]) -> str:
    num_missing = steps[-1] + 1 - len(steps)
    if not num_missing:
        return ""
    first = next(place for place, step in enumerate(steps) if step > place)
    are = "image is" if num_missing == 1 else "images are"
    return (
        f"{path}: {num_missing} {are} missing by the numbers of the others, first between {numbers[first - 1]} and "
        f"{numbers[first]}; times go on as if they were there"
    )


def _sharing(path: Path, names: Sequence[str]) -> str:
    """A line if most images are called by numbers, and some share theirs, as copies and other formats do."""
    by_number: dict[int, list[str]] = {}
    for name in names:
        number = number_in(re.sub(r"\s*\([0-9]+\)(?=\.[^.]*$)", "", name))  # of a copy: `000003 (1).png`
        if number is not None:
            by_number.setdefault(number, []).append(name)
    shared = [found for found in by_number.values() if len(found) > 1]
    if not shared or sum(map(len, by_number.values())) <= 0.5 * len(names):
        return ""
    return (
        f"{path}: images have the same number as others, first {shortened(', '.join(shared[0]))}: each counts as a "
        "frame of its own, and all are counted from 0 in the order of their names, with none missing; remove copies"
    )


def _in_sequences(frames: Iterable[Frame]) -> Iterator[Frame]:
    """The frames, with another sequence from each that does not continue the drive before it."""
    latest, latest_time, sequence = None, None, ""
    for frame in frames:
        time = _exif_time(Path(frame.path))
        if latest is not None and not (_is_alike(frame, latest) and _is_soon_after(time, latest_time)):
            sequence = in_unicode(Path(frame.path).name)
        latest, latest_time = frame, time
        yield dataclasses.replace(frame, sequence=sequence)


def _is_alike(frame: Frame, other: Frame) -> bool:
    return frame.image.shape == other.image.shape and frame.image.dtype == other.image.dtype


def _is_soon_after(time: datetime | None, before: datetime | None) -> bool:
    if time is None or before is None:
        return time is before
    return timedelta(0) <= time - before <= MAX_STEP


def is_one_drive(before: Path, path: Path) -> bool:
    """Whether the image at `path` goes on with the drive of the one at `before`, by the times of photographs."""
    return _is_soon_after(_exif_time(path), _exif_time(before))


def _exif_time(path: Path) -> datetime | None:
    """When a photograph was taken, by the earliest time in its Exif data; None for an image that does not say it."""
    with path.open("rb") as file:
        if file.read(len(JPEG_SIGNATURE)) != JPEG_SIGNATURE:
            return None
        times = _EXIF_TIME.findall(file.read(_EXIF_BYTES).partition(b"Exif\0\0")[2])
    try:
        return datetime.strptime(min(times).decode(), "%Y:%m:%d %H:%M:%S") if times else None
    except ValueError:
        return None


def is_images(path: Path) -> bool:
    """Whether `path` is a folder, or a file that is an image by its ending."""
    return path.is_dir() or path.suffix.lower() in (IMAGE_SUFFIXES | OTHER_IMAGES) - {_ANY_DATA}


def _folders_below(folder: Path) -> str:
    """The names of some of the folders in a folder that have images, for messages; empty without any."""
    names = [below.name for below in sorted(folder.iterdir()) if below.is_dir() and _has_images(below)]
    return ", ".join([*map(shortened, names[:MAX_NAMED]), *(["..."] if len(names) > MAX_NAMED else [])])


def _has_images(folder: Path) -> bool:
    """Whether images lie in a folder, or in one of its own folders."""
    with contextlib.suppress(OSError):  # what may not be read is not read either
        files = itertools.chain(folder.glob("*"), folder.glob("*/*"))
        return not folder.name.startswith(".") and any(path.suffix.lower() in IMAGE_SUFFIXES for path in files)
    return False


def _images_in(folder: Path) -> tuple[list[Path], list[str]]:
    # What is no file, such as a link to nothing, is not passed over either: reading it says what is wrong.
    paths = [path for path in folder.iterdir() if not path.name.startswith(".") and not path.is_dir()]
    files = [path for path in paths if path.suffix.lower() in IMAGE_SUFFIXES]
    earlier = {earlier_name(path.name) for path in files}
    files = [path for path in files if path.name not in earlier]
    others = sorted(path for path in paths if path.suffix.lower() in OTHER_IMAGES)
    messages = [f"{path}: expected an image that is {known_formats()}, got another format" for path in others]
    if not files:
        below = "" if messages else _folders_below(folder)
        hint = f" but in folders below it: {below}; run each by itself" if below else ""
        bags = sorted(path.name for path in paths if path.suffix.lower() in (".db3", ".mcap"))
        if bags and not hint:
            hint = f", nor the metadata.yaml of a ROS 2 bag, whose file {bags[0]} can be read by itself"
        raise ValueError([*messages, f"{folder}: expected images ({known_formats()}), found none{hint}"][0])
    return sorted(files, key=lambda path: (natural_key(path.name), path.name)), messages
