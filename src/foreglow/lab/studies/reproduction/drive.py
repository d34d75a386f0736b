"""One drive in pictures: the paper's figures of a scene, of the detector's stages, and of the road ahead."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from foreglow.beam.policy import brightness
from foreglow.config import PipelineConfig
from foreglow.datasets import open_labelled
from foreglow.files import write_json_results
from foreglow.geometry import Floats
from foreglow.lab.evaluation import Predictions, read_split_labels
from foreglow.lab.evaluation.boxes.lights import Light
from foreglow.lab.evaluation.boxes.matching import lies_in
from foreglow.lab.evaluation.ratios import share
from foreglow.lab.reports.road_picture import road_picture
from foreglow.lab.reports.stage_picture import stage_picture
from foreglow.lab.studies.demo.figures import write_moments
from foreglow.lab.studies.demo.metrics import Moment, Story, best_story, tell_stories
from foreglow.lab.studies.progress import Progress, counted
from foreglow.pipeline import Pipeline
from foreglow.provenance import provenance
from foreglow.types import Frame, Tracks
from foreglow.whole_files import together, write_atomic

STATES = ("light", "sight", "reported")
"""The moments of the paper's first figure: first light, the vehicle comes into sight, it is in full sight."""


def run_drive(split: Path, config: PipelineConfig, folder: Path, progress: Progress) -> None:
    """Writes `states.png`, `moments.png`, `stages.png`, `road.png` and `results.json` of one drive to `folder`.

    Raises:
        FileNotFoundError: If an image or a label file is missing.
        ValueError: If one is broken, or there is no vehicle's light.
    """
    dataset = open_labelled(split)
    pipeline = Pipeline(config)
    boxes, scores, tracks, gaps_rad = {}, {}, {}, {}
    lights, on_lamps = read_split_labels(dataset).lights, []
    for frame in counted(dataset, "images", len(dataset), progress):
        result = pipeline.step(frame)
        assert result.detections is not None  # commands are made from tracks
        assert result.tracks is not None
        assert result.beam is not None
        boxes[frame.frame] = result.detections.boxes_xyxy_px.astype(np.float64)
        scores[frame.frame] = result.detections.scores.astype(np.float64)
        tracks[frame.frame], gaps_rad[frame.frame] = result.tracks, result.beam.gaps_rad
        lamps_px = np.array([light.position_px for light in lights[frame.frame] if light.is_direct])
        if len(lamps_px) and result.tracks.is_plausible.any():
            on_lamps.append(_brightest_holds(frame, result.tracks, lamps_px))
    predictions, threshold = Predictions(boxes, scores), config.classifier.score_threshold
    story = chosen_story(tell_stories(dataset, predictions, threshold, tracks, gaps_rad))
    if story is None:
        raise ValueError(f"{dataset.root}: expected a vehicle whose light is annotated, found none")
    frames = [dataset.read(moment.light.image_id) for moment in story.moments.values()]
    with together():
        write_moments(folder / "moments.png", story, frames, predictions, threshold)
        write_moments(folder / "states.png", story, frames, predictions, threshold, STATES)
        shown = dataset.read((story.found or story.light).light.image_id)
        detector = Pipeline(config.detector_only)
        write_atomic(folder / "stages.png", stage_picture(shown, detector.step(shown), detector.config))
        if shown.camera is not None and shown.road is not None:
            write_atomic(folder / "road.png", road_picture(shown))
        light_s = story.times.light_s
        times = {"found_s": story.times.found_s, "confirmed_s": story.confirmed_s, "production_s": story.production_s}
        record: dict[str, Any] = {
            "sequence": story.sequence,
            **{name: time_s - light_s for name, time_s in times.items()},
            "brightest": {"num": len(on_lamps), "share": share(on_lamps)},
        }
        if story.found is not None:
            record["found_lights"] = _lights_found(story.found, lights, predictions, threshold)
        opening = story.seen.get(story.gap_s)
        if opening is not None and story.gaps_rad:
            frame = dataset.read(opening.light.image_id)
            record["gap"] = _gap(frame, opening, story.gaps_rad[story.gap_s], predictions)
        write_json_results(folder / "results.json", {"made_with": provenance(), **record})


def chosen_story(stories: Sequence[Story]) -> Story | None:
    """Of the stories in which all happens that the paper's scene shows, that with the longest lead, if there are any.

    A gap that was there before the light was for something else. One whose light is there from its first image on says
    little about times after the first light: only without others.
    """
    whole = [
        story
        for story in stories
        if story.confirmed_s < story.production_s and story.gaps_rad and story.gap_s >= story.times.light_s
    ]
    begun = [story for story in whole if story.num_images_before]
    return best_story(begun or whole or stories)


def _lights_found(
    found: Moment, lights: Mapping[int, Sequence[Light]], predictions: Predictions, threshold: float
) -> dict[str, int]:
    """How many lamps and other lights accepted boxes hold in the image of `found`."""
    image_id = found.light.image_id
    boxes_xyxy_px = predictions.boxes_xyxy_px[image_id][predictions.scores[image_id] > threshold]
    there = lights[image_id]
    points_px = np.array([light.position_px for light in there])
    is_held = lies_in(points_px[:, np.newaxis], boxes_xyxy_px).any(axis=1)
    is_direct = np.array([light.is_direct for light in there])
    return {"direct": int((is_held & is_direct).sum()), "indirect": int((is_held & ~is_direct).sum())}


def _gap(
    frame: Frame, opening: Moment, gap_rad: tuple[float, float], predictions: Predictions
) -> dict[str, float | None]:
    """Width of a gap, its middle to the left of the light, and the width of the widest box around that, degrees."""
    camera = frame.camera
    assert camera is not None  # otherwise there are no gaps

    def azimuth_deg(x_px: float) -> float:
        ray = camera.vehicle_from_camera.rotation @ camera.rays(np.array([[x_px, opening.light.position_px[1]]]))[0]
        return math.degrees(math.atan2(ray[1], ray[0]))

    point = np.array([opening.light.position_px])
    boxes = [box for box in predictions.boxes_xyxy_px[frame.frame].tolist() if lies_in(point, np.array(box)).any()]
    right_deg, left_deg = map(math.degrees, gap_rad)
    return {
        "width_deg": left_deg - right_deg,
        "left_deg": (left_deg + right_deg) / 2 - azimuth_deg(opening.light.position_px[0]),
        "box_deg": max((azimuth_deg(box[0]) - azimuth_deg(box[2]) for box in boxes), default=None),
    }


def _brightest_holds(frame: Frame, tracks: Tracks, points_px: Floats) -> bool:
    """Whether the brightest plausible track, which alone the paper acts on, holds one of the points."""
    boxes_xyxy_px = tracks.boxes_xyxy_px[tracks.is_plausible]
    brightest = max(boxes_xyxy_px, key=lambda box: brightness(frame.image, box))
    return bool(lies_in(points_px, brightest).any())
