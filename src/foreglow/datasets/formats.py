"""The formats that frames come in, and the choice among them by path.

A new format is a folder of this package and a line in `FORMATS`; a format with labels reads them as a `LabelledSource`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from foreglow.datasets.bags import Recording, is_recording
from foreglow.datasets.exchange import LabelFile, is_labels
from foreglow.datasets.image_folder import DEFAULT_RATE_HZ, ImageFolder, checked_rate_hz, is_images
from foreglow.datasets.labelled import LabelledSource
from foreglow.datasets.pvdn import PVDN, is_pvdn
from foreglow.datasets.pvdn.splits import check_finished
from foreglow.datasets.source import FrameSource, OnError
from foreglow.datasets.video import Video
from foreglow.files import checked_path


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenOptions:
    """The options of `open_source`; a format takes those that apply to it."""

    on_error: OnError
    rate_hz: float
    topic: str | None


@dataclass(frozen=True, slots=True)
class DataFormat:
    """A format of frames.

    Attributes:
        is_at: Whether an existing path has this format.
        opened: The source of frames at such a path.
        labelled: The data set with labels at such a path; None for a format without labels.
        has_topics: Whether it takes a topic.
    """

    is_at: Callable[[Path], bool]
    opened: Callable[[Path, OpenOptions], FrameSource]
    labelled: Callable[[Path], LabelledSource] | None = None
    has_topics: bool = False


FORMATS: dict[str, DataFormat] = {
    "recording": DataFormat(
        is_recording, lambda path, given: Recording(path, topic=given.topic, on_error=given.on_error), has_topics=True
    ),
    "PVDN": DataFormat(is_pvdn, lambda path, given: PVDN(path, on_error=given.on_error), PVDN),
    "labels": DataFormat(is_labels, lambda path, given: LabelFile(path, on_error=given.on_error), LabelFile),
    "images": DataFormat(
        is_images,
        lambda path, given: ImageFolder(path, rate_hz=given.rate_hz, on_error=given.on_error),
    ),
    "video": DataFormat(Path.exists, lambda path, given: Video(path, on_error=given.on_error)),
}
"""The formats by name; a path has the first format that recognises it."""


def open_source(
    path: Path | str,
    *,
    on_error: OnError = "stop",
    rate_hz: float = DEFAULT_RATE_HZ,
    topic: str | None = None,
) -> FrameSource:
    """The frames at `path`.

    A folder is a ROS 2 bag (it has `metadata.yaml`), a PVDN split (it has `labels/sequences.json`), a folder with a
    single split (such as `DIR/night/train`), a PVDN sequence (`SPLIT/images/NAME`), or a folder of images. A file is a
    recording (`.mcap`, `.bag`, `.db3`) or an image (`IMAGE_SUFFIXES`) by its ending, and a video otherwise.

    Args:
        path: A file or folder.
        on_error: What a bad frame does.
        rate_hz: Frames a second of images that carry no time, 0.001 to 1,000,000; PVDN, videos and recordings have
            their own.
        topic: Image topic of a recording; None for its first.

    Raises:
        FileNotFoundError: If there is nothing at `path`, or a label file is missing.
        ValueError: If it or an option cannot be used; whether the source needs the option does not matter.
    """
    path, rate_hz = checked_path(path), checked_rate_hz(rate_hz)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file or folder")
    chosen = FORMATS[format_of(path)]
    if topic is not None and not chosen.has_topics:
        raise ValueError(f"{path}: expected a recording, as a topic was named ({topic}), is none")
    try:
        return chosen.opened(path, OpenOptions(on_error=on_error, rate_hz=rate_hz, topic=topic))
    except ValueError:
        check_finished(path)
        raise


def format_of(path: Path) -> str:
    """The name of the format of an existing path."""
    return next(name for name, each in FORMATS.items() if each.is_at(path))


def open_labelled(path: Path | str, white_level: int | None = None) -> LabelledSource:
    """The data set with labels at `path`: a split, a sequence of it, or a folder with a single split.

    Args:
        path: A file or folder.
        white_level: That of the pipeline, for what looks at the images without one; see `LabelledSource.seen_by`.

    Raises:
        FileNotFoundError: If there is nothing at `path`, or a label file is missing.
        ValueError: If its labels cannot be used.
    """
    path = checked_path(path)
    for each in FORMATS.values():
        if each.labelled is not None and path.exists() and each.is_at(path):
            return each.labelled(path).seen_by(white_level)
    check_finished(path)
    return PVDN(path)  # raises, and says what is missing
