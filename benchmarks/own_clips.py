"""What correcting and fine-tuning brings on real clips: learn from one half of the marked frames, judge by the other.

`python -m benchmarks.own_clips MARKS CLIPS --out DIR --drives SPLIT...`: MARKS has a folder for each clip with bright
spots (`candidates.json`) and what each is (`labels.json`), CLIPS the videos, SPLIT are splits of simulated drives that
nothing may be lost on. It goes the way of a user: labels as a CVAT file, `labels import`, `train --from`. Both halves
are learnt from in turn, so that every marked frame is judged once. MARKS do not say what is in boxes without a spot,
many of which hold light of vehicles: such boxes are marked as doubtful, and count neither as right nor as wrong.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from foreglow.config import PipelineConfig, preset
from foreglow.datasets import PVDN, Video
from foreglow.datasets.exchange import LabelFile, LabelSet, Mark, write_labels_file, write_split
from foreglow.datasets.exchange.marks import ImageLabels, Kind
from foreglow.lab.evaluation.boxes.matching import lies_in
from foreglow.lab.learning.annotation import IGNORED, POSITIVE
from foreglow.lab.learning.fine_tuning import box_figures, fine_tune, fine_tuning_recipe, light_scores
from foreglow.lab.learning.model_import import StartingPoint, read_model
from foreglow.lab.learning.recipes import changed
from foreglow.lab.learning.sample_cache import cached_samples
from foreglow.lab.learning.samples import SampleConfig
from foreglow.lab.learning.training import score_samples, torch_device
from foreglow.pipeline import Pipeline
from foreglow.proposals import make_proposer

LIGHT_MARKS: dict[str, dict[str, bool]] = {
    "headlamp": {"is_direct": True},
    "reflection": {},
    "tail": {"is_direct": True, "is_rear": True},
}
"""Spots that are light of a vehicle; a model of one score is not taught rear lamps, which PVDN does not label."""

OWN_LIGHT = {"headlamp", "reflection"}

Spots = dict[int, list[tuple[tuple[int, int], str]]]
"""Position and class of the spots in each marked frame."""


@dataclass(frozen=True, slots=True)
class Clip:
    """A clip with marked frames.

    Attributes:
        unknown: As of `unknown_boxes`.
    """

    name: str
    video: Path
    size_px: tuple[int, int]
    spots: Spots
    unknown: dict[int, list[tuple[int, int]]]


def read_clips(marks: Path, clips: Path) -> Iterator[Clip]:
    """The clips in MARKS."""
    for folder in sorted(path for path in marks.iterdir() if path.is_dir()):
        found = json.loads((folder / "candidates.json").read_text())
        spots: Spots = {}
        for frame, told in json.loads((folder / "labels.json").read_text()).items():
            classes = (told["classes"][str(index)] for index in range(len(found["frames"][frame])))
            positions = zip(map(tuple, found["frames"][frame]), classes, strict=True)
            spots[int(frame)] = [*positions, *((tuple(each), "headlamp") for each in told["missed_headlamps"])]
        video = clips / found["video"]
        yield Clip(folder.name, video, (found["width"], found["height"]), spots, unknown_boxes(video, spots))


def unknown_boxes(video: Path, spots: Spots) -> dict[int, list[tuple[int, int]]]:
    """The middle of each box of the preset without a spot, in each marked frame.

    Left out are those in another box that has spots, and none of light of a vehicle: they are a part of it.
    """
    proposer = make_proposer(preset("foreglow").proposals)
    found = {}
    for frame in Video(video):
        if frame.frame in spots:
            boxes = proposer.propose(frame.image).boxes_xyxy_px
            kinds = np.array([kind for _, kind in spots[frame.frame]], str)
            positions = np.array([position for position, _ in spots[frame.frame]]).reshape(-1, 2)
            is_in = lies_in(positions, boxes[:, None])
            may_be_light = is_in[:, np.isin(kinds, [*LIGHT_MARKS, "unsure"])].any(axis=1)
            wrong = boxes[is_in.any(axis=1) & ~may_be_light]
            middles = (boxes[:, :2] + boxes[:, 2:])[~is_in.any(axis=1)] // 2
            is_apart = ~lies_in(middles[:, None], wrong).any(axis=1)
            found[frame.frame] = [(x, y) for x, y in middles[is_apart].tolist()]
        if frame.frame >= max(spots):
            break
    return found


def write_half(clip: Clip, half: int, folder: Path, has_kinds: bool) -> Path:
    """The data set of every second marked frame, whose split `train` is imported from a CVAT file."""
    data = folder / f"{clip.name}_{half}{'_kinds' if has_kinds else ''}"
    if not (data / "train").exists():
        images = []
        for frame in sorted(clip.spots)[half::2]:
            points = [_mark(position, kind, has_kinds) for position, kind in clip.spots[frame]]
            points += [Mark(Kind.DOUBTFUL, position) for position in clip.unknown[frame]]
            told = tuple(point for point in points if point is not None)
            images.append(ImageLabels(f"frame_{frame:06d}.png", clip.size_px, told))
        data.mkdir(parents=True, exist_ok=True)
        write_labels_file(data / "labels.xml", LabelSet(tuple(images), is_video=True), "cvat")
        write_split(LabelFile(data / "labels.xml", clip.video), data / "train")
    return data


def _mark(position_px: tuple[int, int], kind: str, has_kinds: bool) -> Mark | None:
    if kind in OWN_LIGHT or (kind == "tail" and has_kinds):
        return Mark(Kind.LIGHT, position_px, **LIGHT_MARKS[kind])
    return Mark(Kind.DOUBTFUL, position_px) if kind == "unsure" else None


def count(split: PVDN, config: PipelineConfig, spots: Spots, right: set[str]) -> Counter[str]:
    """Spots and accepted boxes by class, over the images of a split."""
    counts: Counter[str] = Counter()
    pipeline = Pipeline(config)
    for image_id in split.frame_ids:
        pipeline.reset()
        detections = pipeline.step(split.read(image_id)).detections
        assert detections is not None
        boxes = detections.accepted_boxes_xyxy_px
        inside = [
            [x1 <= x <= x2 and y1 <= y <= y2 for x1, y1, x2, y2 in boxes.tolist()] for (x, y), _ in spots[image_id]
        ]
        for (_, kind), held in zip(spots[image_id], inside, strict=True):
            counts[f"{kind} spots"] += 1
            counts[f"{kind} accepted"] += any(held)
        for index in range(len(boxes)):
            kinds = {kind for (_, kind), held in zip(spots[image_id], inside, strict=True) if held[index]}
            verdict = "right" if kinds & right else "unsure" if "unsure" in kinds else "wrong" if kinds else "unknown"
            counts[f"boxes {verdict}"] += 1
    return counts


def line(name: str, counts: Counter[str]) -> str:
    """A row of the table."""
    kinds = ("headlamp", "reflection", "tail", "fixed", "own", "artefact")
    shares = (f"{kind} {counts[f'{kind} accepted'] / max(1, counts[f'{kind} spots']):.2f}" for kind in kinds)
    known = counts["boxes right"] + counts["boxes wrong"]
    return f"{name}: {', '.join(shares)}; precision {counts['boxes right'] / max(1, known):.3f} of {known} known boxes"


def average_precisions(start: StartingPoint, networks: list[Any], drives: list[Path], cache: Path) -> None:
    """Prints that of boxes, for each split of simulated drives and each network: by whose light, and by key points."""
    by_points = SampleConfig(proposals=preset("foreglow").proposals, inputs=start.inputs)
    for drive in drives:
        for name, config in (("light", by_points.model_copy(update={"by_light": True})), ("key points", by_points)):
            samples = cached_samples(PVDN(drive), config, cache)
            samples = samples[samples.labels != IGNORED]
            scores = (light_scores(score_samples(network, samples, torch_device("cpu"))) for network in networks)
            is_light = samples.labels == POSITIVE
            found = [box_figures(each, is_light, 0.5).average_precision for each in scores]
            print(f"{drive}: average precision by {name} {' '.join(f'{value:.3f}' for value in found)}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("marks", type=Path)
    parser.add_argument("clips", type=Path)
    parser.add_argument("--model", type=Path, default=Path("foreglow"))
    parser.add_argument("--drives", type=Path, nargs="*", default=[], help="splits of simulated drives")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, help="of the trainings (default: that of the recipe)")
    parser.add_argument("--cache", type=Path, help="where samples are kept (default: in OUT)")
    given = parser.parse_args()
    cache = given.cache or given.out / "samples"
    start = read_model(given.model)
    right = OWN_LIGHT | ({"tail"} if start.has_kinds else set())
    clips = list(read_clips(given.marks, given.clips))
    networks = [start.network]
    totals: dict[tuple[str, str], Counter[str]] = {}
    for half in (0, 1):
        data = [write_half(clip, half, given.out / "own", start.has_kinds) for clip in clips]
        base = preset("foreglow").detector_only
        classifier = base.classifier.model_copy(update={"model": given.model})
        before = base.model_copy(update={"classifier": classifier})
        begun = read_model(given.model)
        folder = given.out / f"learnt_{half}"
        recipe = fine_tuning_recipe(begun)
        recipe = recipe if given.seed is None else changed(recipe, {"seed": given.seed})
        summary, _ = fine_tune(data, begun, recipe, before, folder, cache=cache)
        networks.append(read_model(folder / "model.onnx").network)
        print(f"half {half}: {summary['seconds']} s, way {summary['way']}, {summary['samples']}", flush=True)
        learnt = classifier.model_copy(update={"model": folder / "model.onnx"})
        after = base.model_copy(update={"classifier": learnt})
        for clip in clips:
            other = PVDN(write_half(clip, 1 - half, given.out / "own", start.has_kinds) / "train")
            for name, config in (("before", before), ("after", after)):
                found = totals.setdefault((clip.name, name), Counter())
                found.update(count(other, config, clip.spots, right))
    for (clip_name, name), counts in totals.items():
        print(line(f"{clip_name} {name}", counts), flush=True)
    average_precisions(start, networks, given.drives, cache)


if __name__ == "__main__":
    main()
