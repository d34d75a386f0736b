"""Can real and simulated images be told apart? `python -m benchmarks.camera_sheet REAL SIMULATED ... [--out DIR]`.

Both are sources of frames, such as a folder of images or a clip; further pairs of sources may follow. Twelve grey
frames of each are put side by side as pairs, in random order and of one size, into `sheet.png`, and each pair into a
`pair_NN.png` of its own; `--gamma` makes both brighter for the eye. Write down for each pair which side is real before
you look into `key.json`.

A source `PICTURE#RxC:N,N` is one picture of R rows and C columns of panels, of which those with the numbers N, from 0,
are frames. After a source, `~Q` compresses its frames as JPEG of quality Q, and then `*G` makes them G times as bright
in the size of the sheet and cuts off the fraction, as was done to some pictures of real frames.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.camera_looks import NUM_FRAMES, frames_of
from benchmarks.timing import CONSOLE, RESULTS
from foreglow.datasets import read_image
from foreglow.whole_files import write_atomic

PAIRS_PER_ROW = 2
BORDER_PX = 10
SOURCE = re.compile(
    r"(?P<path>.+?)(#(?P<rows>\d+)x(?P<columns>\d+):(?P<chosen>\d+(,\d+)*))?(~(?P<quality>\d+))?(\*(?P<gain>[\d.]+))?"
)

Grey: TypeAlias = NDArray[np.uint8]


def read_frames(source: str, width_px: int) -> list[Grey]:
    """The frames of a source as its text describes them, `width_px` wide."""
    found = SOURCE.fullmatch(source)
    assert found is not None, "any text that is not empty matches"
    path, quality, gain = Path(found["path"]), found["quality"], found["gain"]
    if found["rows"]:
        panels = _panels(read_image(path).astype(np.uint8), int(found["rows"]), int(found["columns"]))
        images = [panels[int(number)] for number in found["chosen"].split(",")]
    elif path.is_file() and path.suffix == ".png":
        images = [read_image(path).astype(np.uint8)]
    else:
        images = [grey.astype(np.uint8) for grey, _ in frames_of(str(path), NUM_FRAMES)]
    if quality:
        jpegs = [cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(quality)])[1] for image in images]
        images = [np.asarray(cv2.imdecode(jpeg, cv2.IMREAD_GRAYSCALE), np.uint8) for jpeg in jpegs]
    images = [_resized(image, width_px, round(width_px * image.shape[0] / image.shape[1])) for image in images]
    return [np.minimum(np.floor(image * float(gain or 1.0)), 255.0).astype(np.uint8) for image in images]


def drawn_pairs(groups: Sequence[tuple[Sequence[Grey], Sequence[Grey]]], seed: int) -> list[tuple[Grey, Grey]]:
    """Pairs (real, simulated), each of one group, in random order."""
    rng = np.random.default_rng(seed)
    pairs = []
    for group in groups:
        num = min(len(images) for images in group)
        orders = [rng.permutation(len(images))[:num] for images in group]
        pairs += [(group[0][real], group[1][simulated]) for real, simulated in zip(*orders, strict=True)]
    return [pairs[number] for number in rng.permutation(len(pairs))]


def side_by_side(pairs: Sequence[tuple[Grey, Grey]], seed: int) -> tuple[list[Grey], list[str]]:
    """Each pair as one picture of the real frame's height, and the side on which the real one is."""
    rng = np.random.default_rng(seed)
    pictures, key = [], []
    for real, simulated in pairs:
        images = [real, _resized(simulated, real.shape[1], real.shape[0])]
        is_left = bool(rng.random() < 0.5)
        key.append("left" if is_left else "right")
        pictures.append(np.asarray(cv2.hconcat(images if is_left else images[::-1]), np.uint8))
    return pictures, key


def sheet(pictures: Sequence[Grey]) -> Grey:
    """The contact sheet of pictures, numbered from 1; lower ones are filled up at the bottom."""
    height = max(picture.shape[0] for picture in pictures)
    framed = []
    for number, picture in enumerate(pictures, 1):
        named = np.pad(picture, ((0, height - picture.shape[0]), (0, 0)), constant_values=128)
        cv2.putText(named, str(number), (8, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.8, 255)
        framed.append(np.pad(named, BORDER_PX, constant_values=128))
    framed += [np.full_like(framed[0], 128)] * (-len(framed) % PAIRS_PER_ROW)
    rows = [cv2.hconcat(framed[at : at + PAIRS_PER_ROW]) for at in range(0, len(framed), PAIRS_PER_ROW)]
    return np.asarray(cv2.vconcat(rows), np.uint8)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sources", nargs="+", metavar="REAL SIMULATED")
    parser.add_argument("--gamma", type=float, default=2.0, help="both are brightened by it")
    parser.add_argument("--rows", type=float, default=1.0, help="share of the rows down to which is shown")
    parser.add_argument("--top", type=float, default=0.0, help="share of the rows that is left out at the top")
    parser.add_argument("--width", type=int, default=480, help="columns of an image on the sheet")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=RESULTS / "camera_sheet")
    given = parser.parse_args(arguments)
    if len(given.sources) % 2:
        parser.error(f"expected pairs REAL SIMULATED, got {len(given.sources)} sources")

    def shown(image: Grey) -> Grey:
        cut = image[round(given.top * len(image)) : round(given.rows * len(image))]
        return np.asarray(255.0 * (cut / 255.0) ** (1.0 / given.gamma), np.uint8)

    sources = [[shown(image) for image in read_frames(source, given.width)] for source in given.sources]
    pairs = drawn_pairs(list(zip(sources[::2], sources[1::2], strict=True)), given.seed)
    pictures, key = side_by_side(pairs, given.seed)
    given.out.mkdir(parents=True, exist_ok=True)
    write_atomic(given.out / "sheet.png", cv2.imencode(".png", sheet(pictures))[1].tobytes())
    for number, picture in enumerate(pictures, 1):
        write_atomic(given.out / f"pair_{number:02d}.png", cv2.imencode(".png", picture)[1].tobytes())
    write_atomic(given.out / "key.json", (json.dumps(dict(enumerate(key, 1))) + "\n").encode())
    CONSOLE.print(f"look at {given.out / 'sheet.png'}, and then into key.json")


def _panels(picture: Grey, num_rows: int, num_columns: int) -> list[Grey]:
    """The panels of a picture, row by row."""
    height, width = picture.shape[0] // num_rows, picture.shape[1] // num_columns
    corners = [(row * height, column * width) for row in range(num_rows) for column in range(num_columns)]
    return [picture[y : y + height, x : x + width] for y, x in corners]


def _resized(image: Grey, width_px: int, height_px: int) -> Grey:
    return np.asarray(cv2.resize(image, (width_px, height_px), interpolation=cv2.INTER_AREA), np.uint8)


if __name__ == "__main__":
    main()
