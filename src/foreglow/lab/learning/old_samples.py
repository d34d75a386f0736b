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
from scipy.special import expit

from foreglow.classifier.inputs import InputSpec
from foreglow.config import preset
from foreglow.datasets import LabelledSource, open_labelled, split_folder
from foreglow.datasets.images import NPY_ERRORS
from foreglow.lab.learning.annotation import IGNORED, NEGATIVE, POSITIVE
from foreglow.lab.learning.recipes import RECIPES
from foreglow.lab.learning.sample_cache import cached_samples
from foreglow.lab.learning.samples import ARRAYS, Jitter, SampleConfig, Samples, joined
from foreglow.models import OLD_SAMPLES
from foreglow.whole_files import write_atomic

NUM_SAMPLES = 3000

WIDEST = RECIPES["foreglow"].inputs
"""What the samples hold: models that read fewer channels or features are given those. They are single boxes, of no use
to a model that compares those of an image."""

POSITIVE_SHARE = 0.4
"""Of the samples; there are ten times as many boxes without light, but few of them teach anything."""

NUM_JUDGING = {POSITIVE: 130, NEGATIVE: 220}
"""Samples of each camera that judge, about: by these and by all boxes of 16 drives, losses differ by up to .005."""

_LEAST_SHARE = 0.05  # added to a score: boxes that look unlike light are drawn as well
_QUALITY = 80  # of WebP: 2 grey levels off on average, at 0.5 kB a sample
_COLUMNS = 64


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Samples of one camera's drives that nothing is learnt from.

    Attributes:
        camera: Its name.
        samples: Without doubtful ones.
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
    """Samples drawn at random, as many of each part, without doubtful ones.

    >>> from foreglow.lab.learning.samples import no_samples
    >>> len(chosen([no_samples(WIDEST)], 10))
    0
    """
    random, drawn = np.random.default_rng(seed), []
    for part in parts:
        for label, share in ((POSITIVE, POSITIVE_SHARE), (NEGATIVE, 1 - POSITIVE_SHARE)):
            indices = np.flatnonzero(part.labels == label)
            count = min(len(indices), round(share * num_samples / len(parts)))
            drawn.append(part[np.sort(random.choice(indices, count, replace=False))])
    return joined(drawn)


def held_out(
    camera: str, samples: Samples, scores: NDArray[np.floating[Any]], num: Mapping[int, int], seed: int = 0
) -> HeldOut:
    """Samples drawn at random to judge by; the more a box without light looks like light, the likelier it is drawn.

    What is drawn counts as one over its probability, so that figures of a few samples are those of all, on average.

    Args:
        camera: Its name.
        samples: All that there are of it.
        scores: Shape (N,): how much each looks like light.
        num: How many are drawn on average, by label.
        seed: Of the draws.
    """
    shares = np.zeros(len(samples))
    shares[samples.labels == POSITIVE] = 1.0
    is_negative = samples.labels == NEGATIVE
    shares[is_negative] = _LEAST_SHARE + scores[is_negative]
    random, is_drawn = np.random.default_rng(seed), np.zeros(len(samples), np.bool_)
    for label, wanted in num.items():
        here = np.flatnonzero(samples.labels == label)
        here = here[np.argsort(scores[here], kind="stable")]
        shares[here] = _probabilities(shares[here], wanted)
        steps = np.floor(np.cumsum(shares[here]) + random.random())  # so boxes of all scores are drawn
        is_drawn[here] = np.diff(steps, prepend=0.0) > 0
    return HeldOut(camera, samples[is_drawn], (1 / shares[is_drawn]).astype(np.float32))


def _probabilities(shares: NDArray[np.float64], wanted: int) -> NDArray[np.float64]:
    """Probabilities that are proportional to `shares`, but at most 1, and sum to `wanted`, or to N if that is less."""
    if len(shares) <= wanted:
        return np.ones(len(shares))
    is_sure = np.zeros(len(shares), np.bool_)
    while True:
        found = np.where(is_sure, 1.0, shares * (wanted - is_sure.sum()) / shares[~is_sure].sum())
        if (found <= 1.0).all():
            return found
        is_sure |= found >= 1.0


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
    arrays: dict[str, Any] = {f"{name}_{field}": getattr(samples, field) for field in ARRAYS if field != "sets"}
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
        together=False,
    )
    if given != WIDEST or spec.together:
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
    arrays = {field: file[f"{name}_{field}"] for field in ARRAYS if field != "sets"}
    arrays["sets"] = np.arange(len(arrays["labels"]), dtype=np.int32)
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
    parser.add_argument("data", nargs="+", type=Path, metavar="DATA", help="data sets whose split train is mixed in")
    parser.add_argument(
        "--judge", nargs="+", type=Path, metavar="DATA", required=True, help="... whose split val judges, by camera"
    )
    parser.add_argument("--out", type=Path, default=OLD_SAMPLES, help="the file to write")
    parser.add_argument("--cache", type=Path, required=True, help="where samples are kept, such as those of a training")
    parser.add_argument("--samples", type=int, default=NUM_SAMPLES, metavar="N", help="how many are mixed in")
    parser.add_argument("--model", type=Path, default=Path("foreglow"), help="says what looks like light")
    given = parser.parse_args(arguments)
    recipe = RECIPES["foreglow"]
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
        judge = [judging(camera, found, config, given.model, given.cache) for camera, found in splits.items()]
    old = OldSamples(chosen(parts, given.samples), tuple(judge))
    write_old_samples(given.out, old)
    counts = [old.learn.num_labelled(label) for label in (POSITIVE, NEGATIVE)]
    num_judging = sum(len(each.samples) for each in old.judge)
    print(  # noqa: T201
        f"{given.out}: {counts[0]} boxes with light, {counts[1]} without, {num_judging} to judge by, "
        f"{given.out.stat().st_size / 1e6:.2f} MB"
    )


def judging(camera: str, splits: Sequence[LabelledSource], config: SampleConfig, model: Path, cache: Path) -> HeldOut:
    """Samples of a camera's splits to judge by, drawn with a model's help; without those in which light is doubtful.

    Raises:
        As `cached_samples`, and `model_import.read_model`.
    """
    import torch

    from foreglow.lab.learning.model_import import read_model
    from foreglow.lab.learning.scores import light_logits
    from foreglow.lab.learning.training import score_samples

    plain = config.model_copy(update={"jitter": Jitter()})
    parts = []
    for split in splits:
        by_light, by_points = (
            cached_samples(split, plain.model_copy(update={"by_light": each}), cache) for each in (True, False)
        )
        parts.append(by_light[(by_light.labels != IGNORED) & (by_points.labels != IGNORED)])
    samples = joined(parts)
    start = read_model(model)
    logits = score_samples(start.network, _as_read(samples, start.inputs), torch.device("cpu"))
    return held_out(camera, samples, expit(light_logits(logits)), NUM_JUDGING)


if __name__ == "__main__":
    main()
