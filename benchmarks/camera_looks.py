"""How alike simulated and real images look: `python -m benchmarks.camera_looks SIMULATED=REAL ... [--out DIR]`.

Each pair is a simulated split (or any source of frames) and a real one, such as `DATA/phone=clip.mp4`. For both, the
figures are means over the same number of frames: percentiles of the grey levels, noise in the dark, sharpness of edges,
blocks of the compression, and the grey levels around the largest lamps against the angle. `halo.png` and `looks.json`
go into the folder.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.timing import CONSOLE, RESULTS, table
from foreglow.datasets import open_source
from foreglow.whole_files import write_atomic

NUM_FRAMES = 12
PERCENTILES = (1, 5, 25, 50, 75, 95, 99, 99.9)
ANGLES_DEG = np.array([0.2, 0.3, 0.45, 0.7, 1.0, 1.5, 2.2, 3.3, 5.0, 7.0, 10.0])
LAMP_GREY_SHARE = 0.8
"""A lamp is at least so bright, as a share of the frame's brightest pixel; and not in the lower part of the image."""

LOWEST_SHARE = 0.62
NUM_LAMPS = 3
SKY_DEG = (25.0, 155.0)
"""Directions above a lamp in which its halo is measured: below it is its light on the road."""

Grey = NDArray[np.float64]


def frames_of(path: str, num: int) -> list[tuple[Grey, float]]:
    """Evenly spaced grey images of a source in 8 bits, each with its focal length, NaN where that is not known."""
    source = open_source(Path(path))
    total = source.num_frames or sum(1 for _ in source)
    wanted = set(np.linspace(0, total - 1, num).round().astype(int).tolist())
    found = []
    for number, frame in enumerate(source):
        if number in wanted:
            focal = np.nan if frame.camera is None else frame.camera.focal_px[0]
            found.append((frame.image.astype(np.float64), float(focal)))
    return found


def figures(grey: Grey) -> dict[str, float]:
    """Percentiles, noise, edges and blocks of an image.

    `noise` is the standard deviation against the mean of 3x3 pixels in the darker half, `edge` the steepest step
    between neighbours over the contrast, `blocks` the ratio of steps between blocks of 8 pixels and of all others.
    """
    found = {f"percentile {share}": float(np.percentile(grey, share)) for share in PERCENTILES}
    is_dark = cv2.blur(grey, (15, 15)) <= np.median(grey)
    found["noise"] = float((grey - cv2.blur(grey, (3, 3)))[is_dark].std())
    steps = np.abs(np.diff(grey, axis=1))
    found["edge"] = float(np.percentile(steps, 99.9) / max(np.percentile(grey, 99.9) - np.percentile(grey, 1), 1.0))
    columns = steps.mean(0)
    found["blocks"] = float(columns[7::8].mean() / max(np.delete(columns, np.s_[7::8]).mean(), 1e-6))
    return found


def halos(grey: Grey, focal_px: float) -> list[Grey]:
    """Median grey level in rings above each of the largest lamps; NaN where a ring is too small."""
    is_bright = (grey >= LAMP_GREY_SHARE * grey.max()).astype(np.uint8)
    is_bright[round(LOWEST_SHARE * len(grey)) :] = 0
    num, _, sizes, middles = cv2.connectedComponentsWithStats(is_bright)
    largest = sorted(range(1, num), key=lambda number: -sizes[number][cv2.CC_STAT_AREA])[:NUM_LAMPS]
    rows, columns = np.indices(grey.shape)
    found = []
    for number in largest:
        x, y = middles[number]
        angles = np.degrees(np.arctan(np.hypot(columns - x, rows - y) / focal_px))
        direction = np.degrees(np.arctan2(y - rows, columns - x))
        is_above = (direction > SKY_DEG[0]) & (direction < SKY_DEG[1])
        rings = [grey[is_above & (angles >= low) & (angles < high)] for low, high in itertools.pairwise(ANGLES_DEG)]
        found.append(np.array([np.median(ring) if ring.size > 3 else np.nan for ring in rings]))
    return found


def measured(path: str, hfov_deg: float) -> tuple[dict[str, float], Grey]:
    """Mean figures of a source, and the median halo of its lamps."""
    rows, around = [], []
    for grey, focal_px in frames_of(path, NUM_FRAMES):
        if np.isnan(focal_px):
            focal_px = 0.5 * grey.shape[1] / float(np.tan(np.radians(hfov_deg / 2)))
        rows.append(figures(grey))
        around += halos(grey, focal_px)
    means = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
    return means, np.nanmedian(around, axis=0)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pairs", nargs="+", metavar="SIMULATED=REAL")
    parser.add_argument("--hfov", type=float, default=65.0, help="horizontal field of view of real clips, degrees")
    parser.add_argument("--out", type=Path, default=RESULTS / "camera_looks")
    given = parser.parse_args(arguments)
    results = {}
    for pair in given.pairs:
        simulated, _, real = pair.partition("=")
        (ours, our_halo), (theirs, their_halo) = measured(simulated, given.hfov), measured(real, given.hfov)
        shown = table(pair, ("figure",), ("real", "simulated", "ratio"))
        rings = [f"halo at {low:g} to {high:g} deg" for low, high in itertools.pairwise(ANGLES_DEG)]
        ours |= dict(zip(rings, our_halo.tolist(), strict=True))
        theirs |= dict(zip(rings, their_halo.tolist(), strict=True))
        for name, value in theirs.items():
            # One grey level is added to both: black is the same as black.
            ratio = ours[name] if name in ("noise", "edge", "blocks") else ours[name] + 1.0
            ratio /= max(value if name in ("noise", "edge", "blocks") else value + 1.0, 1e-3)
            shown.add_row(name, f"{value:.2f}", f"{ours[name]:.2f}", f"{ratio:.2f}")
        CONSOLE.print(shown)
        results[pair] = {"real": theirs, "simulated": ours}
    given.out.mkdir(parents=True, exist_ok=True)
    write_atomic(given.out / "looks.json", (json.dumps(results, indent=1) + "\n").encode())
    _draw(results, given.out / "halo.png")
    CONSOLE.print(f"look in {given.out}")


def _draw(results: dict[str, dict[str, dict[str, float]]], path: Path) -> None:
    import matplotlib as mpl

    mpl.use("agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(results), figsize=(4.2 * len(results), 3.4), squeeze=False, layout="constrained")
    middles = np.sqrt(ANGLES_DEG[1:] * ANGLES_DEG[:-1])
    for axis, (pair, both) in zip(axes[0], results.items(), strict=True):
        for name, values in both.items():
            axis.plot(middles, [value for key, value in values.items() if key.startswith("halo")], "o-", label=name)
        axis.set(xscale="log", xlabel="angle to the lamp, degrees", ylabel="grey level", title=Path(pair).name[:40])
        axis.legend()
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    main()
