"""Rating of a proposer's boxes on labelled frames: box quality, recall by kind of light, boxes per image."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foreglow.config import ProposalConfig
from foreglow.datasets import LabelledSource
from foreglow.files import check_file, file_digest, read_plain_json
from foreglow.lab.evaluation import BoxQuality, Predictions, evaluate_boxes
from foreglow.lab.evaluation.boxes.breakdown import check_has_light
from foreglow.lab.evaluation.boxes.lights import NUM_STRONGEST, Light, read_lights
from foreglow.lab.evaluation.boxes.matching import lies_in
from foreglow.lab.learning.annotation import Progress
from foreglow.lab.learning.kept_files import image_state
from foreglow.proposals import make_proposer
from foreglow.types import Image
from foreglow.whole_files import RemadeWarning, open_atomic, write_atomic


@dataclass(frozen=True, slots=True)
class FrameStack:
    """A file of decoded frames, one after another; small enough to be sent to another process.

    Attributes:
        shapes: Rows and columns of each frame.
        dtypes: Data type of each frame, uint8 or uint16.
        digest: SHA-256 of the file.
    """

    path: Path
    shapes: tuple[tuple[int, int], ...]
    dtypes: tuple[str, ...]
    digest: str

    def images(self) -> list[Image]:
        """The frames, memory-mapped and read-only, in order."""
        check_file(self.path)
        pixels = np.memmap(self.path, np.uint8, "r")
        images: list[Image] = []
        start = 0
        for shape, dtype in zip(self.shapes, self.dtypes, strict=True):
            end = start + shape[0] * shape[1] * np.dtype(dtype).itemsize
            images.append(pixels[start:end].view(dtype).reshape(shape))
            start = end
        return images


def stack_frames(
    dataset: LabelledSource,
    image_ids: Sequence[int],
    folder: Path,
    *,
    jobs: int = 1,
    progress: Progress | None = None,
) -> FrameStack:
    """The images `image_ids` of `dataset`, decoded into `folder`; the file of an earlier call is used again.

    A damaged one is decoded again, with a `RemadeWarning`.

    Raises:
        FileNotFoundError: If an image is missing.
        ValueError: If one is broken.
        OSError: If the pixels cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = hashlib.sha256()
    for image_id in image_ids:
        path = dataset.image_path(image_id)
        files.update(f"{path.resolve()}\0".encode(errors="surrogateescape") + image_state(path))
    if dataset.white_level is not None:
        files.update(f"white {dataset.white_level}".encode())
    pixels = folder / f"{files.hexdigest()[:16]}.bin"
    index = pixels.with_suffix(".json")
    if (decoded := _decoded(pixels, index)) is not None:
        return decoded
    if pixels.exists():
        warnings.warn(RemadeWarning(f"{pixels}: the frames kept here are damaged, and are decoded again"), stacklevel=2)
    entries: list[tuple[int, int, str]] = []
    written = hashlib.sha256()
    with open_atomic(pixels) as file, ThreadPoolExecutor(jobs) as pool:
        for done, image in enumerate(pool.map(lambda image_id: dataset.read(image_id).image, image_ids), start=1):
            content = np.ascontiguousarray(image).tobytes()
            file.write(content)
            written.update(content)
            entries.append((image.shape[0], image.shape[1], image.dtype.name))
            if progress is not None:
                progress("frames decoded", done, len(image_ids))
    about = {"frames": entries, "sha256": written.hexdigest()}
    write_atomic(index, json.dumps(about).encode())
    return _stack(pixels, about)


def _decoded(pixels: Path, index: Path) -> FrameStack | None:
    """The images that were decoded before; None if there are none, or they are damaged."""
    try:
        stack = _stack(pixels, read_plain_json(index))
        size = sum(
            rows * columns * np.dtype(name).itemsize
            for (rows, columns), name in zip(stack.shapes, stack.dtypes, strict=True)
        )
        is_whole = pixels.stat().st_size == size and file_digest(pixels) == stack.digest
    except (FileNotFoundError, IsADirectoryError, ValueError, TypeError, LookupError):
        return None
    return stack if is_whole else None


def _stack(pixels: Path, about: Mapping[str, Any]) -> FrameStack:
    return FrameStack(
        pixels,
        shapes=tuple((rows, columns) for rows, columns, _ in about["frames"]),
        dtypes=tuple(dtype for _, _, dtype in about["frames"]),
        digest=about["sha256"],
    )


NUM_CHUNKS = 8
"""A trial's frames come in this many parts, each spread over the data set; a trial may be stopped after any part."""


@dataclass(frozen=True, slots=True, eq=False)
class LabelledLights:
    """The lights of one image.

    Attributes:
        points_px: Shape (K, 2), columns x and y, full-frame pixels.
        is_of_kind: Shape (K,) by name of the kind; a light may be of several kinds.
    """

    points_px: NDArray[np.float64]
    is_of_kind: dict[str, NDArray[np.bool_]]

    @classmethod
    def of(cls, lights: Sequence[Light]) -> LabelledLights:
        """The lights, sorted into the kinds that `Measurement` distinguishes."""
        points = np.array([light.position_px for light in lights], np.float64).reshape(-1, 2)
        kinds = {
            "lamps": [light.is_direct for light in lights],
            "strongest": [0 <= light.rank < NUM_STRONGEST for light in lights],
            "hidden": [light.is_hidden for light in lights],
        }
        return cls(points, {name: np.array(flags, np.bool_) for name, flags in kinds.items()})


@dataclass(frozen=True, slots=True)
class Measurement:
    """The rating of one proposer's boxes. NaN where undefined.

    Attributes:
        quality: Quality of all boxes; boxes without a key point do not change its recall, q, q_K and q_B.
        recall_lamps: Share of the lamps that are in a box.
        recall_strongest: Share of the `NUM_STRONGEST` strongest reflections of each image that are in a box.
        recall_hidden: Share of the lights of vehicles without a lamp in sight so far that are in a box.
    """

    num_images: int
    num_boxes: int
    quality: BoxQuality
    recall_lamps: float
    recall_strongest: float
    recall_hidden: float

    @property
    def boxes_per_image(self) -> float:
        """Mean number of boxes per image."""
        return self.num_boxes / self.num_images if self.num_images else math.nan

    @property
    def figures(self) -> dict[str, float]:
        """The figures for tables, by name."""
        return {
            "q": self.quality.q,
            "q_k": self.quality.q_k,
            "q_b": self.quality.q_b,
            "recall": self.quality.recall,
            "recall_lamps": self.recall_lamps,
            "recall_strongest": self.recall_strongest,
            "recall_hidden": self.recall_hidden,
            "boxes_per_image": self.boxes_per_image,
        }

    def to_json(self) -> dict[str, Any]:
        """The figures and counts, for JSON: null instead of NaN."""
        figures = {name: None if math.isnan(value) else value for name, value in self.figures.items()}
        return {"num_images": self.num_images, "num_boxes": self.num_boxes, **figures}


@dataclass(slots=True)
class Tally:
    """Counts of boxes and the lights in them, image by image."""

    boxes: dict[int, NDArray[np.float64]] = dataclasses.field(default_factory=dict)
    keypoints_px: dict[int, NDArray[np.float64]] = dataclasses.field(default_factory=dict)
    num_found: dict[str, int] = dataclasses.field(default_factory=dict)
    num_lights: dict[str, int] = dataclasses.field(default_factory=dict)

    def add(self, image_id: int, boxes_xyxy_px: NDArray[Any], lights: LabelledLights) -> None:
        """Counts one image."""
        boxes = boxes_xyxy_px.astype(np.float64)
        self.boxes[image_id] = boxes
        self.keypoints_px[image_id] = lights.points_px
        is_found = lies_in(lights.points_px[:, None], boxes).any(axis=1)
        for name, is_kind in lights.is_of_kind.items():
            self.num_lights[name] = self.num_lights.get(name, 0) + int(np.count_nonzero(is_kind))
            self.num_found[name] = self.num_found.get(name, 0) + int(np.count_nonzero(is_kind & is_found))

    def measurement(self) -> Measurement:
        """The rating over all images so far."""
        scores = {image_id: np.ones(len(boxes)) for image_id, boxes in self.boxes.items()}
        recall = {name: self.num_found[name] / num if num else math.nan for name, num in self.num_lights.items()}
        return Measurement(
            num_images=len(self.boxes),
            num_boxes=sum(len(boxes) for boxes in self.boxes.values()),
            quality=evaluate_boxes(self.keypoints_px, Predictions(self.boxes, scores, is_scored=False)),
            recall_lamps=recall.get("lamps", math.nan),
            recall_strongest=recall.get("strongest", math.nan),
            recall_hidden=recall.get("hidden", math.nan),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """The frames that trials are measured on, with their labels; small, since the pixels stay in a file.

    Attributes:
        image_ids: The images in the order of the trials: each of the `NUM_CHUNKS` parts is spread over all sequences.
    """

    image_ids: tuple[int, ...]
    lights: tuple[LabelledLights, ...]
    frames: FrameStack

    @property
    def digest(self) -> str:
        """A digest of the images with their ids and labels; the folder of the data does not matter."""
        state = hashlib.sha256(repr(self.image_ids).encode())
        state.update(bytes.fromhex(self.frames.digest))
        for labelled in self.lights:
            state.update(labelled.points_px.tobytes())
            for flags in labelled.is_of_kind.values():
                state.update(flags.tobytes())
        return state.hexdigest()[:8]


class Bench:
    """Measures one proposer after another on the same frames."""

    def __init__(self, material: Material) -> None:
        self.material = material
        self._images: list[Image] = material.frames.images()
        edges = np.linspace(0, len(self._images), min(NUM_CHUNKS, len(self._images)) + 1).round().astype(int)
        self._edges: tuple[int, ...] = tuple(edges.tolist())

    @property
    def num_chunks(self) -> int:
        """Number of measurements that `measure` yields."""
        return len(self._edges) - 1

    def measure(self, config: ProposalConfig) -> Iterator[Measurement]:
        """The ratings of `config` on the first part of the frames, on the first two parts, ..., and on all."""
        proposer = make_proposer(config)
        tally = Tally()
        for start, end in zip(self._edges, self._edges[1:], strict=False):
            for index in range(start, end):
                boxes = proposer.propose(self._images[index]).boxes_xyxy_px
                tally.add(self.material.image_ids[index], boxes, self.material.lights[index])
            yield tally.measurement()


def read_material(
    dataset: LabelledSource,
    num_images: int,
    folder: Path,
    *,
    jobs: int = 1,
    progress: Progress | None = None,
) -> Material:
    """`num_images` of `dataset`, or all if there are fewer, evenly spread over its sequences, decoded into `folder`.

    Raises:
        FileNotFoundError: If an image or a label file is missing.
        ValueError: If one is broken, or no light is labelled in these images.
        OSError: If the pixels cannot be written.
    """
    image_ids = interleaved(evenly_spread(dataset.frame_ids, num_images), NUM_CHUNKS)
    check_has_light(dataset, image_ids)
    lights = read_lights(dataset)
    return Material(
        image_ids,
        tuple(LabelledLights.of(lights[image_id]) for image_id in image_ids),
        stack_frames(dataset, image_ids, folder, jobs=jobs, progress=progress),
    )


def measure_split(
    dataset: LabelledSource, configs: Sequence[ProposalConfig], progress: Progress | None = None
) -> tuple[Measurement, ...]:
    """The rating of each of `configs` on all images of `dataset`; each image is decoded once.

    Raises:
        FileNotFoundError: If an image or a label file is missing.
        ValueError: If one is broken.
    """
    lights = read_lights(dataset)
    proposers = [make_proposer(config) for config in configs]
    tallies = [Tally() for _ in configs]
    for done, frame in enumerate(dataset, start=1):
        labelled = LabelledLights.of(lights[frame.frame])
        for proposer, tally in zip(proposers, tallies, strict=True):
            tally.add(frame.frame, proposer.propose(frame.image).boxes_xyxy_px, labelled)
        if progress is not None:
            progress(dataset.name, done, len(dataset))
    return tuple(tally.measurement() for tally in tallies)


def evenly_spread(image_ids: Sequence[int], num_images: int) -> tuple[int, ...]:
    """`num_images` of `image_ids` at even distances, or all of them.

    >>> evenly_spread((1, 2, 3, 4, 5, 6), 3)
    (1, 3, 5)
    """
    if num_images >= len(image_ids):
        return tuple(image_ids)
    return tuple(image_ids[index * len(image_ids) // num_images] for index in range(num_images))


def interleaved(image_ids: Sequence[int], num_parts: int) -> tuple[int, ...]:
    """`image_ids` in `num_parts` passes over all of them.

    >>> interleaved((1, 2, 3, 4, 5), 2)
    (1, 3, 5, 2, 4)
    """
    return tuple(image_id for part in range(num_parts) for image_id in image_ids[part::num_parts])
