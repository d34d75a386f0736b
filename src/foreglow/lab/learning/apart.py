"""That nothing is learnt from which judges or tests: all figures would be too good, and nobody would see it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path

from foreglow.datasets import open_labelled
from foreglow.datasets.images import read_image
from foreglow.lab.learning.kept_files import image_contents


def check_apart(learnt: Sequence[Path], judging: Sequence[Path], data: Sequence[Path] = ()) -> None:
    """Checks that neither a split nor an image is learnt from which judges or tests.

    Args:
        learnt: The splits to train on.
        judging: The splits to validate or test on.
        data: The data sets, or single splits, that the user gave.

    Raises:
        FileNotFoundError: If a split or a label file is missing.
        ValueError: If a split to train on judges, lies in a data set that is given as well, is called test, or has an
            image of one that judges, under whatever name; or if the labels of one are broken.
    """
    for path in learnt:
        if any(path.resolve() == judge.resolve() for judge in judging):
            raise ValueError(f"{path}: expected a split to train on, got one that judges what is learnt")
        if path.resolve().name == "test":
            raise ValueError(f"{path}: expected a split to train on, got a test split, which is never learnt from")
        outer = next((each for each in data if path in data and each.resolve() in path.resolve().parents), None)
        if outer is not None:
            raise ValueError(f"{path}: expected a split outside the data sets that are given, got one of {outer}")
    found = next(_shared_images(learnt, judging), None)
    if found is not None:
        judge, own = found
        raise ValueError(f"{judge}: expected an image that nothing is learnt from, got that of {own}")


def _shared_images(learnt: Iterable[Path], judging: Iterable[Path]) -> Iterator[tuple[Path, Path]]:
    """Files of the same image: one that judges, and one that is learnt from. Flat images are alike by themselves."""
    contents = cache(image_contents)
    by_size: dict[int, list[Path]] = defaultdict(list)
    for path in _images(learnt):
        by_size[path.stat().st_size].append(path)
    for path in _images(judging):
        for own in by_size.get(path.stat().st_size, ()):
            if contents(path) == contents(own):
                image = read_image(path)
                if image.min() < image.max():
                    yield path, own


def _images(splits: Iterable[Path]) -> Iterator[Path]:
    """Those that are there; what is missing is noticed where it is read."""
    for split in splits:
        dataset = open_labelled(split)
        yield from filter(Path.is_file, map(dataset.image_path, dataset.frame_ids))
