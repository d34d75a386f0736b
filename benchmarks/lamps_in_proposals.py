"""How many lamps in sight lie in a proposal: `python -m benchmarks.lamps_in_proposals SPLIT ... [--preset NAME ...]`.

Each SPLIT is a simulated one, such as `DATA/phone/night/val`. Lamps of vehicles at 20 to 150 m count if at least half
of their disc is seen, and the labelled light of vehicles on something. A box must not be much larger than the light:
one around half of the image holds every lamp, and tells of none. In a frame of 1280 columns the longer side is at most
28 px + 1200 px m / range for a lamp, 150 px for light on something, and a lamp is at most 2 px outside.
`lamps_in_proposals.json` goes into the folder of results.
"""

from __future__ import annotations

import argparse
import functools
from collections import Counter
from pathlib import Path

import numpy as np

from benchmarks.timing import CONSOLE, RESULTS, table
from foreglow.config import PRESETS, preset
from foreglow.datasets import open_labelled
from foreglow.datasets.simulated import VehicleTruth, read_truth
from foreglow.datasets.simulated.files import MAX_FRAMES
from foreglow.files import write_json_results
from foreglow.proposals import Proposer, make_proposer
from foreglow.types import Boxes

RANGES_M = (20.0, 150.0)
MIN_VISIBLE_SHARE = 0.5
MARGIN = 2.0 / 1280.0
"""A lamp may be outside of its box by so much, as a share of the frame's width."""

LAMP_SIDE, LAMP_SIDE_M, LIGHT_SIDE = 28.0 / 1280.0, 1200.0 / 1280.0, 150.0 / 1280.0
"""Longest side of a box over the width of the frame: of a lamp the first, and the second over its range in metres."""

KINDS = ("front lamps", "rear lamps", "light of front lamps", "light of rear lamps")


def lights_of(vehicle: VehicleTruth) -> list[tuple[str, tuple[float, float], float, float]]:
    """Kind and place of the vehicle's lights that count, with the margin and the longest side of their boxes."""
    side = LAMP_SIDE + LAMP_SIDE_M / max(vehicle.range_m, 1.0)
    low, high = RANGES_M
    lamps = [lamp for lamp in vehicle.lamps if low <= vehicle.range_m <= high and lamp.intensity_cd >= 1.0]
    return [
        (KINDS[lamp.is_rear], lamp.position_px, MARGIN, side)
        for lamp in lamps
        if lamp.visible_share >= MIN_VISIBLE_SHARE
    ] + [
        (KINDS[2 + artifact.is_rear], artifact.position_px, 0.0, LIGHT_SIDE)
        for artifact in vehicle.artifacts
        if not (artifact.is_direct or artifact.is_doubtful)
    ]


def holds(boxes_xyxy_px: Boxes, position_px: tuple[float, float], margin_px: float, side_px: float) -> bool:
    """Whether any of the boxes with sides of at most `side_px` holds the position."""
    x, y = position_px
    sides_px = boxes_xyxy_px[:, 2:] - boxes_xyxy_px[:, :2]
    x1, y1, x2, y2 = boxes_xyxy_px[sides_px.max(axis=1, initial=0) <= side_px].T
    return bool(((x1 - margin_px <= x) & (x <= x2 + margin_px) & (y1 - margin_px <= y) & (y <= y2 + margin_px)).any())


def measure(split: Path, proposer: Proposer) -> dict[str, float]:
    """Shares of the lights of each kind in a proposal, and proposals a frame."""
    dataset, sequence = open_labelled(split), functools.lru_cache(1)(read_truth(split).sequence)
    num, num_held, num_boxes = Counter[str](), Counter[str](), 0
    for image_id in dataset.frame_ids:
        image = dataset.read(image_id).image
        boxes = proposer.propose(image).boxes_xyxy_px
        num_boxes += len(boxes)
        height, width = image.shape
        for vehicle in sequence(image_id // MAX_FRAMES).frame(image_id).vehicles:
            for kind, position_px, margin, side in lights_of(vehicle):
                if 0 <= position_px[0] < width and 0 <= position_px[1] < height:
                    num[kind] += 1
                    num_held[kind] += holds(boxes, position_px, margin * width, side * width)
    shares = {kind: num_held[kind] / num[kind] if num[kind] else float("nan") for kind in KINDS}
    return {**shares, "number of lamps": num[KINDS[0]] + num[KINDS[1]], "boxes": num_boxes / len(dataset.frame_ids)}


def main(arguments: list[str] | None = None) -> None:
    """Measures, prints a table, and writes the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("splits", nargs="+", type=Path, metavar="SPLIT")
    parser.add_argument("--preset", nargs="+", choices=list(PRESETS), default=list(PRESETS))
    parser.add_argument("--out", type=Path, default=RESULTS / "lamps_in_proposals.json")
    asked = parser.parse_args(arguments)
    rows = [
        {"split": str(split), "preset": name, **measure(split, make_proposer(preset(name).proposals))}
        for split in asked.splits
        for name in asked.preset
    ]
    shown = table("Share of the lights in a proposal", ["split", "preset"], [*KINDS, "boxes a frame"])
    for row in rows:
        figures = [f"{np.round(row[kind], 3):g}" for kind in KINDS]
        shown.add_row(str(row["split"]), str(row["preset"]), *figures, f"{row['boxes']:.1f}")
    CONSOLE.print(shown)
    write_json_results(asked.out, rows, indent=2)


if __name__ == "__main__":
    main()
