"""A few samples of what a model learnt from, small enough to ship: they are mixed in when it is trained further.

`python -m foreglow.lab.learning.old_samples DATA... --out FILE` makes them of the training drives.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import io
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from foreglow.classifier.inputs import FEATURES, InputSpec
from foreglow.config import preset
from foreglow.datasets import open_labelled, split_folder
from foreglow.datasets.images import NPY_ERRORS
from foreglow.files import write_atomic
from foreglow.lab.learning.annotation import IGNORED, NEGATIVE, POSITIVE
from foreglow.lab.learning.recipes import RECIPES
from foreglow.lab.learning.sample_cache import cached_samples
from foreglow.lab.learning.samples import ARRAYS, SampleConfig, Samples, joined
from foreglow.models import OLD_SAMPLES

NUM_SAMPLES = 3000

WIDEST = InputSpec(size_px=32, lag_s=0.25, num_features=len(FEATURES), context=6)
"""What the samples hold: models that read fewer channels or features are given those."""

POSITIVE_SHARE = 0.4
"""Of the samples; there are ten times as many boxes without light, but few of them teach anything."""

_QUALITY = 80  # of WebP: 2 grey levels off on average, at 0.5 kB a sample
_COLUMNS = 64
_HELD_OUT = 5  # every fifth drive is only judged by


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


def split_by_drive(samples: Samples) -> tuple[Samples, Samples]:
    """The samples to learn from, and those of every fifth drive, to judge by."""
    numbers = np.unique(samples.sequence_ids, return_inverse=True)[1]
    is_held_out = numbers % _HELD_OUT == _HELD_OUT - 1
    return tuple(
        dataclasses.replace(samples[mask], digest=f"{samples.digest} {name}")
        for name, mask in (("learn", ~is_held_out), ("judge", is_held_out))
    )  # type: ignore[return-value]


def write_old_samples(path: Path, samples: Samples) -> None:
    """Writes samples for `WIDEST` inputs; their crops lose a little.

    Raises:
        OSError: If the file cannot be written.
    """
    encoded = cv2.imencode(".webp", _sheet(samples.crops), [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])[1]
    arrays: dict[str, Any] = {name: getattr(samples, name) for name in ARRAYS} | {"crops": encoded}
    arrays["features"] = arrays["features"].astype(np.float16)
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    write_atomic(path, content.getvalue())


def read_old_samples(path: Path, spec: InputSpec) -> Samples:
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
    )
    if given != WIDEST:
        raise ValueError(
            f"{path}: expected a model that reads no more than {WIDEST}, got {spec}; mix in drives instead"
        )
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file of samples")
    content = path.read_bytes()
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            arrays = {name: file[name] for name in ARRAYS}
        sheet: Any = cv2.imdecode(arrays["crops"], cv2.IMREAD_GRAYSCALE)
        arrays["crops"] = _crops(sheet, len(arrays["labels"]))
    except (KeyError, AttributeError, cv2.error, zipfile.BadZipFile, *NPY_ERRORS) as error:
        raise ValueError(f"{path}: expected samples as foreglow.lab.learning.old_samples writes them") from error
    channels = [0, *([1] if spec.lag_s is not None else []), *([2] if spec.context is not None else [])]
    arrays["crops"] = np.ascontiguousarray(arrays["crops"][:, channels])
    arrays["features"] = arrays["features"][:, : spec.num_features].astype(np.float32)
    return Samples(**arrays, digest=hashlib.sha256(content).hexdigest())


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
    parser.add_argument("data", nargs="+", type=Path, metavar="DATA", help="data sets with a split train")
    parser.add_argument("--out", type=Path, default=OLD_SAMPLES, help="the file to write")
    parser.add_argument("--cache", type=Path, required=True, help="where samples are kept, such as those of a training")
    parser.add_argument("--samples", type=int, default=NUM_SAMPLES, metavar="N", help="how many")
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
    samples = chosen(parts, given.samples)
    write_old_samples(given.out, samples)
    counts = [samples.num_labelled(label) for label in (POSITIVE, NEGATIVE, IGNORED)]
    print(f"{given.out}: {counts[0]} boxes with light, {counts[1]} without, {given.out.stat().st_size / 1e6:.2f} MB")  # noqa: T201


if __name__ == "__main__":
    main()
