"""What a path is: an image, a folder of images, a video, a recording, or PVDN."""

from __future__ import annotations

from pathlib import Path

from foreglow.datasets.bags import Recording, is_recording
from foreglow.datasets.cache import FrameCache
from foreglow.datasets.image_folder import DEFAULT_RATE_HZ, ImageFolder
from foreglow.datasets.images import IMAGE_SUFFIXES
from foreglow.datasets.pvdn import PVDN, is_split, split_of_sequence, splits_below
from foreglow.datasets.source import FrameSource, OnError
from foreglow.datasets.video import Video


def open_source(
    path: Path | str,
    *,
    on_error: OnError = "stop",
    rate_hz: float = DEFAULT_RATE_HZ,
    cache: FrameCache | None = None,
    topic: str | None = None,
) -> FrameSource:
    """The frames at `path`.

    A folder is a PVDN split (it has `labels/sequences.json`) or holds exactly one (such as `DIR/night/train`), is one
    PVDN sequence (`SPLIT/images/NAME`), is a ROS 2 bag (it has `metadata.yaml`), or holds images. A file is an image by
    its ending (`IMAGE_SUFFIXES`), a recording likewise (`.mcap`, `.bag`, `.db3`), and a video otherwise.

    Args:
        path: A file or folder.
        on_error: What a bad frame does.
        rate_hz: Frames a second of images that carry no time; PVDN, videos and recordings have their own.
        cache: Where decoded images are kept for the next pass; videos and recordings are not cached.
        topic: Image topic of a recording; None for its first.

    Raises:
        FileNotFoundError: If there is nothing at `path`, or a label file is missing.
        ValueError: If what is there cannot be used.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file or folder")
    if is_recording(path):
        return Recording(path, topic=topic, on_error=on_error)
    if topic is not None:
        raise ValueError(f"{path}: expected a recording, as a topic was named ({topic}), is none")
    if path.is_dir():
        splits = splits_below(path)
        if len(splits) > 1:
            raise ValueError(f"{path}: expected one split of PVDN, such as {splits[0]}")
        if splits or is_split(path) or split_of_sequence(path) is not None:
            return PVDN(path, on_error=on_error, cache=cache)
        return ImageFolder(path, rate_hz=rate_hz, on_error=on_error, cache=cache)
    if path.suffix.lower() in IMAGE_SUFFIXES:
        return ImageFolder(path, rate_hz=rate_hz, on_error=on_error, cache=cache)
    return Video(path, on_error=on_error)
