"""Which file or frame each image of a file of labels is, its id, and its sequence."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from foreglow.datasets.exchange.marks import ImageLabels, LabelSet
from foreglow.datasets.image_folder import frame_numbers, natural_key, number_in
from foreglow.datasets.pvdn.schema import Sequence
from foreglow.datasets.video import Video


def named_images(labels: LabelSet, folder: Path, path: Path) -> tuple[ImageLabels, ...]:
    """The images with the names of files in `folder`, where the labels at `path` count its images as a video's frames.

    Raises:
        ValueError: If there are fewer images.
    """
    if not labels.is_video:
        return labels.images
    names = list(frame_numbers(folder))
    numbers = [int(image.name) for image in labels.images]
    if numbers[-1] >= len(names):
        raise ValueError(
            f"{folder}: expected an image for frame {numbers[-1]} of {path}, found {len(names)} images"
            " (earlier images beside others are no frames)"
        )
    return tuple(dataclasses.replace(image, name=names[k]) for k, image in zip(numbers, labels.images, strict=True))


def ids_in_video(names: list[str], video: Path, path: Path) -> list[int]:
    """The images' ids: their frames' numbers.

    Raises:
        ValueError: If one of the labels at `path` is no frame's, or there twice.
    """
    frames_of = [frame_number(name) for name in names]
    twice = next((number for number, count in Counter(frames_of).items() if count > 1), None)
    if twice is not None:
        raise ValueError(f"{path}: expected each frame of {video} once, {twice} is there twice")
    return frames_of


def ids_in_folder(names: list[str], folder: Path) -> list[int]:
    """The images' ids: their frames' numbers, as a run on the folder counts them.

    In folders of folders it is the number that each is called by, where all are; else its place by its name.
    """
    if (folder / names[0]).is_file() and not any("/" in name for name in names):
        frames = frame_numbers(folder)
        if frames.keys() >= set(names):
            return [frames[name] for name in names]
    numbers = [number_in(name) for name in names]
    known = [number for number in numbers if number is not None]
    order = sorted(names, key=lambda name: (natural_key(name), name))
    places = {name: place for place, name in enumerate(order)}
    return known if len(set(known)) == len(names) else [places[name] for name in names]


def frame_number(name: str) -> int:
    """The frame of a video that an image is, by its name.

    Raises:
        ValueError: If the name does not say it.
    """
    number = number_in(name)
    if number is None:
        raise ValueError(f"{name}: expected the name of a frame, such as frame_000012.png, as the images are a video's")
    return number


def left_out_frames(video: Video) -> dict[int | str, str]:
    """The lines about what the latest iteration of a video left out, by the frame; those about more, by themselves."""
    found: dict[int | str, str] = {}
    for line in video.skipped:
        rest = line.removeprefix(f"{video.path}: frame ")
        number = re.match("([0-9]+): ", rest) if rest != line else None
        found[int(number[1]) if number and line not in video.lost_parts else line] = line
    return found


def sequences_of(images: Mapping[int, ImageLabels], path: Path) -> tuple[Sequence, ...]:
    """The sequences: a folder each, called by its name, or by that of the file where the images lie in none."""
    ids: dict[str, list[int]] = {}
    for image_id, image in images.items():
        ids.setdefault(image.name.rpartition("/")[0], []).append(image_id)
    folders: dict[str, str] = {}  # by the name of the sequence
    for folder in sorted(ids):
        name = (folder.replace("/", "_") or re.sub(r"[^\w.-]", "_", path.stem))[:200]
        others = (f"{name[:190]}_{number}" for number in itertools.count(2))  # a/b and a_b are two drives
        folders[next(each for each in (name, *itertools.islice(others, len(folders))) if each not in folders)] = folder
    known = [re.fullmatch("S([0-9]{1,9})", directory) for directory in folders]
    numbers = {int(found[1]) for found in known if found}
    is_known = all(known) and len(numbers) == len(ids)
    return tuple(
        Sequence.plain(
            int(directory[1:]) if is_known else index,
            directory=directory,
            image_ids=tuple(sorted(ids[folder])),
            num_images=len(ids[folder]),
        )
        for index, (directory, folder) in enumerate(sorted(folders.items()), start=1)
    )
