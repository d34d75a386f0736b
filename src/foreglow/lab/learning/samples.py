"""Training samples: the classifier's inputs for every proposal of a split, with their labels."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from foreglow.classifier.inputs import InputMaker, InputSpec
from foreglow.classifier.onnx import MAX_TOGETHER
from foreglow.config import FrozenModel, ProposalConfig
from foreglow.datasets import LabelledSource
from foreglow.lab.evaluation.boxes.lights import SEEN_ON, Light, SplitShares, read_lights, read_split_shares
from foreglow.lab.evaluation.boxes.whose_light import MIN_VEHICLE_SHARE
from foreglow.lab.learning.annotation import IGNORED, NEGATIVE, POSITIVE, label_boxes, label_image
from foreglow.proposals import make_proposer
from foreglow.types import KINDS, Boxes, Frame, Proposals

NO_GROUP = -1
NUM_KINDS = len(KINDS)


Progress: TypeAlias = Callable[[int, int], None]
"""Called with the number of images done, and of all images."""


def input_spec(fields: Any) -> Any:
    """An `InputSpec` made of a dict of fields, such as a table of a TOML file; anything else is returned unchanged.

    Raises:
        ValueError: If a field is unknown or of another type.
    """
    if not isinstance(fields, dict):
        return fields
    known = {field.name: field.default for field in dataclasses.fields(InputSpec)}
    for name, value in fields.items():
        if name not in known:
            raise ValueError(f"{name}: unknown, expected one of {', '.join(known)}")
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if name == "lag_s" and not (value is None or is_number):
            raise ValueError(f"{name}: expected a number or none, got {value!r}")
        if name == "context" and not (value is None or type(value) is int):
            raise ValueError(f"{name}: expected a whole number or none, got {value!r}")
        if name == "together" and type(value) is not bool:
            raise ValueError(f"{name}: expected true or false, got {value!r}")
        if name in ("size_px", "support", "num_features") and type(value) is not int:
            raise ValueError(f"{name}: expected a whole number, got {value!r}")
    return InputSpec(**fields)


Inputs: TypeAlias = Annotated[InputSpec, BeforeValidator(input_spec)]
"""The inputs of a model, as a field of a configuration."""


class Jitter(FrozenModel):
    """Copies of every box, moved and resized a little before they are cropped.

    They show the network boxes that are a few pixels off. A copy keeps the label of its box.

    Attributes:
        num_copies: Copies of each box, besides the box itself.
        centre: Largest shift of the centre to either side, as a share of the box's width and height.
        min_scale: Smallest factor on width and height, drawn for each.
        max_scale: Largest factor on width and height.
    """

    num_copies: Annotated[int, Field(ge=0, le=16)] = 0
    centre: Annotated[float, Field(ge=0, le=1)] = 0.15
    min_scale: Annotated[float, Field(gt=0, le=1)] = 0.85
    max_scale: Annotated[float, Field(ge=1, le=4)] = 1.2
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0


class SampleConfig(FrozenModel):
    """Everything that determines the samples, except the data.

    Attributes:
        by_light: Whether a box is labelled by whose light is in it, where that is stored, instead of by key points.
    """

    proposals: ProposalConfig = ProposalConfig()
    inputs: Inputs = InputSpec()
    jitter: Jitter = Jitter()
    by_light: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """N labelled inputs of a classifier; arrays may be memory-mapped and must not be written to.

    Attributes:
        crops: Shape (N, C, S, S), uint8: 255 times the crop, rounded; a second channel is clipped to [0, 1] first.
        features: Shape (N, F), float32.
        labels: Shape (N,), int8: 1 light artifact, 0 none, -1 not used for training.
        kinds: Shape (N, 5), float32: shares of the kinds of light in `KINDS`, which sum to one; NaN where unknown.
        groups: Shape (N,), int8: for the strongest light in the box, 2 times the index of its kind in `SEEN_ON`,
            plus 1 if its vehicle is hidden; -1 without light.
        boxes_xyxy_px: Shape (N, 4), int32, half-open, full-frame pixels.
        image_ids: Shape (N,), int64, unique within a data set.
        sequence_ids: Shape (N,), int64, unique within a data set.
        sets: Shape (N,), int32: the boxes that a model reads together have the same number, and follow one another.
        digest: Of the data and the configuration that they were made from; empty where unknown.

    Raises:
        ValueError: If a dtype or a shape is wrong, or a label has another value.
    """

    crops: NDArray[np.uint8]
    features: NDArray[np.float32]
    labels: NDArray[np.int8]
    kinds: NDArray[np.float32]
    groups: NDArray[np.int8]
    boxes_xyxy_px: Boxes
    image_ids: NDArray[np.int64]
    sequence_ids: NDArray[np.int64]
    sets: NDArray[np.int32]
    digest: str = ""

    def __post_init__(self) -> None:
        for name, (dtype, shape) in ARRAYS.items():
            array = getattr(self, name)
            is_fitting = len(array) == len(self.labels) and array.ndim == 1 + len(shape)
            if (
                array.dtype != dtype
                or not is_fitting
                or any(wanted not in (None, found) for wanted, found in zip(shape, array.shape[1:], strict=True))
            ):
                wanted_shape = (len(self.labels), *("any" if side is None else side for side in shape))
                raise ValueError(
                    f"Samples.{name}: expected {np.dtype(dtype)} of shape {wanted_shape}, "
                    f"got {array.dtype} of shape {array.shape}"
                )
        if not np.isin(self.labels, (POSITIVE, NEGATIVE, IGNORED)).all():
            raise ValueError("Samples.labels: expected 1, 0 or -1")

    def __len__(self) -> int:
        return len(self.labels)

    def __getitem__(self, chosen: Any) -> Samples:
        """Some of the samples: by slice, indices or mask."""
        return dataclasses.replace(self, **{name: getattr(self, name)[chosen] for name in ARRAYS})

    def whole_sets(self, num_samples: int) -> Samples:
        """About so many of the samples, in whole sets that are spread evenly over them; all if there are fewer."""
        numbers = self.sets[set_bounds(self.sets)[:, 0]]
        num_sets = min(len(numbers), max(1, round(len(numbers) * num_samples / max(1, len(self)))))
        return self[np.isin(self.sets, numbers[np.linspace(0, len(numbers) - 1, num_sets).astype(int)])]

    def num_labelled(self, label: int) -> int:
        """How many samples have this label."""
        return int(np.count_nonzero(self.labels == label))


# Dtype, and shape after the first axis with None where it is free, by field of `Samples`.
ARRAYS: dict[str, tuple[type[np.generic], tuple[int | None, ...]]] = {
    "crops": (np.uint8, (None, None, None)),
    "features": (np.float32, (None,)),
    "labels": (np.int8, ()),
    "kinds": (np.float32, (NUM_KINDS,)),
    "groups": (np.int8, ()),
    "boxes_xyxy_px": (np.int32, (4,)),
    "image_ids": (np.int64, ()),
    "sequence_ids": (np.int64, ()),
    "sets": (np.int32, ()),
}
assert set(ARRAYS) | {"digest"} == {field.name for field in dataclasses.fields(Samples)}


def set_bounds(sets: NDArray[np.int32]) -> NDArray[np.intp]:
    """Where each of K sets begins and ends among N samples, shape (K, 2), from the number of each sample's set.

    >>> set_bounds(np.array([4, 4, 7, 5, 5], np.int32)).tolist()
    [[0, 2], [2, 3], [3, 5]]
    """
    starts = np.flatnonzero(np.diff(sets, prepend=sets[:1] - 1))
    return np.column_stack([starts, np.append(starts[1:], len(sets))[: len(starts)]])


def set_sizes(sets: NDArray[np.int32]) -> list[int]:
    """How many samples each set has, in order."""
    return [int(end - start) for start, end in set_bounds(sets)]


def joined(parts: Sequence[Samples]) -> Samples:
    """The samples of one or several data sets together; in memory if there are several.

    Raises:
        ValueError: If they were not made for the same inputs.
    """
    if len(parts) == 1:
        return parts[0]
    arrays: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in ARRAYS}
    sizes = [size for part in parts for size in set_sizes(part.sets)]
    arrays["sets"] = np.repeat(np.arange(len(sizes), dtype=np.int32), sizes)
    return Samples(**arrays, digest=joined_digest([part.digest for part in parts]))


def joined_digest(digests: Sequence[str]) -> str:
    """`Samples.digest` of samples with these digests, joined; empty where one is unknown."""
    if len(digests) == 1 or not all(digests):
        return digests[0] if len(digests) == 1 else ""
    return hashlib.sha256(" ".join(digests).encode()).hexdigest()


def samples_by_image(
    dataset: LabelledSource, config: SampleConfig, progress: Progress | None = None
) -> Iterator[Samples]:
    """The samples of one image after another, in the order of sequences and time; jittered copies follow their boxes.

    The inputs are made as in the pipeline: the images of a sequence come in order, and earlier images are forgotten at
    the start of a new sequence.
    """
    proposer = make_proposer(config.proposals)
    # One maker for the boxes and one for each set of copies, so that what they remember is not mixed.
    makers = [InputMaker(config.inputs) for _ in range(1 + config.jitter.num_copies)]
    lights = read_lights(dataset)
    num_sets = 0
    shares = read_split_shares(dataset) if config.by_light else {}
    sequence_id = -1
    for num_done, image_id in enumerate(dataset.frame_ids):
        if progress is not None:
            progress(num_done, len(dataset.frame_ids))
        if dataset.sequence(image_id).id != sequence_id:
            sequence_id = dataset.sequence(image_id).id
            for maker in makers:
                maker.reset()
        frame = dataset.read(image_id)
        boxes = proposer.propose(frame.image).boxes_xyxy_px
        strongest = strongest_lights(boxes, lights[image_id])
        groups = box_groups(strongest)
        if shares:
            kinds = _kinds_by_light(dataset, image_id, boxes, shares)
            is_light = kinds[:, :-1].sum(axis=1) >= MIN_VEHICLE_SHARE
            labels = np.where(is_light, POSITIVE, NEGATIVE).astype(np.int8)
        else:
            labels = label_image(dataset, image_id, boxes)
            kinds = _kinds_by_key_points(labels, strongest)
        random = np.random.default_rng([config.jitter.seed, image_id])
        for number, maker in enumerate(makers):
            shown = boxes if number == 0 else jittered(boxes, frame, config.jitter, random)
            sets = num_sets + np.arange(len(boxes), dtype=np.int32) // MAX_TOGETHER
            num_sets += -(-len(boxes) // MAX_TOGETHER)
            yield _samples(maker, frame, shown, (labels, kinds, groups), sequence_id, sets)
    if progress is not None:
        progress(len(dataset.frame_ids), len(dataset.frame_ids))


def _kinds_by_light(
    dataset: LabelledSource, image_id: int, boxes_xyxy_px: Boxes, shares: SplitShares
) -> NDArray[np.float32]:
    """The kinds of light in each box, shape (N, 5): the stored shares of vehicles, and all other light as none."""
    for images in shares.values():
        found = images.get(image_id)
        if found is not None and np.array_equal(found.boxes_xyxy_px, boxes_xyxy_px):
            return found.kinds
    if not len(boxes_xyxy_px):
        return np.zeros((0, NUM_KINDS), np.float32)
    raise ValueError(
        f"{dataset.root}: image {image_id}: expected whose light is in these proposals; simulate with --shares and "
        f"the preset of the training, in this version, or train with by_light = false"
    )


def _kinds_by_key_points(labels: NDArray[np.int8], strongest: Sequence[Light | None]) -> NDArray[np.float32]:
    """The kinds of light in each box, shape (N, 5): that of its strongest key point; NaN if it does not count.

    PVDN's key points are of oncoming vehicles alone, so that none is of a rear lamp.
    """
    kinds = np.zeros((len(labels), NUM_KINDS), np.float32)
    for row, light in zip(kinds, strongest, strict=True):
        name = "none"
        if light is not None:
            name = f"{'rear' if light.is_rear else 'front'}_{'lamp' if light.is_direct else 'light'}"
        row[KINDS.index(name)] = 1.0
    kinds[labels == IGNORED] = np.nan
    return kinds


def strongest_lights(boxes_xyxy_px: Boxes, lights: Sequence[Light]) -> list[Light | None]:
    """The strongest light in each of N boxes, None without any; a lamp is stronger than any other light."""
    strongest: list[Light | None] = [None] * len(boxes_xyxy_px)
    for light in sorted(lights, key=lambda light: -light.rank):  # the strongest last, so that it overwrites the others
        for index in np.flatnonzero(label_boxes(boxes_xyxy_px, np.array([light.position_px])) == POSITIVE):
            strongest[index] = light
    return strongest


def box_groups(strongest: Sequence[Light | None]) -> NDArray[np.int8]:
    """The group of each box as in `Samples.groups`, shape (N,), by the strongest light in it."""
    return np.array(
        [NO_GROUP if light is None else 2 * SEEN_ON.index(light.kind) + light.is_hidden for light in strongest],
        np.int8,
    )


def jittered(boxes_xyxy_px: Boxes, frame: Frame, jitter: Jitter, random: np.random.Generator) -> Boxes:
    """The boxes moved and resized as `jitter` says, at least one pixel wide and high, clipped to the frame."""
    corners = boxes_xyxy_px.astype(np.float64)
    sizes = corners[:, 2:] - corners[:, :2]
    centres = (corners[:, :2] + corners[:, 2:]) / 2 + random.uniform(-jitter.centre, jitter.centre, sizes.shape) * sizes
    sizes = sizes * random.uniform(jitter.min_scale, jitter.max_scale, sizes.shape)
    limit = np.array([frame.width_px, frame.height_px])
    lows = np.clip(np.round(centres - sizes / 2), 0, limit - 1)
    highs = np.clip(np.round(centres + sizes / 2), lows + 1, limit)
    return np.concatenate([lows, highs], axis=1).astype(np.int32)


def no_samples(inputs: InputSpec) -> Samples:
    """Empty samples of the right shapes."""
    shapes = {"crops": (inputs.num_channels, inputs.size_px, inputs.size_px), "features": (inputs.num_features,)}
    arrays: dict[str, Any] = {
        name: np.empty((0, *shapes.get(name, tuple(side or 0 for side in shape))), dtype)
        for name, (dtype, shape) in ARRAYS.items()
    }
    return Samples(**arrays)


def _samples(
    maker: InputMaker,
    frame: Frame,
    boxes_xyxy_px: Boxes,
    truth: tuple[NDArray[np.int8], NDArray[np.float32], NDArray[np.int8]],
    sequence_id: int,
    sets: NDArray[np.int32],
) -> Samples:
    labels, kinds, groups = truth
    inputs = maker.make(frame, Proposals(boxes_xyxy_px))
    return Samples(
        crops=np.round(255 * np.clip(inputs.crops, 0, 1)).astype(np.uint8),
        features=np.asarray(inputs.features, np.float32),
        labels=labels,
        kinds=kinds,
        groups=groups,
        boxes_xyxy_px=boxes_xyxy_px,
        image_ids=np.full(len(labels), frame.frame, np.int64),
        sequence_ids=np.full(len(labels), sequence_id, np.int64),
        sets=sets,
    )


def check_learnable(samples: Samples, origin: str, *, has_kinds: bool) -> None:
    """Checks that a network can learn from samples: there are light artifacts and others, and with kinds if needed.

    Raises:
        ValueError: If it cannot; the message begins with `origin`.
    """
    for label, kind in ((POSITIVE, "light artifacts"), (NEGATIVE, "boxes without one")):
        if samples.num_labelled(label) == 0:
            raise ValueError(f"{origin}: expected {kind} among {len(samples)} boxes, found none")
    if has_kinds and np.isnan(samples.kinds[samples.labels != IGNORED]).any():
        raise ValueError(f"{origin}: expected the kind of light of every labelled box, found NaN")
