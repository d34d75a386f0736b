"""Can real and simulated images be told apart? `python -m benchmarks.camera_sheet REAL SIMULATED [--out DIR]`.

Both are sources of frames, such as a folder of images or a clip. Twelve grey frames of each are put side by side as
pairs, in random order and of one size, into `sheet.png`; `--gamma` makes both brighter for the eye. Write down for each
pair which side is real before you look into `key.json`.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from benchmarks.camera_looks import NUM_FRAMES, frames_of
from benchmarks.timing import CONSOLE, RESULTS
from foreglow.whole_files import write_atomic

PAIRS_PER_ROW = 2
BORDER_PX = 10


def sheet(
    real: Sequence[np.ndarray], simulated: Sequence[np.ndarray], width_px: int, seed: int
) -> tuple[np.ndarray, list[str]]:
    """The contact sheet of grey images in 8 bits, and for each pair the side on which the real one is."""
    rng = np.random.default_rng(seed)
    num = min(len(real), len(simulated))
    real_order, simulated_order = rng.permutation(len(real))[:num], rng.permutation(len(simulated))[:num]
    height_px = round(width_px * real[0].shape[0] / real[0].shape[1])
    pairs, key = [], []
    for number, (first, second) in enumerate(zip(real_order, simulated_order, strict=True), 1):
        images = [
            cv2.resize(image.astype(np.uint8), (width_px, height_px), interpolation=cv2.INTER_AREA)
            for image in (real[first], simulated[second])
        ]
        is_left = bool(rng.random() < 0.5)
        key.append("left" if is_left else "right")
        pair = cv2.hconcat(images if is_left else images[::-1])
        cv2.putText(pair, str(number), (8, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.8, 255)
        pairs.append(np.pad(pair, BORDER_PX, constant_values=128))
    pairs += [np.full_like(pairs[0], 128)] * (-num % PAIRS_PER_ROW)
    rows = [cv2.hconcat(pairs[at : at + PAIRS_PER_ROW]) for at in range(0, len(pairs), PAIRS_PER_ROW)]
    return np.asarray(cv2.vconcat(rows)), key


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("real")
    parser.add_argument("simulated")
    parser.add_argument("--gamma", type=float, default=2.0, help="both are brightened by it")
    parser.add_argument("--rows", type=float, default=1.0, help="share of the rows that is shown, from the top")
    parser.add_argument("--width", type=int, default=480, help="columns of an image on the sheet")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=RESULTS / "camera_sheet")
    given = parser.parse_args(arguments)
    real, simulated = (
        [
            255.0 * (grey[: round(given.rows * len(grey))] / 255.0) ** (1.0 / given.gamma)
            for grey, _ in frames_of(path, NUM_FRAMES)
        ]
        for path in (given.real, given.simulated)
    )
    picture, key = sheet(real, simulated, given.width, given.seed)
    given.out.mkdir(parents=True, exist_ok=True)
    write_atomic(given.out / "sheet.png", cv2.imencode(".png", picture)[1].tobytes())
    write_atomic(given.out / "key.json", (json.dumps(dict(enumerate(key, 1))) + "\n").encode())
    CONSOLE.print(f"look at {given.out / 'sheet.png'}, and then into key.json")


if __name__ == "__main__":
    main()
