"""Labels beside a run: whether they are for what it was made from, and which image each of its frames is in them."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TypeVar

from foreglow.datasets import PVDN, LabelledSource
from foreglow.datasets.exchange import LabelFile, is_labels
from foreglow.datasets.exchange.transfer import ORIGIN, Origin, OriginsFile
from foreglow.datasets.image_folder import frame_numbers
from foreglow.datasets.json_files import parse_json
from foreglow.datasets.pvdn.splits import find_split, is_pvdn
from foreglow.outputs import exists
from foreglow.runs.origin import origin_digest
from foreglow.runs.predictions import Predictions
from foreglow.runs.summary_file import SummaryFile, read_summary

Value = TypeVar("Value")

LEAST_CHANGE_S = 0.002
"""Times that differ less are the same: some are whole milliseconds."""


@dataclass(frozen=True, slots=True)
class LabelsOfRun:
    """The labels of what a run was made from.

    Attributes:
        dataset: The images that the run can have gone over: all, or those of its folder.
        ids: By the frame of the run, the image that it is; None where both have the same numbers.
        part: A line if the labels have other images, too; else None.
        doubt: A line if nothing tells whether they are labels of what the run was made from; else None.
    """

    dataset: LabelledSource
    ids: Mapping[int, int] | None = None
    part: str | None = None
    doubt: str | None = None

    @property
    def lines(self) -> tuple[str, ...]:
        """What is to be said of them."""
        return (*(line for line in (self.doubt, self.part) if line is not None), *self.dataset.notes)

    def by_image(self, by_frame: Mapping[int, Value]) -> Mapping[int, Value]:
        """What the run has for each frame, by image; for frames without labels by numbers below 0."""
        if self.ids is None:
            return by_frame
        unknown = {frame: -number for number, frame in enumerate(by_frame.keys() - self.ids.keys(), start=1)}
        images = {**self.ids, **unknown}
        return {images[frame]: value for frame, value in by_frame.items()}

    def of_images(self, predictions: Predictions) -> Predictions:
        """The run's predictions by image."""
        return Predictions(
            self.by_image(predictions.boxes_xyxy_px),
            self.by_image(predictions.scores),
            predictions.is_scored,
            self.by_image(predictions.direct_probabilities),
            self.by_image(predictions.light_kinds),
            self.by_image(predictions.times_ns),
        )


def labels_of_run(run: Path, labelled: Path, dataset: LabelledSource) -> LabelsOfRun:
    """The labels of what the run in `run` was made from, or of a part of it, among those of `dataset`.

    Labels know their images by digest: those of a split or beside a file of labels, and what they were imported for.
    Nothing is asked of runs that know no digest of their source, unless they were made from another file of labels, and
    of live ones without one that fits.

    Args:
        run: The folder of the run, or another one.
        labelled: Where the labels are.
        dataset: They, opened.

    Raises:
        ValueError: If they are for other images, images of several of their folders could be those of the run, or the
            run's summary is broken.
    """
    path = run / "summary.json"
    summary = read_summary(path) if path.is_file() else None
    if summary is None:
        return LabelsOfRun(dataset)
    source = Path(summary.source)
    doubt = f"{labelled}: nothing tells whether these are labels of what {run} was made from, {source}"
    if summary.source_digest is None:  # such as of a run on a file of labels, which are of any images
        is_other = exists(source) and is_labels(source) and source.resolve() != labelled.resolve()
        return LabelsOfRun(dataset, doubt=doubt if is_other else None)
    digests, stated = digests_of(dataset), stated_origins(dataset)
    found = [each for each in stated if each.digest == summary.source_digest]
    for place, digest in digests.items():
        found += _origins_at(place, digest, dataset) if digest == summary.source_digest else ()
    numberings = _numberings(found, dataset, source)
    if len(numberings) > 1:
        folders = " and ".join(sorted({each.folder or "." for each in found}))
        raise ValueError(
            f"{labelled}: expected labels of the folder that {run} was made from, {source}, got those of "
            f"{folders}, whose images have the same names and sizes; `foreglow labels import` makes labels of each"
        )
    is_live, sizes_px, theirs_px = summary.live is not None, set(summary.frame_sizes_px), set(_sizes_px(dataset))
    is_other_size = not is_live and bool(sizes_px) and sizes_px.isdisjoint(theirs_px)
    if numberings and is_other_size:
        ours, theirs = (f"{width}x{height} px" for width, height in (min(sizes_px), min(theirs_px)))
        raise ValueError(f"{labelled}: image size: expected {ours} as {run} has, got {theirs}")
    if numberings:
        return _part(dataset, dict(numberings[0]), labelled, summary)
    is_known = bool(stated or (digests and (is_pvdn(source) or (labelled.is_file() and source.is_dir()))))
    if is_known or is_other_size:
        raise ValueError(
            f"{labelled}: expected the labels of what {run} was made from, {summary.source}, got others"
            f"{_missing(dataset)}"
        )
    if is_live or is_pvdn(source):  # without images, a split cannot be told from another one
        return LabelsOfRun(dataset)
    return LabelsOfRun(dataset, doubt=doubt)


def check_times(run: Path, labelled: Path, dataset: LabelledSource, times_ns: Mapping[int, int]) -> None:
    """Checks that the images of a split have the times that a run on a split found, by which its tracks went.

    Args:
        run: The folder of the run, or another one.
        labelled: Where the labels are.
        dataset: They, opened.
        times_ns: By image, the time of the run's frame.

    Raises:
        ValueError: If they have others: the labels' times or rate were changed since.
    """
    path = run / "summary.json"
    if not (path.is_file() and isinstance(dataset, PVDN) and is_pvdn(Path(read_summary(path).source))):
        return
    firsts: dict[int, int] = {}
    for image_id in (each for each in dataset.frame_ids if each in times_ns):
        first = firsts.setdefault(dataset.sequence(image_id).id, image_id)
        now_s = dataset.time_s(image_id) - dataset.time_s(first)
        then_s = (times_ns[image_id] - times_ns[first]) / 1e9
        if abs(now_s - then_s) > LEAST_CHANGE_S:
            raise ValueError(
                f"{labelled}: image {image_id}: expected {then_s:.3f} s after image {first}, as in {run}, "
                f"got {now_s:.3f} s; were times or rate changed since? run again"
            )


def _missing(dataset: LabelledSource) -> str:
    """What to add where labels fit nothing: whether images of theirs are missing, as in a copy that is not whole."""
    paths = [dataset.image_path(image_id) for image_id in dataset.frame_ids]
    missing = [path for path in paths if not path.is_file()]
    if len(missing) in (0, len(paths)):
        return ""
    return f"; {len(missing)} of its {len(paths)} images {'are' if len(missing) > 1 else 'is'} missing: {missing[0]}"


def _numberings(found: list[Origin], dataset: LabelledSource, source: Path) -> list[frozenset[tuple[int, int]]]:
    """The different pairs of a run's frame and an image of `dataset`, as the origins have them that fit `source` best.

    The digest tells a folder by the names and sizes of its images, which a second one may have, too.
    """
    selected = frozenset(dataset.frame_ids)
    pairs = {each: frozenset(pair for pair in _pairs(each, selected) if pair[1] in selected) for each in found}
    left = [each for each in dict.fromkeys(found) if pairs[each]]
    is_split = is_pvdn(source)
    for fits in (
        lambda each: bool(each.folder) and source.parts[-len(Path(each.folder).parts) :] == Path(each.folder).parts,
        lambda each: source.exists() and each.is_split == is_split,
    ):
        if len({pairs[each] for each in left}) > 1:
            left = [each for each in left if fits(each)] or left
    return list(dict.fromkeys(pairs[each] for each in left))


def _pairs(origin: Origin, selected: frozenset[int]) -> Iterator[tuple[int, int]]:
    return ((image_id, image_id) for image_id in selected) if origin.ids is None else iter(origin.ids)


def _part(dataset: LabelledSource, ids: Mapping[int, int], labelled: Path, summary: SummaryFile) -> LabelsOfRun:
    """The images of `dataset` that are frames of a run, by these `ids`."""
    part = dataset.with_images(set(ids.values()))
    numbers = None if all(frame == image_id for frame, image_id in ids.items()) else ids
    if len(part) == len(dataset):
        return LabelsOfRun(dataset, numbers)
    words = f"{len(part)} of its {len(dataset)} images count, those of what the run was made from, {summary.source}"
    return LabelsOfRun(part, numbers, f"{labelled}: {words}")


def digests_of(dataset: LabelledSource) -> dict[Path, str]:
    """What a run on the images of a data set may have been made from, and its digest.

    Of a split, these are it and its sequences; of a file of labels, the video or the folders, and their split.
    """
    places: list[Path] = []
    if isinstance(dataset, LabelFile):
        places = sorted(dataset.places)
    elif isinstance(dataset, PVDN):
        places = [dataset.root, *sorted((dataset.root / "images").glob("*/"))]
    digests = ((place, origin_digest(place)) for place in places)
    return {place: digest for place, digest in digests if digest is not None}


def origins_of(dataset: LabelledSource) -> list[Origin]:
    """All that a run may have been made from of which there are images in a data set, with their frames there."""
    return [each for place, digest in digests_of(dataset).items() for each in _origins_at(place, digest, dataset)]


def stated_origins(dataset: LabelledSource) -> tuple[Origin, ...]:
    """As `origins_of`, of what the labels of a split were imported for; none if they do not say so.

    Raises:
        ValueError: If what they say is not what `labels import` writes.
    """
    if not isinstance(dataset, PVDN) or ORIGIN not in dataset.labels.images_file.info:
        return ()
    path = dataset.root / "labels" / "image_annotations.json"
    try:
        return parse_json(
            json.dumps(dataset.labels.images_file.info[ORIGIN]), OriginsFile, f"{path}: info.{ORIGIN}"
        ).root
    except ValueError as error:
        raise ValueError(f"{error}; import the labels again") from None


def _origins_at(place: Path, digest: str, dataset: LabelledSource) -> Iterator[Origin]:
    """The images of `dataset` at a place, by the frames that a run on it, or on a copy of it, has for them."""
    if place.is_file() or (isinstance(dataset, PVDN) and place == dataset.root):
        yield Origin(digest, is_split=place.is_dir())
        return
    real = cache(Path.resolve)  # of folders: an image that is a link stays where it is
    images = {real(path.parent) / path.name: id_ for id_ in dataset.frame_ids if (path := dataset.image_path(id_))}
    above = dataset.folder if isinstance(dataset, LabelFile) else dataset.root / "images"
    folder = place.relative_to(above).as_posix() if place.is_relative_to(above) and place != above else ""
    for is_split, numbers in _numbers_at(place):
        named = ((frame, images.get(real(path.parent) / path.name)) for path, frame in numbers.items())
        ids = tuple(sorted((frame, image_id) for frame, image_id in named if image_id is not None))
        is_alike = len(ids) == len(images) and all(frame == image_id for frame, image_id in ids)
        if ids:
            yield Origin(digest, folder, is_split, None if is_alike else ids)


def _numbers_at(place: Path) -> Iterator[tuple[bool, dict[Path, int]]]:
    """For the images in a folder the frames that a run on it has, and whether as a split; where none can, nothing.

    A copy of a sequence is a folder like any other, whose images are called by other numbers perhaps.
    """
    is_sequence = True
    with contextlib.suppress(ValueError, OSError):
        if is_pvdn(place):
            is_sequence = find_split(place)[1] is not None
            split = PVDN(place)
            yield True, {split.image_path(id_): id_ for id_ in split.frame_ids}
        if is_sequence:
            yield False, {place / name: number for name, number in frame_numbers(place).items()}


def _sizes_px(dataset: LabelledSource) -> Iterator[tuple[int, int]]:
    for image_id in dataset.frame_ids:
        record = dataset.image(image_id)
        yield record.width_px, record.height_px
