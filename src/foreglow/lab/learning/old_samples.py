"""A few samples of simulated drives, small enough to ship: a model that is trained further keeps what it knew of them.

Some are of the drives that the model learnt from; they are mixed in. Others are of validation drives, camera by camera;
they only judge what was lost. `python -m foreglow.lab.learning.old_samples DATA... --judge DATA... --out FILE` makes
both.
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
from foreglow.datasets.pvdn import is_split
from foreglow.lab.learning.annotation import IGNORED, NEGATIVE, POSITIVE
from foreglow.lab.learning.recipes import RECIPES
from foreglow.lab.learning.sample_cache import cached_samples
from foreglow.lab.learning.samples import ARRAYS, Jitter, SampleConfig, Samples, joined
from foreglow.models import OLD_SAMPLES
from foreglow.whole_files import write_atomic

NUM_SAMPLES = 3000

WIDEST = RECIPES["foreglow"].inputs
"""What the samples hold: models that read fewer channels or features are given those."""

LIT_SHARE = 0.75
"""Of the samples that are mixed in, those of images with light of vehicles."""

NUM_JUDGING = {True: 20, False: 9}
"""Images of each camera that judge, with light of vehicles and without."""

_QUALITY = 80  # of WebP: 2 grey levels off on average, at 0.5 kB a sample
_COLUMNS = 64


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Samples of one camera's drives that nothing is learnt from.

    Attributes:
        camera: Its name.
        samples: In whole sets.
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
    """About so many samples in whole sets drawn at random, as many of each part, most of images with light.

    >>> from foreglow.lab.learning.samples import no_samples
    >>> len(chosen([no_samples(WIDEST)], 10))
    0
    """
    random, drawn = np.random.default_rng(seed), []
    for part in parts:
        for share, sets in zip((LIT_SHARE, 1 - LIT_SHARE), _lit_and_dark(part), strict=True):
            sets = random.permutation(sets)
            counts = np.cumsum([np.count_nonzero(part.sets == number) for number in sets])
            wanted = sets[: np.searchsorted(counts, share * num_samples / len(parts)) + 1]
            drawn.append(part[np.isin(part.sets, wanted)])
    return joined(drawn)


def held_out(camera: str, samples: Samples, num: Mapping[bool, int], seed: int = 0) -> HeldOut:
    """Samples drawn at random, in whole sets, to judge by.

    What is drawn counts as one over its probability, so that figures of a few samples are those of all, on average.

    Args:
        camera: Its name.
        samples: All that there are of it.
        num: How many sets are drawn, with light (True) and without.
        seed: Of the draws.
    """
    random, weights = np.random.default_rng(seed), np.zeros(len(samples), np.float32)
    for is_lit, sets in zip((True, False), _lit_and_dark(samples), strict=True):
        wanted = random.choice(sets, min(num[is_lit], len(sets)), replace=False)
        weights[np.isin(samples.sets, wanted)] = len(sets) / max(1, len(wanted))
    return HeldOut(camera, samples[weights > 0], weights[weights > 0])


def _lit_and_dark(samples: Samples) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The numbers of the sets with light of vehicles, and of those without."""
    lit = np.unique(samples.sets[samples.labels == POSITIVE])
    return lit, np.setdiff1d(samples.sets, lit)


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
    return _as_read(Samples(**arrays, digest=digest), spec)


def _as_read(samples: Samples, spec: InputSpec) -> Samples:
    """The samples of `WIDEST` as a model reads them that reads `spec`."""
    channels = [0, *([1] if spec.lag_s is not None else []), *([2] if spec.context is not None else [])]
    return dataclasses.replace(
        samples,
        crops=np.ascontiguousarray(samples.crops[:, channels]),
        features=samples.features[:, : spec.num_features],
    )


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
    parser.add_argument("data", nargs="+", type=Path, metavar="DATA", help="data sets (train is mixed in) or splits")
    parser.add_argument(
        "--judge", nargs="+", type=Path, metavar="DATA", required=True, help="... whose split val judges, by camera"
    )
    parser.add_argument("--out", type=Path, default=OLD_SAMPLES, help="the file to write")
    parser.add_argument("--cache", type=Path, required=True, help="where samples are kept, such as those of a training")
    parser.add_argument("--samples", type=int, default=NUM_SAMPLES, metavar="N", help="how many are mixed in")
    given = parser.parse_args(arguments)
    recipe = RECIPES["foreglow"]
    config = SampleConfig(
        proposals=preset("foreglow").proposals, inputs=recipe.inputs, jitter=recipe.jitter, by_light=recipe.by_light
    )
    with StepProgress() as progress:
        parts = []
        for data in given.data:
            split = open_labelled(data if is_split(data) else split_folder(data, "train"))
            parts.append(cached_samples(split, config, given.cache, progress.of(f"{data}: images")))
        splits: dict[str, list[LabelledSource]] = {}
        for data in given.judge:
            splits.setdefault("/".join(data.parts[-2:]), []).append(open_labelled(split_folder(data, "val")))
        judge = [judging(camera, found, config, given.cache) for camera, found in splits.items()]
    old = OldSamples(chosen(parts, given.samples), tuple(judge))
    write_old_samples(given.out, old)
    counts = [old.learn.num_labelled(label) for label in (POSITIVE, NEGATIVE)]
    num_judging = sum(len(each.samples) for each in old.judge)
    print(  # noqa: T201
        f"{given.out}: {counts[0]} boxes with light, {counts[1]} without, {num_judging} to judge by, "
        f"{given.out.stat().st_size / 1e6:.2f} MB"
    )


def judging(camera: str, splits: Sequence[LabelledSource], config: SampleConfig, cache: Path) -> HeldOut:
    """Samples of a camera's splits to judge by; those in which light is doubtful are labelled so.

    Raises:
        As `cached_samples`.
    """
    plain = config.model_copy(update={"jitter": Jitter()})
    parts = []
    for split in splits:
        by_light, by_points = (
            cached_samples(split, plain.model_copy(update={"by_light": each}), cache) for each in (True, False)
        )
        labels = np.where(by_points.labels == IGNORED, np.int8(IGNORED), by_light.labels)
        parts.append(dataclasses.replace(by_light, labels=labels))
    return held_out(camera, joined(parts), NUM_JUDGING)


if __name__ == "__main__":
    main()
