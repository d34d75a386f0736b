"""A few images' samples of simulated drives, small enough to ship: a model that is trained further keeps what it knew.

Some are of the drives that the model learnt from; they are mixed in. Others are of validation drives, camera by camera;
they only judge what was lost. All boxes of an image are there, for models that compare them.
`python -m foreglow.lab.learning.old_samples DATA... --judge DATA... --out FILE` makes both.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import io
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.classifier.inputs import InputSpec
from foreglow.config import preset
from foreglow.datasets import LabelledSource, open_labelled, split_folder
from foreglow.datasets.images import NPY_ERRORS
from foreglow.lab.learning.annotation import IGNORED, NEGATIVE, POSITIVE, label_image
from foreglow.lab.learning.recipes import RECIPES
from foreglow.lab.learning.sample_cache import cached_samples
from foreglow.lab.learning.samples import ARRAYS, SampleConfig, Samples, joined, set_bounds
from foreglow.models import OLD_SAMPLES
from foreglow.whole_files import write_atomic

NUM_SAMPLES = 3000

WIDEST = RECIPES["related"].inputs
"""What the samples hold: models that read fewer channels or features are given those, or each box alone."""

LIT_SHARE = 0.7
"""Of the samples: those of images with light of a vehicle, which teach more; a quarter of their boxes have it."""

NUM_JUDGING = {True: 400, False: 220}
"""Samples of each camera that judge, about: of images with light of a vehicle, and of those without. By these and by
all boxes of 8 drives, losses differ by .002 (standard deviation) where weights moved by .3 of the way, up to .007."""

_QUALITY = 80  # of WebP: 2 grey levels off on average, at 0.5 kB a sample
_COLUMNS = 64


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Samples of one camera's drives that nothing is learnt from.

    Attributes:
        camera: Its name.
        samples: Whole sets, with doubtful ones, which are not judged.
        weights: Shape (N,), float32: how many boxes of the drives each stands for.
    """

    camera: str
    samples: Samples
    weights: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class OldSamples:
    """What a model knew: samples to mix in, and others to judge by."""

    learn: Samples
    judge: tuple[HeldOut, ...]


def chosen(parts: Sequence[Samples], num_samples: int, seed: int = 0) -> Samples:
    """Whole sets drawn at random: about so many samples, of which those of sets with light are `LIT_SHARE`.

    Of either kind, each part that has such sets gives as many samples.

    >>> from foreglow.lab.learning.samples import no_samples
    >>> len(chosen([no_samples(WIDEST)], 10))
    0
    """
    random, drawn = np.random.default_rng(seed), []
    sets = [_sets_by_light(part) for part in parts]
    for is_lit, share in ((True, LIT_SHARE), (False, 1 - LIT_SHARE)):
        num_wanted = share * num_samples / max(1, sum(len(bounds[is_lit]) > 0 for bounds in sets))
        for part, each in zip(parts, sets, strict=True):
            bounds = random.permutation(each[is_lit])
            sums = np.cumsum([0, *(bounds[:, 1] - bounds[:, 0])])
            drawn.append(part[_members(bounds[: np.argmin(np.abs(sums - num_wanted))])])
    return joined(drawn)


def held_out(camera: str, samples: Samples, num: Mapping[bool, int], seed: int = 0) -> HeldOut:
    """Whole sets to judge by, drawn at random from all times of the drives.

    Each counts as one over its probability, so that figures of a few sets are those of all, on average.

    Args:
        camera: Its name.
        samples: All that there are of it, in order.
        num: How many samples are drawn on average, of sets with light (True) and of those without.
        seed: Of the draws.
    """
    random, weights = np.random.default_rng(seed), np.zeros(len(samples), np.float32)
    for is_lit, bounds in _sets_by_light(samples).items():
        num_samples = int((bounds[:, 1] - bounds[:, 0]).sum())
        if not num_samples:
            continue
        spacing = max(1.0, num_samples / num[is_lit])
        for place in np.arange(spacing * random.random(), len(bounds), spacing).astype(int):
            weights[slice(*bounds[place])] = spacing
    is_drawn = weights > 0
    return HeldOut(camera, samples[is_drawn], weights[is_drawn])


def _sets_by_light(samples: Samples) -> dict[bool, NDArray[np.intp]]:
    """Where the sets begin and end that have light (True), and those without, shape (K, 2); none of doubtful boxes."""
    bounds = set_bounds(samples.sets)
    positives, known = (
        np.array([is_some[start:end].any() for start, end in bounds], np.bool_)
        for is_some in (samples.labels == POSITIVE, samples.labels != IGNORED)
    )
    return {True: bounds[positives], False: bounds[known & ~positives]}


def _members(bounds: NDArray[np.intp]) -> NDArray[np.intp]:
    """The samples of sets, in order, shape (N,)."""
    return np.concatenate([np.empty(0, np.intp), *(np.arange(*each) for each in np.sort(bounds, axis=0))])


def write_old_samples(path: Path, old: OldSamples) -> None:
    """Writes samples for `WIDEST` inputs; their crops lose a little.

    Raises:
        OSError: If the file cannot be written.
    """
    arrays = _packed("learn", old.learn)
    arrays |= _packed("judge", joined([each.samples for each in old.judge]))
    arrays["judge_weights"] = np.concatenate([each.weights for each in old.judge])
    arrays["judge_counts"] = np.array([len(each.samples) for each in old.judge], np.int32)
    arrays["judge_cameras"] = np.array([each.camera for each in old.judge], np.str_)
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    write_atomic(path, content.getvalue())


def _packed(name: str, samples: Samples) -> dict[str, Any]:
    encoded = cv2.imencode(".webp", _sheet(samples.crops), [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])[1]
    arrays: dict[str, Any] = {f"{name}_{field}": getattr(samples, field) for field in ARRAYS}
    return arrays | {f"{name}_crops": encoded, f"{name}_features": samples.features.astype(np.float16)}


def read_old_samples(path: Path, spec: InputSpec) -> OldSamples:
    """The samples in `path` for a model that reads `spec`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it holds something else, or the model reads what the samples do not have.
    """
    given = dataclasses.replace(
        spec,
        num_features=WIDEST.num_features,
        lag_s=WIDEST.lag_s if spec.lag_s is None else spec.lag_s,
        context=WIDEST.context if spec.context is None else spec.context,
        together=WIDEST.together,
    )
    if given != WIDEST:
        raise ValueError(
            f"{path}: expected a model that reads no more than {WIDEST}, got {spec}; mix in drives instead"
        )
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file of samples")
    content = path.read_bytes()
    digest = hashlib.sha256(content).hexdigest()
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            learn, judge = (_unpacked(file, name, spec, f"{digest} {name}") for name in ("learn", "judge"))
            ends = np.cumsum(file["judge_counts"])[:-1]
            weights, cameras = np.split(file["judge_weights"], ends), file["judge_cameras"].tolist()
        parts = (judge[chosen] for chosen in np.split(np.arange(len(judge)), ends))
        return OldSamples(learn, tuple(map(HeldOut, cameras, parts, weights)))
    except (KeyError, AttributeError, cv2.error, zipfile.BadZipFile, *NPY_ERRORS) as error:
        raise ValueError(f"{path}: expected samples as foreglow.lab.learning.old_samples writes them") from error


def _unpacked(file: Mapping[str, Any], name: str, spec: InputSpec, digest: str) -> Samples:
    arrays = {field: file[f"{name}_{field}"] for field in ARRAYS}
    sheet: Any = cv2.imdecode(arrays["crops"], cv2.IMREAD_GRAYSCALE)
    arrays["crops"] = _crops(sheet, len(arrays["labels"]))
    arrays["features"] = arrays["features"].astype(np.float32)
    arrays["sequence_ids"] = arrays["sequence_ids"].astype(np.int64)  # 32 bits in what ships
    channels = [0, *([1] if spec.lag_s is not None else []), *([2] if spec.context is not None else [])]
    arrays["crops"] = np.ascontiguousarray(arrays["crops"][:, channels])
    arrays["features"] = arrays["features"][:, : spec.num_features]
    return Samples(**arrays, digest=digest)


def _sheet(crops: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """All channels of all crops as one image, channel by channel, which an image format makes small."""
    count, channels, side = crops.shape[:3]
    rows = -(-count // _COLUMNS)
    filled = np.zeros((channels, rows * _COLUMNS, side, side), np.uint8)
    filled[:, :count] = crops.transpose(1, 0, 2, 3)
    tiles = filled.reshape(channels * rows, _COLUMNS, side, side)
    return tiles.transpose(0, 2, 1, 3).reshape(channels * rows * side, _COLUMNS * side)


def _crops(sheet: NDArray[np.uint8], count: int) -> NDArray[np.uint8]:
    """The crops on a sheet, shape (N, C, S, S)."""
    channels, side = WIDEST.num_channels, WIDEST.size_px
    tiles = sheet.reshape(-1, side, _COLUMNS, side).transpose(0, 2, 1, 3)
    return np.ascontiguousarray(tiles.reshape(channels, -1, side, side)[:, :count].transpose(1, 0, 2, 3))


def main(arguments: Sequence[str] | None = None) -> None:
    """Makes the samples, as the module's docstring says."""
    from foreglow.display.progress import StepProgress

    parser = argparse.ArgumentParser(prog="python -m foreglow.lab.learning.old_samples", description=__doc__)
    parser.add_argument("data", nargs="+", type=Path, metavar="DATA", help="data sets whose split train is mixed in")
    parser.add_argument(
        "--judge", nargs="+", type=Path, metavar="DATA", required=True, help="... whose split val judges, by camera"
    )
    parser.add_argument("--out", type=Path, default=OLD_SAMPLES, help="the file to write")
    parser.add_argument("--cache", type=Path, required=True, help="where samples are kept, such as those of a training")
    parser.add_argument("--samples", type=int, default=NUM_SAMPLES, metavar="N", help="about how many are mixed in")
    given = parser.parse_args(arguments)
    recipe = RECIPES["related"]
    config = SampleConfig(
        proposals=preset("foreglow").proposals, inputs=WIDEST, jitter=recipe.jitter, by_light=recipe.by_light
    )
    with StepProgress() as progress:
        parts = []
        for data in given.data:
            split = open_labelled(split_folder(data, "train"))
            parts.append(cached_samples(split, config, given.cache, progress.of(f"{data}: images")))
        splits: dict[str, list[LabelledSource]] = {}
        for data in given.judge:
            splits.setdefault("/".join(data.parts[-2:]), []).append(open_labelled(split_folder(data, "val")))
        judge = [
            judging(camera, found, config, given.cache, seed=number)
            for number, (camera, found) in enumerate(splits.items())
        ]  # other images by each camera, of drives that are the same
    old = OldSamples(chosen(parts, given.samples), tuple(judge))
    write_old_samples(given.out, old)
    counts = [old.learn.num_labelled(label) for label in (POSITIVE, NEGATIVE)]
    num_sets = [len(set_bounds(each.sets)) for each in (old.learn, *(each.samples for each in old.judge))]
    num_judging = sum(len(each.samples) for each in old.judge)
    print(  # noqa: T201
        f"{given.out}: {counts[0]} boxes with light, {counts[1]} without, of {num_sets[0]} images; {num_judging} of "
        f"{sum(num_sets[1:])} to judge by; {given.out.stat().st_size / 1e6:.2f} MB"
    )


def judging(camera: str, splits: Sequence[LabelledSource], config: SampleConfig, cache: Path, seed: int) -> HeldOut:
    """Samples of a camera's splits to judge by; those in which light is doubtful are not judged.

    Raises:
        As `cached_samples`.
    """
    parts = []
    for split in splits:
        samples = cached_samples(split, config, cache)
        labels = samples.labels.copy()
        for start, end in set_bounds(samples.sets):
            by_points = label_image(split, int(samples.image_ids[start]), samples.boxes_xyxy_px[start:end])
            labels[start:end][by_points == IGNORED] = IGNORED
        parts.append(dataclasses.replace(samples, labels=labels))
    return held_out(camera, joined(parts), NUM_JUDGING, seed)


if __name__ == "__main__":
    main()
